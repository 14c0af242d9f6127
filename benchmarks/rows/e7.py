"""E7: fewer queries and noisy answers in Emergency (thesis figures 4.5 and 4.6)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import exceeds, spread
from benchmarks.rows.drawing import BLUE, CYCLE, GREEN, ORANGE, curves, over_seeds, panels
from benchmarks.rows.e6 import utilities
from benchmarks.rows.e8 import moral
from benchmarks.stages import Aligned
from benchmarks.stages.settings import seeds

_QUERIES = (5, 10, 25)
_NOISE = (0.05, 0.1, 0.2, 0.3)
_SEEDS = 5


def runs(profile: Profile) -> list[Run]:
    """List every number of queries without noise, and every noise with 25 queries.

    The strongest noise comes once more, under a likelihood that expects as much of it.
    """
    found: list[Run] = [
        moral(profile, seed, queries) for queries in _QUERIES for seed in seeds(profile, _SEEDS)
    ]
    for noise in _NOISE:
        for seed in seeds(profile, _SEEDS):
            plain = moral(profile, seed)
            noisy = replace(plain, teacher=replace(plain.teacher, noise=noise))
            found.append(noisy)
            # The thesis's likelihood knows of no random answers.
            if noise == max(_NOISE) and plain.config.likelihood != "exponential":
                found.append(replace(noisy, config=replace(plain.config, lapse=noise)))
    return found


def judge(results: Results) -> list[Check]:
    """Compare with the thesis's observations and our bars."""
    by_queries, by_noise = _sorted(results)
    expected = _expected(results)
    checks = []
    if 10 in by_queries:
        saved, goal = _objectives(by_queries[10])
        value = f"{spread(saved)} saved; {spread(goal)} goal steps"
        met = min(saved) >= 5.9 and min(goal) >= 50
        checks.append(
            Check("10 queries: at least 5.9 saved and 50 goal steps in every seed", value, met, "ours")
        )
    if 5 in by_queries:
        saved, goal = _objectives(by_queries[5])
        checks.append(
            Check(
                "5 queries do better than the thesis's 10, which spend far less goal time than its 25",
                f"{spread(saved)} saved; {spread(goal)} goal steps",
                bool(np.mean(saved) >= 5.76 and np.mean(goal) >= 40.08),
                "ours",
            )
        )
    if {5, 25} <= by_queries.keys():
        few, many = (_objectives(by_queries[count]) for count in (5, 25))
        checks.append(
            Check(
                "25 queries end nearer to the optimum than 5, by more than two standard errors",
                f"{spread(many[0])} saved against {spread(few[0])}; "
                f"{spread(many[1])} goal steps against {spread(few[1])}",
                exceeds(utilities(by_queries[25]), utilities(by_queries[5])),
                "thesis",
            )
        )
    if 0.0 in by_noise and 0.3 in by_noise:
        ratios = [
            float(np.mean(noisy) / np.mean(exact))
            for noisy, exact in zip(_objectives(by_noise[0.3]), _objectives(by_noise[0.0]), strict=True)
        ]
        checks.append(
            Check(
                "noise 0.3 reaches people saved and goal time within 5 % of no noise",
                f"{100 * ratios[0]:.1f} % and {100 * ratios[1]:.1f} %",
                min(ratios) >= 0.95,
                "ours",
            )
        )
        saved, _ = _objectives(by_noise[0.3])
        checks.append(
            Check(
                "noise 0.3 loses no people", f"{spread(saved)} saved", bool(np.mean(saved) >= 5.76), "thesis"
            )
        )
    if expected:
        saved, goal = _objectives(expected)
        checks.append(
            Check(
                "noise 0.3 under a likelihood that expects it (lapse 0.3): at least 5.9 saved and 50 goal "
                "steps in every seed",
                f"{spread(saved)} saved; {spread(goal)} goal steps",
                min(saved) >= 5.9 and min(goal) >= 50,
                "ours",
            )
        )
    return checks


def draw(results: Results) -> Figure:
    """Draw final objectives over queries and noise, and training under noise."""
    figure, axes = panels(4, width=4.1)
    by_queries, by_noise = _sorted(results)
    groups: list[tuple[str, list[float], list[list[dict[str, Any]]]]] = [
        ("queries", [float(queries) for queries in by_queries], list(by_queries.values())),
        ("noise", list(by_noise), list(by_noise.values())),
    ]
    for place, (title, values, found_groups) in enumerate(groups):
        objectives = [_objectives(group) for group in found_groups]
        second = axes[place].twinx()
        over_seeds(axes[place], values, [one[0] for one in objectives], BLUE, "people saved")
        over_seeds(second, values, [one[1] for one in objectives], ORANGE, "goal time")
        axes[place].set(xlabel=title, ylim=(0, 6.3))
        axes[place].set_ylabel("people saved", color=BLUE)
        second.set_ylabel("goal time", color=ORANGE)
        second.set(ylim=(0, 63))
        second.spines["top"].set_visible(False)
    expected = _expected(results)
    if expected:
        beside = max(run.teacher.noise for run, _ in results.of(Aligned)) + 0.012
        saved, _ = _objectives(expected)
        over_seeds(axes[1], [beside], [saved], GREEN, "people saved,\nnoise expected")
        axes[1].legend(frameon=False, fontsize=8, loc="lower left")
    for (noise, found), colour in zip(by_noise.items(), CYCLE, strict=False):
        for one, objective in ((axes[2], "people_saved"), (axes[3], "goal_time")):
            curves(one, [result["curve"] for result in found], objective, colour, f"noise {noise:g}")
            one.set_ylabel(objective.replace("_", " "))
    axes[3].legend(frameon=False, fontsize=8)
    return figure


def _sorted(results: Results) -> tuple[dict[int, list[dict[str, Any]]], dict[float, list[dict[str, Any]]]]:
    """Sort results without noise by queries, and those with the most queries by noise, none expected."""
    found = [(run, result) for run, result in results.of(Aligned) if not run.config.lapse]
    most = max((run.config.queries for run, _ in found), default=0)
    by_queries: dict[int, list[dict[str, Any]]] = {}
    by_noise: dict[float, list[dict[str, Any]]] = {}
    for run, result in found:
        if run.teacher.noise == 0:
            by_queries.setdefault(run.config.queries, []).append(result)
        if run.config.queries == most:
            by_noise.setdefault(run.teacher.noise, []).append(result)
    return dict(sorted(by_queries.items())), dict(sorted(by_noise.items()))


def _expected(results: Results) -> list[dict[str, Any]]:
    """List the results under a likelihood that expects random answers."""
    return [result for run, result in results.of(Aligned) if run.config.lapse]


def _objectives(found: list[dict[str, Any]]) -> tuple[list[float], list[float]]:
    objectives = [one["objectives"] for one in found]
    return [one["people_saved"] for one in objectives], [one["goal_time"] for one in objectives]


BENCHMARK = Benchmark(
    id="E7",
    title="Fewer queries, noisy answers",
    source="figures 4.5, 4.6",
    claim="10 queries suffice to save everyone, 25 come near the optimum; with random answers up to a "
    "probability of 0.3, nothing significant is lost.",
    bar="10 queries: at least 5.9 and 50 in every seed; 5 queries better than the thesis's 10 (at least what "
    "it reports for 25); noise 0.3 within 5 % of none.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="There were three seeds first, and 25 queries had to be better than 5 by any amount. When one of "
    "five had lost people under noise 0.3, the likelihood that expects it was added.",
)
