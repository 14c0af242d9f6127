"""The exact optimum of Emergency: the yardstick for every learner.

People do not move and nothing is random after the start, so the best policy from a given start follows by
dynamic programming. One forward pass over (set of people saved, cell of the agent) keeps the most goal time
so far. At the horizon it has, for every number of people saved, the most goal time that goes with it: the
start's whole Pareto front, and with it the best policy for any scalarisation weights.

A *start* is an observation of a one-agent Emergency world: 0/1 planes ``(4, height, width)`` in the order
walls, agent, people, extinguisher. Any state will do, also one in mid-episode; `horizon` counts the steps
that remain. Walls inside the border are respected. Observations of Burning Warehouse have the same planes and
are not refused, but the results are then those of Emergency's rules: people who stand still and are saved
from beside them.

Results are in objectives, ``(goal_time, people_saved)``, in the order of the environment's
``objective_names``: steps on the extinguisher's cell, and people. The return in the reward vector
``(extinguish, save)`` is ``(EXTINGUISH_REWARD * goal_time, people_saved)``.

With a discount it matters when people are saved, not only how many, so `discounted_coverage_set` has a
dynamic programme of its own, in :mod:`moral_envs.discounted`, and its results are returns.

The convex coverage set is that of Roijers, Vamplew, Whiteson and Dazeley, "A Survey of Multi-Objective
Sequential Decision-Making", JAIR 48 (2013). The world is that of Peschl et al., "MORAL", AAMAS 2022.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from moral_envs.arguments import as_integer, is_chance, require_integer
from moral_envs.array_arguments import require_numbers, require_weights
from moral_envs.discounted import coverage_vertices
from moral_envs.emergency_starts import (
    EXTINGUISH_REWARD,
    neighbour_offsets,
    people_in_each_set,
    require_starts,
    seeded_starts,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

__all__ = [
    "EXTINGUISH_REWARD",
    "REFERENCE_POINT",
    "CoverageSet",
    "best_returns",
    "coverage_set",
    "discounted_coverage_set",
    "hypervolume",
    "lexicographic_optimum",
    "optimal_actions",
    "pareto_fronts",
    "seeded_starts",
]

REFERENCE_POINT = (0.0, 0.0)
"""Return from which Emergency's hypervolume is measured: no reward is negative, so no policy returns less."""

_WAIT, _FIRST_INTERACTION = 4, 5
# States of one chunk of starts: small enough for its arrays to stay in a processor's cache.
_CHUNK_STATES = 2**18
# Returns this close, relatively, are ties: it absorbs the rounding of 0.1 and of the weights.
_TIE = 1e-12


@dataclass(frozen=True)
class CoverageSet:
    """Vertices of a convex coverage set, from least to most weight on saving people.

    Attributes
    ----------
    points : float64 ``(m, 2)``
        Objectives ``(goal_time, people_saved)`` of each vertex: goal time falls and people saved rises from
        row to row.
    save_weights : float64 ``(m, 2)``
        Lowest and highest weight ``w`` at which the vertex is optimal for the scalarisation weights
        ``(1 - w, w)`` over the reward vector ``(extinguish, save)``. Each interval begins where the one
        before ends; together they are ``[0, 1]``.
    """

    points: npt.NDArray[np.float64]
    save_weights: npt.NDArray[np.float64]


