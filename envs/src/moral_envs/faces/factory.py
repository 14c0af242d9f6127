"""What a world's module offers: a function for each of the standard interfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from gymnasium.vector import AutoresetMode

from moral_envs.faces.aec import GridAECEnv
from moral_envs.faces.parallel import GridParallelEnv
from moral_envs.faces.single import GridEnv
from moral_envs.faces.vector import GridVectorEnv
from moral_envs.world import World


class Faces:
    """The interfaces of one world; a module binds these methods to its own names.

    Parameters
    ----------
    world
        Makes the world from its rules, which every method takes as further keyword arguments.
    single
        Class of the Gymnasium environment.
    """

    def __init__(self, world: Callable[..., World], single: type[GridEnv] = GridEnv) -> None:
        self._world = world
        self._single = single

    def parallel_env(
        self,
        num_agents: int = 1,
        team_reward: bool = False,
        render_mode: str | None = None,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
        **rules: Any,
    ) -> GridParallelEnv:
        """Make a PettingZoo parallel environment; ``rules`` go to the module's ``world``."""
        return GridParallelEnv(
            self._world(**rules), num_agents, team_reward, render_mode, view_radius, agent_rewards
        )

    def env(
        self,
        num_agents: int = 1,
        team_reward: bool = False,
        render_mode: str | None = None,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
        **rules: Any,
    ) -> GridAECEnv:
        """Make a PettingZoo agent-environment-cycle environment; ``rules`` go to the module's ``world``."""
        return GridAECEnv(
            self._world(**rules), num_agents, team_reward, render_mode, view_radius, agent_rewards
        )

    def single_env(
        self, render_mode: str | None = None, view_radius: int | None = None, **rules: Any
    ) -> GridEnv:
        """Make a single-agent Gymnasium environment; ``rules`` go to the module's ``world``."""
        return self._single(self._world(**rules), render_mode, view_radius)

    def vector_env(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_agents: int | None = None,
        team_reward: bool = False,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
        **rules: Any,
    ) -> GridVectorEnv:
        """Make a Gymnasium vector environment; ``rules`` go to the module's ``world``.

        With ``num_agents`` all that belongs to an agent has an axis for them after that of the environments.
        """
        return GridVectorEnv(
            self._world(**rules),
            num_envs,
            render_mode,
            autoreset_mode,
            num_agents,
            team_reward,
            view_radius,
            agent_rewards,
        )
