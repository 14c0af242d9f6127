"""Independent seeds for the parts of a run."""

from __future__ import annotations

import numpy as np


def spawn_seeds(seed: int, count: int) -> list[int]:
    """Independent seeds below 2**32 for the parts of a run.

    Parameters
    ----------
    seed
        Entropy, 0 or more.
    count
        How many.

    Raises
    ------
    ValueError
        If ``seed`` is negative or no integer.
    """
    if not isinstance(seed, (int, np.integer)):
        raise ValueError(f"seed is {seed!r}; it must be an integer")
    if seed < 0:
        raise ValueError(f"seed is {seed}; it must be 0 or more")
    return [int(child.generate_state(1)[0]) for child in np.random.SeedSequence(seed).spawn(count)]
