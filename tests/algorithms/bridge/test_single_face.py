"""Stable-Baselines3's checker takes the scalarised single face of every world, without the bridge."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest
from gymnasium.wrappers import FlattenObservation
from mo_gymnasium.wrappers import LinearReward
from stable_baselines3.common.env_checker import check_env

import moral_envs  # noqa: F401  # registers the environments

WORLDS = [
    ("Emergency", {}),
    ("Emergency", {"view_radius": 2}),
    ("Delivery", {}),
    ("Delivery", {"layout": "random"}),
    ("BurningWarehouse", {}),
    ("BurningWarehouse", {"layout": "maze", "view_radius": 1}),
    ("WindyWall", {}),
]


@pytest.mark.parametrize("mode", [None, "ansi", "rgb_array", "human"])
@pytest.mark.parametrize(("world", "rules"), WORLDS)
def test_stable_baselines3_accepts_the_scalarised_single_face(
    world: str, rules: dict[str, Any], mode: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")

    def make() -> LinearReward:
        env = gymnasium.make(f"moral/{world}-v0", render_mode=mode, **rules)
        env.unwrapped.metadata["render_fps"] = 10_000
        return LinearReward(env)

    # Its warnings take the planes for a picture with values up to 255.
    env = make()
    check_env(env, warn=False, skip_render_check=False)
    check_env(FlattenObservation(make()), warn=True, skip_render_check=False)
    env.close()
