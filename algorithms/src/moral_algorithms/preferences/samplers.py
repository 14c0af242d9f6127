"""Markov chain Monte Carlo samplers of the posterior; every chain advances in one array operation.

A sampler takes a log-density on (m, d) points (up to a constant), the prior that gives the support,
approximate samples to start from and a generator, and returns as many new samples. Bind its own arguments
with `functools.partial`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from .priors import FloatArray, Prior

LogDensity = Callable[[FloatArray], FloatArray]


class Sampler(Protocol):
    """A function from (m, d) approximate samples of `log_density` to (m, d) new ones."""

    def __call__(
        self, log_density: LogDensity, prior: Prior, start: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """Draw the samples; `start` lies in the support of `prior`."""
        ...


def hit_and_run(
    log_density: LogDensity,
    prior: Prior,
    start: FloatArray,
    rng: np.random.Generator,
    *,
    num_sweeps: int = 4,
) -> FloatArray:
    """Hit-and-run (Smith 1984) with slice sampling on the chord, one chain from each starting point.

    A step draws a direction, then a new point on the line through the current one, cut off at the support.
    Directions are scaled by the chains' covariance, taken anew during the first half of the sweeps; the
    second half leaves it alone, as a kernel that keeps adapting to its own chains would be biased. The
    returned samples are the chains' last points.

    Parameters
    ----------
    num_sweeps : int
        Length of the chains, in sweeps of d steps each. A step redraws one of d directions, so a chain
        forgets its start at a rate of about (1 - 1/d)**d, or e**-1, a sweep.

    Raises
    ------
    ValueError
        If `num_sweeps` is below 1.
    """
    if num_sweeps < 1:
        raise ValueError(f"num_sweeps is {num_sweeps}; it must be at least 1")
    points: FloatArray = start.copy()
    log_densities = log_density(points)
    dim = points.shape[1]
    transform: FloatArray = np.eye(dim)
    for sweep in range(num_sweeps):
        if 2 * sweep < num_sweeps:
            transform = _covariance_root(points)
        for _ in range(dim):
            normals = rng.standard_normal(points.shape)
            directions = normals / np.linalg.norm(normals, axis=1, keepdims=True) @ transform.T
            points, log_densities = _slice(log_density, prior, points, log_densities, directions, rng)
    return points


def metropolis(
    log_density: LogDensity,
    prior: Prior,
    start: FloatArray,
    rng: np.random.Generator,
    *,
    num_chains: int = 100,
    num_warm_up: int = 500,
    num_thinning: int = 20,
) -> FloatArray:
    """Random walk Metropolis from beside v = 0, the mode of the thesis's proxy (eq. 4.6 to 4.8).

    A prior whose mass is far from there, such as the rationality prior's under consistent answers, takes a
    longer warm-up: directions settle early, the length of v late. Hit-and-run has no such trouble.

    Several chains run side by side, and `start` gives no more than their number and first sigma. The proposal
    is N(v, sigma**2 I). During the warm-up sigma follows the acceptance rate of all chains towards 0.3, near
    the random walk's optimum (Roberts, Gelman and Gilks 1997): any constant is too wide once the answers add
    up.

    Parameters
    ----------
    num_chains : int
        Number of chains, at most the number of samples.
    num_warm_up : int
        Steps of each chain before its first sample.
    num_thinning : int
        Steps of each chain from one sample to the next.

    Raises
    ------
    ValueError
        If `num_chains` or `num_thinning` is below 1, or `num_warm_up` below 0.
    """
    for name, value, least in (
        ("num_chains", num_chains, 1),
        ("num_warm_up", num_warm_up, 0),
        ("num_thinning", num_thinning, 1),
    ):
        if value < least:
            raise ValueError(f"{name} is {value}; it must be at least {least}")
    num_samples, dim = start.shape
    # The origin, but for a prior that has no density where a component is zero.
    points = np.full((min(num_chains, num_samples), dim), np.finfo(np.float64).tiny)
    log_densities = log_density(points)
    sigma = math.sqrt(start.var(axis=0).mean() + np.finfo(np.float64).tiny)
    num_kept = math.ceil(num_samples / len(points))
    kept: list[FloatArray] = []
    for step in range(1, num_warm_up + num_kept * num_thinning + 1):
        proposals = points + sigma * rng.standard_normal(points.shape)
        proposed_log_densities = log_density(proposals)
        accepted = -rng.standard_exponential(len(points)) < proposed_log_densities - log_densities
        points = np.where(accepted[:, None], proposals, points)
        log_densities = np.where(accepted, proposed_log_densities, log_densities)
        if step <= num_warm_up:
            sigma *= math.exp(accepted.mean() - _ACCEPTANCE)
        elif (step - num_warm_up) % num_thinning == 0:
            kept.append(points)
    return np.concatenate(kept)[:num_samples]


def resample(samples: FloatArray, log_weights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Resample (m, d) rows in proportion to exp(log_weights), (m,), systematically."""
    total = np.cumsum(np.exp(log_weights - log_weights.max()))
    num_samples = len(samples)
    picks = (np.arange(num_samples) + rng.random()) / num_samples * total[-1]
    rows: FloatArray = samples[np.minimum(np.searchsorted(total, picks), num_samples - 1)]
    return rows


