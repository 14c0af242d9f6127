"""D10: training for single ratios, with active and with random queries (thesis figures C.12 to C.15)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.rows.d8 import study_runs
from benchmarks.rows.drawing import BLUE, GREEN, ORANGE, RED, curves, panels
from benchmarks.rows.ratios import COLLECTED
from benchmarks.stages import Asked

_SHOWN = 4
_COLOURS = {"delivered": ORANGE, "helped": BLUE, "cleaned": GREEN, "vases_broken": RED}


def runs(profile: Profile) -> list[Run]:
    """List the first ratios of the study of queries, 25 of them, active and random."""
    queries = 10 if profile == "smoke" else 25
    active, random = study_runs(profile, queries), study_runs(profile, queries, acquisition="random")
    return [*active[:_SHOWN], *random[:_SHOWN]]


def judge(results: Results) -> list[Check]:
    """Compare how far apart the policies of different ratios end."""
    spans = {}
    for acquisition, found in _by_asking(results).items():
        shares = np.array([[one["objectives"][name] for name in COLLECTED] for _, one in found])
        shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1e-9)
        spans[acquisition] = float(shares.std(axis=0).mean())
    if len(spans) < 2:
        return []
    value = f"{spans['active']:.3f} against {spans['random']:.3f} (standard deviation of the shares)"
    statement = "policies for different ratios differ more with active queries than with random ones"
    return [Check(statement, value, spans["active"] > spans["random"], "thesis")]


def draw(results: Results) -> Figure:
    """Draw the counters during training, active above random."""
    by_asking = _by_asking(results)
    figure, axes = panels(_SHOWN, rows=2, width=3.6, height=3.0)
    for row, (asking, found) in enumerate(by_asking.items()):
        for column, (run, result) in enumerate(found):
            one = axes[row * _SHOWN + column]
            for name, colour in _COLOURS.items():
                curves(one, [result["curve"]], name, colour, name.replace("_", " "))
            ratio = ":".join(f"{share:g}" for share in run.teacher.ratio.values())
            one.set(title=f"{asking}, {ratio}", ylim=(0, 13))
    axes[0].set_ylabel("per episode")
    axes[0].legend(frameon=False, fontsize=8)
    return figure


def _by_asking(results: Results) -> dict[str, list[tuple[Asked, dict[str, Any]]]]:
    found: dict[str, list[tuple[Asked, dict[str, Any]]]] = {}
    for run, result in results.of(Asked):
        asking = "random" if run.config.acquisition == "random" else "active"
        found.setdefault(asking, []).append((run, result))
    return found


BENCHMARK = Benchmark(
    id="D10",
    title="Training curves, active and random",
    source="figures C.12 to C.15",
    claim="With random queries the policies for different ratios do not greatly differ from each other.",
    bar="Drawn.",
    runs=runs,
    judge=judge,
    draw=draw,
)
