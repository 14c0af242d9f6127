"""The ``gymnasium.vector.VectorEnv`` face: a batch of environments in one array operation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from moral_envs.engine import Engine
from moral_envs.faces.common import (
    BATCH_RENDER_MODES,
    RENDER_FPS,
    Frame,
    action_space,
    batch_reward_space,
    draw,
    observation_space,
    require_render_mode,
    reward_space,
)
from moral_envs.streams import spawn_streams
from moral_envs.world import World

Result = tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class GridVectorEnv(VectorEnv[NDArray[np.uint8], ArrayLike, NDArray[Any]]):
    """A batch of environments of one world; rewards are float32 arrays of shape (n, k).

    Given ``num_agents``, all that belongs to an agent has an axis for them after the first: actions of shape
    (n, n_agents), observations (n, n_agents, C, H, W), rewards (n, n_agents, k), objectives (n, n_agents, m).
    All agents of an environment begin and end together.

    ``infos["objectives"]`` is int64 of shape (n, m). An episode's last counters are those of the step that
    ends it; in the same-step mode they are in ``infos["final_info"]["objectives"]``, and
    ``infos["final_obs"]``, an object array of shape (n,), holds the last observations; both are valid where
    ``infos["_final_obs"]`` is true.

    Parameters
    ----------
    world
        The rules.
    num_envs
        Environments in the batch.
    render_mode
        None, ``"ansi"`` or ``"rgb_array"``.
    autoreset_mode
        When an environment whose episode has ended is reset: at the next step, whose action it ignores, in
        the same step, or by the caller with ``reset(options={"reset_mask": ...})``.
    num_agents
        Agents in each environment. None: one, and no axis for it.
    team_reward, view_radius, agent_rewards
        As for :class:`~moral_envs.engine.Engine`.
    """

    def __init__(
        self,
        world: World,
        num_envs: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_agents: int | None = None,
        team_reward: bool = False,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
    ) -> None:
        agents = 1 if num_agents is None else num_agents
        self.engine = Engine(world, num_envs, agents, team_reward, view_radius, agent_rewards)
        # The part of the engine's arrays that is handed out: all of it, or what the only agent has.
        self._shown = np.s_[:, 0] if num_agents is None else np.s_[:, :]
        self.num_envs = num_envs
        self.render_mode = require_render_mode(render_mode, BATCH_RENDER_MODES)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            modes = [mode.value for mode in AutoresetMode]
            raise ValueError(f"autoreset_mode is {autoreset_mode!r}; it must be one of {modes}") from error
        self.metadata = {
            "render_modes": list(BATCH_RENDER_MODES),
            "render_fps": RENDER_FPS,
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = observation_space(self.engine)
        self.single_action_space = action_space(self.engine)
        self.reward_space = reward_space(self.engine)
        if num_agents is not None:
            self.single_observation_space = batch_space(self.single_observation_space, num_agents)
            self.single_action_space = batch_space(self.single_action_space, num_agents)
            self.reward_space = batch_reward_space(self.engine)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.reward_dim = len(world.reward_names)
        self.reward_names = world.reward_names
        self.objective_names = world.objective_names
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._any_ended = False
        self._started = False
        self._everywhere = np.ones(num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Start episodes in all environments, or in those of ``options["reset_mask"]``.

        An integer seed gives every environment a stream of its own, spawned from it; with a sequence,
        environment ``i`` goes through what a single environment does after ``reset(seed=seed[i])``.
        """
        mask = None if options is None else options.get("reset_mask")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
                found, wanted = f"{mask.dtype} {mask.shape}", f"bool {(self.num_envs,)}"
                raise ValueError(f"options['reset_mask'] is {found}; it must be {wanted}")
        if isinstance(seed, (int, np.integer)):
            self.engine.seed(spawn_streams(int(seed), self.num_envs), mask)
        elif seed is not None:
            if len(seed) != self.num_envs:
                raise ValueError(f"seed has {len(seed)} entries; it must be one integer or {self.num_envs}")
            given = np.array([one is not None for one in seed], dtype=np.bool_)
            streams = np.concatenate([spawn_streams(one, 1) for one in seed])
            self.engine.seed(streams, given if mask is None else given & mask)
        self.engine.reset(mask)
        self._started = True
        self._ended[slice(None) if mask is None else mask] = False
        self._any_ended = bool(self._ended.any())
        return self.engine.observe()[self._shown], self._infos()

    def step(self, actions: ArrayLike) -> Result:
        """Take one step in every environment; ``actions`` are integers of shape (n,) or (n, n_agents)."""
        if not self._started:
            raise ValueError("actions were given before the first episode; call reset first")
        if self._any_ended and self.autoreset_mode == AutoresetMode.DISABLED:
            ended = int(self._ended.argmax())
            raise ValueError(f"actions were given after the end of environment {ended}; call reset first")
        step = self.engine.step(actions, self._ended if self._any_ended else None)
        final = {}
        self._any_ended = step.any_end
        if step.any_end:
            self._ended = step.terminations | step.truncations
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                final = self._final(self._ended)
                self.engine.reset(self._ended)
                self._any_ended = False
        observations, rewards = self.engine.observe()[self._shown], step.rewards[self._shown]
        return observations, rewards, step.terminations, step.truncations, {**self._infos(), **final}

    def render(self) -> tuple[Frame, ...] | None:
        """Draw all environments as ``render_mode`` says."""
        return draw(self.engine, self.render_mode)

    def _final(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        observations = np.full(self.num_envs, None, dtype=object)
        last = self.engine.observe()[self._shown]
        for env in ended.nonzero()[0]:
            observations[env] = last[env]
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": {"objectives": self.engine.objectives[self._shown], "_objectives": ended.copy()},
            "_final_info": ended.copy(),
        }

    def _infos(self) -> dict[str, Any]:
        return {"objectives": self.engine.objectives[self._shown], "_objectives": self._everywhere.copy()}
