"""D7: DRLHP in Delivery, asked to behave as MORAL does (thesis figure 5.10; second paper, figure 8)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, ORANGE, curves, panels
from benchmarks.rows.ratios import COLLECTED, three_rewards
from benchmarks.stages import Asked, FromPreferences
from benchmarks.stages.settings import DELIVERY, drlhp, episodes, seeds
from moral_algorithms.pipeline import TeacherConfig

_RATIOS = ((1, 5, 5), (3, 1, 1), (1, 3, 1), (1, 1, 3))
_QUERIES = 5000


def runs(profile: Profile) -> list[Run]:
    """List MORAL for every ratio and seed, and DRLHP with MORAL's returns as its target."""
    found: list[Run] = []
    for ratio in _RATIOS[:1] if profile == "smoke" else _RATIOS:
        for seed in seeds(profile):
            aligned = three_rewards(profile, ratio, seed)
            # A target is one for whole episodes.
            config = replace(drlhp(profile, DELIVERY, _QUERIES), clip_length=0)
            teacher = TeacherConfig(teacher="target")
            found += [
                aligned,
                FromPreferences(DELIVERY, teacher, seed, config, aligned, episodes(profile)),
            ]
    return found


def judge(results: Results) -> list[Check]:
    """Compare what both reach, pair by pair."""
    pairs = _pairs(results)
    if not pairs:
        return []
    ours, theirs = ([_total(result) for result in side] for side in zip(*pairs, strict=True))
    our_vases, their_vases = (
        [one["objectives"]["vases_broken"] for one in side] for side in zip(*pairs, strict=True)
    )
    distances = [_distance(*pair) for pair in pairs]
    return [
        Check(
            "DRLHP collects less than MORAL, whose returns are its target",
            f"{spread(theirs)} against {spread(ours)}",
            bool(np.mean(theirs) < np.mean(ours)),
            "thesis",
        ),
        Check(
            "DRLHP breaks more vases",
            f"{spread(their_vases)} against {spread(our_vases)}",
            bool(np.mean(their_vases) > np.mean(our_vases)),
            "thesis",
        ),
        Check(
            "DRLHP is a fair opponent: it comes within 5 objects of its target (Euclidean, four counters)",
            spread(distances),
            bool(np.mean(distances) <= 5),
            "ours",
        ),
    ]


def draw(results: Results) -> Figure:
    """Draw both by environment steps, a row for each ratio; MORAL is offset by what precedes its queries."""
    found = results.of(Asked)
    ratios = list(dict.fromkeys(tuple(run.teacher.ratio.values()) for run, _ in found))
    figure, axes = panels(4, rows=max(len(ratios), 1), width=3.6, height=2.8)
    for row, ratio in enumerate(ratios):
        ours = [one["curve"] for run, one in found if tuple(run.teacher.ratio.values()) == ratio]
        theirs = [
            one["curve"]
            for run, one in results.of(FromPreferences)
            if run.target is not None and tuple(run.target.teacher.ratio.values()) == ratio
        ]
        for column, name in enumerate((*COLLECTED, "vases_broken")):
            one = axes[4 * row + column]
            policy = found[0][0].covered
            learned = sum(norm.config.steps + norm.expert.config.max_steps for norm in policy.norms)
            offset = learned + policy.config.steps
            curves(one, ours, name, BLUE, "MORAL", offset)
            curves(one, theirs, name, ORANGE, "DRLHP")
            one.set(ylim=(0, None), ylabel=name.replace("_", " "))
            if column == 0:
                one.set_title(":".join(f"{share:g}" for share in ratio), loc="left")
    # Where nothing is drawn, matplotlib warns of an empty legend.
    if found:
        axes[0].legend(frameon=False, fontsize=8)
    return figure


def _pairs(results: Results) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """List the results of MORAL and of the DRLHP that was to behave alike."""
    return [
        (results[run.target], result)
        for run, result in results.of(FromPreferences)
        if run.target is not None and run.target in results
    ]


def _total(result: dict[str, Any]) -> float:
    return float(sum(result["objectives"][name] for name in COLLECTED))


def _distance(ours: dict[str, Any], theirs: dict[str, Any]) -> float:
    differences = [ours["objectives"][name] - theirs["objectives"][name] for name in ours["objectives"]]
    return float(np.linalg.norm(differences))


BENCHMARK = Benchmark(
    id="D7",
    title="DRLHP in Delivery",
    source="figure 5.10; second paper, figure 8",
    claim="With 5,000 preferences for MORAL's own returns, DRLHP is slower, ends worse and breaks vases.",
    bar="The same comparison, fair to both.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="MORAL's agents, whose returns DRLHP is to reach, were made again (see D6), and so was DRLHP.",
)
