"""The exact optimum of Emergency: the yardstick for every learner.

People do not move and nothing is random after the start, so the best policy from a given start follows by
dynamic programming. One forward pass over (set of people saved, cell of the agent) keeps the most goal time
so far. At the horizon it has, for every number of people saved, the most goal time that goes with it: the
start's whole Pareto front, and with it the best policy for any scalarisation weights.

A *start* is an observation of a one-agent Emergency world: 0/1 planes ``(4, height, width)`` in the order
walls, agent, people, extinguisher. Any state will do, also one in mid-episode; `horizon` counts the steps
that remain. Walls inside the border are respected.

Results are in objectives, ``(goal_time, people_saved)``, in the order of the environment's
``objective_names``: steps on the extinguisher's cell, and people. The return in the reward vector
``(extinguish, save)`` is ``(EXTINGUISH_REWARD * goal_time, people_saved)``.

The convex coverage set is that of Roijers, Vamplew, Whiteson and Dazeley, "A Survey of Multi-Objective
Sequential Decision-Making", JAIR 48 (2013); the world is that of Peschl et al., "MORAL", AAMAS 2022.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

__all__ = [
    "EXTINGUISH_REWARD",
    "CoverageSet",
    "best_returns",
    "coverage_set",
    "lexicographic_optimum",
    "optimal_actions",
    "pareto_fronts",
]

EXTINGUISH_REWARD = 0.1
"""Reward of one step on the extinguisher's cell; saving a person pays 1."""

_MAX_PEOPLE = 12
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
        Start observations, all with the same number of people, ``p <= 12``.
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
        If `starts` are not such observations or `horizon` is negative.
    """
    worlds = _checked_starts(starts)
    _check_horizon(horizon)
    n, _, height, width = worlds.shape
    saved = _people_in_each_set(worlds)
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
    scalarisation = np.asarray(weights, dtype=np.float64)
    if scalarisation.shape != (2,):
        raise ValueError(
            f"weights has shape {scalarisation.shape}; expected (2,), one for extinguish and one for save"
        )
    if not (np.isfinite(scalarisation).all() and (scalarisation >= 0).all() and scalarisation.any()):
        raise ValueError(
            f"weights is {scalarisation.tolist()}; expected finite, nonnegative and not all zero"
        )
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
    planes = np.asarray(start)
    if planes.ndim != 3:
        raise ValueError(f"start has shape {planes.shape}; expected (4, height, width)")
    worlds = _checked_starts(planes[np.newaxis])
    _check_horizon(horizon)
    offsets = _neighbour_offsets(worlds)
    extinguisher = int(np.flatnonzero(worlds[0, 3])[0])
    person_at = {int(cell): person for person, cell in enumerate(np.flatnonzero(worlds[0, 2]))}
    goal_time = list(_forward(worlds, horizon))

    eligible = np.flatnonzero(_people_in_each_set(worlds) == people_saved)
    if not eligible.size or goal_time[-1][eligible].max() < 0:
        raise ValueError(
            f"people_saved is {people_saved}; expected 0 to {len(person_at)}, "
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
    sets, cells = len(_people_in_each_set(worlds)), walls.size
    persons = np.flatnonzero(people).reshape(n, -1)
    offsets = _neighbour_offsets(worlds)

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


def _neighbour_offsets(worlds: npt.NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Distances in the flattened grid to the cells above, below, left and right: the order of the actions."""
    width = worlds.shape[-1]
    return -width, width, -1, 1


def _people_in_each_set(worlds: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Size of every set of people, ``(2**p,)``, the set's members being the bits of its index."""
    return np.array([people.bit_count() for people in range(1 << int(worlds[0, 2].sum()))], dtype=np.int64)


def _check_horizon(horizon: int) -> None:
    if horizon < 0:
        raise ValueError(f"horizon is {horizon}; expected at least 0 steps")


def _checked_starts(starts: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Return the starts as uint8 ``(n, 4, height, width)`` if they are states of Emergency, else raise."""
    planes = np.asarray(starts)
    if planes.ndim != 4 or planes.shape[0] < 1 or planes.shape[1] != 4 or min(planes.shape[2:]) < 3:
        raise ValueError(
            f"starts has shape {planes.shape}; expected (n, 4, height, width), "
            "at least one start of at least 3 by 3 cells"
        )
    if not np.isin(planes, (0, 1)).all():
        raise ValueError(f"starts has values from {planes.min()} to {planes.max()}; expected only 0 and 1")
    worlds = planes.astype(np.uint8)
    walls, agents, people, extinguishers = np.moveaxis(worlds, 1, 0)
    inside = np.zeros(walls.shape[1:], dtype=bool)
    inside[1:-1, 1:-1] = True
    _refuse_first(~walls[:, ~inside].all(axis=1), "has a gap in its border", "walls all around")
    for name, plane in (("agents", agents), ("extinguishers", extinguishers)):
        _refuse_first(plane.sum(axis=(1, 2)) != 1, f"has no or several {name}", "exactly one")
    for name, plane in (("agent", agents), ("person", people), ("extinguisher", extinguishers)):
        _refuse_first((plane & walls).any(axis=(1, 2)), f"has its {name} in a wall", "a free cell")
    counts = people.sum(axis=(1, 2))
    _refuse_first(
        counts != counts[0], f"has not {counts[0]} people as starts[0] has", "the same number everywhere"
    )
    if counts[0] > _MAX_PEOPLE:
        raise ValueError(
            f"starts have {counts[0]} people; expected at most {_MAX_PEOPLE}, for 2**people sets are visited"
        )
    return worlds


def _refuse_first(wrong: npt.NDArray[np.bool_], fault: str, expected: str) -> None:
    if wrong.any():
        raise ValueError(f"starts[{wrong.argmax()}] {fault}; expected {expected}")
