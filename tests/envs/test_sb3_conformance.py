"""The scalarised single face through Stable-Baselines3's checker, which needs PyTorch."""

from __future__ import annotations

import gymnasium
import pytest
from gymnasium.wrappers import FlattenObservation
from mo_gymnasium.wrappers import LinearReward

import moral_envs  # noqa: F401  # registers the environments

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.env_checker import check_env


@pytest.mark.parametrize("env_id", ["moral/Emergency-v0", "moral/Delivery-v0"])
def test_stable_baselines3_accepts_the_scalarised_single_face(env_id: str) -> None:
    # Its warnings take the planes for a picture with values up to 255.
    check_env(LinearReward(gymnasium.make(env_id)), warn=False)
    check_env(FlattenObservation(LinearReward(gymnasium.make(env_id))), warn=True)
