"""The PettingZoo ``ParallelEnv`` face: all agents act at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, SupportsIndex

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from moral_envs.arguments import as_integer
from moral_envs.engine import Engine
from moral_envs.faces.common import (
    RENDER_FPS,
    RENDER_MODES,
    Frame,
    action_space,
    draw_single,
    make_window,
    observation_space,
    of_agent,
    paid_components,
    require_render_mode,
    reward_space,
)
from moral_envs.streams import spawn_streams
from moral_envs.world import World

AgentID = str
Observation = NDArray[np.uint8]
Reward = NDArray[np.float32]
Info = dict[str, Any]


class GridParallelEnv(ParallelEnv[AgentID, Observation, int]):
    """A world as a PettingZoo parallel environment with vector rewards.

    It has what MOMAland's ``MOParallelEnv`` has (``reward_space(agent)``, ``reward_spaces``) and so goes
    through MOMAland's wrappers. Rewards are float32 arrays of shape (k,), fresh for each agent and step.

    Parameters
    ----------
    world
        The rules.
    num_agents
        Agents, named ``agent_0``, ``agent_1``, ...
    team_reward
        Pay and count every agent the sum over all agents instead of its own part.
    render_mode
        None, ``"ansi"``, ``"rgb_array"`` or ``"human"``.
    view_radius
        How many cells an agent sees in each direction. None: the whole grid.
    agent_rewards
        For each agent the names of the reward components that it is paid; its reward vectors have these
        alone, in the world's order, which ``agent_reward_names`` gives. None: all are paid all.
    """

    def __init__(
        self,
        world: World,
        num_agents: int = 1,
        team_reward: bool = False,
        render_mode: str | None = None,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
    ) -> None:
        self.engine = Engine(
            world,
            num_agents=num_agents,
            team_reward=team_reward,
            view_radius=view_radius,
            agent_rewards=agent_rewards,
        )
        self.render_mode = require_render_mode(render_mode)
        self.metadata = {
            "name": world.name,
            "render_modes": list(RENDER_MODES),
            "render_fps": RENDER_FPS,
            "is_parallelizable": True,
            "central_observation": True,
        }
        self.window = make_window(self.engine, render_mode, self.metadata)
        self.reward_names = world.reward_names
        self.objective_names = world.objective_names
        self.possible_agents = [f"agent_{i}" for i in range(self.engine.num_agents)]
        self.agents: list[AgentID] = []
        self.observation_spaces: dict[AgentID, spaces.Box] = {
            agent: observation_space(self.engine) for agent in self.possible_agents
        }
        self.action_spaces: dict[AgentID, spaces.Discrete] = {
            agent: action_space(self.engine) for agent in self.possible_agents
        }
        self.reward_spaces: dict[AgentID, spaces.Box] = {
            agent: reward_space(self.engine, number) for number, agent in enumerate(self.possible_agents)
        }
        self._paid = [paid_components(self.engine, number) for number in range(self.engine.num_agents)]
        self.agent_reward_names = {
            agent: tuple(world.reward_names[component] for component in paid)
            for agent, paid in zip(self.possible_agents, self._paid, strict=True)
        }

    def observation_space(self, agent: AgentID) -> spaces.Box:
        """Space of one agent's observations, always the same object."""
        return of_agent(self.observation_spaces, agent)

    def action_space(self, agent: AgentID) -> spaces.Discrete:
        """Space of one agent's actions, always the same object."""
        return of_agent(self.action_spaces, agent)

    def reward_space(self, agent: AgentID) -> spaces.Box:
        """Space of one agent's reward vectors, always the same object."""
        return of_agent(self.reward_spaces, agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[AgentID, Observation], dict[AgentID, Info]]:
        """Start an episode.

        Parameters
        ----------
        seed
            Of the environment's random stream, 0 or more. None: the stream goes on from the last episode; the
            first one takes fresh entropy.
        options
            Not used.

        Returns
        -------
        observations
            For each agent 0/1 planes, uint8 of shape (C, H, W).
        infos
            For each agent ``{"objectives": counters}``, int64 zeros of shape (m,).

        Raises
        ------
        ValueError
            If the seed is negative or no integer.
        """
        if seed is not None:
            self.engine.seed(spawn_streams(seed, 1))
        self.engine.seed_unseeded()
        self.engine.reset()
        self.agents = list(self.possible_agents)
        if self.window is not None:
            self.window.reset()
        return self._by_agent(self.engine.observe()[0]), self._infos()

    def step(
        self, actions: Mapping[AgentID, SupportsIndex]
    ) -> tuple[
        dict[AgentID, Observation],
        dict[AgentID, Reward],
        dict[AgentID, bool],
        dict[AgentID, bool],
        dict[AgentID, Info],
    ]:
        """Take one step.

        Parameters
        ----------
        actions
            For every agent in ``agents`` an index into :data:`~moral_envs.world.ACTION_NAMES`.

        Returns
        -------
        observations
            For each agent 0/1 planes, uint8 of shape (C, H, W).
        rewards
            For each agent a float32 array of the components that it is paid, shape (k,).
        terminations, truncations
            For each agent whether the episode has reached a terminal state, or else its horizon; the same for
            all. ``agents`` is empty then.
        infos
            For each agent ``{"objectives": counters}`` of the episode so far, int64 of shape (m,).

        Raises
        ------
        ValueError
            If there is no episode, or actions are missing or none of this world's; nothing has changed then.
        """
        if not self.agents:
            raise ValueError("actions were given outside an episode; call reset first")
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions are {actions!r}; they must be a dict with one for each agent")
        if actions.keys() != set(self.agents):
            raise ValueError(f"actions are for {list(actions)}; they must be for {self.agents}")
        joint = []
        for agent in self.agents:
            action = as_integer(actions[agent])
            if action is None:
                wanted = f"an integer, 0 to {self.engine.world.num_actions - 1}"
                raise ValueError(f"actions have {actions[agent]!r} for {agent}; an action is {wanted}")
            joint.append(action)
        step = self.engine.step([joint])
        observations = self._by_agent(self.engine.observe()[0])
        rewards = {
            agent: reward[paid]
            for agent, reward, paid in zip(self.agents, step.rewards[0], self._paid, strict=True)
        }
        terminations = dict.fromkeys(self.agents, bool(step.terminations[0]))
        truncations = dict.fromkeys(self.agents, bool(step.truncations[0]))
        infos = self._infos()
        if self.window is not None:
            self.window.step(step.rewards[0])
        if step.any_end:
            self.agents = []
        return observations, rewards, terminations, truncations, infos

    def render(self) -> Frame | None:
        """Draw the current state as ``render_mode`` says."""
        return draw_single(self.engine, self.render_mode, self.window)

    def state(self) -> Observation:
        """Planes of the whole world, walls, one per agent, then objects: uint8 (planes, height, width)."""
        walls, _, *things = self.engine.world_planes()[0]
        agents = np.zeros((len(self.possible_agents), *walls.shape), dtype=np.uint8)
        rows, columns = self.engine.agent_cells[0].T
        agents[np.arange(len(agents)), rows, columns] = 1
        return np.stack([walls, *agents, *things])

    @property
    def state_space(self) -> spaces.Box:
        """Space of :meth:`state`."""
        return spaces.Box(0, 1, shape=self.state().shape, dtype=np.uint8)

    def get_central_observation_space(self) -> spaces.Box:
        """Space of the flattened :meth:`state`, for MOMAland's ``CentraliseAgent``."""
        return spaces.Box(0, 1, shape=(self.state().size,), dtype=np.uint8)

    def close(self) -> None:
        """Close the window of ``render_mode="human"``."""
        if self.window is not None:
            self.window.close()

    def _by_agent(self, rows: NDArray[Any]) -> dict[AgentID, Any]:
        return {agent: row.copy() for agent, row in zip(self.agents, rows, strict=True)}

    def _infos(self) -> dict[AgentID, Info]:
        objectives = self._by_agent(self.engine.objectives[0])
        return {agent: {"objectives": counters} for agent, counters in objectives.items()}
