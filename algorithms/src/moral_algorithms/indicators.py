"""Measures of a set of vector returns, one row per policy, all to be maximised.

A set is a float array (n, k): n >= 1 policies, k >= 2 objectives, in any order and with any duplicates. Its
worth as a whole is told by its hypervolume, its expected utility or its distance from a known front; which of
its members are worth keeping, by `pareto_optimal` and `convex_coverage`; how well its members keep a wanted
ratio between the objectives, by `preference_deviation`.

Distances and utilities add up objectives: bring these to comparable scales first.
"""

from __future__ import annotations

import moocore  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moral_algorithms.preferences import ratio_divergence

_TOLERANCE = 1e-8
_SOLVER_TOLERANCE = 1e-10


def hypervolume(points: ArrayLike, reference: ArrayLike) -> float:
    """Volume between a reference point and the surface that a set spans (Zitzler and Thiele, 1998).

    The volume of {x : reference <= x <= p for some point p}. Dominated points and duplicates add nothing.

    Parameters
    ----------
    points : float, shape (n, k)
        Vector returns.
    reference : float, shape (k,)
        What every point reaches in every objective. Sets can be compared only under the same reference.

    Returns
    -------
    float
        The volume; higher is better.

    Raises
    ------
    ValueError
        If a shape is wrong, a value is not finite, or the reference exceeds a point in some objective.
    """
    points = _points("points", points)
    reference = np.array(reference, dtype=np.float64)
    if reference.shape != points.shape[1:]:
        raise ValueError(f"reference has shape {reference.shape}; it must be {points.shape[1:]}")
    if not np.isfinite(reference).all():
        raise ValueError(f"reference is {reference.tolist()}; every value must be finite")
    worst = points.min(axis=0)
    # The volume would leave such a point out without a word.
    if (reference > worst).any():
        raise ValueError(
            f"reference is {reference.tolist()}; it must be at most {worst.tolist()}, the points' minimum"
        )
    return float(moocore.hypervolume(points, ref=reference, maximise=True))


def igd(points: ArrayLike, front: ArrayLike) -> float:
    """Inverted generational distance of a set from a front (Coello Coello and Reyes Sierra, 2004).

    The mean, over the points of the front, of the Euclidean distance to the nearest point of the set. A set
    that goes beyond the front is measured as if it had stayed behind it, and may score worse than one that it
    dominates; :func:`igd_plus` never does.

    Parameters
    ----------
    points : float, shape (n, k)
        Vector returns.
    front : float, shape (m, k)
        What could be reached, usually the Pareto front.

    Returns
    -------
    float
        The distance; lower is better, and 0 means that every point of the front is in the set.

    Raises
    ------
    ValueError
        If a shape is wrong or a value is not finite.
    """
    points, front = _points_and_front(points, front)
    return float(moocore.igd(points, ref=front, maximise=True))


def igd_plus(points: ArrayLike, front: ArrayLike) -> float:
    """Inverted generational distance that counts only what is missing (Ishibuchi et al., 2015).

    As :func:`igd`, with the distance from a point of the front to a point of the set taken over those
    objectives alone in which the latter is worse. It never prefers a set to one that dominates it.

    Parameters
    ----------
    points : float, shape (n, k)
        Vector returns.
    front : float, shape (m, k)
        What could be reached, usually the Pareto front.

    Returns
    -------
    float
        The distance; lower is better, and 0 means that every point of the front is reached or exceeded.

    Raises
    ------
    ValueError
        If a shape is wrong or a value is not finite.
    """
    points, front = _points_and_front(points, front)
    return float(moocore.igd_plus(points, ref=front, maximise=True))


def expected_utility(points: ArrayLike, weights: ArrayLike) -> float:
    """Mean over scalarisation weights of the best scalarised return in a set (Zintgraf et al., 2015).

    Parameters
    ----------
    points : float, shape (n, k)
        Vector returns.
    weights : float, shape (m, k)
        Scalarisation weights, each row on the simplex; :func:`uniform_weights` draws them.

    Returns
    -------
    float
        The expected utility; higher is better. Sets can be compared only under the same weights.

    Raises
    ------
    ValueError
        If a shape is wrong, a value is not finite, or weights are negative or do not sum to 1.
    """
    points = _points("points", points)
    weights = _points("weights", weights, points.shape[1])
    # Room for weights that were stored as float32.
    wrong = (weights < 0.0).any(axis=1) | (np.abs(weights.sum(axis=1) - 1.0) > 1e-5)
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(
            f"weights[{row}] is {weights[row].tolist()}; weights must be nonnegative and sum to 1"
        )
    return float((weights @ points.T).max(axis=1).mean())


