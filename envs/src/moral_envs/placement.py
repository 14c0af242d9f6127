"""Where everything is when an episode starts, for a batch of environments at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moral_envs.streams import draw_integers
from moral_envs.world import World


class Placement(NamedTuple):
    """Starts of n episodes; a cell is ``row * width + column``."""

    agents: NDArray[np.int64]
    """Cells, shape (n_agents, n)."""
    objects: NDArray[np.int64]
    """Cells in the order of the world's kinds, shape (n_objects, n)."""
    turns: NDArray[np.int64]
    """Where in the rounds of turns the episode starts, shape (n,)."""
    rooms: Rooms | None
    """What a layout has drawn; None without one."""


class Rooms(NamedTuple):
    """The rooms of n episodes in a world with a layout."""

    walls: NDArray[np.uint8]
    """0/1, shape (n, cells)."""
    present: NDArray[np.bool_]
    """Which of the objects there are, shape (n_objects, n)."""
    fixtures: NDArray[np.int64]
    """Cells of the fixture, shape (n,)."""
    horizons: NDArray[np.int64]
    """Steps after which the episodes truncate, shape (n,)."""


class Placer:
    """Draws starts of one world: agents and objects on distinct free cells, uniformly.

    Parameters
    ----------
    world
        The rules.
    num_agents
        Agents in each environment.

    Raises
    ------
    ValueError
        If agents and objects do not fit on the free cells.
    """

    def __init__(self, world: World, num_agents: int) -> None:
        # Nothing starts where an episode would end at once.
        self._barred = int(world.fixture is not None and world.fixture.terminates)
        wanted, room = num_agents + world.num_objects, world.num_free_cells - self._barred
        if wanted > room:
            fewest = "has at least" if world.layout is not None else "has"
            raise ValueError(
                f"num_agents and the objects' counts add up to {wanted}; "
                f"{world.name} {fewest} {room} free cells to place them on"
            )
        self._world = world
        self._num_agents = num_agents
        self.walls = _fixed_walls(world)
        self.fixture_cell = _fixture_cell(world)
        free = np.flatnonzero(self.walls == 0)
        self._corner_cells = np.zeros((0, 1), dtype=np.int64)
        if self._barred:
            free = free[free != self.fixture_cell]
        if world.start == "corner":
            self._corner_cells = free[:num_agents, None]
            free = free[num_agents:]
        self._free_cells = free
        placed = wanted - len(self._corner_cells)
        # One draw for each agent and object that is placed at random, and one for the order of the agents.
        self._ranks = np.arange(placed, dtype=np.uint64)
        self._draw_bounds = np.append(np.uint64(len(free)) - self._ranks, np.uint64(2 * num_agents))
        self._kind_names = [kind.name for kind in world.objects]
        self._counts = {kind.name: kind.count for kind in world.objects}
        numbers = [np.arange(kind.count) for kind in world.objects]
        self._numbers = np.concatenate([np.zeros(0, dtype=np.int64), *numbers])[:, None]
        self._kinds = np.repeat(np.arange(len(world.objects)), list(self._counts.values()))

    def place(self, streams: NDArray[np.uint64]) -> Placement:
        """Draw the starts of as many episodes as there are streams, which advance in place.

        Parameters
        ----------
        streams
            uint64 array of shape (n,), changed in place.
        """
        if self._world.layout is not None:
            return self._place_in_rooms(streams)
        draws = draw_integers(streams, self._draw_bounds)
        pool = np.repeat(self._free_cells.astype(np.int32)[:, None], len(streams), axis=1)
        return self._placement(_take_distinct(pool, draws[:-1]), draws[-1], None)

    def _place_in_rooms(self, streams: NDArray[np.uint64]) -> Placement:
        world, layout = self._world, self._world.layout
        assert layout is not None
        drawn = layout.draw(
            streams, height=world.height, width=world.width, counts=self._counts, horizon=world.horizon
        )
        walls = drawn.walls.reshape(len(streams), -1)
        # Free cells first, in reading order; the last of them is the fixture's.
        pool = np.argsort(walls, axis=1, kind="stable").astype(np.int32).T.copy()
        num_free = ((~walls).sum(axis=1) - self._barred).astype(np.uint64)
        bounds = np.vstack([num_free - self._ranks[:, None], np.full_like(num_free, 2 * self._num_agents)])
        draws = draw_integers(streams, bounds)
        last = walls.shape[1] - 1 - (~walls)[:, ::-1].argmax(axis=1)
        rooms = Rooms(
            walls.astype(np.uint8), self._numbers < drawn.counts.T[self._kinds], last, drawn.horizons
        )
        return self._placement(_take_distinct(pool, draws[:-1]), draws[-1], rooms)

    def _placement(
        self, cells: NDArray[np.int64], turns: NDArray[np.int64], rooms: Rooms | None
    ) -> Placement:
        if len(self._corner_cells):
            agents = np.repeat(self._corner_cells, cells.shape[1], axis=1)
            return Placement(agents, cells, turns, rooms)
        return Placement(cells[: self._num_agents], cells[self._num_agents :], turns, rooms)


def _fixed_walls(world: World) -> NDArray[np.uint8]:
    """Walls of a world without a layout, 0/1 of shape (cells,)."""
    walls = np.ones((world.height, world.width), dtype=np.uint8)
    walls[1:-1, 1:-1] = 0
    for cell in world.interior_walls:
        walls[cell] = 1
    return walls.ravel()


def _fixture_cell(world: World) -> int:
    if world.fixture is None or world.fixture.cell is None:
        return int(np.flatnonzero(_fixed_walls(world) == 0)[-1])
    row, column = world.fixture.cell
    return row * world.width + column


def _take_distinct(pool: NDArray[np.int32], draws: NDArray[np.int64]) -> NDArray[np.int64]:
    """Shuffle every column of ``pool`` (f, n), in place and as far as needed; returns what comes up (m, n).

    Fisher and Yates: draw ``i`` of a column lies in ``0 .. f - 1 - i`` and picks from what is not yet taken.
    """
    count, columns = draws.shape
    flat = pool.ravel()
    picks = draws + np.arange(count)[:, None]
    picks *= columns
    picks += np.arange(columns)
    taken = np.empty((count, columns), dtype=np.int64)
    for i in range(count):
        taken[i] = flat.take(picks[i])
        flat[picks[i]] = pool[i]
    return taken
