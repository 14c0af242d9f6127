"""The benchmark of teams: its arithmetic by hand, and a run small enough for the suite."""

import json
from pathlib import Path

import pytest

from benchmarks import delivery_teams
from benchmarks.delivery_teams import Team


def run(num_agents: int, seed: int, collected: float) -> dict[str, object]:
    return {
        "num_agents": num_agents,
        "team_reward": False,
        "seed": seed,
        "collected": collected,
        "collected_per_agent": collected / num_agents,
        "objectives": {"vases_broken": 0.5},
        "training_seconds": 60.0,
    }


def test_an_agent_alone_has_no_team_to_share_with() -> None:
    assert delivery_teams.teams([1, 2], [0]) == [Team(1, False, 0), Team(2, False, 0), Team(2, True, 0)]


def test_summary_by_hand() -> None:
    summary = delivery_teams.summarise([run(2, 0, 30.0), run(2, 1, 34.0), run(1, 0, 20.0)])
    assert [(one["num_agents"], one["seeds"]) for one in summary] == [(1, 1), (2, 2)]
    assert summary[0]["collected"] == {"mean": 20.0, "standard_deviation": 0.0}
    assert summary[1]["collected"]["mean"] == 32.0
    assert summary[1]["collected"]["standard_deviation"] == pytest.approx(8**0.5)
    assert summary[1]["collected_per_agent"]["mean"] == 16.0
    assert "32.00 (2.83)" in delivery_teams.table(summary)


def test_finished_runs_are_not_repeated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = tmp_path / "results.json"
    options = ["--agent-steps", "6400", "--json", str(results)]
    delivery_teams.main([*options, "--sizes", "2", "--seeds", "0"])
    first = json.loads(results.read_text())
    assert [one["team_reward"] for one in first["runs"]] == [False, True]
    assert all(one["environment_steps"] == 3200 for one in first["runs"])
    assert 0 < first["runs"][0]["collected"] < 36
    delivery_teams.main([*options, "--sizes", "1", "2", "--seeds", "0"])
    again = json.loads(results.read_text())
    assert again["runs"][:2] == first["runs"]
    assert len(again["runs"]) == 3
    assert capsys.readouterr().out.count("collected, ") == 3
