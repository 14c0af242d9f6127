"""Rows E4, D4 and P1 judge and draw what they should, told by results that are made up."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.harness import Benchmark, Results, Run
from benchmarks.harness.benchmark import verdict
from benchmarks.rows import d4, e4, p1
from benchmarks.rows.d4 import CoverageSet, compare
from benchmarks.stages import Asked, Weighted
from moral_envs import emergency_v0
from moral_envs.optimal import coverage_set, seeded_starts


def made_up(benchmark: Benchmark, result: Callable[[Run], dict[str, Any]]) -> Results:
    return Results([(run, result(run)) for run in benchmark.runs("laptop")])


def objectives(**values: float) -> dict[str, Any]:
    return {"objectives": values, "standard_errors": dict.fromkeys(values, 0.5)}


@cache
def exact_vertices() -> NDArray[np.float64]:
    return coverage_set(seeded_starts(emergency_v0.world(), 100, seed=1), 75).points


def on_the_exact_front(run: Run) -> dict[str, Any]:
    """Pretend that a sharp change takes place on either side of lambda 0.2."""
    assert isinstance(run, Weighted)
    weight = run.weights[0]
    vertices = exact_vertices()
    some_lost = vertices[vertices[:, 1] < 5.8]
    above = [one for one in e4.LAMBDAS if one > 0.2]
    ranks = np.linspace(len(some_lost) - 1, 0, len(above))
    lost = {one: round(rank) for one, rank in zip(above, ranks, strict=True)}
    goal_time, people_saved = some_lost[lost[weight]] if weight > 0.2 else vertices[-1]
    if weight < 0.2:
        goal_time = 200 * weight
    found = objectives(goal_time=float(goal_time), people_saved=float(people_saved))
    return {**found, "scales": {"extinguish": 1 / 7, "learned_1": 1 / 140}}


def test_a_front_as_the_thesis_saw_it_holds() -> None:
    results = made_up(e4.BENCHMARK, on_the_exact_front)
    checks = e4.judge(results)
    assert verdict(checks) == "holds", checks
    # 0.2 / 7 against 0.8 / 140.
    assert "lambda 0.2 (0.83 to 0.83 on rewards as they are)" in checks[0].value


def test_a_sweep_that_saves_nobody_fails() -> None:
    def result(run: Run) -> dict[str, Any]:
        return {**objectives(goal_time=50.0, people_saved=1.0), "scales": {}}

    checks = e4.judge(made_up(e4.BENCHMARK, result))
    assert verdict(checks) == "fails"
    assert checks[0].value == "at most 1.00 saved"


def quarter_circle(radius: float, vases: float) -> CoverageSet:
    angles = np.linspace(0, np.pi / 2, 11)
    return CoverageSet(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1), np.full(11, vases))


def test_hypervolumes_are_compared_seed_by_seed() -> None:
    true = [quarter_circle(10, 3.0), quarter_circle(20, 5.0)]
    volume, vases = compare([quarter_circle(9.8, 0.2), quarter_circle(19.6, 0.4)], true)
    # Areas go with the square of the radius.
    assert volume.value.startswith(f"{0.98**2:.3f} (0.000)")
    assert vases.value.startswith("0.30")
    assert volume.met
    assert vases.met
    volume, vases = compare([quarter_circle(9, 1.6), quarter_circle(18, 2.6)], true)
    assert not volume.met
    assert not vases.met


def in_delivery(run: Run) -> dict[str, Any]:
    if isinstance(run, Asked):
        help_, clean = run.teacher.ratio.values()
        share, vases = help_ / (help_ + clean), 0.2
    else:
        assert isinstance(run, Weighted)
        share, vases = run.weights[1], 0.1 if "vase" in run.primary else 3.0
    angle = share * np.pi / 2
    radius = 10.0 if vases == 3.0 else 9.5
    return objectives(
        delivered=1.0,
        helped=float(radius * np.sin(angle)),
        cleaned=float(radius * np.cos(angle)),
        vases_broken=vases,
    )


def test_policies_are_sorted_by_method_and_seed() -> None:
    results = made_up(d4.BENCHMARK, in_delivery)
    moral, ppo, sparing = d4.coverage_sets(results)
    assert moral.keys() == ppo.keys() == sparing.keys() == {0, 1, 2}
    for seed in moral:
        assert moral[seed].collected.shape == ppo[seed].collected.shape == (11, 2)
        # Weights are of (clean, help), counters of (helped, cleaned).
        np.testing.assert_allclose(ppo[seed].collected[0], [10, 0], atol=1e-9)
        assert moral[seed].vases.tolist() == [0.2] * 11
        assert sparing[seed].vases.tolist() == [0.1] * 11
    volume, vases, against_sparing, mixed = d4.judge(results)
    assert not volume.met
    assert vases.met
    # MORAL's ratios lie elsewhere on the circle than the lambdas do.
    assert against_sparing.met
    assert against_sparing.value.endswith(f"that PPO spans {0.95**2:.3f} of the one that pays for none")
    assert not mixed.met


def test_mixtures_fill_the_gaps_of_a_coverage_set() -> None:
    """(1, 3) and (3, 1) mix to (2, 2), beyond (1.5, 1.5); 1 by 3 and a trapezium lie under them."""
    collected = np.array([[3.0, 1.0], [1.5, 1.5], [1.0, 3.0]])
    assert d4.mixed_area(CoverageSet(collected, np.zeros(3))) == pytest.approx(3 + 2 * (3 + 1) / 2)
    assert d4.mixed_area(CoverageSet(collected[:1], np.zeros(1))) == pytest.approx(3)


def in_the_warehouse(run: Run) -> dict[str, Any]:
    if isinstance(run, Weighted):
        return objectives(goal_time=78.0, people_saved=6.0)
    assert isinstance(run, p1.SingleLoop)
    weight = run.imitation_weight
    return objectives(
        goal_time=90 * (1 - weight) if weight < 0.3 else 1.0, people_saved=6 * min(1.0, weight / 0.13)
    )


def test_the_single_loop_is_judged() -> None:
    checks = p1.judge(made_up(p1.BENCHMARK, in_the_warehouse))
    assert verdict(checks) == "holds", checks
    assert checks[0].value.startswith("lambda 0.1:")

    def nothing(run: Run) -> dict[str, Any]:
        return objectives(goal_time=40.0, people_saved=4.0)

    assert verdict(p1.judge(made_up(p1.BENCHMARK, nothing))) == "fails"


@pytest.mark.parametrize(
    ("benchmark", "result"),
    [
        (e4.BENCHMARK, on_the_exact_front),
        (d4.BENCHMARK, in_delivery),
        (p1.BENCHMARK, in_the_warehouse),
    ],
    ids=["E4", "D4", "P1"],
)
def test_figures_show_every_run(benchmark: Benchmark, result: Callable[[Run], dict[str, Any]]) -> None:
    results = made_up(benchmark, result)
    figure = benchmark.draw(results)
    shown = sum(len(line.get_xdata()) for axes in figure.axes for line in axes.lines)
    shown += sum(len(dots.get_offsets()) for axes in figure.axes for dots in axes.collections)
    assert shown >= len(results)
    # The first runs that are finished are drawn and judged, too.
    first = Results([(run, result(run)) for run in benchmark.runs("smoke")[:1]])
    benchmark.draw(first)
    benchmark.judge(first)
