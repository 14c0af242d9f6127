"""Random numbers for a batch of environments: one independent stream each, drawn without a loop.

NumPy's generators draw one stream at a time, so a batch of them needs a Python loop over environments at
every reset. SplitMix64 [1]_ is a hash of a counter: many streams are then one array operation, a stream's
whole state is one integer, and restoring it replays the episode.

.. [1] Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moral_envs.arguments import require_integer

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3, _HALF = (np.uint64(shift) for shift in (30, 27, 31, 32))


def spawn_streams(seed: int | None, count: int) -> NDArray[np.uint64]:
    """Independent stream states for a batch of environments.

    Parameters
    ----------
    seed
        Entropy of a ``numpy.random.SeedSequence``; None takes fresh entropy from the operating system.
    count
        How many streams to spawn.

    Returns
    -------
    uint64 array of shape (count,)
        One state per environment; the first does not depend on ``count``.

    Raises
    ------
    ValueError
        If the seed is negative or no integer.
    """
    if seed is not None:
        seed = require_integer("seed", seed, 0, "0 or more")
    children = np.random.SeedSequence(seed).spawn(count)
    return np.array([child.generate_state(1, np.uint64)[0] for child in children], dtype=np.uint64)


def seed_unseeded(
    states: NDArray[np.uint64], unseeded: NDArray[np.bool_], seed: int | None, mask: NDArray[np.bool_] | None
) -> None:
    """Give streams spawned from ``seed`` to those environments, in ``mask``, that have never been seeded.

    Parameters
    ----------
    states
        uint64 array of shape (n,), changed in place.
    unseeded
        Which have never been seeded, bool of shape (n,), changed in place.
    seed
        As for :func:`spawn_streams`.
    mask
        bool array of shape (n,); None: all.
    """
    chosen = unseeded if mask is None else unseeded & mask
    if chosen.any():
        states[chosen] = spawn_streams(seed, len(states))[chosen]
        unseeded[chosen] = False


def draw_integers(states: NDArray[np.uint64], bounds: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Draw integers from every stream and advance the states in place.

    Parameters
    ----------
    states
        uint64 array of shape (n,), changed in place.
    bounds
        uint64 array of shape (m,), or (m, n) with bounds for each stream: draw number ``i`` lies in
        ``0 .. bounds[i] - 1``. Bounds are at most 2**16 here, where the bias of the multiply-shift reduction
        is under 2**-16 of a draw's probability.

    Returns
    -------
    int64 array of shape (m, n)
        One row per draw.
    """
    steps = np.arange(1, len(bounds) + 1, dtype=np.uint64) * _GOLDEN
    words = states + steps[:, None]
    words ^= words >> _SHIFT_1
    words *= _MIX_1
    words ^= words >> _SHIFT_2
    words *= _MIX_2
    words ^= words >> _SHIFT_3
    states += steps[-1:]
    words >>= _HALF
    words *= bounds if bounds.ndim == 2 else bounds[:, None]
    words >>= _HALF
    return words.view(np.int64)
