"""D8: how many queries it takes in Delivery, active or random (thesis figure 5.11)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import write_mean
from benchmarks.rows.drawing import BLUE, ORANGE, mean_intervals, panels
from benchmarks.rows.ratios import ALL_RATIOS, deviation, three_rewards
from benchmarks.stages import Asked
from benchmarks.stages.settings import seeds

QUERIES = (5, 10, 25, 50)


def study_runs(profile: Profile, queries: int, **changes: Any) -> list[Asked]:
    """List all ratios, nine with each of three seeds; settings of MORAL may be changed."""
    ratios = ALL_RATIOS[:1] if profile == "smoke" else ALL_RATIOS
    found = []
    for ratio in ratios:
        # Every share of every objective meets every seed three times.
        plain = three_rewards(profile, ratio, sum(ratio) % len(seeds(profile)), queries)
        found.append(replace(plain, config=replace(plain.config, **changes)))
    return found


def runs(profile: Profile) -> list[Run]:
    """List all numbers of queries, active and random."""
    counts = QUERIES[1:2] if profile == "smoke" else QUERIES
    active = [run for queries in counts for run in study_runs(profile, queries)]
    return [
        *active,
        *(run for queries in counts for run in study_runs(profile, queries, acquisition="random")),
    ]


def judge(results: Results) -> list[Check]:
    """Compare active with random queries, and ten active ones with the bar."""
    active, random = deviations(results)
    checks = []
    if 10 in active:
        statement, reached = "10 active queries: mean divergence at most 0.02", _mean(active[10]) <= 0.02
        checks.append(Check(statement, write_mean([active[10]]), reached, "ours"))
    for queries in (25, 50):
        if queries in active and queries in random:
            ours, theirs = _mean(active[queries]), _mean(random[queries])
            statement = f"{queries} active queries deviate less than half as much as random ones"
            checks.append(Check(statement, f"{ours:.4f} against {theirs:.4f}", ours < theirs / 2, "thesis"))
    return checks


def draw(results: Results) -> Figure:
    """Draw mean divergences with intervals over the number of queries."""
    figure, (axes,) = panels(1, width=6.0, height=4.0)
    for found, label, colour in zip(deviations(results), ("active", "random"), (BLUE, ORANGE), strict=True):
        counts = sorted(found)
        mean_intervals(axes, counts, [found[count] for count in counts], colour, label)
    axes.plot(50, 0.045, "s", color="0.4", label="random, thesis")
    axes.set(xlabel="queries", ylabel="KL divergence from the wanted ratio", ylim=(0, None))
    axes.set_xticks(QUERIES)
    axes.legend(frameon=False)
    return figure


def deviations(results: Results) -> tuple[dict[int, list[float]], dict[int, list[float]]]:
    """Sort divergences by the number of queries, of active and of random ones, without noise."""
    active: dict[int, list[float]] = {}
    random: dict[int, list[float]] = {}
    for run, result in results.of(Asked):
        if run.teacher.noise == 0:
            found = random if run.config.acquisition == "random" else active
            found.setdefault(run.config.queries, []).append(deviation(run, result))
    return active, random


def _mean(values: Any) -> float:
    return float(np.mean(values))


BENCHMARK = Benchmark(
    id="D8",
    title="How many queries, active or random",
    source="figure 5.11",
    claim="Deviations fall with the number of queries; above 10, active queries deviate less than half as "
    "much as random ones, which end at about 0.045 after 50.",
    bar="10 active queries deviate by at most 0.02 in the mean.",
    runs=runs,
    judge=judge,
    draw=draw,
)
