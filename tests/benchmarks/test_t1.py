"""T1: scores and marks of table 6.1 from results that were made up."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.harness import Results, Run
from benchmarks.rows import t1
from benchmarks.stages import Aligned, FromPreferences, LearnedNorm


def made_up(run: Run) -> dict[str, Any]:
    """People saved and goal time that tell every question's policies apart."""

    def objectives(goal_time: float, people_saved: float) -> dict[str, Any]:
        return {"objectives": {"goal_time": goal_time, "people_saved": people_saved}}

    if isinstance(run, t1.Reachable):
        return {"both": {"goal_time": 50.0, "people_saved": 6.0}, "goal_time": 60.0}
    if isinstance(run, LearnedNorm):
        return {"demonstrated": {"people_saved": 5.0}}
    if isinstance(run, t1.Shaped):
        if run.config.features == "planes":
            return objectives(0.0, 2.4)
        if len(run.norms) > 1:
            return objectives(10.0, 3.0)
        return objectives(57.0, 0.0) if run.config.penalty == 0 else objectives(48.0, 5.7)
    if isinstance(run, t1.Orchestrated):
        return objectives(30.0, 4.2)
    if isinstance(run, Aligned):
        first = run.teacher.order[0]
        return objectives(58.8, 0.6) if first == "goal_time" else objectives(49.0, 6.0)
    if isinstance(run, FromPreferences):
        return objectives(20.0, 4.8)
    return {}


@pytest.fixture(scope="module")
def results() -> Results:
    return Results([(run, made_up(run)) for run in t1.runs("smoke")])


@pytest.mark.parametrize(
    ("capability", "method", "score"),
    [
        ("function approximation", "ethics shaping", 2.4 / 6),
        # 57 of 60 steps, 5.7 of 6 people, and 5.7 of 6 people with 48 of 50 steps.
        ("multi-objective", "ethics shaping", 0.95),
        ("multiple experts", "ethics shaping", 10 / 50),
        ("outperform experts", "ethics shaping", 5.7 / 5),
        # For goal time alone 30 of 60 steps; for both 30 of 50.
        ("multi-objective", "policy orchestration", 0.5),
        ("multiple experts", "policy orchestration", 0.6),
        ("multi-objective", "DRLHP", 20 / 60),
        ("multiple experts", "DRLHP", 0.0),
        ("outperform experts", "DRLHP", 4.8 / 5),
        ("function approximation", "MORAL", 1.0),
        ("multi-objective", "MORAL", 0.98),
        ("outperform experts", "MORAL", 6 / 5),
    ],
)
def test_scores_by_hand(results: Results, capability: str, method: str, score: float) -> None:
    assert t1.scores(results)[capability, method] == pytest.approx([score])


@pytest.mark.parametrize(
    ("capability", "values", "mark"),
    [
        ("multi-objective", [0.88, 0.96], "✓"),
        ("multi-objective", [0.8, 0.9], "~"),
        ("multi-objective", [0.3, 0.6], "✗"),
        ("outperform experts", [1.01, 1.2], "✓"),
        ("outperform experts", [0.99, 1.2], "✗"),
    ],
)
def test_marks(capability: str, values: list[float], mark: str) -> None:
    assert t1.mark(capability, values) == mark


def test_every_cell_is_judged_against_the_thesis(results: Results) -> None:
    checks = {check.statement: check for check in t1.judge(results)}
    assert len(checks) == len(t1.METHODS) * len(t1.CAPABILITIES)
    assert checks["function approximation, ethics shaping: ✗"].met
    assert not checks["multi-objective, ethics shaping: ✗"].met
    assert checks["multi-objective, ethics shaping: ✗"].value.startswith("✓ 0.95")
    assert not checks["outperform experts, DRLHP: ✓"].met


def test_what_is_not_finished_is_not_judged() -> None:
    kept = (t1.Reachable, t1.Shaped, LearnedNorm)
    some = Results([(run, made_up(run)) for run in t1.runs("smoke") if isinstance(run, kept)])
    methods = {check.statement.split(", ")[1].split(":")[0] for check in t1.judge(some)}
    assert methods == {"ethics shaping"}
    assert t1.draw(some).axes
