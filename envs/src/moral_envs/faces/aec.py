"""The PettingZoo ``AECEnv`` face: agents give their actions one after the other, then the world steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, SupportsIndex

import numpy as np
from gymnasium import spaces
from pettingzoo import AECEnv
from pettingzoo.utils import AgentSelector

from moral_envs.arguments import as_integer
from moral_envs.engine import Engine
from moral_envs.faces.common import Frame, of_agent
from moral_envs.faces.parallel import AgentID, GridParallelEnv, Info, Observation, Reward
from moral_envs.world import World


class GridAECEnv(AECEnv[AgentID, Observation, SupportsIndex | None]):
    """A world as a PettingZoo agent-environment-cycle environment with vector rewards.

    The world steps when the last agent has given its action; until then all agents keep what they last saw.

    Parameters
    ----------
    world, num_agents, team_reward, render_mode, view_radius, agent_rewards
        As for :class:`~moral_envs.faces.parallel.GridParallelEnv`.
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
        super().__init__()
        self.parallel = GridParallelEnv(
            world, num_agents, team_reward, render_mode, view_radius, agent_rewards
        )
        self.render_mode = self.parallel.render_mode
        self.metadata = self.parallel.metadata
        self.reward_names = world.reward_names
        self.agent_reward_names = self.parallel.agent_reward_names
        self.objective_names = world.objective_names
        self.possible_agents = list(self.parallel.possible_agents)
        self.agents: list[AgentID] = []
        self.observation_spaces = self.parallel.observation_spaces
        self.action_spaces = self.parallel.action_spaces
        self.reward_spaces = self.parallel.reward_spaces
        self._observations: dict[AgentID, Observation] = {}

    @property
    def engine(self) -> Engine:
        """The simulation behind the environment."""
        return self.parallel.engine

    def observation_space(self, agent: AgentID) -> spaces.Box:
        """Space of one agent's observations, always the same object."""
        return self.parallel.observation_space(agent)

    def action_space(self, agent: AgentID) -> spaces.Discrete:
        """Space of one agent's actions, always the same object."""
        return self.parallel.action_space(agent)

    def reward_space(self, agent: AgentID) -> spaces.Box:
        """Space of one agent's reward vectors, always the same object."""
        return self.parallel.reward_space(agent)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start an episode.

        Parameters
        ----------
        seed
            Of the environment's random stream, 0 or more. None: the stream goes on from the last episode; the
            first one takes fresh entropy.
        options
            Not used.

        Raises
        ------
        ValueError
            If the seed is negative or no integer.
        """
        self._observations, self.infos = self.parallel.reset(seed=seed, options=options)
        self._keep_infos()
        self.agents = list(self.possible_agents)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self._clear_rewards()
        self._cumulative_rewards = {agent: self._no_reward(agent) for agent in self.agents}
        self._actions: dict[AgentID, int] = {}
        self._selector = AgentSelector(self.agents)
        self.agent_selection = self._selector.next()

    def step(self, action: SupportsIndex | None) -> None:
        """Give the selected agent's action.

        Parameters
        ----------
        action
            Index into :data:`~moral_envs.world.ACTION_NAMES`; None for an agent whose episode has ended.

        Raises
        ------
        ValueError
            If the action is none of this world's or there is no episode; nothing has changed then.
        """
        if not self.agents:
            raise ValueError("action was given outside an episode; call reset first")
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        number, last = as_integer(action), self.engine.world.num_actions - 1
        if number is None:
            raise ValueError(f"action is {action!r}; it must be an integer, 0 to {last}")
        if not 0 <= number <= last:
            raise ValueError(f"action is {number}; it must be 0 to {last}")
        self._cumulative_rewards[agent] = self._no_reward(agent)
        self._actions[agent] = number
        if self._selector.is_last():
            step = self.parallel.step(self._actions)
            self._observations, self.rewards, self.terminations, self.truncations, self.infos = step
            self._keep_infos()
            self._actions = {}
            for name, reward in self.rewards.items():
                self._cumulative_rewards[name] = self._cumulative_rewards[name] + reward
        else:
            self._clear_rewards()
        self.agent_selection = self._selector.next()

    def last(self, observe: bool = True) -> tuple[Observation | None, Reward, bool, bool, Info]:
        """Return what the selected agent sees, got since its last action, and whether its episode ended."""
        if not self.agents:
            raise ValueError("last was called outside an episode; call reset first")
        # The interface's own tests demand what equals ``infos``, and arrays in a dict equal only themselves.
        # So ``infos`` gets fresh arrays, too, and what a caller does to them lasts until the next call only.
        self.infos[self.agent_selection] = self._own_info(self.agent_selection)
        observation, reward, terminated, truncated, info = super().last(observe)
        return observation, reward.copy(), terminated, truncated, info

    def observe(self, agent: AgentID) -> Observation:
        """Show what the agent saw after the last step of the world, uint8 (C, H, W), a fresh array."""
        if not self._observations:
            raise ValueError("observe was called before the first episode; call reset first")
        return of_agent(self._observations, agent).copy()

    def render(self) -> Frame | None:
        """Draw the current state as ``render_mode`` says."""
        return self.parallel.render()

    def state(self) -> Observation:
        """Planes of the whole world, walls, one per agent, then objects: uint8 (planes, height, width)."""
        return self.parallel.state()

    @property
    def state_space(self) -> spaces.Box:
        """Space of :meth:`state`."""
        return self.parallel.state_space

    def get_central_observation_space(self) -> spaces.Box:
        """Space of the flattened :meth:`state`, for MOMAland's ``CentraliseAgent``."""
        return self.parallel.get_central_observation_space()

    def close(self) -> None:
        """Close the window of ``render_mode="human"``."""
        self.parallel.close()

    def _clear_rewards(self) -> None:
        self.rewards = {agent: self._no_reward(agent) for agent in self.agents}

    def _keep_infos(self) -> None:
        self._last_infos = self.infos
        self.infos = {agent: self._own_info(agent) for agent in self._last_infos}

    def _own_info(self, agent: AgentID) -> Info:
        return {name: array.copy() for name, array in self._last_infos[agent].items()}

    def _no_reward(self, agent: AgentID) -> Reward:
        return np.zeros(len(self.agent_reward_names[agent]), dtype=np.float32)
