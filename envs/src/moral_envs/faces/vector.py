"""The ``gymnasium.vector.VectorEnv`` face: a batch of one-agent environments in one array operation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from moral_envs.engine import Engine
from moral_envs.faces.common import (
    RENDER_FPS,
    RENDER_MODES,
    Frame,
    action_space,
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

    ``infos["objectives"]`` is int64 of shape (n, m). An episode's last counters are those of the step that
    truncates it; in the same-step mode they are in ``infos["final_info"]["objectives"]``, and
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
        When a truncated environment is reset: at the next step, whose action it ignores, in the same step, or
        by the caller with ``reset(options={"reset_mask": ...})``.
    """

    def __init__(
        self,
        world: World,
        num_envs: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.engine = Engine(world, num_envs)
        self.num_envs = num_envs
        self.render_mode = require_render_mode(render_mode)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            modes = [mode.value for mode in AutoresetMode]
            raise ValueError(f"autoreset_mode is {autoreset_mode!r}; it must be one of {modes}") from error
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": RENDER_FPS,
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = observation_space(self.engine)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.reward_space = reward_space(self.engine)
        self.reward_dim = len(world.reward_names)
        self.reward_names = world.reward_names
        self.objective_names = world.objective_names
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._any_ended = False
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
        self._ended[slice(None) if mask is None else mask] = False
        self._any_ended = bool(self._ended.any())
        return self.engine.world_planes(), self._infos()

    def step(self, actions: ArrayLike) -> Result:
        """Take one step in every environment; ``actions`` are integers of shape (n,)."""
        if self._any_ended and self.autoreset_mode == AutoresetMode.DISABLED:
            ended = int(self._ended.argmax())
            raise ValueError(f"actions were given after the end of environment {ended}; call reset first")
        rewards, truncations, any_truncation = self.engine.step(actions)
        rewards = rewards[:, 0]
        if self._any_ended:
            self.engine.reset(self._ended)
            rewards[self._ended] = 0
            truncations &= ~self._ended
            any_truncation = bool(truncations.any())
            self._any_ended = False
        final = None
        if any_truncation:
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                final = self._final(truncations)
                self.engine.reset(truncations)
            else:
                self._ended = truncations.copy()
                self._any_ended = True
        terminations = np.zeros(self.num_envs, dtype=np.bool_)
        infos = self._infos() if final is None else {**self._infos(), **final}
        return self.engine.world_planes(), rewards, terminations, truncations, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Draw all environments as ``render_mode`` says."""
        return draw(self.engine, self.render_mode)

    def _final(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        observations = np.full(self.num_envs, None, dtype=object)
        last = self.engine.world_planes()
        for env in ended.nonzero()[0]:
            observations[env] = last[env]
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": {"objectives": self.engine.objectives[:, 0], "_objectives": ended.copy()},
            "_final_info": ended.copy(),
        }

    def _infos(self) -> dict[str, Any]:
        return {"objectives": self.engine.objectives[:, 0], "_objectives": self._everywhere.copy()}
