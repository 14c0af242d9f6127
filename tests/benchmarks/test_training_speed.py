"""The benchmark of training: that it runs, and that it compares what it says it compares."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from stable_baselines3.common.vec_env import VecEnvWrapper
from torch import nn

from benchmarks import training_speed
from benchmarks.training_speed import VARIANTS, Config, Training
from moral_algorithms.bridge import LearnedReward, ScalarisedRewards
from moral_algorithms.learners.moral import MoralConfig
from moral_envs import emergency_v0
from tests.algorithms.tiny import parameters, seeded_engine

TINY = Config(fast_envs=2, paper_envs=2, rollout_steps=2, repeats=1)


def test_plain_is_the_network_of_paper_in_contiguous_float32() -> None:
    plain, paper = (
        Training.start("emergency", variant, False, TINY, "cpu").model.policy
        for variant in ("plain", "paper")
    )
    # Under the same names.
    paper.load_state_dict(plain.state_dict())
    observations = torch.from_numpy(seeded_engine(emergency_v0.world(), 5).observe()[:, 0])
    actions = torch.arange(5)
    maps: list[torch.Tensor] = []
    for module in plain.modules():
        if isinstance(module, nn.Conv2d):
            module.register_forward_hook(lambda _, inputs, output: maps.extend([*inputs, output]))
    values, log_probabilities, _ = plain.evaluate_actions(observations, actions)
    assert len(maps) == 8
    assert {tensor.dtype for tensor in [*maps, *plain.parameters()]} == {torch.float32}
    assert all(tensor.is_contiguous() for tensor in [*maps, *plain.parameters()])

    others, other_log_probabilities, _ = paper.evaluate_actions(observations, actions)
    # The preset may multiply in bfloat16.
    torch.testing.assert_close(others, values, atol=2e-2, rtol=2e-2)
    torch.testing.assert_close(other_log_probabilities, log_probabilities, atol=2e-2, rtol=2e-2)
    assert values.abs().max() > 0.1, "values near zero would show nothing"


@pytest.mark.parametrize("world", training_speed.WORLDS)
def test_learned_rewards_stand_beside_the_primary_one(world: str) -> None:
    rewards = training_speed.WORLDS[world]
    for learned in (False, True):
        venv = Training.start(world, "fast", learned, TINY, "cpu").model.env
        assert isinstance(venv, VecEnvWrapper)
        assert isinstance(venv.venv, ScalarisedRewards)
        components = venv.venv.components
        assert components[0].name == rewards.primary
        networks = [part.network for part in components[1:] if isinstance(part, LearnedReward)]
        assert [network.architecture for network in networks] == [rewards.architecture] * (
            rewards.learned * learned
        )


def test_a_measurement_is_of_whole_rollouts_with_updates() -> None:
    training = Training.start("emergency", "fast", True, TINY, "cpu")
    before = parameters(training.model.policy)
    assert min(training.seconds()) > 0
    assert training.model.num_timesteps == training.steps == 4
    after = parameters(training.model.policy)
    assert any((before[name] != after[name]).any() for name in before)


def test_the_figures_are_printed_and_stored_with_what_produced_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "speed.json"
    sizes = ["--fast-envs", "4", "--paper-envs", "4", "--rollout-steps", "5", "--repeats", "1"]
    training_speed.main([*sizes, "--worlds", "emergency", "--json", str(path)])
    stored = json.loads(path.read_text())
    assert stored["results"].keys() == {"emergency"}
    lines = capsys.readouterr().out.splitlines()
    for line, (rewards, case) in zip(lines[3:], stored["results"]["emergency"].items(), strict=True):
        speeds = [case[variant]["steps_per_second"] for variant in VARIANTS]
        shown = [f"{speed:,.0f}" for speed in speeds] + [f"{speeds[1] / speeds[2]:.1f}"]
        assert line.split() == ["emergency", rewards, *shown]
    assert stored["config"]["paper_envs"] == 4
    assert stored["ppo"]["emergency"]["batch_size"] == MoralConfig().ppo.batch_size
    assert stored["device"] == "cpu"
    assert stored["threads"] >= 1
    assert {"torch", "stable-baselines3"} <= stored["versions"].keys()
    assert stored["processor"]
    assert list(tmp_path.iterdir()) == [path]
