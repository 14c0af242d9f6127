"""E6: active against random queries, the primary reward as it is and ten times larger (thesis figure 4.4)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, ORANGE, panels
from benchmarks.rows.e8 import moral
from benchmarks.stages import Aligned
from benchmarks.stages.settings import seeds
from moral_algorithms.plotting import THESIS

_SCALES = (1.0, 10.0)

Found = dict[tuple[str, float], list[dict[str, Any]]]


def runs(profile: Profile) -> list[Run]:
    """List both ways of asking on both scales."""
    found: list[Run] = []
    for seed in seeds(profile, 5):
        plain = moral(profile, seed)
        for config in (plain.config, replace(plain.config, acquisition="random")):
            found += [replace(plain, config=config, primary_scale=scale) for scale in _SCALES]
    return found


def judge(results: Results) -> list[Check]:
    """Compare what the scale costs with both ways of asking."""
    found = _sorted(results)
    checks = []
    if len(found) == 4:
        active, random = (np.mean(utilities(found[asking, 1.0])) for asking in _ASKING)
        checks.append(
            Check(
                "on the usual scale both ways of asking do alike, to within 0.02 of what the teacher wants",
                f"active {active:.3f}, random {random:.3f}",
                bool(abs(active - random) <= 0.02),
                "thesis",
            )
        )
        losses = {
            asking: float(np.mean(utilities(found[asking, 1.0])) - np.mean(utilities(found[asking, 10.0])))
            for asking in _ASKING
        }
        checks.append(
            Check(
                "the larger primary reward costs random queries more than active ones",
                f"{losses['random']:.3f} against {losses['active']:.3f} of what the teacher wants",
                losses["random"] > losses["active"],
                "thesis",
            )
        )
    for (asking, scale), group in found.items():
        if asking == "active":
            saved = [one["objectives"]["people_saved"] for one in group]
            goal = [one["objectives"]["goal_time"] for one in group]
            checks.append(
                Check(
                    f"active queries do as well as the thesis's, primary reward times {scale:g}: 5.76 and "
                    "40.08",
                    f"{spread(saved)} saved; {spread(goal)} goal steps",
                    bool(
                        np.mean(saved) >= THESIS["MORAL"]["people_saved"]
                        and np.mean(goal) >= THESIS["MORAL"]["goal_time"]
                    ),
                    "ours",
                )
            )
    return checks


def draw(results: Results) -> Figure:
    """Draw both objectives for the four settings."""
    figure, axes = panels(2)
    found = _sorted(results)
    for one, objective in zip(axes, ("people_saved", "goal_time"), strict=True):
        for (asking, scale), group in found.items():
            values = [result["objectives"][objective] for result in group]
            place = _SCALES.index(scale) + (0.2 if asking == "random" else -0.2)
            colour = ORANGE if asking == "random" else BLUE
            label = asking if scale == _SCALES[0] else None
            one.bar(
                place,
                np.mean(values),
                0.36,
                yerr=np.std(values),
                color=colour,
                alpha=0.8,
                label=label,
                capsize=3,
            )
            one.plot([place] * len(values), values, ".", color="black", markersize=4)
        one.set_xticks(range(len(_SCALES)), [f"primary reward times {scale:g}" for scale in _SCALES])
        one.set_ylabel(objective.replace("_", " "))
    axes[0].legend(frameon=False, title="queries")
    return figure


_ASKING = ("active", "random")


def _sorted(results: Results) -> Found:
    found: Found = {}
    for run, result in results.of(Aligned):
        asking = "random" if run.config.acquisition == "random" else "active"
        found.setdefault((asking, run.primary_scale), []).append(result)
    return found


def utilities(group: list[dict[str, Any]]) -> list[float]:
    """Put what the teacher wants into one number: all people count six times as much as all goal time."""
    objectives = [one["objectives"] for one in group]
    return [(one["people_saved"] + one["goal_time"] / 59.3) / 7 for one in objectives]


BENCHMARK = Benchmark(
    id="E6",
    title="Active against random queries",
    source="figure 4.4",
    claim="On the usual scale both ways of asking do alike; random queries are more sensitive to a primary "
    "reward that is ten times larger.",
    bar="The same comparison, active queries ending no worse than the thesis's MORAL saves and spends.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="MORAL's likelihood expects a tenth of the answers to be random now, as was chosen for E7. With "
    "three seeds, one lost people then under active queries and the larger reward; two more were added.",
)