def uniform_weights(num_weights: int, num_objectives: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw scalarisation weights uniformly from the simplex.

    Parameters
    ----------
    num_weights : int
        How many, m.
    num_objectives : int
        Number k of objectives.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    float64, shape (m, k)
        Nonnegative rows that sum to 1.

    Raises
    ------
    ValueError
        If there is not at least one draw of at least two weights.
    """
    if num_weights < 1:
        raise ValueError(f"num_weights is {num_weights}; it must be at least 1")
    if num_objectives < 2:
        raise ValueError(f"num_objectives is {num_objectives}; it must be at least 2")
    return rng.dirichlet(np.ones(num_objectives), size=num_weights)


def pareto_optimal(points: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point dominates (thesis eq. 2.17).

    One point dominates another if it is at least as good in every objective and better in one, compared
    exactly. Duplicates do not dominate each other: either all of them are optimal or none is.

    Parameters
    ----------
    points : float, shape (n, k)
        Vector returns.

    Returns
    -------
    bool, shape (n,)
        Which points are Pareto optimal; at least one is.

    Raises
    ------
    ValueError
        If the shape is wrong or a value is not finite.
    """
    return _pareto_optimal(_points("points", points))


def convex_coverage(points: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that are optimal for some positive scalarisation weights (thesis eq. 2.18).

    These are the points that no mixture of the others dominates (Isermann, 1974); a linear programme for each
    seeks the mixture that gains most over it. Points on a face of the convex hull belong, not only its
    vertices, and of duplicates all or none. Weights of zero do not count: under (0, 0, 1) every point that
    ties for the best third objective is optimal, even one that a mixture dominates.

    Each objective is measured in units of its range over the Pareto-optimal points, so that scales do not
    matter. A point is left out if a mixture gains more than 1e-8 over it, summed over the objectives, and
    loses no more than 1e-10, the solver's tolerance, in any.

    Parameters
    ----------
    points : float, shape (n, k)
        Vector returns.

    Returns
    -------
    bool, shape (n,)
        Which points are in the convex coverage set, all of them Pareto optimal; at least one is.

    Raises
    ------
    ValueError
        If the shape is wrong or a value is not finite.
    """
    points = _points("points", points)
    covered = _pareto_optimal(points)
    candidates, positions = np.unique(points[covered], axis=0, return_inverse=True)
    spans = np.ptp(candidates, axis=0)
    candidates /= np.where(spans > 0.0, spans, 1.0)
    gains = np.array([_mixture_gain(candidates - candidate) for candidate in candidates])
    # NumPy 2.0 alone gives the positions a second axis.
    covered[covered] = (gains <= _TOLERANCE)[positions.ravel()]
    return covered


def preference_deviation(objectives: ArrayLike, ratio: ArrayLike) -> NDArray[np.float64]:
    """How far policies are from the ratio of objectives that they were to achieve (thesis eq. 5.12).

    The Kullback-Leibler divergence, in nats, of each policy's shares ``j / |j|_1`` from the wanted ones. As
    in the thesis's figures 5.4, 5.9, 5.11 and 5.12, j is what a policy achieves on average: the mean counters
    over episodes go in, not single episodes. The last two of those figures show the mean of the divergences
    over policies, each trained for a ratio of its own.

    Parameters
    ----------
    objectives : float, shape (n, k)
        Mean of each counter that the ratio is about, one row per policy.
    ratio : float, shape (k,) or (n, k)
        Wanted ratio, for all policies or for each; (3, 1, 1) and (0.6, 0.2, 0.2) are the same.

    Returns
    -------
    float64, shape (n,)
        The divergences; 0 where the ratio is met, infinite where nothing at all was achieved, as for
        :class:`~moral_algorithms.preferences.teachers.RatioTeacher`.

    Raises
    ------
    ValueError
        If a shape is wrong, a value is not finite, a counter is negative or a share is not positive.
    """
    objectives = _points("objectives", objectives)
    if (objectives < 0.0).any():
        raise ValueError(f"objectives holds {objectives.min()}; counters must not be negative")
    ratio = np.array(ratio, dtype=np.float64)
    if ratio.shape not in (objectives.shape, objectives.shape[1:]):
        raise ValueError(
            f"ratio has shape {ratio.shape}; it must be {objectives.shape[1:]} or {objectives.shape}"
        )
    possible = np.isfinite(ratio) & (ratio > 0.0)
    if not possible.all():
        raise ValueError(f"ratio holds {ratio[~possible][0]}; every share must be positive and finite")
    return ratio_divergence(objectives, ratio)


def _points(name: str, value: ArrayLike, num_objectives: int | None = None) -> NDArray[np.float64]:
    """Copy a set as float64 of shape (n, k), after checking it."""
    points = np.array(value, dtype=np.float64, order="C")
    expected = (
        "(n, k) with n >= 1 and k >= 2" if num_objectives is None else f"(m, {num_objectives}) with m >= 1"
    )
    if (
        points.ndim != 2
        or len(points) == 0
        or points.shape[1] < 2
        or num_objectives not in (None, points.shape[1])
    ):
        raise ValueError(f"{name} has shape {points.shape}; it must be {expected}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        row = int(finite.argmin())
        raise ValueError(f"{name}[{row}] is {points[row].tolist()}; every value must be finite")
    return points


def _points_and_front(points: ArrayLike, front: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = _points("points", points)
    return points, _points("front", front, points.shape[1])


def _pareto_optimal(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    optimal: NDArray[np.bool_] = moocore.is_nondominated(points, maximise=True, keep_weakly=True)
    return optimal


def _mixture_gain(differences: NDArray[np.float64]) -> float:
    """Find the most that a mixture gains over a point, summed over the objectives, without losing in any.

    `differences` (n, k) are those of all points from it. What of the mixture is left to the point itself,
    whose difference is zero, is the slack of the last constraint.
    """
    # Its import takes longer than all the rest of this module does.
    from scipy.optimize import linprog  # type: ignore[import-untyped]

    num_points, num_objectives = differences.shape
    solution = linprog(
        c=-differences.sum(axis=1),
        A_ub=np.vstack([-differences.T, np.ones(num_points)]),
        b_ub=np.append(np.zeros(num_objectives), 1.0),
        method="highs",
        options={
            "primal_feasibility_tolerance": _SOLVER_TOLERANCE,
            "dual_feasibility_tolerance": _SOLVER_TOLERANCE,
        },
    )
    if solution.status != 0:
        raise RuntimeError(f"the linear programme of a point was not solved: {solution.message}")
    return float(-solution.fun)
