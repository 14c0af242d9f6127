"""The simulation: a batch of environments of one world, stepped at once.

``reset`` and ``step`` are the only places where state changes; no loop runs over environments. What an action
leads to is looked up in :mod:`moral_envs.outcomes`; where an episode starts is drawn by
:mod:`moral_envs.placement`.

Rules
-----
With chance ``world.slip`` an agent's action becomes a move in a random direction. The agent moves (walls and
other agents block; objects do not) or interacts with a neighbouring cell. Then the fixture pays if the agent
stands on its cell, and ends the episode if it is one that terminates. Rewards and counters see the state
after the move. Once all agents have acted, objects that walk do so, one after the other. Every environment
truncates after ``world.horizon`` steps. The engine does not stop there: until the environment is reset its
world goes on and every step ends it again. It is the faces that refuse to step beyond the end.

Agents act one after the other. Who is first rotates by one every step, and the order goes round upwards in
the agents' numbers for as many steps as there are agents and downwards for as many. So over twice as many
steps as agents each of any two agents precedes the other equally often. Where in these rounds an episode
starts is drawn at reset, so the order is fixed by the seed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from moral_envs.arguments import require_bool, require_integer
from moral_envs.outcomes import FIRST_OBJECT, FREE, WALL, OutcomeTables
from moral_envs.placement import Placer
from moral_envs.streams import draw_integers, seed_unseeded, spawn_streams
from moral_envs.world import NUM_ACTIONS, NUM_MOVES, World

MAX_AGENTS = 16

_CHANCES = 2**16
"""A chance is drawn as an integer below this."""


class Step(NamedTuple):
    """What one step of all environments brought."""

    rewards: NDArray[np.float32]
    """Reward vectors, shape (n_envs, n_agents, k)."""
    terminations: NDArray[np.bool_]
    """Which episodes have reached a terminal state, shape (n_envs,)."""
    truncations: NDArray[np.bool_]
    """Which of the others have reached their horizon, shape (n_envs,)."""
    any_end: bool
    """Whether there is one of either."""


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
    view_radius
        How many cells an agent sees in each direction. None: the whole grid.
    agent_rewards
        For each agent the names of the reward components that it is paid; the others are zero for it.
        Reward vectors keep the world's order, whatever the order of the names. None: all are paid all.

    Raises
    ------
    ValueError
        If a number is out of range, a name unknown, or agents and objects do not fit on the free cells.
    """

    def __init__(
        self,
        world: World,
        num_envs: int = 1,
        num_agents: int = 1,
        team_reward: bool = False,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
    ) -> None:
        num_envs = require_integer("num_envs", num_envs, 1, "at least 1")
        num_agents = require_integer("num_agents", num_agents, 1, f"1 to {MAX_AGENTS}")
        if num_agents > MAX_AGENTS:
            raise ValueError(f"num_agents is {num_agents}; it must be 1 to {MAX_AGENTS}")
        team_reward = require_bool("team_reward", team_reward)
        if view_radius is not None:
            wanted = "at least 1, or None for the whole grid"
            view_radius = require_integer("view_radius", view_radius, 1, wanted)
        self.world = world
        self.num_envs = num_envs
        self.num_agents = num_agents
        self.team_reward = team_reward
        self.view_radius = view_radius
        self.agent_rewards = _require_agent_rewards(agent_rewards, world, num_agents)
        # Their own: what the caller does to the lists later is not for copies of this engine.
        names = None if agent_rewards is None else tuple(tuple(listed) for listed in agent_rewards)
        self._arguments = (world, num_envs, num_agents, team_reward, view_radius, names)
        self.action_shape: tuple[int, ...] = (num_envs, num_agents)
        """The shape that the message about actions of another shape asks for; faces put their own here."""
        self._streams = spawn_streams(None, num_envs)
        self._unseeded = np.ones(num_envs, dtype=np.bool_)
        self._placer = Placer(world, num_agents)
        self._tables = OutcomeTables(world)

        # Only where something can stand in an agent's way must it be known where agents are: a plane more.
        self._walkers = _Walkers(world, num_envs)
        self._shared = num_agents > 1 or len(self._walkers.chances) > 0
        self._num_planes = len(world.plane_names)
        planes = self._num_planes + self._shared
        cells = world.height * world.width
        self._to_occupancy = (self._num_planes - 1) * cells

        # A cell's address: environment, agent plane, cell, as one flat index. Contents use the same addresses
        # as the planes, so that one index serves both; the agent plane itself stays zero until it is handed
        # out. A content is the first row of its kind in the tables; bytes, to stay in the processor's cache.
        self._origins = (np.arange(num_envs, dtype=np.int64)[:, None] * planes + 1) * cells
        self._planes = np.zeros(num_envs * planes * cells, dtype=np.uint8)
        self._contents = np.zeros_like(self._planes)
        self._plane_rows = self._planes.reshape(num_envs, planes, cells)
        self._content_rows = self._contents.reshape(num_envs, planes, cells)[:, 1]
        self._blank_planes = np.zeros((planes, cells), dtype=np.uint8)
        self._blank_planes[0] = self._placer.walls
        self._fixture_addresses: NDArray[np.int64] | None = None
        self._to_fixture = (self._num_planes - 2) * cells
        if world.fixture is not None:
            self._fixture_addresses = self._origins[:, 0] + self._placer.fixture_cell
            if world.layout is None:
                self._blank_planes[self._num_planes - 1, self._placer.fixture_cell] = 1
        self._blank_contents = self._placer.walls * np.uint8(WALL * NUM_ACTIONS)

        self._addresses = np.zeros((num_envs, num_agents), dtype=np.int64)
        self._counters = np.zeros((num_envs, num_agents, len(world.objective_names)), dtype=np.int64)
        # Views without the axis of agents; so these two arrays change in place only.
        self._flat_addresses = self._addresses.reshape(-1)
        self._flat_counters = self._counters.reshape(num_envs * num_agents, -1)
        # One clock for all environments; each ends at its own time, and the earliest of these is kept.
        self._clock = 0
        self._horizons = np.full(num_envs, world.horizon, dtype=np.int64)
        self._ends = np.zeros(num_envs, dtype=np.int64)
        self._next_end = 0
        kinds = np.repeat(np.arange(len(world.objects)), [kind.count for kind in world.objects])
        self._object_contents = ((FIRST_OBJECT + kinds) * NUM_ACTIONS).astype(np.uint8)[:, None]
        self._object_planes = ((1 + kinds) * cells)[:, None]

        self._turn_offsets = np.zeros(num_envs, dtype=np.int64)
        self._turns = _turns(num_agents)
        self._first_rows = np.arange(num_envs) * num_agents
        # From an agent's address to its cell on the agent plane of its own observation, among all agents'.
        own_planes = (np.arange(num_envs * num_agents).reshape(-1, num_agents) * planes + 1) * cells
        self._own_planes = own_planes - self._origins
        slips = num_agents if world.slip > 0 else 0
        self._slip_chance = round(world.slip * _CHANCES)
        chances = [_CHANCES, NUM_MOVES] * (slips + len(self._walkers.chances))
        self._step_bounds = np.array(chances, dtype=np.uint64)
        self.deterministic = not chances
        """Whether nothing is random after the start of an episode."""
        self._terminating = world.fixture is not None and world.fixture.terminates
        self.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        # Copied or pickled one by one, arrays that share memory would come apart.
        return _rebuild, (self._arguments, self.state_dict(), self._unseeded, self.action_shape)

    @property
    def observation_shape(self) -> tuple[int, int, int]:
        """Shape (C, H, W) of one agent's observation."""
        planes = len(self.world.plane_names) + (1 if self.num_agents > 1 else 0)
        if self.view_radius is None:
            return planes, self.world.height, self.world.width
        return planes, 2 * self.view_radius + 1, 2 * self.view_radius + 1

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
        return self._clock - self._ends + self._horizons

    @property
    def horizons(self) -> NDArray[np.int64]:
        """Steps after which the current episodes truncate, shape (n_envs,), a fresh array."""
        return self._horizons.copy()

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
        self._unseeded[slice(None) if mask is None else mask] = False

    def seed_unseeded(self, seed: int | None = None, mask: NDArray[np.bool_] | None = None) -> None:
        """Seed all environments, or those in ``mask``, that have never been seeded.

        The faces do so when an episode starts without a seed, Gymnasium's with their ``np_random_seed``, and
        not when they are made: copies of an environment, in this process or in others, then differ.

        Parameters
        ----------
        seed
            Seed of the batch, as for :func:`~moral_envs.streams.spawn_streams`; None takes fresh entropy.
        mask
            bool array of shape (n_envs,).
        """
        seed_unseeded(self._streams, self._unseeded, seed, mask)

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
        placement = self._placer.place(streams)
        self._streams[envs] = streams
        self._turn_offsets[envs] = placement.turns

        self._plane_rows[envs] = self._blank_planes
        self._content_rows[envs] = self._blank_contents
        objects = placement.objects + origins
        if placement.rooms is None:
            self._planes[objects + self._object_planes] = 1
            self._contents[objects] = self._object_contents
        else:
            rooms = placement.rooms
            self._plane_rows[envs, 0] = rooms.walls
            self._content_rows[envs] = rooms.walls * np.uint8(WALL * NUM_ACTIONS)
            self._planes[(objects + self._object_planes)[rooms.present]] = 1
            contents = np.broadcast_to(self._object_contents, objects.shape)
            self._contents[objects[rooms.present]] = contents[rooms.present]
            self._horizons[envs] = rooms.horizons
            if self._fixture_addresses is not None:
                self._fixture_addresses[envs] = rooms.fixtures + origins
                self._planes[self._fixture_addresses[envs] + self._to_fixture] = 1
        self._walkers.addresses[:, envs] = objects[self._walkers.objects]
        self._walkers.walking[:, envs] = (
            True if placement.rooms is None else placement.rooms.present[self._walkers.objects]
        )
        agents = placement.agents + origins
        self._addresses[envs] = agents.T
        if self._shared:
            self._planes[agents + self._to_occupancy] = 1

        self._counters[envs] = 0
        self._ends[envs] = self._clock + self._horizons[envs]
        self._next_end = int(self._ends.min())

    def step(self, actions: ArrayLike, restart: NDArray[np.bool_] | None = None) -> Step:
        """Take one step in every environment.

        Parameters
        ----------
        actions
            Integers of shape (n_envs, n_agents), or (n_envs,) if there is one agent, each below
            ``world.num_actions`` (:data:`~moral_envs.world.ACTION_NAMES`).
        restart
            bool array of shape (n_envs,): environments that ignore their actions, start a new episode from
            their own streams and are paid nothing.

        Returns
        -------
        Step
            Rewards of shape (n_envs, n_agents, k), terminations and truncations of shape (n_envs,), fresh.

        Raises
        ------
        ValueError
            If the actions are not integers, out of range or of another shape; nothing has changed then.
        """
        actions = self._require_actions(actions)
        if restart is not None:
            return self._step_and_restart(actions, restart)
        return self._step(actions)

    def _step(self, actions: NDArray[np.int64]) -> Step:
        if self.deterministic:
            rewards = self._act_in_turn(actions) if self._shared else self._act_alone(actions)
        else:
            rewards = self._act_by_chance(actions)
        if self.agent_rewards is not None:
            rewards *= self.agent_rewards
        self._clock += 1
        terminations: NDArray[np.bool_]
        if self._terminating:
            terminations = np.logical_or.reduce(self._standing(), axis=1)
        else:
            terminations = np.zeros(self.num_envs, dtype=np.bool_)
            if self._clock < self._next_end:
                return Step(rewards, terminations, terminations.copy(), False)
        truncations = (self._clock >= self._ends) & ~terminations
        return Step(rewards, terminations, truncations, bool(terminations.any() or truncations.any()))

    def _step_and_restart(self, actions: NDArray[np.int64], restart: NDArray[np.bool_]) -> Step:
        if restart.all():
            self.reset()
            rewards = np.zeros((*self._addresses.shape, len(self.world.reward_names)), dtype=np.float32)
            return Step(rewards, np.zeros_like(restart), np.zeros_like(restart), False)
        # An ignored action takes nothing from the stream.
        streams = self.streams
        step = self._step(actions)
        np.copyto(self._streams, streams, where=restart)
        self.reset(restart)
        for array in step[:3]:
            array[restart] = 0
        return step._replace(any_end=bool(step.terminations.any() or step.truncations.any()))

    def observe(self) -> NDArray[np.uint8]:
        """Show each agent its observation.

        Returns
        -------
        uint8 array of shape (n_envs, n_agents, C, H, W)
            A fresh array of 0/1 planes in the order of ``world.plane_names``; with several agents a plane of
            the other agents comes last. With ``view_radius`` r, H and W are 2 r + 1, the agent is in the
            middle, and beyond the border everything is wall.
        """
        if self.view_radius is not None:
            return self._observe_windows(self.view_radius)
        if self.num_agents == 1:
            return self.world_planes()[:, None]
        shape = (self.num_envs, self.num_agents, *self.observation_shape)
        observations = np.empty((*shape[:2], self._plane_rows[0].size), dtype=np.uint8)
        observations[:] = self._plane_rows.reshape(self.num_envs, 1, -1)
        own = self._own_planes + self._addresses
        flat = observations.reshape(-1)
        flat[own] = 1
        own += self._to_occupancy
        flat[own] = 0
        return observations.reshape(shape)

    def world_planes(self) -> NDArray[np.uint8]:
        """Show the whole worlds, all agents on the agent plane.

        Returns
        -------
        uint8 array of shape (n_envs, C, H, W)
            A fresh array of 0/1 planes in the order of ``world.plane_names``.
        """
        if self._shared:
            planes = self._plane_rows[:, : self._num_planes].copy()
            planes[np.arange(self.num_envs)[:, None], 1, self._addresses - self._origins] = 1
        else:
            planes = self._planes.copy()
            planes[self._flat_addresses] = 1
        return planes.reshape(self.num_envs, -1, self.world.height, self.world.width)

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Copy the whole state into arrays, for :meth:`load_state_dict`.

        It is the engine's alone: whether an episode goes on is known to the faces. To branch from a state of
        a face, copy the face (``copy.deepcopy``).
        """
        state: dict[str, NDArray[np.generic]] = {
            "streams": self.streams,
            "planes": self._plane_rows[:, : self._num_planes].reshape(-1).copy(),
            "contents": self._content_rows.copy(),
            "cells": self._addresses - self._origins,
            "counters": self._counters.copy(),
            "turn_offsets": self._turn_offsets.copy(),
            "elapsed": self.elapsed,
        }
        if len(self._walkers.chances):
            state["walker_cells"] = self._walkers.addresses - self._origins[:, 0]
            state["walking"] = self._walkers.walking.copy()
        if self.world.layout is not None:
            state["horizons"] = self.horizons
        return state

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
        self._unseeded[:] = False
        planes = np.asarray(state["planes"], dtype=np.uint8).reshape(self.num_envs, self._num_planes, -1)
        self._plane_rows[:, : self._num_planes] = planes
        self._content_rows[:] = state["contents"]
        self._addresses[:] = np.asarray(state["cells"], dtype=np.int64) + self._origins
        self._counters[:] = state["counters"]
        self._turn_offsets[:] = state["turn_offsets"]
        if len(self._walkers.chances):
            cells = np.asarray(state["walker_cells"], dtype=np.int64)
            self._walkers.addresses[:] = cells + self._origins[:, 0]
            self._walkers.walking[:] = state["walking"]
        if self.world.layout is not None:
            self._horizons[:] = state["horizons"]
            if self._fixture_addresses is not None:
                self._fixture_addresses[:] = self._origins[:, 0] + planes[:, -1].argmax(axis=1)
        self._ends[:] = self._clock - np.asarray(state["elapsed"], dtype=np.int64) + self._horizons
        self._next_end = int(self._ends.min())
        if self._shared:
            self._plane_rows[:, -1] = 0
            self._planes[self._addresses + self._to_occupancy] = 1

    def _require_actions(self, actions: ArrayLike) -> NDArray[np.int64]:
        """Return ``actions`` as an int64 array of their own shape, or raise a ValueError if they are none."""
        try:
            array = given = np.asarray(actions)
        except ValueError:
            wanted = f"integers of shape {self.action_shape}"
            raise ValueError(f"actions are {actions!r}; they must be {wanted}") from None
        if array.dtype != np.int64:
            if array.dtype.kind not in "iu":
                raise ValueError(f"actions have dtype {array.dtype}; they must be integers")
            array = array.astype(np.int64)
        shape = (self.num_envs, self.num_agents)
        if array.shape != shape and (self.num_agents > 1 or array.shape != (self.num_envs,)):
            raise ValueError(f"actions have shape {array.shape}; they must have shape {self.action_shape}")
        # Seen as unsigned, a negative action is a huge one, so that one look at the largest checks both ends.
        unsigned = array.view(np.uint64)
        largest = unsigned.argmax()
        if unsigned.item(largest) >= self.world.num_actions:
            last = self.world.num_actions - 1
            raise ValueError(f"actions contain {given.item(largest)}; an action is 0 to {last}")
        return array

    def _act_by_chance(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        """Let agents act, who may slip, and then objects walk; returns rewards (n_envs, n_agents, k)."""
        draws = draw_integers(self._streams, self._step_bounds).reshape(-1, 2, self.num_envs)
        if self._slip_chance:
            luck, directions = draws[: self.num_agents].swapaxes(0, 1)
            slipping = self._slip_chance > luck.T
            actions = np.where(slipping, directions.T, actions.reshape(slipping.shape))
        rewards = self._act_in_turn(actions) if self._shared else self._act_alone(actions)
        if len(self._walkers.chances):
            self._walk(draws[-len(self._walkers.chances) :])
        return rewards

    def _act_alone(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        """Let the only agent act; returns rewards (n_envs, 1, k)."""
        tables, addresses, actions = self._tables, self._flat_addresses, actions.reshape(-1)
        touched = tables.directions.take(actions)
        touched += addresses
        outcomes = self._contents.take(touched) + actions
        addresses += tables.shifts.take(outcomes)
        self._remove(touched, outcomes)
        if self._fixture_addresses is not None:
            np.add(outcomes, tables.standing, out=outcomes, where=addresses == self._fixture_addresses)
        self._flat_counters += tables.counts.take(outcomes, axis=0)
        return tables.rewards.take(outcomes, axis=0)[:, None]

    def _act_in_turn(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        """Let several agents act one after the other; returns rewards (n_envs, n_agents, k)."""
        tables, planes = self._tables, self._planes
        # Arrays of shape (n_agents, n_envs) are in the order of turns; each agent changes its own row only.
        phases = (self._turn_offsets + self.elapsed) % (2 * self.num_agents)
        acting = self._turns.take(phases, axis=1)
        acting += self._first_rows
        addresses, actions = self._flat_addresses.take(acting), actions.reshape(-1).take(acting)
        touched = tables.directions.take(actions)
        touched += addresses
        occupancies = addresses + self._to_occupancy
        looked_at = touched + self._to_occupancy
        outcomes_by_turn = actions.copy()
        for turn in range(self.num_agents):
            occupancy, outcomes = occupancies[turn], outcomes_by_turn[turn]
            outcomes += self._contents.take(touched[turn])
            outcomes += tables.occupied.take(planes.take(looked_at[turn]))
            planes[occupancy] = 0
            occupancy += tables.shifts.take(outcomes)
            planes[occupancy] = 1
            self._remove(touched[turn], outcomes)
        occupancies -= self._to_occupancy
        self._flat_addresses[acting] = occupancies
        outcomes = np.empty(acting.size, dtype=np.int64)
        outcomes[acting] = outcomes_by_turn
        if self._fixture_addresses is not None:
            np.add(outcomes, tables.standing, out=outcomes, where=self._standing().ravel())
        self._flat_counters += tables.counts.take(outcomes, axis=0)
        rewards = tables.rewards.take(outcomes, axis=0).reshape(self.num_envs, self.num_agents, -1)
        if self.team_reward:
            rewards[:] = rewards.sum(axis=1, keepdims=True, dtype=np.float64)
        return rewards

    def _remove(self, touched: NDArray[np.int64], outcomes: NDArray[np.int64]) -> None:
        """Take the touched objects away where the outcomes say so; both arrays have shape (n_envs,)."""
        removing = self._tables.removes.take(outcomes).nonzero()[0]
        if removing.size:
            removed = touched.take(removing)
            self._contents[removed] = FREE
            removed += self._tables.planes.take(outcomes.take(removing))
            self._planes[removed] = 0

    def _standing(self) -> NDArray[np.bool_]:
        """Which agents stand on the fixture, shape (n_envs, n_agents)."""
        assert self._fixture_addresses is not None
        standing: NDArray[np.bool_] = self._addresses == self._fixture_addresses[:, None]
        return standing

    def _walk(self, draws: NDArray[np.int64]) -> None:
        """Let the objects walk, one after the other; draws (walkers, 2, n_envs): whether, and where to."""
        walkers = self._walkers
        # What an agent has just removed walks no more; nothing has had the time to take its place.
        planes = self._object_planes[walkers.objects]
        walkers.walking &= self._planes.take(walkers.addresses + planes).view(np.bool_)
        for number, (chance, (luck, direction)) in enumerate(zip(walkers.chances, draws, strict=True)):
            address = walkers.addresses[number]
            target = address + self._tables.directions.take(direction)
            free = self._contents.take(target) == FREE
            free &= self._planes.take(target + self._to_occupancy) == 0
            moving = (free & walkers.walking[number] & (luck < chance)).nonzero()[0]
            left, entered = address.take(moving), target.take(moving)
            self._contents[left] = FREE
            self._contents[entered] = self._object_contents[walkers.objects[number], 0]
            self._planes[left + planes[number]] = 0
            self._planes[entered + planes[number]] = 1
            address[moving] = entered

    def _observe_windows(self, radius: int) -> NDArray[np.uint8]:
        """Show each agent the cells around it, uint8 (n_envs, n_agents, C, 2 radius + 1, 2 radius + 1)."""
        planes = self._plane_rows[:, : self._num_planes] if self.num_agents == 1 else self._plane_rows
        planes = planes.reshape(self.num_envs, -1, self.world.height, self.world.width)
        padded = np.pad(planes, [(0, 0), (0, 0), (radius, radius), (radius, radius)])
        inside = np.zeros(padded.shape[2:], dtype=np.bool_)
        inside[radius:-radius, radius:-radius] = True
        padded[:, 0, ~inside] = 1
        windows = sliding_window_view(padded, (2 * radius + 1, 2 * radius + 1), axis=(2, 3))
        rows, columns = np.divmod(self._addresses - self._origins, self.world.width)
        envs = np.arange(self.num_envs)[:, None]
        observations: NDArray[np.uint8] = windows[envs, :, rows, columns]
        observations[:, :, 1, radius, radius] = 1
        if self.num_agents > 1:
            observations[:, :, -1, radius, radius] = 0
        return observations


def _rebuild(
    arguments: tuple[Any, ...],
    state: dict[str, NDArray[np.generic]],
    unseeded: NDArray[np.bool_],
    action_shape: tuple[int, ...],
) -> Engine:
    engine = Engine(*arguments)
    engine.action_shape = action_shape
    engine.load_state_dict(state)
    engine._unseeded[:] = unseeded
    return engine


class _Walkers:
    """The objects that walk.

    Attributes
    ----------
    objects : int64 array of shape (walkers,)
        Their places among all the world's objects.
    chances : int64 array of shape (walkers,)
        Chance of a step, out of ``_CHANCES``.
    addresses : int64 array of shape (walkers, n_envs)
        Where they are, or were when they disappeared.
    walking : bool array of shape (walkers, n_envs)
        Whether they are still there.
    """

    def __init__(self, world: World, num_envs: int) -> None:
        chances = np.repeat([kind.walks for kind in world.objects], [kind.count for kind in world.objects])
        self.objects = np.flatnonzero(chances)
        self.chances = np.rint(chances[self.objects] * _CHANCES).astype(np.int64)
        self.addresses = np.zeros((len(self.objects), num_envs), dtype=np.int64)
        self.walking = np.zeros(self.addresses.shape, dtype=np.bool_)


def _turns(num_agents: int) -> NDArray[np.int64]:
    """Who acts when: int64 (n_agents, 2 n_agents), a column for each step of a double round."""
    first, turn = np.arange(2 * num_agents), np.arange(num_agents)[:, None]
    return (first + np.where(first < num_agents, turn, -turn)) % num_agents


def _is_listing(value: object) -> bool:
    return isinstance(value, Collection) and not isinstance(value, str)


def _require_agent_rewards(
    agent_rewards: Sequence[Sequence[str]] | None, world: World, num_agents: int
) -> NDArray[np.float32] | None:
    """Return which components each agent is paid as 0/1 of shape (n_agents, k); None if all are paid all."""
    if agent_rewards is None:
        return None
    if not _is_listing(agent_rewards):
        raise ValueError(f"agent_rewards is {agent_rewards!r}; it must list names for each agent")
    if len(agent_rewards) != num_agents:
        found = len(agent_rewards)
        raise ValueError(
            f"agent_rewards has {found} entries; it must have one for each of {num_agents} agents"
        )
    for names in agent_rewards:
        if not _is_listing(names) or not names or any(name not in world.reward_names for name in names):
            raise ValueError(
                f"agent_rewards has {names!r}; for each agent it must list some of {world.reward_names}"
            )
        if len(set(names)) < len(names):
            raise ValueError(f"agent_rewards has {names!r}; it must name each component once")
    paid = [[name in names for name in world.reward_names] for names in agent_rewards]
    return np.array(paid, dtype=np.float32)
