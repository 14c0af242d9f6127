"""E7: fewer queries and noisy answers in Emergency (thesis figures 4.5 and 4.6)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import exceeds, spread
from benchmarks.rows.drawing import BLUE, CYCLE, GREEN, ORANGE, RED, curves, over_seeds, panels
from benchmarks.rows.e6 import utilities
from benchmarks.rows.e8 import moral
from benchmarks.stages import Aligned
from benchmarks.stages.settings import seeds

_QUERIES = (5, 10, 25)
_NOISE = (0.05, 0.1, 0.2, 0.3)
_SEEDS = 5


def runs(profile: Profile) -> list[Run]:
    """List every number of queries without noise, and every noise with 25 queries.

    The strongest noise comes twice more: under a likelihood that expects no random answers, as the thesis's,
    and under one that expects as many as there are.
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
                found += [replace(noisy, config=replace(plain.config, lapse=lapse)) for lapse in (0.0, noise)]
    return found


def judge(results: Results) -> list[Check]:
    """Compare with the thesis's observations and our bars."""
    by_queries, by_noise = _sorted(results)
    others = _by_lapse(results)
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
        reached = _shares(by_noise[0.3], by_noise[0.0])
        value = f"{100 * reached[0]:.1f} % and {100 * reached[1]:.1f} %"
        if 0.0 in others:
            unexpected = _shares(others[0.0], by_noise[0.0])
            value += (
                f"; {100 * unexpected[0]:.1f} % and {100 * unexpected[1]:.1f} % under a likelihood that "
                "expects no random answers (lapse 0)"
            )
        claim = "noise 0.3 reaches people saved and goal time within 5 % of no noise"
        checks.append(Check(claim, value, min(reached) >= 0.95, "ours"))
        saved, _ = _objectives(by_noise[0.3])
        checks.append(
            Check(
                "noise 0.3 loses no people", f"{spread(saved)} saved", bool(np.mean(saved) >= 5.76), "thesis"
            )
        )
    if 0.3 in others:
        saved, goal = _objectives(others[0.3])
        checks.append(
            Check(
                "noise 0.3 under a likelihood that expects as much (lapse 0.3): at least 5.9 saved and 50 "
                "goal steps in every seed",
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
    for one, (title, values, found_groups) in zip(axes[:2], groups, strict=True):
        second = one.twinx()
        _both(one, second, values, found_groups, (BLUE, ORANGE), ("people saved", "goal time"))
        one.set(xlabel=title, ylim=(0, 6.3))
        one.set_ylabel("people saved", color=BLUE)
        second.set_ylabel("goal time", color=ORANGE)
        second.set(ylim=(0, 63))
        second.spines["top"].set_visible(False)
        if title == "noise":
            strongest = max(by_noise, default=0.0)
            for place, (lapse, found) in enumerate(_by_lapse(results).items(), start=1):
                colours = ((GREEN, RED)[place % 2],) * 2
                labels = (f"both, lapse {lapse:g}", "")
                _both(one, second, [strongest + 0.012 * place], [found], colours, labels)
                one.legend(frameon=False, fontsize=8, loc="lower left")
    for (noise, found), colour in zip(by_noise.items(), CYCLE, strict=False):
        for one, objective in ((axes[2], "people_saved"), (axes[3], "goal_time")):
            curves(one, [result["curve"] for result in found], objective, colour, f"noise {noise:g}")
            one.set_ylabel(objective.replace("_", " "))
    if by_noise:
        axes[3].legend(frameon=False, fontsize=8)
    return figure


def _both(
    axes: Axes,
    second: Axes,
    values: list[float],
    groups: list[list[dict[str, Any]]],
    colours: tuple[str, str],
    labels: tuple[str, str],
) -> None:
    """Draw both objectives of groups of results over some value, each on its axis."""
    objectives = [_objectives(group) for group in groups]
    for number, one in enumerate((axes, second)):
        over_seeds(one, values, [pair[number] for pair in objectives], colours[number], labels[number])


def _sorted(results: Results) -> tuple[dict[int, list[dict[str, Any]]], dict[float, list[dict[str, Any]]]]:
    """Sort results without noise by queries, and those with most queries by noise; the likelihood is one."""
    usual = _usual_lapse(results)
    found = [(run, result) for run, result in results.of(Aligned) if run.config.lapse == usual]
    most = max((run.config.queries for run, _ in found), default=0)
    by_queries: dict[int, list[dict[str, Any]]] = {}
    by_noise: dict[float, list[dict[str, Any]]] = {}
    for run, result in found:
        if run.teacher.noise == 0:
            by_queries.setdefault(run.config.queries, []).append(result)
        if run.config.queries == most:
            by_noise.setdefault(run.teacher.noise, []).append(result)
    return dict(sorted(by_queries.items())), dict(sorted(by_noise.items()))


def _by_lapse(results: Results) -> dict[float, list[dict[str, Any]]]:
    """Sort the results under other likelihoods by the share of random answers that these expect."""
    usual = _usual_lapse(results)
    found: dict[float, list[dict[str, Any]]] = {}
    for run, result in results.of(Aligned):
        if run.config.lapse != usual:
            found.setdefault(run.config.lapse, []).append(result)
    return dict(sorted(found.items()))


def _usual_lapse(results: Results) -> float:
    return next((run.config.lapse for run, _ in results.of(Aligned) if run.teacher.noise == 0), 0.1)


def _shares(found: list[dict[str, Any]], reference: list[dict[str, Any]]) -> tuple[float, float]:
    """Compare means of both objectives with those of a reference."""
    saved, goal = (
        float(np.mean(ours) / np.mean(theirs))
        for ours, theirs in zip(_objectives(found), _objectives(reference), strict=True)
    )
    return saved, goal


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
    "five had lost people under noise 0.3, where the likelihood expected no random answers, other shares "
    "were added. That a tenth is expected by default, as by DRLHP, was then chosen on four development "
    "seeds, and every run was made again.",
)