SAMPLERS: dict[str, Sampler] = {"hit_and_run": hit_and_run, "metropolis": metropolis}

# Of the random walk's proposals.
_ACCEPTANCE = 0.3
# A slice of a Gaussian whose deviation is 1 is about this wide, so few chains step out more than once.
_STEP_WIDTH = 4.0
# In both directions together. It bounds a step's cost where chains start much closer together than they end.
_MAX_STEPS = 16
# Shrinking stops by itself at the current point; the bound only stops a density that returns NaN.
_MAX_SHRINKS = 200


def _slice(
    log_density: LogDensity,
    prior: Prior,
    points: FloatArray,
    log_densities: FloatArray,
    directions: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Move each point along its chord: slice sampling, stepping out and shrinking (Neal 2003, section 4)."""
    levels = log_densities - rng.standard_exponential(len(points))
    chord_low, chord_high = prior.chord(points, directions)
    behind = _STEP_WIDTH * rng.random(len(points))
    ahead = _STEP_WIDTH - behind
    steps_behind = rng.integers(_MAX_STEPS, size=len(points))
    limits_behind = np.minimum(-chord_low, behind + _STEP_WIDTH * steps_behind)
    limits_ahead = np.minimum(chord_high, ahead + _STEP_WIDTH * (_MAX_STEPS - 1 - steps_behind))
    low = -_step_out(log_density, points, -directions, levels, behind, limits_behind)
    high = _step_out(log_density, points, directions, levels, ahead, limits_ahead)

    moved, moved_log_densities = points.copy(), log_densities.copy()
    active = np.arange(len(points))
    for _ in range(_MAX_SHRINKS):
        t = low[active] + (high[active] - low[active]) * rng.random(active.size)
        candidates = points[active] + t[:, None] * directions[active]
        candidate_log_densities = log_density(candidates)
        accepted = candidate_log_densities > levels[active]
        moved[active[accepted]] = candidates[accepted]
        moved_log_densities[active[accepted]] = candidate_log_densities[accepted]
        active, t = active[~accepted], t[~accepted]
        if active.size == 0:
            break
        behind_start = t < 0.0
        low[active[behind_start]] = t[behind_start]
        high[active[~behind_start]] = t[~behind_start]
    return moved, moved_log_densities


def _step_out(
    log_density: LogDensity,
    points: FloatArray,
    directions: FloatArray,
    levels: FloatArray,
    distances: FloatArray,
    limits: FloatArray,
) -> FloatArray:
    """Lengthen `distances` by whole steps until each ends below its slice's level or at its limit."""
    distances = distances.copy()
    active = np.flatnonzero(distances < limits)
    while active.size:
        ends = points[active] + distances[active, None] * directions[active]
        active = active[log_density(ends) > levels[active]]
        distances[active] += _STEP_WIDTH
        active = active[distances[active] < limits[active]]
    return np.minimum(distances, limits)


def _covariance_root(points: FloatArray) -> FloatArray:
    """Lower triangular L with L L^T the covariance of (m, d) points, kept off singularity."""
    centred = points - points.mean(axis=0)
    covariance = centred.T @ centred / len(points)
    # A deviation of 1e-4 of the points' size, from which chains that all start at one point can spread.
    ridge = 1e-8 * (points**2).mean() + np.finfo(np.float64).tiny
    root: FloatArray = np.linalg.cholesky(covariance + ridge * np.eye(points.shape[1]))
    return root
