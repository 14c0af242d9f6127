"""Hand-made features of Emergency, for learners that know tables and linear functions but no networks.

A table needs states that come back. With up to six people on its 36 cells, Emergency has 86 million, of which
an episode meets 75. What stands in for the state is where the agent is and where the person nearest to it is
(1,332 states); for linear functions, how far from the agent that person and the extinguisher are. Raw planes
are offered under the same interface, to measure what a learner does without that help.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from moral_envs.world import World

# Maps uint8 states (n, C, H, W) to keys (n, b), alike for states that a table does not tell apart.
_Key = Callable[[World, NDArray[np.uint8]], NDArray[np.uint8]]
# Maps uint8 states (n, C, H, W) to float64 contexts (n, d).
_Context = Callable[[World, NDArray[np.uint8]], NDArray[np.float64]]


def nearest_person(world: World, states: NDArray[np.uint8]) -> tuple[NDArray[np.int64], ...]:
    """Find the agent, the person nearest to it, and how many steps apart they are.

    Parameters
    ----------
    world
        Emergency, of any size.
    states
        uint8 planes of shape (n, C, H, W).

    Returns
    -------
    tuple of three int64 arrays of shape (n,)
        Cells of agent and person, counted row by row, and the steps between them. Of people equally near it
        is the first. Where nobody is left both the person's cell and the steps are -1.
    """
    width = states.shape[-1]
    agents, people = (
        states[:, world.plane_names.index(name)].reshape(len(states), -1) for name in ("agent", "people")
    )
    cells = np.arange(agents.shape[1])
    rows, columns = np.divmod(cells, width)
    apart = np.abs(rows[:, None] - rows) + np.abs(columns[:, None] - columns)
    agent = agents.argmax(axis=1)
    distances = np.where(people > 0, apart[agent], len(cells))
    person = distances.argmin(axis=1)
    steps = distances[np.arange(len(states)), person]
    return agent, np.where(steps < len(cells), person, -1), np.where(steps < len(cells), steps, -1)


def _nearest(world: World, states: NDArray[np.uint8]) -> NDArray[np.uint8]:
    agent, person, _ = nearest_person(world, states)
    return np.stack([agent, person], axis=1).astype(np.int32).view(np.uint8)


def _planes(world: World, states: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.packbits(states.reshape(len(states), -1), axis=1)


def _distances(world: World, states: NDArray[np.uint8]) -> NDArray[np.float64]:
    agent, _, to_person = nearest_person(world, states)
    height, width = states.shape[2:]
    grid = (height, width)
    counts = states[:, world.plane_names.index("people")].sum(axis=(1, 2))
    fixture = states[:, world.plane_names.index("extinguisher")].reshape(len(states), -1).argmax(axis=1)
    (row, column), (goal_row, goal_column) = np.unravel_index(agent, grid), np.unravel_index(fixture, grid)
    to_goal = np.abs(row - goal_row) + np.abs(column - goal_column)
    longest = height + width
    return np.stack(
        [
            np.ones(len(states)),
            counts > 0,
            counts / max(world.num_objects, 1),
            np.maximum(to_person, 0) / longest,
            to_goal / longest,
            to_goal == 0,
        ],
        axis=1,
    ).astype(np.float64)


def _flat_planes(world: World, states: NDArray[np.uint8]) -> NDArray[np.float64]:
    flat = states.reshape(len(states), -1).astype(np.float64)
    return np.concatenate([np.ones((len(states), 1)), flat], axis=1)


KEYS: dict[str, _Key] = {"nearest": _nearest, "planes": _planes}
"""What a table tells apart: the cells of agent and nearest person, or every state."""

CONTEXTS: dict[str, _Context] = {"distances": _distances, "planes": _flat_planes}
"""What linear functions see: a bias and five hand-made features, or a bias and all planes."""


def require_emergency(world: World) -> None:
    """Raise a ValueError if a world has not what the features are about."""
    missing = [name for name in ("people", "extinguisher") if name not in world.plane_names]
    if missing:
        raise ValueError(f"world is {world.name}, which has no {missing[0]}; it must be Emergency")


class StateTable:
    """Numbers states in the order in which they are first met.

    Parameters
    ----------
    world
        Emergency, of any size.
    features
        What tells states apart: a name in :data:`KEYS`.

    Raises
    ------
    ValueError
        If there are no such features, or the world is another one.
    """

    def __init__(self, world: World, features: str) -> None:
        require_emergency(world)
        if features not in KEYS:
            raise ValueError(f"features is {features!r}; it must be one of {sorted(KEYS)}")
        self._world = world
        self._key = KEYS[features]
        self._rows: dict[bytes, int] = {}

    def __len__(self) -> int:
        """Count the states met."""
        return len(self._rows)

    def add(self, states: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Rows (n,) of states (n, C, H, W), int64; those not met before get the next numbers."""
        rows = self._rows
        return np.array([rows.setdefault(key, len(rows)) for key in self._keys(states)], dtype=np.int64)

    def find(self, states: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Rows (n,) of states (n, C, H, W), int64; -1 for those not met before."""
        return np.array([self._rows.get(key, -1) for key in self._keys(states)], dtype=np.int64)

    def _keys(self, states: NDArray[np.uint8]) -> list[bytes]:
        return [key.tobytes() for key in self._key(self._world, states)]
