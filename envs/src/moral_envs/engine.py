"""The simulation: every rule of every world, for a batch of environments at once.

``reset`` and ``step`` are the only places where state changes; no loop runs over environments. A step is one
table look-up per agent: the content of the cell that an action touches, together with the action, decides
where the agent goes, what disappears, what is paid and what is counted.

Rules
-----
The agent moves (walls and other agents block; objects do not) or interacts with a neighbouring cell. Then the
fixture pays if the agent stands on its cell. Rewards and counters see the state after the move. Every
environment truncates after ``world.horizon`` steps. The engine does not stop there: until the environment is
reset its world goes on and every step truncates again. It is the faces that refuse to step beyond the end.

Agents act one after the other. Who is first rotates by one every step, and the order goes round upwards in
the agents' numbers for as many steps as there are agents and downwards for as many. So over twice as many
steps as agents each of any two agents precedes the other equally often. Where in these rounds an episode
starts is drawn at reset, so the order is fixed by the seed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moral_envs.streams import draw_integers, spawn_streams
from moral_envs.world import NUM_ACTIONS, Effect, World

MAX_AGENTS = 16

_WAIT = 4
_FREE, _WALL, _FIRST_OBJECT = range(3)


class Step(NamedTuple):
    """What one step of all environments brought."""

    rewards: NDArray[np.float32]
    """Reward vectors, shape (n_envs, n_agents, k)."""
    truncations: NDArray[np.bool_]
    """Which episodes have reached their horizon, shape (n_envs,)."""
    any_truncation: bool
    """Whether one of them has."""


class _OutcomeTables:
    """What follows from touching a cell, in rows ``content * NUM_ACTIONS + action``.

    Attributes
    ----------
    directions : int64 array of shape (NUM_ACTIONS,)
        How far away the cell lies that an action touches.
    shifts : int64 array of shape (rows,)
        By how many cells the agent moves.
    removes : bool array of shape (rows,)
        Whether the touched object disappears.
    planes : int64 array of shape (rows,)
        How far the touched object's plane lies behind the agent plane, in cells.
    rewards, counts : float32 (2 * rows, k) and int64 (2 * rows, m) arrays
        What is paid and counted; from row ``num_rows`` on for an agent that ends the step on the fixture.
    """

    def __init__(self, world: World) -> None:
        cells = world.height * world.width
        contents = _FIRST_OBJECT + len(world.objects)
        self.num_rows = contents * NUM_ACTIONS
        neighbours = [-world.width, world.width, -1, 1]
        self.directions = np.array([*neighbours, 0, *neighbours], dtype=np.int64)
        shifts = np.zeros((contents, NUM_ACTIONS), dtype=np.int64)
        shifts[:, :_WAIT] = neighbours
        shifts[_WALL] = 0
        removes = np.zeros((contents, NUM_ACTIONS), dtype=np.bool_)
        planes = np.zeros((contents, NUM_ACTIONS), dtype=np.int64)
        rewards = np.zeros((2, contents, NUM_ACTIONS, len(world.reward_names)), dtype=np.float32)
        counts = np.zeros((2, contents, NUM_ACTIONS, len(world.objective_names)), dtype=np.int64)

        def pay(effect: Effect, where: tuple[int | slice, ...]) -> None:
            rewards[(*where, world.reward_names.index(effect.reward))] += effect.amount
            counts[(*where, world.objective_names.index(effect.objective))] += 1

        for number, kind in enumerate(world.objects):
            content = _FIRST_OBJECT + number
            for effect, actions in (
                (kind.on_enter, slice(0, _WAIT)),
                (kind.on_interact, slice(_WAIT + 1, NUM_ACTIONS)),
            ):
                if effect is not None:
                    removes[content, actions] = True
                    planes[content, actions] = (1 + number) * cells
                    pay(effect, (slice(None), content, actions))
        if world.fixture is not None:
            pay(world.fixture.on_stand, (1, slice(None), slice(None)))

        self.shifts = shifts.ravel()
        self.removes = removes.ravel()
        self.planes = planes.ravel()
        self.rewards = rewards.reshape(2 * self.num_rows, -1)
        self.counts = counts.reshape(2 * self.num_rows, -1)


class Engine:
    """A batch of environments of one world.

    Parameters
    ----------
    world
        The rules.
    num_envs
        Environments in the batch.
    num_agents
        Agents in each environment, 1 to 16.
    team_reward
        False: every agent is paid, and counted, for what it does itself. True: every agent gets the sum over
        all agents.

    Raises
    ------
    ValueError
        If a number is out of range or agents and objects do not fit on the free cells.
    """

    def __init__(
        self, world: World, num_envs: int = 1, num_agents: int = 1, team_reward: bool = False
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}; it must be at least 1")
        if not 1 <= num_agents <= MAX_AGENTS:
            raise ValueError(f"num_agents is {num_agents}; it must be 1 to {MAX_AGENTS}")
        wanted = num_agents + world.num_objects
        if wanted > world.num_free_cells:
            raise ValueError(
                f"num_agents and the objects' counts add up to {wanted}; "
                f"{world.name} has {world.num_free_cells} free cells to place them on"
            )
        self.world = world
        self.num_envs = num_envs
        self.num_agents = num_agents
        self.team_reward = team_reward
        self._streams = spawn_streams(None, num_envs)

        planes = len(world.plane_names)
        cells = world.height * world.width
        walls = np.ones((world.height, world.width), dtype=np.uint8)
        walls[1:-1, 1:-1] = 0
        self._free_cells = np.flatnonzero(walls == 0)
        self._tables = _OutcomeTables(world)

        # A cell's address: environment, agent plane, cell, as one flat index. Contents use the same addresses
        # as the planes, so that one index serves both; the agent plane itself stays zero until it is handed
        # out. A content is the first row of its kind in the tables; bytes, to stay in the processor's cache.
        self._origins = (np.arange(num_envs, dtype=np.int64)[:, None] * planes + 1) * cells
        self._planes = np.zeros(num_envs * planes * cells, dtype=np.uint8)
        self._contents = np.zeros_like(self._planes)
        self._occupied = np.zeros_like(self._planes) if num_agents > 1 else None
        self._plane_rows = self._planes.reshape(num_envs, planes, cells)
        self._content_rows = self._contents.reshape(num_envs, planes, cells)[:, 1]
        self._blank_planes = np.zeros((planes, cells), dtype=np.uint8)
        self._blank_planes[0] = walls.ravel()
        self._blank_contents = walls.ravel() * np.uint8(_WALL * NUM_ACTIONS)
        self._fixture_addresses: NDArray[np.int64] | None = None
        if world.fixture is not None:
            self._blank_planes[-1, self._free_cells[-1]] = 1
            self._fixture_addresses = self._origins[:, 0] + self._free_cells[-1]

        self._addresses = np.zeros((num_envs, num_agents), dtype=np.int64)
        self._counters = np.zeros((num_envs, num_agents, len(world.objective_names)), dtype=np.int64)
        # Views without the axis of agents; so these two arrays change in place only.
        self._flat_addresses = self._addresses.reshape(-1)
        self._flat_counters = self._counters.reshape(num_envs * num_agents, -1)
        self._turn_offsets = np.zeros(num_envs, dtype=np.int64)
        # One clock for all environments; each ends at its own time, and the earliest of these is kept.
        self._clock = 0
        self._ends = np.zeros(num_envs, dtype=np.int64)
        self._next_end = 0
        self._env_indices = np.arange(num_envs)
        kinds = np.repeat(np.arange(len(world.objects)), [kind.count for kind in world.objects])
        self._object_contents = ((_FIRST_OBJECT + kinds) * NUM_ACTIONS).astype(np.uint8)[:, None]
        self._object_planes = ((1 + kinds) * cells)[:, None]
        # Placing needs one draw per agent and object, and one for the order of the agents.
        bounds = [world.num_free_cells - i for i in range(wanted)] + [2 * num_agents]
        self._draw_bounds = np.array(bounds, dtype=np.uint64)
        self.reset()

    @property
    def observation_shape(self) -> tuple[int, int, int]:
        """Shape (C, H, W) of one agent's observation."""
        others = 1 if self.num_agents > 1 else 0
        return len(self.world.plane_names) + others, self.world.height, self.world.width

    @property
    def streams(self) -> NDArray[np.uint64]:
        """States of the random streams (:mod:`moral_envs.streams`), shape (n_envs,), a fresh array."""
        return self._streams.copy()

    @property
    def agent_cells(self) -> NDArray[np.int64]:
        """Row and column of every agent, shape (n_envs, n_agents, 2), a fresh array."""
        rows, columns = np.divmod(self._addresses - self._origins, self.world.width)
        return np.stack([rows, columns], axis=-1)

    @property
    def objectives(self) -> NDArray[np.int64]:
        """Objective counters of the episodes so far, shape (n_envs, n_agents, m), a fresh array."""
        if self.team_reward:
            return np.repeat(self._counters.sum(axis=1, keepdims=True), self.num_agents, axis=1)
        return self._counters.copy()

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Steps taken in the current episodes, shape (n_envs,), a fresh array."""
        return self._clock - self._ends + self.world.horizon

    def seed(self, streams: NDArray[np.uint64], mask: NDArray[np.bool_] | None = None) -> None:
        """Set the random streams of all environments, or of those in ``mask``.

        Parameters
        ----------
        streams
            uint64 array of shape (n_envs,), for instance of :func:`~moral_envs.streams.spawn_streams`.
        mask
            bool array of shape (n_envs,).
        """
        assert streams.shape == (self.num_envs,)
        assert streams.dtype == np.uint64
        np.copyto(self._streams, streams, where=True if mask is None else mask)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Start new episodes in all environments, or in those in ``mask``, from their own streams.

        Agents and objects get distinct free cells, uniformly.

        Parameters
        ----------
        mask
            bool array of shape (n_envs,). Environments outside it are not touched.
        """
        # Episodes often end together, and NumPy handles a slice faster than a list of all indices.
        envs: NDArray[np.int64] | slice
        envs = slice(None) if mask is None or mask.all() else np.flatnonzero(mask)
        origins = self._origins[envs, 0]
        if origins.size == 0:
            return
        streams = self._streams[envs]
        draws = draw_integers(streams, self._draw_bounds)
        self._streams[envs] = streams
        self._turn_offsets[envs] = draws[-1]
        addresses = _sample_distinct(self._free_cells, draws[:-1]) + origins
        agents, objects = addresses[: self.num_agents], addresses[self.num_agents :]

        self._plane_rows[envs] = self._blank_planes
        self._content_rows[envs] = self._blank_contents
        self._planes[objects + self._object_planes] = 1
        self._contents[objects] = self._object_contents
        self._addresses[envs] = agents.T
        if self._occupied is not None:
            self._occupied.reshape(self._plane_rows.shape)[envs, 1] = 0
            self._occupied[agents] = 1

        self._counters[envs] = 0
        self._ends[envs] = self._clock + self.world.horizon
        self._next_end = int(self._ends.min())

    def step(self, actions: ArrayLike) -> Step:
        """Take one step in every environment.

        Parameters
        ----------
        actions
            Integers of shape (n_envs, n_agents), or (n_envs,) if there is one agent, each in ``0 .. 8``
            (:data:`~moral_envs.world.ACTION_NAMES`).

        Returns
        -------
        Step
            Rewards of shape (n_envs, n_agents, k) and truncations of shape (n_envs,), both fresh.

        Raises
        ------
        ValueError
            If the actions are not integers, out of range or of another shape; nothing has changed then.
        """
        actions = self._require_actions(actions)
        rewards = self._act_alone(actions) if self.num_agents == 1 else self._act_in_turn(actions)
        self._clock += 1
        if self._clock < self._next_end:
            return Step(rewards, np.zeros(self.num_envs, dtype=np.bool_), False)
        return Step(rewards, self._clock >= self._ends, True)

    def observe(self) -> NDArray[np.uint8]:
        """Show each agent its observation.

        Returns
        -------
        uint8 array of shape (n_envs, n_agents, C, H, W)
            A fresh array of 0/1 planes in the order of ``world.plane_names``; with several agents a plane of
            the other agents comes last.
        """
        if self._occupied is None:
            return self.world_planes()[:, None]
        shape = (self.num_envs, self.num_agents, *self.observation_shape)
        observations = np.empty((*shape[:3], shape[3] * shape[4]), dtype=np.uint8)
        observations[:, :, :-1] = self._plane_rows[:, None]
        observations[:, :, -1] = self._occupied.reshape(self._plane_rows.shape)[:, None, 1]
        cells = self._addresses - self._origins
        envs, agents = self._env_indices[:, None], np.arange(self.num_agents)
        observations[envs, agents, 1, cells] = 1
        observations[envs, agents, -1, cells] = 0
        return observations.reshape(shape)

    def world_planes(self) -> NDArray[np.uint8]:
        """Show the whole worlds, all agents on the agent plane.

        Returns
        -------
        uint8 array of shape (n_envs, C, H, W)
            A fresh array of 0/1 planes in the order of ``world.plane_names``.
        """
        planes = self._planes.copy()
        planes[self._flat_addresses] = 1
        return planes.reshape(self.num_envs, -1, self.world.height, self.world.width)

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Copy the whole state into arrays, for :meth:`load_state_dict`."""
        return {
            "streams": self.streams,
            "planes": self._planes.copy(),
            "contents": self._content_rows.copy(),
            "cells": self._addresses - self._origins,
            "counters": self._counters.copy(),
            "turn_offsets": self._turn_offsets.copy(),
            "elapsed": self.elapsed,
        }

    def load_state_dict(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Continue from a state that :meth:`state_dict` of an engine of the same shape returned.

        Raises
        ------
        ValueError
            If an array is missing or has another shape or dtype than this engine's own.
        """
        for name, own in self.state_dict().items():
            given = state.get(name)
            if given is None or given.shape != own.shape or given.dtype != own.dtype:
                found = "missing" if given is None else f"{given.dtype} {given.shape}"
                raise ValueError(f"state[{name!r}] is {found}; it must be {own.dtype} {own.shape}")
        self._streams[:] = state["streams"]
        self._planes[:] = state["planes"]
        self._content_rows[:] = state["contents"]
        self._addresses[:] = np.asarray(state["cells"], dtype=np.int64) + self._origins
        self._counters[:] = state["counters"]
        self._turn_offsets[:] = state["turn_offsets"]
        self._ends[:] = self._clock - np.asarray(state["elapsed"], dtype=np.int64) + self.world.horizon
        self._next_end = int(self._ends.min())
        if self._occupied is not None:
            self._occupied[:] = 0
            self._occupied[self._addresses] = 1

    def _require_actions(self, actions: ArrayLike) -> NDArray[np.int64]:
        """Return ``actions`` as an int64 array of their own shape, or raise a ValueError if they are none."""
        array = np.asarray(actions)
        if array.dtype != np.int64:
            if array.dtype.kind not in "iu":
                raise ValueError(f"actions have dtype {array.dtype}; they must be integers")
            array = array.astype(np.int64)
        shape = (self.num_envs, self.num_agents)
        if array.shape != shape and (self.num_agents > 1 or array.shape != (self.num_envs,)):
            raise ValueError(f"actions have shape {array.shape}; they must have shape {shape}")
        # Seen as unsigned, a negative action is a huge one, so that one look at the largest checks both ends.
        unsigned = array.view(np.uint64)
        largest = unsigned.argmax()
        if unsigned.item(largest) >= NUM_ACTIONS:
            raise ValueError(f"actions contain {array.item(largest)}; an action is 0 to {NUM_ACTIONS - 1}")
        return array

    def _act_alone(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        """Let the only agent act; returns rewards (n_envs, 1, k)."""
        outcomes = self._act(self._flat_addresses, actions.reshape(-1))
        self._flat_counters += self._tables.counts.take(outcomes, axis=0)
        return self._tables.rewards.take(outcomes, axis=0)[:, None]

    def _act_in_turn(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        """Let several agents act one after the other; returns rewards (n_envs, n_agents, k)."""
        assert self._occupied is not None
        rewards = np.empty((*actions.shape, len(self.world.reward_names)), dtype=np.float32)
        phases = (self._turn_offsets + self.elapsed) % (2 * self.num_agents)
        directions = np.where(phases < self.num_agents, 1, -1)
        for turn in range(self.num_agents):
            acting = (self._env_indices, (phases + turn * directions) % self.num_agents)
            addresses, own_actions = self._addresses[acting], actions[acting]
            ahead = self._occupied.take(addresses + self._tables.directions.take(own_actions))
            blocked = (ahead != 0) & (own_actions < _WAIT)
            self._occupied[addresses] = 0
            outcomes = self._act(addresses, np.where(blocked, _WAIT, own_actions))
            self._occupied[addresses] = 1
            self._addresses[acting] = addresses
            self._counters[acting] += self._tables.counts.take(outcomes, axis=0)
            rewards[acting] = self._tables.rewards.take(outcomes, axis=0)
        if self.team_reward:
            rewards[:] = rewards.sum(axis=1, keepdims=True)
        return rewards

    def _act(self, addresses: NDArray[np.int64], actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """Let one agent of every environment act; returns the rows of the tables that hold what follows.

        All arrays have shape (n_envs,). ``addresses`` are the agents' own and change in place.
        """
        tables = self._tables
        touched = tables.directions.take(actions)
        touched += addresses
        outcomes = self._contents.take(touched) + actions
        addresses += tables.shifts.take(outcomes)
        removing = tables.removes.take(outcomes).nonzero()[0]
        if removing.size:
            removed = touched.take(removing)
            self._contents[removed] = _FREE
            removed += tables.planes.take(outcomes.take(removing))
            self._planes[removed] = 0
        if self._fixture_addresses is not None:
            standing = addresses == self._fixture_addresses
            np.add(outcomes, tables.num_rows, out=outcomes, where=standing)
        return outcomes


def _sample_distinct(values: NDArray[np.int64], draws: NDArray[np.int64]) -> NDArray[np.int64]:
    """Shuffle ``values`` (f,) as far as needed, once per column of ``draws`` (m, n); returns (m, n).

    Fisher and Yates: draw ``i`` lies in ``0 .. f - 1 - i`` and picks from the values not yet taken.
    """
    count, columns = draws.shape
    # A short integer type, so that the whole pool stays in the processor's cache.
    pool = np.repeat(values.astype(np.int32)[:, None], columns, axis=1)
    flat = pool.ravel()
    picks = draws + np.arange(count)[:, None]
    picks *= columns
    picks += np.arange(columns)
    taken = np.empty((count, columns), dtype=np.int32)
    for i in range(count):
        taken[i] = flat.take(picks[i])
        flat[picks[i]] = pool[i]
    return taken.astype(np.int64)
