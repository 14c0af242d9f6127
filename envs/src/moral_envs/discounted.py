"""The discounted optimum of Emergency, by a dynamic programme over all steps and a search over weights.

With a discount it matters when people are saved, not only how many, so the steps are worked through from the
last to the first, for one pair of scalarisation weights at a time. The weights follow the dichotomic search
of Aneja and Nair, "Bicriteria Transportation Problem", Management Science 25 (1979).
:func:`moral_envs.optimal.discounted_coverage_set` tells what comes of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from moral_envs.emergency_starts import EXTINGUISH_REWARD, neighbour_offsets, people_in_each_set

if TYPE_CHECKING:
    import numpy.typing as npt

# States of one chunk of starts: small enough for its arrays, which keep the values of all steps, to stay in a
# processor's cache.
_CHUNK_STATES = 2**16
# Prices this close, relatively, are ties: it absorbs the rounding of 0.1 and of the weights.
_TIE = 1e-12
# A gain in scalarised return that is no new vertex; far above the rounding of a return, which is 1e-14.
_TOLERANCE = 1e-9


def coverage_vertices(worlds: npt.NDArray[np.uint8], horizon: int, gamma: float) -> npt.NDArray[np.float64]:
    """Vertices of the convex coverage set of the discounted returns averaged over the starts.

    Parameters
    ----------
    worlds : uint8 ``(n, 4, height, width)``
        Start observations, as in :func:`~moral_envs.optimal.pareto_fronts`.
    horizon : int
        Steps in an episode.
    gamma : float
        Discount, at least 0 and below 1.

    Returns
    -------
    float64 ``(m, 2)``
        Return ``(extinguish, save)`` of each vertex, from least to most weight on saving people.
    """
    return _minkowski_average([_undominated(points) for points in _vertices(worlds, horizon, gamma)])


def _vertices(
    worlds: npt.NDArray[np.uint8], horizon: int, gamma: float
) -> list[list[npt.NDArray[np.float64]]]:
    """Find every vertex, ``(2,)``, of each start's convex coverage set, in no order.

    What is found is best for some weights, so nothing lies inside the hull. But what is best at an end, where
    one weight is zero, may be dominated, and ties may add points on the lines between vertices.
    """
    ends = [
        _best(worlds, horizon, gamma, np.tile(weights, (len(worlds), 1)))
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
        best = _best(worlds[[start for start, _, _ in unsettled]], horizon, gamma, normals)
        pairs, unsettled = unsettled, []
        for (start, a, b), weights, found in zip(pairs, normals, best, strict=True):
            if weights @ (found - a) > _TOLERANCE:
                vertices[start].append(found)
                unsettled += [(start, a, found), (start, found, b)]


def _best(
    worlds: npt.NDArray[np.uint8], horizon: int, gamma: float, weights: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Discounted return ``(n, 2)`` of a best policy from each start for its own weights, ``(n, 2)``."""
    n, _, height, width = worlds.shape
    cells, sets = height * width, len(people_in_each_set(worlds))
    chunk = min(n, max(1, _CHUNK_STATES // (sets * cells)))
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
    ``s`` of people saved; minus infinity in walls. Cells and sets are laid out as in the search without a
    discount, with the axes exchanged, for the few cells next to a person are then few rows. All is
    discounted to the start.
    """
    horizon, cells, _ = values.shape
    walls, _, people, extinguishers = (np.flatnonzero(plane) for plane in np.moveaxis(worlds, 1, 0))
    offsets = neighbour_offsets(worlds)
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
    offsets = np.array(neighbour_offsets(worlds))
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
