"""D10: training for single ratios, with active and with random queries (thesis figures C.12 to C.15)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.rows.d8 import study_runs
from benchmarks.rows.drawing import BLUE, GREEN, ORANGE, RED, curves, panels
from benchmarks.rows.ratios import COLLECTED
from benchmarks.stages import Asked

_DRAWN = ((1, 1, 3), (1, 2, 1), (2, 1, 3), (3, 2, 1))
"""The ratios of the thesis's figures, of (delivered, helped, cleaned)."""
_COLOURS = {"delivered": ORANGE, "helped": BLUE, "cleaned": GREEN, "vases_broken": RED}


def runs(profile: Profile) -> list[Run]:
    """List the runs of the study of queries with 25 of them, active and random."""
    queries = 10 if profile == "smoke" else 25
    return [*study_runs(profile, queries), *study_runs(profile, queries, acquisition="random")]


def judge(results: Results) -> list[Check]:
    """Compare how far apart the policies of different ratios end, and how far they follow the ratios."""
    by_asking = _by_asking(results)
    if not all(len(found) > 1 for found in by_asking.values()):
        return []
    spreads, slopes = {}, {}
    for asking, found in by_asking.items():
        wanted, achieved = _shares(found)
        spreads[asking] = float(achieved.std(axis=0).mean())
        slopes[asking] = float((wanted * achieved).sum() / (wanted**2).sum())
    return [
        Check(
            "policies for different ratios differ more with active queries than with random ones",
            f"{spreads['active']:.3f} against {spreads['random']:.3f} (standard deviation of the shares)",
            spreads["active"] > spreads["random"],
            "thesis",
        ),
        Check(
            "policies follow the wanted ratio more closely with active queries than with random ones",
            f"{slopes['active']:.2f} against {slopes['random']:.2f} (slope of the shares on the wanted ones; "
            "1 follows, 0 is the prior's policy for everybody)",
            abs(slopes["active"] - 1) < abs(slopes["random"] - 1),
            "thesis",
        ),
    ]


def draw(results: Results) -> Figure:
    """Draw the counters during training, active above random."""
    figure, axes = panels(len(_DRAWN), rows=2, width=3.6, height=3.0)
    for row, (asking, found) in enumerate(_by_asking(results).items()):
        by_ratio = {tuple(run.teacher.ratio.values()): result for run, result in found}
        for column, ratio in enumerate(_DRAWN):
            one = axes[row * len(_DRAWN) + column]
            for name, colour in _COLOURS.items():
                if ratio in by_ratio:
                    curves(one, [by_ratio[ratio]["curve"]], name, colour, name.replace("_", " "))
            one.set(title=f"{asking}, {':'.join(map(str, ratio))}", ylim=(0, 13))
    axes[0].set_ylabel("per episode")
    if axes[0].lines:
        axes[0].legend(frameon=False, fontsize=8)
    return figure


def _by_asking(results: Results) -> dict[str, list[tuple[Asked, dict[str, Any]]]]:
    found: dict[str, list[tuple[Asked, dict[str, Any]]]] = {"active": [], "random": []}
    for run, result in results.of(Asked):
        found["random" if run.config.acquisition == "random" else "active"].append((run, result))
    return found


def _shares(found: list[tuple[Asked, dict[str, Any]]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares wanted and achieved, each of shape (n, 3), less their means over the runs."""
    wanted = np.array([list(run.teacher.ratio.values()) for run, _ in found], dtype=np.float64)
    achieved = np.array([[one["objectives"][name] for name in COLLECTED] for _, one in found])
    wanted /= wanted.sum(axis=1, keepdims=True)
    achieved /= np.maximum(achieved.sum(axis=1, keepdims=True), 1e-9)
    return wanted - wanted.mean(axis=0), achieved - achieved.mean(axis=0)


BENCHMARK = Benchmark(
    id="D10",
    title="Training curves, active and random",
    source="figures C.12 to C.15",
    claim="With random queries the policies for different ratios do not greatly differ from each other: they "
    "are near the one that the prior asks for.",
    bar="Drawn.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="Other ratios were drawn first, and only how far apart the policies end was compared. Half of "
    "the episodes leave the posterior mean since (see D6).",
)
