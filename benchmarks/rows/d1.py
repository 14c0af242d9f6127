"""D1: Delivery's experts, who help or clean and spare the vases (thesis figure A.3)."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, GREEN, panels
from benchmarks.stages import TrainedExpert
from benchmarks.stages.settings import CLEAN, HELP, helper_or_cleaner, seeds

NORMS = {"help": (HELP, "helped"), "clean": (CLEAN, "cleaned")}
"""Weights of each norm's expert, and its own objective."""


def runs(profile: Profile) -> list[Run]:
    """List both experts with every seed."""
    return [
        helper_or_cleaner(profile, weights, seed) for weights, _ in NORMS.values() for seed in seeds(profile)
    ]


def judge(results: Results) -> list[Check]:
    """Compare every expert with the bar."""
    checks = []
    for norm, (weights, objective) in NORMS.items():
        found = [result["objectives"] for run, result in results.of(TrainedExpert) if run.weights == weights]
        if found:
            own, vases = (
                [one[objective] for one in found],
                [one["vases_broken"] for one in found],
            )
            statement = f"{norm}: every expert reaches 9 of its own objective and breaks at most 0.2 vases"
            value = f"{spread(own)}; vases {spread(vases)}"
            checks.append(Check(statement, value, min(own) >= 9 and max(vases) <= 0.2, "ours"))
    return checks


def draw(results: Results) -> Figure:
    """Draw all counters of the experts."""
    figure, axes = panels(2)
    for one, (norm, (weights, _)) in zip(axes, NORMS.items(), strict=True):
        found = [result["objectives"] for run, result in results.of(TrainedExpert) if run.weights == weights]
        draw_counters(one, found, f"expert who likes to {norm}", BLUE if norm == "help" else GREEN)
    return figure


def draw_counters(axes: Any, found: list[dict[str, float]], title: str, colour: str) -> None:
    """Draw bars of all counters, with every seed as a dot."""
    names = list(found[0]) if found else []
    for place, name in enumerate(names):
        values = [one[name] for one in found]
        axes.bar(place, sum(values) / len(values), 0.6, color=colour, alpha=0.8)
        axes.plot([place] * len(values), values, ".", color="black", markersize=4)
    axes.set_xticks(range(len(names)), [name.replace("_", "\n") for name in names])
    axes.set(title=title, ylabel="per episode")


BENCHMARK = Benchmark(
    id="D1",
    title="Experts in Delivery",
    source="figure A.3",
    claim="Experts are paid 1 for helping (cleaning) and -1 for a broken vase.",
    bar="At least 9 of the own objective in 50 steps and at most 0.2 vases, in every seed.",
    runs=runs,
    judge=judge,
    draw=draw,
)
