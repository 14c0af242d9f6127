"""What the faces share: spaces, render modes and drawing."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from moral_envs.engine import Engine
from moral_envs.rendering import draw_ansi, draw_rgb
from moral_envs.world import NUM_ACTIONS

RENDER_MODES = ("ansi", "rgb_array")
RENDER_FPS = 8

Frame = NDArray[np.uint8] | str


def observation_space(engine: Engine) -> spaces.Space[Any]:
    """One agent's observations: uint8 0/1 planes of shape (C, H, W)."""
    return spaces.Box(0, 1, shape=engine.observation_shape, dtype=np.uint8)


def action_space() -> spaces.Space[Any]:
    """Actions, the same in every world (:data:`moral_envs.world.ACTION_NAMES`)."""
    return spaces.Discrete(NUM_ACTIONS)


def reward_space(engine: Engine) -> spaces.Space[Any]:
    """One agent's reward vectors: float32 of shape (k,)."""
    agents = engine.num_agents if engine.team_reward else 1
    low, high = (np.array(bounds, dtype=np.float32) * agents for bounds in engine.world.reward_bounds)
    return spaces.Box(low, high, dtype=np.float32)


def require_render_mode(render_mode: str | None) -> str | None:
    """Return ``render_mode``, or raise a ValueError if no face knows it."""
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode is {render_mode!r}; it must be None or one of {RENDER_MODES}")
    return render_mode


def draw(engine: Engine, render_mode: str | None) -> tuple[Frame, ...] | None:
    """Draw every environment of a batch as ``render_mode`` says; None without a render mode."""
    if render_mode is None:
        return None
    draw_one = draw_ansi if render_mode == "ansi" else draw_rgb
    worlds = zip(engine.world_planes(), engine.agent_cells, strict=True)
    return tuple(draw_one(engine.world, planes, agents) for planes, agents in worlds)


def draw_single(engine: Engine, render_mode: str | None) -> Frame | None:
    """Draw the only environment of a batch as ``render_mode`` says; None without a render mode."""
    frames = draw(engine, render_mode)
    return None if frames is None else frames[0]
