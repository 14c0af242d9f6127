"""D2: norms learned in Delivery from 1,000 demonstrations each (thesis figures 5.3 and A.6)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.d1 import NORMS
from benchmarks.rows.drawing import BLUE, GREEN, ORANGE, RED, curves, panels
from benchmarks.stages import LearnedNorm, TrainedExpert
from benchmarks.stages.settings import helping_and_cleaning, seeds


def runs(profile: Profile) -> list[Run]:
    """List both norms with every seed, and their experts."""
    norms = [norm for seed in seeds(profile) for norm in helping_and_cleaning(profile, seed)]
    return [*norms, *(norm.expert for norm in norms)]


def judge(results: Results) -> list[Check]:
    """Compare every imitator with its expert."""
    checks = []
    experts = {run.key: result for run, result in results.of(TrainedExpert)}
    for norm, (weights, objective) in NORMS.items():
        found = [(run, one) for run, one in results.of(LearnedNorm) if run.expert.weights == weights]
        found = [(run, one) for run, one in found if run.expert.key in experts]
        if not found:
            continue
        shares = [
            one["objectives"][objective] / max(experts[run.expert.key]["objectives"][objective], 1e-9)
            for run, one in found
        ]
        vases = [one["objectives"]["vases_broken"] for _, one in found]
        statement = f"{norm}: every imitator reaches 90 % of its expert and breaks at most 0.3 vases"
        value = f"share {spread(shares)}; vases {spread(vases)}"
        checks.append(Check(statement, value, min(shares) >= 0.9 and max(vases) <= 0.3, "ours"))
        accuracies = [
            float(np.mean([one["curve"][name][-6:] for name in ("fake_accuracy", "real_accuracy")]))
            for _, one in found
        ]
        statement = f"{norm}: the discriminator ends near chance, at accuracies of about 0.6"
        checks.append(Check(statement, spread(accuracies), max(accuracies) <= 0.7, "thesis"))
    return checks


def draw(results: Results) -> Figure:
    """Draw counters and accuracies during AIRL."""
    figure, axes = panels(4, width=4.1)
    for place, (norm, (weights, _)) in enumerate(NORMS.items()):
        found = [one["curve"] for run, one in results.of(LearnedNorm) if run.expert.weights == weights]
        counters, accuracy = axes[2 * place], axes[2 * place + 1]
        names = (
            ("delivered", ORANGE),
            ("helped", BLUE),
            ("cleaned", GREEN),
            ("vases_broken", RED),
        )
        for name, colour in names:
            curves(counters, found, name, colour, name.replace("_", " "))
        for name, colour in (("fake_accuracy", BLUE), ("real_accuracy", ORANGE)):
            curves(accuracy, found, name, colour, name.replace("_", " "))
        counters.set(title=f"AIRL, expert who likes to {norm}", ylabel="per episode")
        accuracy.set(ylabel="accuracy of the discriminator", ylim=(0.4, 1))
        if found:
            counters.legend(frameon=False, fontsize=8)
            accuracy.legend(frameon=False, fontsize=8)
    return figure


BENCHMARK = Benchmark(
    id="D2",
    title="Norms learned in Delivery",
    source="figures 5.3, A.6",
    claim="Both imitators pursue their expert's objective from the start and break few vases; the "
    "discriminator's accuracies end around 0.6.",
    bar="Every imitator within 10 % of its expert, with at most 0.3 vases.",
    runs=runs,
    judge=judge,
    draw=draw,
)
