"""Averages over few seeds and how sure they are (Agarwal et al. 2021)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

_RESAMPLES = 2000
_SEED = 0


def interquartile_mean(values: Sequence[float] | NDArray[np.float64]) -> float:
    """Mean of the middle half of the values; of fewer than four, of all.

    Raises
    ------
    ValueError
        If there are no values, or one is not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if not array.size or not np.isfinite(array).all():
        raise ValueError(f"values is {values}; an interquartile mean takes at least one, all finite")
    cut = array.size // 4
    return float(np.sort(array)[cut : array.size - cut].mean())


def stratified_interval(
    groups: Sequence[Sequence[float]],
    level: float = 0.95,
    statistic: Callable[[NDArray[np.float64]], float] = interquartile_mean,
) -> tuple[float, float]:
    """Bootstrap interval of a statistic over all values, resampling seeds within each group.

    Parameters
    ----------
    groups
        Values of the seeds of each configuration.
    level
        Probability that the interval is to cover.
    statistic
        What is asked for, of the values of all groups together.

    Returns
    -------
    low, high
        Percentile interval from 2,000 resamples; the same values give the same interval.

    Raises
    ------
    ValueError
        If a group is empty, a value is not finite, or ``level`` is not between 0 and 1.
    """
    if not groups or not all(len(group) and np.isfinite(group).all() for group in groups):
        raise ValueError(f"groups is {groups}; every group must hold at least one value, all finite")
    if not 0 < level < 1:
        raise ValueError(f"level is {level}; it must be between 0 and 1")
    rng = np.random.default_rng(_SEED)
    resampled = np.concatenate(
        [rng.choice(np.asarray(group, dtype=np.float64), (_RESAMPLES, len(group))) for group in groups],
        axis=1,
    )
    statistics = [statistic(row) for row in resampled]
    low, high = np.quantile(statistics, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def mean_with_interval(by_seed: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Mean over the values of all seeds, and a 95 % bootstrap interval that resamples whole seeds.

    Values of one seed may share a policy, and then tell little more than one of them does.

    Parameters
    ----------
    by_seed
        Values of each seed.

    Returns
    -------
    mean, low, high
    """
    means = [float(np.mean(values)) for values in by_seed]
    sizes = np.array([len(values) for values in by_seed])
    drawn = np.random.default_rng(_SEED).integers(len(means), size=(_RESAMPLES, len(means)))
    resampled = (np.array(means) * sizes)[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    low, high = np.quantile(resampled, [0.025, 0.975])
    return float(np.average(means, weights=sizes)), float(low), float(high)


def write_mean(by_seed: Sequence[Sequence[float]]) -> str:
    """Write the mean over the values of all seeds, and that of each seed."""
    means = ", ".join(f"{np.mean(values):.4f}" for values in by_seed)
    return f"{mean_with_interval(by_seed)[0]:.4f} (seeds: {means})"


def exceeds(these: Sequence[float], those: Sequence[float]) -> bool:
    """Whether the mean of these is above that of those by more than two standard errors of the difference.

    Of fewer than two values nobody knows how much they vary: then it is not.
    """
    if min(len(these), len(those)) < 2:
        return False
    error = np.sqrt(sum(np.var(values, ddof=1) / len(values) for values in (these, those)))
    return bool(np.mean(these) - np.mean(those) > 2 * error)


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Write mean, standard deviation and range over runs."""
    array = np.asarray(values, dtype=np.float64)
    if len(array) == 1:
        return f"{array[0]:.{digits}f}, 1 run"
    numbers = (array.mean(), array.std(ddof=1), array.min(), array.max())
    mean, deviation, least, most = (f"{number:.{digits}f}" for number in numbers)
    return f"{mean} ({deviation}), {least} to {most}, {len(array)} runs"
