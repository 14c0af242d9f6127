"""PPO as every learner uses it: bootstrapping, schedules, monitoring and exact continuation."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from moral_algorithms.learners.ppo import (
    BatchedBootstrap,
    EntropySchedule,
    ObjectiveMonitor,
    PPOConfig,
    Progress,
    learn,
    load_ppo_state,
    make_ppo,
    ppo_state,
    sampling_seed,
    standard_callbacks,
)
from moral_algorithms.storage import read_tensors, write_tensors
from tests.algorithms.tiny import EMERGENCY, parameters, ppo_config, scalarised

NAMES = EMERGENCY.build().objective_names
HORIZON = EMERGENCY.build().horizon


class Hook(BaseCallback):
    """Calls functions with the model at the start and at the end of every rollout."""

    def __init__(
        self,
        at_start: Callable[[PPO], Any] = lambda model: None,
        at_end: Callable[[PPO], Any] = lambda model: None,
    ) -> None:
        super().__init__()
        self._at_start = at_start
        self._at_end = at_end
        self.infos: list[dict[str, Any]] = []

    def _on_rollout_start(self) -> None:
        self._at_start(self.model)  # type: ignore[arg-type]

    def _on_rollout_end(self) -> None:
        self._at_end(self.model)  # type: ignore[arg-type]

    def _on_step(self) -> bool:
        self.infos += self.locals["infos"]
        return True


def train(config: PPOConfig, total_steps: int, callbacks: Sequence[BaseCallback], seed: int = 0) -> PPO:
    model = make_ppo(config, scalarised(num_envs=config.num_envs, seed=seed), seed)
    learn(model, total_steps, callbacks)
    return model


def test_the_batched_bootstrap_does_what_ppo_does_one_by_one() -> None:
    # Two and a half episodes, so that some end within the rollout and some are cut by its end.
    config = ppo_config(num_envs=6, rollout_steps=20, batch_size=60, gamma=0.9)
    plain, batched = (
        train(config, 120, callbacks).rollout_buffer for callbacks in ([], [BatchedBootstrap()])
    )
    np.testing.assert_array_equal(plain.observations, batched.observations)
    np.testing.assert_array_equal(plain.actions, batched.actions)
    # A batch of another size may be rounded differently in half precision.
    np.testing.assert_allclose(plain.rewards, batched.rewards, atol=2e-3)
    np.testing.assert_allclose(plain.advantages, batched.advantages, atol=5e-3)
    np.testing.assert_allclose(plain.returns, batched.returns, atol=5e-3)


def test_the_bootstrap_adds_the_discounted_value_of_the_terminal_observation_once() -> None:
    config = ppo_config(num_envs=6, rollout_steps=HORIZON, batch_size=48, gamma=0.9)
    found: dict[str, Any] = {}

    def look(model: PPO) -> None:
        terminal = np.stack([info["terminal_observation"] for info in hook.infos[-6:]])
        with torch.no_grad():
            found["values"] = model.policy.predict_values(torch.from_numpy(terminal)).numpy()[:, 0]
        scaled = model.get_env()
        assert isinstance(scaled, VecNormalize)
        found["raw"] = scaled.normalize_reward(scaled.get_original_reward())
        found["rewards"] = model.rollout_buffer.rewards.copy()

    hook = Hook(at_end=look)
    train(config, 48, [BatchedBootstrap(), hook])
    np.testing.assert_allclose(found["rewards"][-1] - found["raw"], 0.9 * found["values"], atol=2e-3)
    assert np.abs(found["values"]).min() > 0.01, "values near zero would show nothing"


def test_the_entropy_bonus_moves_linearly() -> None:
    config = ppo_config(num_envs=8, rollout_steps=8, batch_size=64, epochs=1)
    bonuses: list[float] = []
    schedule = EntropySchedule(0.5, 0.1, total_steps=256)
    train(config, 320, [schedule, Hook(at_end=lambda model: bonuses.append(model.ent_coef))])
    assert bonuses == pytest.approx([0.5, 0.4, 0.3, 0.2, 0.1])


def test_the_learning_rate_falls_linearly_to_a_twentieth() -> None:
    config = ppo_config(num_envs=8, rollout_steps=8, batch_size=64, epochs=1, learning_rate=1.0)
    rates: list[float] = []
    hook = Hook(at_start=lambda model: rates.append(model.policy.optimizer.param_groups[0]["lr"]))
    model = train(config, 256, [hook])
    # At the start of a rollout stands the rate of the update before it.
    assert rates[1:] == pytest.approx([0.75, 0.5, 0.25])
    assert model.policy.optimizer.param_groups[0]["lr"] == pytest.approx(0.05)


def test_the_monitor_reports_the_episodes_of_the_last_rollout_that_had_some() -> None:
    # Rollouts of five steps and episodes of eight: some rollouts end no episode.
    config = ppo_config(num_envs=4, rollout_steps=5, batch_size=20, epochs=1)
    reported: list[Progress] = []
    monitor = ObjectiveMonitor(NAMES, 100, reported.append)
    monitor.queries = 3
    hook = Hook()
    train(config, 100, [monitor, hook])
    assert [progress.steps for progress in reported] == [20, 40, 60, 80, 100]
    assert {(progress.total_steps, progress.queries) for progress in reported} == {(100, 3)}
    objectives = [info.get("objectives") for info in hook.infos]
    expected: dict[str, float] = {}
    for progress, rollout in zip(reported, range(0, 100, 20), strict=True):
        finished = [counters for counters in objectives[rollout : rollout + 20] if counters is not None]
        if finished:
            expected = dict(zip(NAMES, np.mean(finished, axis=0), strict=True))
        assert progress.objectives == pytest.approx(expected)
    assert reported[0].objectives == {}
    assert reported[2].objectives == reported[1].objectives
    assert reported[3].objectives != reported[1].objectives


def test_learning_goes_on_to_the_total_and_no_further() -> None:
    config = ppo_config(num_envs=4, rollout_steps=8, batch_size=32, epochs=1)
    model = train(config, 64, [])
    assert model.num_timesteps == 64
    before = parameters(model.policy)
    learn(model, 64, [])
    assert all((before[name] == value).all() for name, value in parameters(model.policy).items())
    learn(model, 100, [])
    assert model.num_timesteps == 128


def test_a_sampling_seed_leaves_the_generator_as_it_was() -> None:
    torch.manual_seed(0)
    expected = torch.rand(4)
    torch.manual_seed(0)
    first = torch.rand(2)
    with sampling_seed(7):
        inside = torch.rand(3)
    np.testing.assert_array_equal(torch.cat([first, torch.rand(2)]), expected)
    with sampling_seed(7):
        np.testing.assert_array_equal(torch.rand(3), inside)


@pytest.mark.parametrize("policy", ["fast", "paper"])
def test_goes_on_exactly_from_a_saved_state(tmp_path: Path, policy: str) -> None:
    # Rollouts that cut episodes, so that running returns and bootstraps are under way where it is saved.
    config = ppo_config(
        policy=policy, num_envs=4, rollout_steps=6, batch_size=12, epochs=2, entropy_end=0.001
    )
    total, path = 5 * 24, tmp_path / "state"

    def save(model: PPO) -> None:
        if model.num_timesteps == 48:
            arrays, metadata = ppo_state(model)
            write_tensors(path, arrays, {"kind": "test", "ppo": metadata})

    def callbacks() -> list[BaseCallback]:
        return standard_callbacks(config, total, NAMES, None)

    whole = train(config, total, [*callbacks(), Hook(at_start=save)])
    expected, expected_metadata = ppo_state(whole)

    torch.manual_seed(99)
    model = make_ppo(config, scalarised(num_envs=4, seed=99), seed=99)
    arrays, metadata = read_tensors(path, "test")
    load_ppo_state(model, arrays, metadata["ppo"])
    again, again_metadata = ppo_state(model)
    assert again_metadata == metadata["ppo"]
    assert again.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(again[name], array, err_msg=name)
        assert again[name].shape == array.shape, name

    learn(model, total, callbacks())
    got, got_metadata = ppo_state(model)
    assert got_metadata == expected_metadata
    assert got.keys() == expected.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(got[name], array, err_msg=name)
    changed = [name for name in expected if (expected[name] != arrays[name]).any()]
    for prefix in ("policy.", "optimiser.", "scale.returns", "scale.statistics", "venv.", "random."):
        assert any(name.startswith(prefix) for name in changed), f"{prefix} would not show a difference"


def test_a_saved_state_can_be_json() -> None:
    model = train(ppo_config(num_envs=2, rollout_steps=4, batch_size=8), 8, [])
    _, metadata = ppo_state(model)
    assert json.loads(json.dumps(metadata)) == metadata


def test_a_state_of_another_policy_is_refused() -> None:
    small = ppo_config(num_envs=2, rollout_steps=4, batch_size=8)
    arrays, metadata = ppo_state(train(small, 8, []))
    other = make_ppo(ppo_config(policy="paper", num_envs=2, batch_size=32), scalarised(num_envs=2), 0)
    with pytest.raises(RuntimeError):
        load_ppo_state(other, arrays, metadata)


def test_tensorboard_files_are_written_on_request(tmp_path: Path) -> None:
    config = ppo_config(num_envs=2, rollout_steps=HORIZON, batch_size=16, epochs=1)
    model = make_ppo(config, scalarised(num_envs=2), 0, tensorboard=tmp_path / "events")
    learn(model, 32, standard_callbacks(config, 32, NAMES, None))
    model.logger.close()
    (events,) = (tmp_path / "events").iterdir()
    assert b"objectives/people_saved" in events.read_bytes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policy": "slow"}, r"policy is 'slow'; it must be one of \['fast', 'paper'\]"),
        ({"num_envs": 0}, "num_envs is 0; it must be at least 1"),
        ({"rollout_steps": 1}, "rollout_steps is 1; it must be at least 2"),
        ({"batch_size": 1}, "batch_size is 1; it must be at least 2"),
        ({"epochs": 0}, "epochs is 0"),
        ({"gamma": 1.5}, "gamma is 1.5; it must be 0 to 1"),
        ({"gae_lambda": -0.1}, "gae_lambda is -0.1"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0; it must be positive"),
        ({"clip_range": float("nan")}, "clip_range is nan"),
        ({"entropy_start": -1.0}, "entropy_start is -1.0; it must be finite and not negative"),
        ({"entropy_end": float("nan")}, "entropy_end is nan"),
        ({"learning_rate": float("inf")}, "learning_rate is inf; it must be positive and finite"),
        ({"entropy_start": float("inf")}, "entropy_start is inf; it must be finite"),
    ],
)
def test_impossible_configurations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ppo_config(**changes)
