"""The benchmark of DRLHP: its arithmetic by hand, and a run small enough for a test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import drlhp_emergency
from moral_algorithms.learners.drlhp import DRLHPConfig
from moral_algorithms.learners.reward_model import RewardModelConfig
from tests.algorithms.tiny import EMERGENCY, ppo_config


def finished(queries: int, seed: int, goal_time: float) -> dict[str, Any]:
    return {
        "queries": queries,
        "seed": seed,
        "people_saved": 6.0,
        "goal_time": goal_time,
        "env_steps": 100,
        "training_seconds": 2.0,
    }


def test_summary_over_seeds_by_hand() -> None:
    runs = [finished(100, 0, 20.0), finished(25, 0, 1.0), finished(100, 1, 26.0), finished(100, 2, 29.0)]
    few, many = drlhp_emergency.summarise(runs)
    assert (few["queries"], few["seeds"], many["queries"], many["seeds"]) == (25, 1, 100, 3)
    assert many["goal_time"] == {
        "mean": 25.0,
        "standard_deviation": pytest.approx(21**0.5),
        "least": 20.0,
    }
    assert few["goal_time"]["standard_deviation"] == 0.0
    shown = drlhp_emergency.table([few, many])
    assert "25.00 (4.58)" in shown
    assert "12.32" in shown.splitlines()[-1]


def test_a_curve_is_thinned_out() -> None:
    lines: list[dict[str, Any]] = [{"env_steps": 10, "queries": 0, "objectives": {}}]
    lines += [
        {"env_steps": 10 * step, "queries": step, "objectives": {"goal_time": step / 3}}
        for step in range(2, 1001)
    ]
    thin = drlhp_emergency.curve(lines)
    assert thin.keys() == {"env_steps", "queries", "goal_time"}
    assert len(thin["env_steps"]) == len(thin["goal_time"]) == 99
    assert (thin["env_steps"][-1], thin["queries"][-1], thin["goal_time"][-1]) == (10_000, 1000, 333.333)
    assert drlhp_emergency.curve(lines[:1]) == {"env_steps": [], "queries": []}
    assert drlhp_emergency.curve(lines[1:4])["env_steps"] == [20, 30, 40]


def test_finished_runs_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = DRLHPConfig(
        clip_length=4,
        reward=RewardModelConfig(updates=1, initial_updates=1),
        ppo=ppo_config(num_envs=8, rollout_steps=8, batch_size=32, epochs=1),
    )
    monkeypatch.setattr(drlhp_emergency, "drlhp_preset", lambda name, world: config)
    monkeypatch.setattr(drlhp_emergency, "WORLD", EMERGENCY)
    path = tmp_path / "results.json"
    options = ["--steps", "320", "--episodes", "8", "--json", str(path), "--queries"]
    drlhp_emergency.main([*options, "4", "--seeds", "0"])
    first = json.loads(path.read_text())
    assert [(run["queries"], run["seed"], run["env_steps"]) for run in first["runs"]] == [(4, 0, 320)]
    assert first["runs"][0]["curve"]["queries"][-1] == 4
    assert {"versions", "commit", "processor"} <= first["runs"][0].keys()

    trained: list[tuple[int, int]] = []
    train = drlhp_emergency.train

    def watched(config: DRLHPConfig, seed: int, episodes: int) -> dict[str, Any]:
        trained.append((config.queries, seed))
        return train(config, seed, episodes)

    monkeypatch.setattr(drlhp_emergency, "train", watched)
    drlhp_emergency.main([*options, "4", "2", "--seeds", "0", "1"])
    assert trained == [(4, 1), (2, 0), (2, 1)]
    second = json.loads(path.read_text())
    assert second["runs"][0] == first["runs"][0]
    assert [one["seeds"] for one in second["summary"]] == [2, 2]
    # Other settings: nothing is kept.
    drlhp_emergency.main(["--steps", "384", *options[2:], "4", "--seeds", "0"])
    assert trained[3:] == [(4, 0)]
    assert len(json.loads(path.read_text())["runs"]) == 1
    assert "preferences, seed 0" in capsys.readouterr().out