def pareto_fronts(starts: npt.ArrayLike, horizon: int) -> npt.NDArray[np.int64]:
    """Most goal time for every number of people saved.

    Parameters
    ----------
    starts : uint8 ``(n, 4, height, width)``
        Start observations, all with the same number of people, ``p <= 12``. What they follow are Emergency's
        rules, also where they were observed in Burning Warehouse, whose planes are the same.
    horizon : int
        Steps in an episode, at least 0.

    Returns
    -------
    int64 ``(n, p + 1)``
        At ``[i, s]`` the most goal time, in steps, of any policy that saves exactly ``s`` people from start
        ``i``; -1 where none can. Rows never rise: whoever saves one person fewer may wait instead.

    Raises
    ------
    ValueError
        If `starts` are not such observations or `horizon` is no such number.
    """
    worlds = require_starts(starts)
    horizon = require_integer("horizon", horizon, 0, "at least 0")
    n, _, height, width = worlds.shape
    saved = people_in_each_set(worlds)
    fronts = np.empty((n, saved[-1] + 1), dtype=np.int64)
    chunk = max(1, _CHUNK_STATES // (len(saved) * height * width))
    for first in range(0, n, chunk):
        (goal_time,) = deque(_forward(worlds[first : first + chunk], horizon), maxlen=1)
        best = goal_time.reshape(len(saved), -1, height * width).max(axis=2)
        for people in range(saved[-1] + 1):
            fronts[first : first + chunk, people] = best[saved == people].max(axis=0)
    return np.maximum(fronts, -1)


def best_returns(starts: npt.ArrayLike, horizon: int, weights: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Objectives of the best policy for given scalarisation weights.

    Parameters
    ----------
    starts, horizon
        As in `pareto_fronts`.
    weights : float ``(2,)``
        Scalarisation weights over the reward vector ``(extinguish, save)``: nonnegative, not all zero.

    Returns
    -------
    float64 ``(n, 2)``
        Objectives ``(goal_time, people_saved)`` of the policy with the greatest scalarised return
        ``weights[0] * EXTINGUISH_REWARD * goal_time + weights[1] * people_saved``. Of several such policies
        it is the one that saves most people, with the most goal time that this allows; the result is Pareto
        optimal for all weights, also where one of them is zero.

    Raises
    ------
    ValueError
        As in `pareto_fronts`, or if `weights` are not as described.
    """
    scalarisation = require_weights(weights, ("extinguish", "save"))
    return _best_on_fronts(pareto_fronts(starts, horizon), scalarisation)


def lexicographic_optimum(starts: npt.ArrayLike, horizon: int) -> npt.NDArray[np.float64]:
    """Objectives of the policy that saves as many people as it can and then has the most goal time.

    Parameters
    ----------
    starts, horizon
        As in `pareto_fronts`.

    Returns
    -------
    float64 ``(n, 2)``
        Objectives ``(goal_time, people_saved)`` for each start.

    Raises
    ------
    ValueError
        As in `pareto_fronts`.
    """
    # A front has one point, that with most goal time, for each number of people.
    return _best_on_fronts(pareto_fronts(starts, horizon), np.array([0.0, 1.0]))


def coverage_set(starts: npt.ArrayLike, horizon: int) -> CoverageSet:
    """Convex coverage set of the objectives averaged over the starts.

    A policy sees its start, so the best average for given weights is the average of the best from each start:
    the set is the Minkowski average of the starts' convex hulls. Its edges are theirs, ordered by slope, and
    each slope is the weight at which one vertex gives way to the next.

    Parameters
    ----------
    starts, horizon
        As in `pareto_fronts`.

    Returns
    -------
    CoverageSet
        Its Pareto optimal vertices, and the weights for which each is optimal. None lies on a line between
        others.

    Raises
    ------
    ValueError
        As in `pareto_fronts`.
    """
    fronts = pareto_fronts(starts, horizon)
    prices = np.unique(_hull_prices(fronts))
    prices = EXTINGUISH_REWARD * prices[(prices > 0) & np.isfinite(prices)]
    bounds = np.concatenate([[0.0], prices / (1 + prices), [1.0]])
    save_weights = np.stack([bounds[:-1], bounds[1:]], axis=1)
    # Between its bounds each vertex is the only best average, so the middle of the interval finds it.
    points = [_best_on_fronts(fronts, np.array([1 - w, w])).mean(axis=0) for w in save_weights.mean(axis=1)]
    return CoverageSet(points=np.array(points), save_weights=save_weights)


def discounted_coverage_set(
    starts: npt.ArrayLike, horizon: int, gamma: float = 1.0
) -> npt.NDArray[np.float64]:
    """Convex coverage set of the discounted returns averaged over the starts.

    As for `coverage_set` it is the Minkowski average of the starts' own sets. With ``gamma = 1`` the vertices
    are those of `coverage_set`, and exact. With a discount each start's vertices come from a search over
    scalarisation weights: two neighbouring vertices are worth the same at the weights normal to the line
    through them, and the best policy for these weights, found by dynamic programming, is a new vertex between
    them or shows that there is none. So every row is the return of a policy, without error but rounding; and
    for no weights that add up to 1 does any policy return over 1e-9 more, scalarised, than the best row.

    Parameters
    ----------
    starts, horizon
        As in `pareto_fronts`.
    gamma : float
        Discount, from 0 to 1. The reward of the first step counts in full, that of step ``t`` (from 0) by
        ``gamma**t``.

    Returns
    -------
    float64 ``(m, 2)``
        Return ``(extinguish, save)`` of each vertex, from least to most weight on saving people: the first
        component falls and the second rises from row to row.

    Raises
    ------
    ValueError
        As in `pareto_fronts`, or if `gamma` is not as described.

    Notes
    -----
    With a discount time and memory grow with ``2**people``: a start with 12 people in 8 by 8 cells takes
    160 MB at 75 steps.
    """
    if not is_chance(gamma):
        raise ValueError(f"gamma is {gamma!r}; it must be a discount from 0 to 1")
    if gamma == 1:
        return coverage_set(starts, horizon).points * [EXTINGUISH_REWARD, 1.0]
    worlds = require_starts(starts)
    horizon = require_integer("horizon", horizon, 0, "at least 0")
    return coverage_vertices(worlds, horizon, float(gamma))


def hypervolume(points: npt.ArrayLike, reference: npt.ArrayLike = REFERENCE_POINT) -> float:
    """Area that at least one of the points dominates and that itself dominates the reference point.

    Exact, in the plane; the larger, the better. It is that of the points alone: what a random choice between
    two of them would dominate besides does not count.

    Parameters
    ----------
    points : float ``(m, 2)``
        Returns, as one array or a list, for instance a ``pareto_front``. Those that do not exceed the
        reference point in both components add nothing. May be empty.
    reference : float ``(2,)``
        Reference point, in the same units.

    Returns
    -------
    float
        The area, 0 if no point exceeds the reference point.

    Raises
    ------
    ValueError
        If the points or the reference point are not finite or not two-dimensional.
    """
    corner = require_numbers("reference", reference)
    if corner.shape != (2,) or not np.isfinite(corner).all():
        raise ValueError(f"reference is {corner.tolist()}; it must be two finite numbers")
    corners = require_numbers("points", points)
    if corners.shape == (0,):
        return 0.0
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise ValueError(
            f"points has shape {corners.shape}; it must be (m, 2), for only areas in the plane are computed"
        )
    if not np.isfinite(corners).all():
        row = int((~np.isfinite(corners)).any(axis=1).argmax())
        raise ValueError(f"points[{row}] is {corners[row].tolist()}; it must be finite")
    widths, heights = (corners[(corners > corner).all(axis=1)] - corner).T
    by_width = np.argsort(-widths)
    # From wide to narrow, each point adds a strip as wide as itself on top of all the wider ones.
    tops = np.maximum.accumulate(heights[by_width])
    return float(widths[by_width] @ np.diff(tops, prepend=0.0))


def optimal_actions(start: npt.ArrayLike, horizon: int, people_saved: int) -> npt.NDArray[np.int64]:
    """Actions that save exactly `people_saved` people with the most goal time.

    Parameters
    ----------
    start : uint8 ``(4, height, width)``
        One start observation, as in `pareto_fronts`.
    horizon : int
        Steps in the episode, at least 0.
    people_saved : int
        Number of people to save.

    Returns
    -------
    int64 ``(horizon,)``
        The environment's actions: 0-3 move up, down, left, right; 4 wait; 5-8 interact up, down, left, right.
        Of several best sequences it is the one found from the last step backwards by waiting where that is
        optimal, else by the lowest action that is.

    Raises
    ------
    ValueError
        As in `pareto_fronts`, or if no policy saves `people_saved` people within `horizon` steps.
    """
    planes = require_numbers("start", start)
    if planes.ndim != 3:
        raise ValueError(f"start has shape {planes.shape}; it must be (4, height, width)")
    worlds = require_starts(planes[np.newaxis])
    horizon = require_integer("horizon", horizon, 0, "at least 0")
    offsets = neighbour_offsets(worlds)
    extinguisher = int(np.flatnonzero(worlds[0, 3])[0])
    person_at = {int(cell): person for person, cell in enumerate(np.flatnonzero(worlds[0, 2]))}
    goal_time = list(_forward(worlds, horizon))

    counts, wanted = people_in_each_set(worlds).tolist(), as_integer(people_saved)
    eligible = np.array([people for people, count in enumerate(counts) if count == wanted], dtype=int)
    if not eligible.size or goal_time[-1][eligible].max() < 0:
        raise ValueError(
            f"people_saved is {people_saved!r}; it must be 0 to {len(person_at)}, "
            f"and no more than can be saved within horizon={horizon} steps"
        )
    row, cell = divmod(int(goal_time[-1][eligible].argmax()), goal_time[-1].shape[1])
    saved = int(eligible[row])

    actions = np.empty(horizon, dtype=np.int64)
    for step in reversed(range(horizon)):
        target = goal_time[step + 1][saved, cell] - (cell == extinguisher)
        predecessors = [(_WAIT, saved, cell)]
        predecessors += [(move, saved, cell - offset) for move, offset in enumerate(offsets)]
        for interaction, offset in enumerate(offsets, start=_FIRST_INTERACTION):
            person = person_at.get(cell + offset)
            if person is not None and saved & (1 << person):
                predecessors.append((interaction, saved ^ (1 << person), cell))
        actions[step], saved, cell = next(p for p in predecessors if goal_time[step][p[1:]] == target)
    return actions


def _forward(worlds: npt.NDArray[np.uint8], horizon: int) -> Iterator[npt.NDArray[np.signedinteger]]:
    """Yield, at steps 0 to `horizon`, the most goal time so far in every state: ``(2**p, n * cells)``.

    Rows are sets of people saved, person ``i`` (in reading order) being bit ``i``. Columns are the agent's
    cells in all worlds, laid end to end: as each has its border wall, none can be left for the next, and a
    step to a neighbouring cell is one shift of the whole array. States that cannot be reached have negative
    values.
    """
    n, _, _, width = worlds.shape
    walls, agents, people, extinguishers = np.moveaxis(worlds, 1, 0).reshape(4, -1)
    sets, cells = len(people_in_each_set(worlds)), walls.size
    persons = np.flatnonzero(people).reshape(n, -1)
    offsets = neighbour_offsets(worlds)

    # Low enough to stay negative through all the goal steps that are added to it.
    unreached = -horizon - 1
    dtype = np.min_scalar_type(unreached)
    pay = extinguishers.astype(dtype)
    # Upper bounds: none where the agent may be (or may save person i), unreached elsewhere.
    may_stand = np.where(walls, unreached, horizon).astype(dtype)
    may_save = np.full((persons.shape[1], cells), unreached, dtype=dtype)
    for offset in offsets:
        may_save[np.arange(len(may_save)), persons - offset] = horizon

    goal_time = np.full((sets, cells), unreached, dtype=dtype)
    goal_time[0, np.flatnonzero(agents)] = 0
    yield goal_time
    inner = slice(width, cells - width)
    for _ in range(horizon):
        after = goal_time.copy()
        for offset in offsets:
            came_from = slice(inner.start - offset, inner.stop - offset)
            np.maximum(after[:, inner], goal_time[:, came_from], out=after[:, inner])
        np.minimum(after, may_stand, out=after)
        for person, allowed in enumerate(may_save):
            split = (-1, 2, 1 << person, cells)
            unsaved, saved = goal_time.reshape(split)[:, 0], after.reshape(split)[:, 1]
            np.maximum(saved, np.minimum(unsaved, allowed), out=saved)
        after += pay
        goal_time = after
        yield goal_time


def _best_on_fronts(
    fronts: npt.NDArray[np.int64], weights: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Objectives ``(n, 2)`` of each front's best point; of equal ones, that with most people saved."""
    returns = weights[0] * EXTINGUISH_REWARD * fronts + weights[1] * np.arange(fronts.shape[1])
    returns = np.where(fronts >= 0, returns, -np.inf)
    best = returns >= returns.max(axis=1, keepdims=True) * (1 - _TIE)
    people_saved = fronts.shape[1] - 1 - best[:, ::-1].argmax(axis=1)
    goal_time = fronts[np.arange(len(fronts)), people_saved]
    return np.stack([goal_time, people_saved], axis=1).astype(np.float64)


def _hull_prices(fronts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Goal steps that the next person costs along each front's concave hull: ``(n, p)``, rising along a row.

    Infinite for people who cannot be saved. The hull's price between s - 1 and s is the greatest over a < s
    of the least over b >= s of the price per person from a to b (the max-min formula of isotonic regression);
    being quotients of integers, equal prices are equal floats.
    """
    n, counts = fronts.shape
    prices = np.full((n, counts - 1), -np.inf)
    for low in range(counts - 1):
        lost = (fronts[:, low, np.newaxis] - fronts[:, low + 1 :]) / np.arange(1, counts - low)
        lost[fronts[:, low + 1 :] < 0] = np.inf
        least = np.minimum.accumulate(lost[:, ::-1], axis=1)[:, ::-1]
        prices[:, low:] = np.maximum(prices[:, low:], least)
    return prices
