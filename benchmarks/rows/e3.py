"""E3: AIRL from 10, 50, 500 and 2,000 demonstrations in Emergency (thesis figures 3.6 and 3.7)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, CYCLE, ORANGE, curves, over_seeds, panels
from benchmarks.stages import LearnedNorm
from benchmarks.stages.settings import saving, seeds

_SIZES = (10, 50, 500, 2000)


def runs(profile: Profile) -> list[Run]:
    """List every size with every seed."""
    return [saving(profile, seed, size) for size in _SIZES for seed in seeds(profile)]


def judge(results: Results) -> list[Check]:
    """Compare imitators over sizes, and the learned rewards of the least and the most demonstrations."""
    by_size = _by_size(results)
    saved = {size: [one["objectives"]["people_saved"] for one in found] for size, found in by_size.items()}
    checks = [
        Check(
            f"{size} demonstrations: the imitator saves at least 5.7 people in the mean",
            spread(values),
            bool(np.mean(values) >= 5.7),
            "ours",
        )
        for size, values in saved.items()
    ]
    least, most = by_size[min(by_size)], by_size[max(by_size)]
    for name, what in _OVERFITTING.items():
        few, many = (float(np.mean([_measured(one)[name] for one in found])) for found in (least, most))
        checks.append(
            Check(
                f"{min(by_size)} demonstrations give a higher {what} than {max(by_size)}",
                f"{few:.3g} against {many:.3g}",
                few > many,
                "thesis",
            )
        )
    return checks


def draw(results: Results) -> Figure:
    """Draw people saved, accuracies and learned returns over the number of demonstrations."""
    figure, (training, saved, accuracy, returns) = panels(4, width=4.1)
    by_size = _by_size(results)
    sizes = list(by_size)
    for size, colour in zip(sizes, CYCLE, strict=False):
        found = [one["curve"] for one in by_size[size]]
        curves(training, found, "people_saved", colour, f"{size} demonstrations")
    training.set(ylabel="people saved in training", ylim=(0, 6.2))
    training.legend(frameon=False, fontsize=8)
    groups = [[one["objectives"]["people_saved"] for one in by_size[size]] for size in sizes]
    over_seeds(saved, sizes, groups, BLUE, "imitator")
    saved.axhline(5.7, color="0.5", linestyle=":", linewidth=1)
    saved.set(ylabel="people saved", title="Imitation", ylim=(0, 6.2))
    for name, colour in (("fake_accuracy", BLUE), ("real_accuracy", ORANGE)):
        values = [[_measured(one)[name] for one in by_size[size]] for size in sizes]
        over_seeds(accuracy, sizes, values, colour, name.replace("_", " "))
    accuracy.set(ylabel="accuracy of the discriminator, last tenth", title="Overfitting")
    for name, colour in (("learned_return", BLUE), ("learned_deviation", ORANGE)):
        values = [[_measured(one)[name] for one in by_size[size]] for size in sizes]
        over_seeds(returns, sizes, values, colour, name.replace("_", " "))
    returns.set(ylabel="the imitator's return under f", title="Learned reward")
    for axes in (saved, accuracy, returns):
        axes.set(xscale="log", xlabel="demonstrations")
    for axes in (accuracy, returns):
        axes.legend(frameon=False, fontsize=8)
    return figure


_OVERFITTING = {
    "fake_accuracy": "accuracy on the policy's own transitions",
    "learned_return": "absolute learned return",
    "learned_deviation": "spread of the learned return over episodes",
}


def _by_size(results: Results) -> dict[int, list[dict[str, Any]]]:
    found: dict[int, list[dict[str, Any]]] = {}
    for run, result in results.of(LearnedNorm):
        found.setdefault(run.demonstrations, []).append(result)
    return dict(sorted(found.items()))


def _measured(result: dict[str, Any]) -> dict[str, float]:
    """Read what tells overfitting from a result."""
    curve = result["curve"]
    last = max(len(curve["env_steps"]) // 10, 1)
    accuracies = {name: float(np.mean(curve[name][-last:])) for name in ("fake_accuracy", "real_accuracy")}
    learned = result["learned_returns"]["imitator"]
    return {
        **accuracies,
        "learned_return": abs(learned["mean"]),
        "learned_deviation": learned["standard_deviation"],
    }


BENCHMARK = Benchmark(
    id="E3",
    title="AIRL from 10 to 2,000 demonstrations",
    source="figures 3.6, 3.7",
    claim="Imitation comes near 6 people saved from any number of demonstrations; small sets are overfitted: "
    "a high accuracy on the policy's transitions, a large learned reward of high variance.",
    bar="The imitators save at least 5.7 people for every size; the overfitting is seen.",
    runs=runs,
    judge=judge,
    draw=draw,
)
