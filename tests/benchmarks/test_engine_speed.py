"""The benchmark of the environments: that it runs, and that its figures fit together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import engine_speed
from benchmarks.engine_speed import Config

TINY = Config(num_envs=4, episodes=1, repeats=1, agents=(1, 3))


@pytest.mark.parametrize("name", engine_speed.MODULES)
def test_the_automatic_reset_is_not_counted_as_a_step(name: str) -> None:
    horizon = engine_speed.MODULES[name].world().horizon
    found = engine_speed.measure_vector(name, TINY)
    per_call = TINY.num_envs / found["step_microseconds"] * 1e6
    assert found["steps_per_second"] == pytest.approx(per_call * horizon / (horizon + 1))
    assert found["ratio_to_copy"] == pytest.approx(found["step_microseconds"] / found["copy_microseconds"])


def test_all_figures_are_printed_and_stored_with_what_produced_them(tmp_path: Path) -> None:
    results = engine_speed.measure(TINY)
    assert list(results["Delivery"]["engine_agent_steps_per_second"]) == ["1", "3"]
    lines = engine_speed.table(results, TINY).splitlines()
    assert lines[2].split() == ["Emergency", "Delivery"]
    assert len(lines) == 3 + 5 + len(TINY.agents)

    path = tmp_path / "speed.json"
    engine_speed.main(["--num-envs", "4", "--repeats", "1", "--json", str(path)])
    stored = json.loads(path.read_text())
    assert stored["results"].keys() == results.keys()
    assert stored["config"]["num_envs"] == 4
    assert stored["duration_seconds"] > 0
    assert {"python", "numpy"} <= stored["versions"].keys()
    assert stored["platform"]
    assert stored["processor"]
    assert list(tmp_path.iterdir()) == [path]
