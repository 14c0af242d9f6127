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

With a discount it matters when people are saved, not only how many, so `discounted_coverage_set` has its own
dynamic programme, and its results are returns.

The convex coverage set is that of Roijers, Vamplew, Whiteson and Dazeley, "A Survey of Multi-Objective
Sequential Decision-Making", JAIR 48 (2013); its vertices are found by the dichotomic search of Aneja and
Nair, "Bicriteria Transportation Problem", Management Science 25 (1979). The world is that of Peschl et al.,
"MORAL", AAMAS 2022.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, Effect, ObjectKind, World

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

EXTINGUISH_REWARD = 0.1
"""Reward of one step on the extinguisher's cell; saving a person pays 1."""

REFERENCE_POINT = (0.0, 0.0)
"""Return from which Emergency's hypervolume is measured: no reward is negative, so no policy returns less."""

_MAX_PEOPLE = 12
_WAIT, _FIRST_INTERACTION = 4, 5
# States of one chunk of starts: small enough for its arrays to stay in a processor's cache.
_CHUNK_STATES = 2**18
# The same for the search with a discount, which keeps the values of all steps.
_DISCOUNTED_CHUNK_STATES = 2**16
# Returns this close, relatively, are ties: it absorbs the rounding of 0.1 and of the weights.
_TIE = 1e-12
# A gain in scalarised return that is no new vertex; far above the rounding of a return, which is 1e-14.
_TOLERANCE = 1e-9


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
        As in `pareto_fronts`, or if `gamma` is out of range.

    Notes
    -----
    With a discount time and memory grow with ``2**people``: a start with 12 people in 8 by 8 cells takes
    150 MB at 75 steps.
    """
    if not 0 <= gamma <= 1:
        raise ValueError(f"gamma is {gamma}; expected a discount from 0 to 1")
    if gamma == 1:
        return coverage_set(starts, horizon).points * [EXTINGUISH_REWARD, 1.0]
    worlds = _checked_starts(starts)
    _check_horizon(horizon)
    found = _discounted_vertices(worlds, horizon, gamma)
    return _minkowski_average([_undominated(points) for points in found])


def seeded_starts(world: World, num_starts: int = 100, seed: int = 0) -> npt.NDArray[np.uint8]:
    """Draw the starts that stand for an Emergency world.

    They are the first observations of ``vector_env(num_envs=num_starts).reset(seed=seed)``; the defaults are
    those of the environment's ``pareto_front``.

    Parameters
    ----------
    world
        Emergency of any size, with any number of people up to 12, horizon and walls.
    num_starts
        How many starts, at least 1.
    seed
        Seed of the batch.

    Returns
    -------
    uint8 ``(num_starts, 4, height, width)``
        Start observations, as in `pareto_fronts`.

    Raises
    ------
    ValueError
        If a number is out of range or the optimum of the world is unknown: if it has other rules than
        Emergency, people who walk for instance, or a layout that draws the number of people or the horizon.
    """
    if num_starts < 1:
        raise ValueError(f"num_starts is {num_starts}; expected at least 1")
    _check_rules(world)
    engine = Engine(world, num_starts)
    engine.seed(spawn_streams(seed, num_starts))
    engine.reset()
    return engine.world_planes()


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
    corner = np.asarray(reference, dtype=np.float64)
    if corner.shape != (2,) or not np.isfinite(corner).all():
        raise ValueError(f"reference is {corner.tolist()}; expected two finite numbers")
    corners = np.asarray(points, dtype=np.float64)
    if corners.shape == (0,):
        return 0.0
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise ValueError(
            f"points has shape {corners.shape}; expected (m, 2), for only areas in the plane are computed"
        )
    if not np.isfinite(corners).all():
        row = int((~np.isfinite(corners)).any(axis=1).argmax())
        raise ValueError(f"points[{row}] is {corners[row].tolist()}; expected finite numbers")
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


def _discounted_vertices(
    worlds: npt.NDArray[np.uint8], horizon: int, gamma: float
) -> list[list[npt.NDArray[np.float64]]]:
    """Find every vertex, ``(2,)``, of each start's convex coverage set, in no order.

    What is found is best for some weights, so nothing lies inside the hull. But what is best at an end, where
    one weight is zero, may be dominated, and ties may add points on the lines between vertices.
    """
    ends = [
        _best_discounted(worlds, horizon, gamma, np.tile(weights, (len(worlds), 1)))
        for weights in ([1.0, 0.0], [0.0, 1.0])
    ]
    vertices = [list(pair) for pair in zip(*ends, strict=True)]
    # Pairs of neighbours between which there may be others: start, with more goal time, with more saved.
    unsettled = [(start, *pair) for start, pair in enumerate(vertices)]
    while True:
        unsettled = [(start, a, b) for start, a, b in unsettled if a[0] > b[0] and b[1] > a[1]]
        if not unsettled:
            return vertices
        normals = np.array([[b[1] - a[1], a[0] - b[0]] for _, a, b in unsettled])
        normals /= normals.sum(axis=1, keepdims=True)
        best = _best_discounted(worlds[[start for start, _, _ in unsettled]], horizon, gamma, normals)
        pairs, unsettled = unsettled, []
        for (start, a, b), weights, found in zip(pairs, normals, best, strict=True):
            if weights @ (found - a) > _TOLERANCE:
                vertices[start].append(found)
                unsettled += [(start, a, found), (start, found, b)]


def _best_discounted(
    worlds: npt.NDArray[np.uint8], horizon: int, gamma: float, weights: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Discounted return ``(n, 2)`` of a best policy from each start for its own weights, ``(n, 2)``."""
    n, _, height, width = worlds.shape
    cells, sets = height * width, len(_people_in_each_set(worlds))
    chunk = min(n, max(1, _DISCOUNTED_CHUNK_STATES // (sets * cells)))
    stages = np.empty((horizon, chunk * cells, sets))
    returns = np.empty((n, 2))
    for first in range(0, n, chunk):
        part = slice(first, first + chunk)
        values = stages[:, : len(worlds[part]) * cells]
        _fill_values(values, worlds[part], gamma, weights[part])
        returns[part] = _follow(values, worlds[part], gamma, weights[part])
    return returns


def _fill_values(
    values: npt.NDArray[np.float64],
    worlds: npt.NDArray[np.uint8],
    gamma: float,
    weights: npt.NDArray[np.float64],
) -> None:
    """Work back from the horizon: the most scalarised return still to come, in every state and step.

    It is written to `values`, ``(horizon, n * cells, 2**p)``: at ``[t, c, s]`` what the cell itself pays at
    the end of step ``t`` and all that comes later, if the agent ends the step on cell ``c`` with the set
    ``s`` of people saved; minus infinity in walls. Cells and sets are laid out as in `_forward`, with the
    axes exchanged, for the few cells next to a person are then few rows. All is discounted to the start.
    """
    horizon, cells, _ = values.shape
    walls, _, people, extinguishers = (np.flatnonzero(plane) for plane in np.moveaxis(worlds, 1, 0))
    offsets = _neighbour_offsets(worlds)
    beside = [
        np.add.outer(persons, offsets).ravel() for persons in people.reshape(len(worlds), -1).swapaxes(0, 1)
    ]
    discounts = gamma ** np.arange(horizon)
    pay = np.multiply.outer(discounts, EXTINGUISH_REWARD * weights[:, 0])
    saving = np.multiply.outer(discounts, np.repeat(weights[:, 1], len(offsets)))

    width = offsets[1]
    inner = slice(width, cells - width)
    later = np.zeros(values.shape[1:])
    later[walls] = -np.inf
    for step in reversed(range(horizon)):
        now = values[step]
        np.copyto(now, later)
        now[extinguishers] += pay[step][:, np.newaxis]
        # Before the step: the best of waiting, moving and saving. `later` becomes that.
        np.copyto(later, now)
        for offset in offsets:
            went_to = slice(inner.start + offset, inner.stop + offset)
            np.maximum(later[inner], now[went_to], out=later[inner])
        later[walls] = -np.inf
        for person, rows in enumerate(beside):
            split = (len(rows), -1, 2, 1 << person)
            saved = now[rows].reshape(split)[:, :, 1] + saving[step][:, np.newaxis, np.newaxis]
            before = later[rows]
            unsaved = before.reshape(split)[:, :, 0]
            np.maximum(unsaved, saved, out=unsaved)
            later[rows] = before


def _follow(
    values: npt.NDArray[np.float64],
    worlds: npt.NDArray[np.uint8],
    gamma: float,
    weights: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    """Discounted return ``(n, 2)`` of taking the best action for `values` at every step."""
    _, agents, people, extinguishers = (np.flatnonzero(plane) for plane in np.moveaxis(worlds, 1, 0))
    persons = people.reshape(len(worlds), -1)
    offsets = np.array(_neighbour_offsets(worlds))
    shifts = np.array([0, *offsets, *[0] * persons.shape[1]])
    bits = 1 << np.arange(persons.shape[1])
    joins = np.array([0] * (1 + len(offsets)) + bits.tolist())
    cells, saved = agents, np.zeros(len(worlds), dtype=np.int64)
    returns = np.zeros((len(worlds), 2))
    for step, value in enumerate(values):
        discount = gamma**step
        # Waiting, the four moves, and saving each of the people.
        options = value[cells[:, np.newaxis] + shifts, saved[:, np.newaxis] | joins]
        near = ((persons - cells[:, np.newaxis])[:, :, np.newaxis] == offsets).any(axis=2)
        can_save = near & ((saved[:, np.newaxis] & bits) == 0)
        saves = options[:, 1 + len(offsets) :]
        saves += discount * weights[:, 1:]
        saves[~can_save] = -np.inf
        choice = options.argmax(axis=1)
        cells, saved = cells + shifts[choice], saved | joins[choice]
        returns[:, 0] += discount * EXTINGUISH_REWARD * (cells == extinguishers)
        returns[:, 1] += discount * (joins[choice] > 0)
    return returns


def _undominated(points: list[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Pareto optimal ones of the points, ``(m, 2)``, the first component falling and the second rising."""
    ordered = np.array(sorted(points, key=lambda point: (-point[0], -point[1])))
    most = np.maximum.accumulate(ordered[:, 1])
    undominated: npt.NDArray[np.float64] = ordered[np.concatenate([[True], ordered[1:, 1] > most[:-1]])]
    return undominated


def _minkowski_average(hulls: list[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Average of convex sets that are given by their Pareto optimal vertices, as `_undominated` orders them.

    Points on the lines between vertices may be among them; they are not in the result.
    """
    first = np.mean([hull[0] for hull in hulls], axis=0)
    edges = np.concatenate([np.diff(hull, axis=0) for hull in hulls]) / len(hulls)
    prices = -edges[:, 0] / edges[:, 1]
    by_price = np.argsort(prices)
    edges, prices = edges[by_price], prices[by_price]
    corners = np.concatenate([first[np.newaxis], first + edges.cumsum(axis=0)])
    # Parallel edges are one: no vertex lies between them.
    bends = np.diff(prices) > _TIE * prices[1:]
    return corners[np.concatenate([[True], bends, [True]])] if len(edges) else corners


def _neighbour_offsets(worlds: npt.NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Distances in the flattened grid to the cells above, below, left and right: the order of the actions."""
    width = worlds.shape[-1]
    return -width, width, -1, 1


def _people_in_each_set(worlds: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Size of every set of people, ``(2**p,)``, the set's members being the bits of its index."""
    return np.array([people.bit_count() for people in range(1 << int(worlds[0, 2].sum()))], dtype=np.int64)


def _check_rules(world: World) -> None:
    """Raise a ValueError unless the world follows Emergency's rules, with fixed people and horizon."""
    kind = world.objects[0] if world.objects else ObjectKind("people", 0, "person", "P")
    fixture = world.fixture
    for argument, value, expected in (
        ("objects", tuple(kind.name for kind in world.objects), ("people",)),
        ("reward_names", world.reward_names, ("extinguish", "save")),
        ("objective_names", world.objective_names, ("goal_time", "people_saved")),
        ("pickup", "interact" if kind.on_enter is None else "enter", "interact"),
        ("walk", kind.walks, 0.0),
        ("on_interact", kind.on_interact, Effect("save", 1.0, "people_saved")),
        ("on_stand", fixture and fixture.on_stand, Effect("extinguish", EXTINGUISH_REWARD, "goal_time")),
        ("terminates", fixture and fixture.terminates, False),
        ("slip", world.slip, 0.0),
        ("on_step", world.on_step, None),
        ("num_actions", world.num_actions, NUM_ACTIONS),
    ):
        if value != expected:
            raise ValueError(
                f"{argument} is {value!r} in {world.name}; expected {expected!r}, "
                "for the optimum is known only under Emergency's rules"
            )
    if kind.count > _MAX_PEOPLE:
        raise ValueError(
            f"num_people is {kind.count}; expected at most {_MAX_PEOPLE}, for 2**people sets are visited"
        )
    if world.layout is not None:
        for argument, drawn in (*world.layout.counts, ("max_cycles", world.layout.max_cycles)):
            if isinstance(drawn, tuple) and drawn[0] != drawn[1]:
                raise ValueError(
                    f"layout draws {argument} from {drawn}; expected one number, for the optimum is known "
                    "only of starts with the same people and horizon"
                )


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
