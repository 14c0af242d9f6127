"""Stable-Baselines3's own algorithms and tools take the bridge for what it says it is."""

from __future__ import annotations

import numpy as np
import pytest
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

from tests.algorithms.tiny import EMERGENCY, parameters, scalarised


@pytest.mark.parametrize(
    ("algorithm", "arguments"),
    [
        (PPO, {"n_steps": 8, "batch_size": 16, "n_epochs": 1}),
        (A2C, {"n_steps": 4}),
        (DQN, {"learning_starts": 8, "batch_size": 8, "buffer_size": 100, "train_freq": 4}),
    ],
)
def test_algorithms_of_stable_baselines3_train_on_it(
    algorithm: type[BaseAlgorithm], arguments: dict[str, int]
) -> None:
    venv = scalarised(num_envs=4)
    model = algorithm("MlpPolicy", venv, seed=0, policy_kwargs={"net_arch": [8]}, **arguments)  # type: ignore[arg-type]
    before = parameters(model.policy)
    model.learn(64)
    assert model.num_timesteps == 64
    after = parameters(model.policy)
    assert any((before[name] != after[name]).any() for name in before)
    actions, _ = model.predict(venv.reset())
    assert actions.shape == (4,)


def test_policies_are_evaluated_on_it() -> None:
    venv = VecMonitor(scalarised(num_envs=2, weights=(10.0, 1.0)))
    model = A2C("MlpPolicy", venv, seed=0)
    returns, lengths = evaluate_policy(model, venv, n_eval_episodes=4, return_episode_rewards=True)
    assert lengths == [EMERGENCY.build().horizon] * 4
    assert len(returns) == 4
    assert np.isfinite(returns).all()
