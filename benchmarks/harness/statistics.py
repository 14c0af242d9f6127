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


def mean_with_interval(groups: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Mean over all values of some groups, then low and high of its :func:`stratified_interval`."""
    low, high = stratified_interval(groups, statistic=lambda values: float(values.mean()))
    return float(np.concatenate([np.asarray(group) for group in groups]).mean()), low, high


def write_mean(groups: Sequence[Sequence[float]]) -> str:
    """Write what :func:`mean_with_interval` finds."""
    mean, low, high = mean_with_interval(groups)
    return f"{mean:.4f}, 95 % interval {low:.4f} to {high:.4f}"


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Write mean, standard deviation and range over runs."""
    array = np.asarray(values, dtype=np.float64)
    if len(array) == 1:
        return f"{array[0]:.{digits}f}, 1 run"
    numbers = (array.mean(), array.std(ddof=1), array.min(), array.max())
    mean, deviation, least, most = (f"{number:.{digits}f}" for number in numbers)
    return f"{mean} ({deviation}), {least} to {most}, {len(array)} runs"
