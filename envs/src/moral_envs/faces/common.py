"""What the faces share: spaces, render modes and drawing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from moral_envs.engine import Engine
from moral_envs.panel import Panel
from moral_envs.rendering import draw_ansi, draw_rgb
from moral_envs.window import Window

RENDER_MODES = ("human", "ansi", "rgb_array")
BATCH_RENDER_MODES = ("ansi", "rgb_array")
RENDER_FPS = 8

Frame = NDArray[np.uint8] | str

_Value = TypeVar("_Value")


def observation_space(engine: Engine) -> spaces.Box:
    """One agent's observations: uint8 0/1 planes of shape (C, H, W)."""
    return spaces.Box(0, 1, shape=engine.observation_shape, dtype=np.uint8)


def action_space(engine: Engine) -> spaces.Discrete:
    """One agent's actions: the first of :data:`moral_envs.world.ACTION_NAMES`."""
    return spaces.Discrete(engine.world.num_actions)


def reward_space(engine: Engine, agent: int = 0) -> spaces.Box:
    """One agent's reward vectors: float32 of shape (k,), k being the components that it is paid."""
    low, high = (bounds[agent, paid_components(engine, agent)] for bounds in reward_bounds(engine))
    return spaces.Box(low, high, dtype=np.float32)


def reward_bounds(engine: Engine) -> list[NDArray[np.float32]]:
    """Least and greatest reward vectors: float32 (n_agents, k) each, zero where an agent is not paid."""
    agents = engine.num_agents if engine.team_reward else 1
    paid = np.ones((engine.num_agents, 1)) if engine.agent_rewards is None else engine.agent_rewards
    # Rounded as the rewards are: each agent's, then their sum.
    bounds = (np.array(bounds, dtype=np.float32) for bounds in engine.world.reward_bounds)
    return [(bound * agents * paid).astype(np.float32) for bound in bounds]


def paid_components(engine: Engine, agent: int) -> NDArray[np.int64]:
    """Find the indices of the reward components that an agent is paid."""
    if engine.agent_rewards is None:
        return np.arange(len(engine.world.reward_names))
    return np.flatnonzero(engine.agent_rewards[agent])


def of_agent(values: Mapping[str, _Value], agent: str) -> _Value:
    """Return an agent's entry, or raise a ValueError if there is no such agent."""
    if agent not in values:
        raise ValueError(f"agent is {agent!r}; it must be one of {list(values)}")
    return values[agent]


def require_render_mode(render_mode: str | None, modes: tuple[str, ...] = RENDER_MODES) -> str | None:
    """Return ``render_mode``, or raise a ValueError if it is none of those that a face knows."""
    if render_mode is not None and render_mode not in modes:
        raise ValueError(f"render_mode is {render_mode!r}; it must be None or one of {modes}")
    return render_mode


def make_window(engine: Engine, render_mode: str | None, metadata: dict[str, Any]) -> Window | None:
    """Return the window in which a face shows itself without being asked, None in the other modes."""
    return Window(Panel(engine), metadata) if render_mode == "human" else None


def draw(engine: Engine, render_mode: str | None) -> tuple[Frame, ...] | None:
    """Draw every environment of a batch as ``render_mode`` says; None without a render mode."""
    if render_mode is None:
        return None
    worlds = zip(engine.world_planes(), engine.agent_cells, strict=True)
    draw_one = draw_ansi if render_mode == "ansi" else draw_rgb
    radius = engine.view_radius
    return tuple(draw_one(engine.world, planes, agents, view_radius=radius) for planes, agents in worlds)


def draw_single(engine: Engine, render_mode: str | None, window: Window | None) -> Frame | None:
    """Draw the only environment of a batch as ``render_mode`` says; None without one, or into a window."""
    if window is not None:
        window.refresh()
        return None
    frames = draw(engine, render_mode)
    return None if frames is None else frames[0]
