"""The benchmark of imitation in Delivery: its arithmetic by hand, and a run small enough for the suite."""

import json
from pathlib import Path

import pytest

from benchmarks import delivery_imitation


def run(seed: int, expert: float, imitator: float, vases: float) -> dict[str, object]:
    return {
        "norm": "help",
        "seed": seed,
        "objective": "helped",
        "expert": {"helped": expert, "vases_broken": 0.1},
        "imitator": {"helped": imitator, "vases_broken": vases},
        "wall_seconds": {"expert": 60.0, "airl": 200.0},
    }


def test_summary_by_hand() -> None:
    summary = delivery_imitation.summarise([run(0, 10.0, 9.0, 0.1), run(1, 8.0, 8.0, 0.3)])["help"]
    assert summary["expert_objective"] == 9.0
    assert summary["imitator_objective"] == 8.5
    assert summary["least_share"] == pytest.approx(0.9)
    assert summary["most_vases"] == 0.3
    assert summary["imitator_vases"] == pytest.approx(0.2)


def test_a_small_run_and_its_continuation(tmp_path: Path) -> None:
    results = tmp_path / "results.json"
    small = ["--seeds", "0", "--expert-steps", "6400", "--airl-steps", "6400", "--json", str(results)]
    delivery_imitation.main([*small, "--norms", "help"])
    delivery_imitation.main([*small, "--norms", "help", "clean"])
    runs = json.loads(results.read_text())["runs"]
    assert [one["norm"] for one in runs] == ["help", "clean"]
    for one in runs:
        assert one["env_steps"]["expert"] == 6400
        assert 0 < one["imitator"][one["objective"]] < 12
