"""How environments are seeded and batches reset: the arguments of ``reset``, checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moral_envs.arguments import as_integer
from moral_envs.streams import spawn_streams

Seeds = int | Sequence[int | None] | NDArray[np.integer] | None
"""What a batch is seeded with."""


class Streams(NamedTuple):
    """Random streams for a batch."""

    states: NDArray[np.uint64]
    """Shape (n,)."""
    given: NDArray[np.bool_]
    """Which environments get theirs, shape (n,)."""


def require_mask(options: object, num_envs: int) -> NDArray[np.bool_] | None:
    """Return ``options["reset_mask"]``, None without one, or raise a ValueError if it does not fit."""
    if options is not None and not isinstance(options, dict):
        raise ValueError(f"options is {options!r}; it must be a dict or None")
    mask = None if options is None else options.get("reset_mask")
    if mask is None:
        return None
    mask = np.asarray(mask)
    if mask.shape != (num_envs,) or mask.dtype != np.bool_:
        found, wanted = f"{mask.dtype} {mask.shape}", f"bool {(num_envs,)}"
        raise ValueError(f"options['reset_mask'] is {found}; it must be {wanted}")
    return mask


def still_waiting(
    waiting: NDArray[np.bool_] | None, mask: NDArray[np.bool_] | None
) -> NDArray[np.bool_] | None:
    """Which environments still wait after a reset of ``mask``, of all if it is None; None if none does."""
    if waiting is None or mask is None:
        return None
    left = waiting & ~mask
    return left if left.any() else None


def require_started(waiting: NDArray[np.bool_] | None) -> None:
    """Raise a ValueError about actions if environments wait for their first reset; None: none does."""
    if waiting is not None:
        which = "" if waiting.all() else f" of environment {int(waiting.argmax())}"
        raise ValueError(f"actions were given before the first episode{which}; call reset first")


def require_streams(seed: object, num_envs: int, mask: NDArray[np.bool_] | None) -> Streams | None:
    """Return the streams of one seed, or of a sequence of them, or raise a ValueError; None without any."""
    everywhere = np.ones(num_envs, dtype=np.bool_) if mask is None else mask
    number = as_integer(seed)
    if number is not None:
        return Streams(spawn_streams(number, num_envs), everywhere)
    if seed is None:
        return None
    if isinstance(seed, np.ndarray) and seed.ndim == 1:
        seed = list(seed)
    if not isinstance(seed, Sequence) or isinstance(seed, (str, bytes)):
        shown = " ".join(repr(seed).split())
        raise ValueError(f"seed is {shown}; it must be an integer, None or a sequence of {num_envs}")
    if len(seed) != num_envs:
        raise ValueError(f"seed has {len(seed)} entries; it must be one integer or {num_envs}")
    given = np.array([one is not None for one in seed], dtype=np.bool_)
    return Streams(np.concatenate([spawn_streams(one, 1) for one in seed]), given & everywhere)


def known_seed(np_random_seed: int | None) -> int | None:
    """Return Gymnasium's ``np_random_seed``; None where it is -1, since the generator was replaced."""
    return None if np_random_seed == -1 else np_random_seed
