"""The benchmark of the planner: its arithmetic by hand, and a small run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import delivery_planner


def test_summary_by_hand() -> None:
    weights = np.array([1.0, 0.5, 1.0, 1.0])
    objectives = np.array([[2, 4, 1, 0], [3, 2, 4, 1]])
    returns = objectives * np.array([1.0, 1.0, 1.0, -1.0])
    bounds = np.array([5.0, 9.0])
    figures = delivery_planner.summarise(weights, returns, bounds, objectives)
    assert figures["collected"] == {
        "mean": 8.0,
        "standard_deviation": pytest.approx(np.sqrt(2)),
        "least": 7,
        "most": 9,
    }
    assert figures["mean_objectives"] == {"delivered": 2.5, "helped": 3, "cleaned": 2.5, "vases_broken": 0.5}
    assert figures["mean_scalarised_return"] == 6.0
    assert (figures["mean_upper_bound"], figures["mean_gap"], figures["largest_gap"]) == (7.0, 1.0, 2.0)
    assert figures["proved_optimal"] == 1


def test_returns_that_the_environment_does_not_count_are_refused() -> None:
    objectives = np.array([[2, 4, 1, 0]])
    with pytest.raises(AssertionError, match="does not count"):
        delivery_planner.summarise(np.ones(4), objectives + 1.0, np.array([9.0]), objectives)


def test_a_small_run_stores_what_it_measured(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    delivery_planner.main(["--starts", "2", "--beam-width", "50", "--iterations", "10", "--json", str(path)])
    stored = json.loads(path.read_text())
    assert stored["config"] == {"starts": 2, "seed": 0, "beam_width": 50, "iterations": 10}
    assert stored["results"].keys() == delivery_planner.WEIGHTS.keys()
    for figures in stored["results"].values():
        assert 5 < figures["mean_scalarised_return"] <= figures["mean_upper_bound"]
        assert figures["seconds_per_start"] > 0
    assert {"python", "numpy"} <= stored["versions"].keys()
    assert list(tmp_path.iterdir()) == [path]
