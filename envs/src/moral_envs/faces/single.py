"""The ``gymnasium.Env`` face: one agent, to the conventions of MO-Gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from moral_envs.arguments import require_integer
from moral_envs.engine import Engine
from moral_envs.faces.common import (
    RENDER_FPS,
    RENDER_MODES,
    Frame,
    action_space,
    draw_single,
    make_window,
    observation_space,
    require_render_mode,
    reward_space,
)
from moral_envs.faces.resets import known_seed
from moral_envs.streams import spawn_streams
from moral_envs.world import World


class GridEnv(gymnasium.Env[NDArray[np.uint8], int]):
    """A world as a single-agent Gymnasium environment whose reward is a float32 array of shape (k,).

    Parameters
    ----------
    world
        The rules.
    render_mode
        None, ``"ansi"``, ``"rgb_array"`` or ``"human"``.
    view_radius
        How many cells the agent sees in each direction. None: the whole grid.
    """

    observation_space: spaces.Box  # type: ignore[assignment]
    action_space: spaces.Discrete  # type: ignore[assignment]

    def __init__(self, world: World, render_mode: str | None = None, view_radius: int | None = None) -> None:
        self.engine = Engine(world, view_radius=view_radius)
        self.render_mode = require_render_mode(render_mode)
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}
        self.window = make_window(self.engine, render_mode, self.metadata)
        self.engine.action_shape = ()
        self.observation_space = observation_space(self.engine)
        self.action_space = action_space(self.engine)
        self.reward_space = reward_space(self.engine)
        self.reward_dim = len(world.reward_names)
        self.reward_names = world.reward_names
        self.objective_names = world.objective_names
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed
            Of the environment's random stream, 0 or more. None: the stream goes on from the last episode; the
            first one takes fresh entropy, and ``np_random_seed`` is then the seed that gives it again.
        options
            Not used.

        Returns
        -------
        observation
            uint8 array of 0/1 planes, shape (C, H, W).
        info
            ``info["objectives"]``, the counters of the episode: int64 zeros of shape (m,).

        Raises
        ------
        ValueError
            If the seed is negative or no integer.
        """
        if seed is not None:
            seed = require_integer("seed", seed, 0, "0 or more")
            self.engine.seed(spawn_streams(seed, 1))
        super().reset(seed=seed, options=options)
        self.engine.seed_unseeded(known_seed(self.np_random_seed))
        self.engine.reset()
        self._running = True
        if self.window is not None:
            self.window.reset()
        return self.engine.observe()[0, 0], self._info()

    def step(
        self, action: int | np.integer[Any]
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], bool, bool, dict[str, Any]]:
        """Take one step.

        Parameters
        ----------
        action
            Index into :data:`~moral_envs.world.ACTION_NAMES`.

        Returns
        -------
        observation
            uint8 array of 0/1 planes, shape (C, H, W).
        reward
            float32 array of shape (k,), in the order of ``reward_names``.
        terminated, truncated
            Whether the episode has reached a terminal state, or else its horizon.
        info
            ``info["objectives"]``, the counters of the episode so far: int64 of shape (m,), in the order of
            ``objective_names``.

        Raises
        ------
        ValueError
            If the action is none of this world's or there is no episode; nothing has changed then.
        """
        if not self._running:
            raise ValueError("action was given outside an episode; call reset first")
        step = self.engine.step(np.reshape(action, -1) if np.size(action) == 1 else action)
        self._running = not step.any_end
        if self.window is not None:
            self.window.step(step.rewards[0])
        terminated, truncated = bool(step.terminations[0]), bool(step.truncations[0])
        return self.engine.observe()[0, 0], step.rewards[0, 0], terminated, truncated, self._info()

    def render(self) -> Frame | None:
        """Draw the current state as ``render_mode`` says."""
        return draw_single(self.engine, self.render_mode, self.window)

    def close(self) -> None:
        """Close the window of ``render_mode="human"``."""
        if self.window is not None:
            self.window.close()

    def _info(self) -> dict[str, Any]:
        return {"objectives": self.engine.objectives[0, 0]}
