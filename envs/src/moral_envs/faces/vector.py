"""The ``gymnasium.vector.VectorEnv`` face: a batch of environments in one array operation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from moral_envs.arguments import as_integer
from moral_envs.engine import Engine
from moral_envs.faces.common import (
    BATCH_RENDER_MODES,
    RENDER_FPS,
    Frame,
    action_space,
    draw,
    observation_space,
    paid_components,
    require_render_mode,
    reward_bounds,
)
from moral_envs.faces.resets import (
    Seeds,
    known_seed,
    require_mask,
    require_started,
    require_streams,
    still_waiting,
)
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

    To reproduce single environments, seed with one integer for each: ``reset(seed=[s0, s1, ...])``. One
    integer alone seeds the batch through ``SeedSequence.spawn``, where Gymnasium's own vector environments
    use ``seed + i``.

    ``agent_reward_names`` names, for each agent, the reward components that it is paid; the others are zero.

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
        num_envs, agents = self.engine.num_envs, self.engine.num_agents
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
        self.single_observation_space: spaces.Box = observation_space(self.engine)
        self.single_action_space: spaces.Discrete | spaces.MultiDiscrete = action_space(self.engine)
        if num_agents is not None:
            self.single_observation_space = _batch_box(self.single_observation_space, agents)
            self.single_action_space = spaces.MultiDiscrete([world.num_actions] * agents)
        low, high = (bounds[self._shown[1]] for bounds in reward_bounds(self.engine))
        self.reward_space = spaces.Box(low, high, dtype=np.float32)
        self.observation_space: spaces.Box = _batch_box(self.single_observation_space, num_envs)
        joint = batch_space(self.single_action_space, num_envs)
        assert isinstance(joint, (spaces.MultiDiscrete, spaces.Box))
        self.action_space: spaces.MultiDiscrete | spaces.Box = joint
        self.engine.action_shape = joint.shape
        self.reward_dim = len(world.reward_names)
        self.reward_names = world.reward_names
        self.objective_names = world.objective_names
        self.agent_reward_names = tuple(
            tuple(world.reward_names[component] for component in paid_components(self.engine, agent))
            for agent in range(agents)
        )
        # Which environments wait for their first reset, and which have ended and wait for the next.
        self._unstarted: NDArray[np.bool_] | None = np.ones(num_envs, dtype=np.bool_)
        self._ended: NDArray[np.bool_] | None = None
        self._everywhere = np.ones(num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: Seeds = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Start episodes in all environments, or in those of ``options["reset_mask"]``.

        Parameters
        ----------
        seed
            With a sequence, environment ``i`` goes through what a single environment does after
            ``reset(seed=seed[i])``, and None leaves its stream as it is. An integer seeds the batch as a
            whole: every environment gets a stream of its own, spawned from it by ``SeedSequence.spawn``, and
            not, as in Gymnasium's own vector environments, the seed ``seed + i``. None: all streams go on;
            those that have never been seeded are spawned from fresh entropy, ``np_random_seed``.
        options
            ``{"reset_mask": mask}``, a bool array of shape (n,), resets some environments only.

        Returns
        -------
        observations
            uint8 array of 0/1 planes, shape (n, C, H, W) or (n, n_agents, C, H, W).
        infos
            ``infos["objectives"]``, the counters of the episodes so far: int64 of shape (n, m) or
            (n, n_agents, m).

        Raises
        ------
        ValueError
            If a seed is negative or no integer, or their number or the mask does not fit; nothing has changed
            then.
        """
        mask = require_mask(options, self.num_envs)
        streams = require_streams(seed, self.num_envs, mask)
        if streams is not None:
            self.engine.seed(streams.states, streams.given)
        # What Gymnasium's own generator was seeded with is told as `np_random_seed`.
        super().reset(seed=as_integer(seed))
        self.engine.seed_unseeded(known_seed(self.np_random_seed), mask)
        self.engine.reset(mask)
        self._unstarted = still_waiting(self._unstarted, mask)
        self._ended = still_waiting(self._ended, mask)
        return self.engine.observe()[self._shown], self._infos()

    def step(self, actions: ArrayLike) -> Result:
        """Take one step in every environment.

        Parameters
        ----------
        actions
            Integers of the shape of ``action_space``, (n,) or (n, n_agents), for one agent either:
            indices into :data:`~moral_envs.world.ACTION_NAMES`.

        Returns
        -------
        observations
            uint8 array of 0/1 planes, shape (n, C, H, W) or (n, n_agents, C, H, W).
        rewards
            float32 array of shape (n, k) or (n, n_agents, k).
        terminations, truncations
            bool arrays of shape (n,): which episodes have reached a terminal state, and which of the others
            their horizon.
        infos
            The counters and, in the same-step mode, what the episodes that ended showed last; see the class.

        Raises
        ------
        ValueError
            If the actions are none of this world's or of another shape, or an environment has no episode;
            nothing has changed then.
        """
        require_started(self._unstarted)
        if self._ended is not None and self.autoreset_mode == AutoresetMode.DISABLED:
            ended = int(self._ended.argmax())
            raise ValueError(f"actions were given after the end of environment {ended}; call reset first")
        step = self.engine.step(actions, self._ended)
        final = {}
        self._ended = step.terminations | step.truncations if step.any_end else None
        if self._ended is not None and self.autoreset_mode == AutoresetMode.SAME_STEP:
            final = self._final(self._ended)
            self.engine.reset(self._ended)
            self._ended = None
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


def _batch_box(space: spaces.Box, count: int) -> spaces.Box:
    batch = batch_space(space, count)
    assert isinstance(batch, spaces.Box)
    return batch
