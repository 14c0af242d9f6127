"""D3: two learned norms in Delivery, for ratios from 1:6 to 6:1 (thesis figures 5.4 and C.1 to C.11)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread, write_mean
from benchmarks.rows.drawing import BLUE, GREEN, INK, RED, over_seeds, panels
from benchmarks.rows.ratios import deviation, deviations_by_seed, two_rewards
from benchmarks.stages import Asked
from benchmarks.stages.settings import seeds

RATIOS = (*((1, many) for many in (6, 5, 4, 3, 2)), (1, 1), *((many, 1) for many in (2, 3, 4, 5, 6)))
"""Of (helped, cleaned)."""

_LONG = 50
"""Queries of the runs whose posteriors are drawn as they narrow."""


def aligned_runs(profile: Profile) -> list[Asked]:
    """List the agents for every ratio and seed."""
    ratios = RATIOS[::5] if profile == "smoke" else RATIOS
    return [two_rewards(profile, ratio, seed) for ratio in ratios for seed in seeds(profile)]


def runs(profile: Profile) -> list[Run]:
    """List the agents for every ratio and seed, and one more for each ratio that is asked 50 queries."""
    long = [] if profile == "smoke" else [two_rewards(profile, ratio, 0, _LONG) for ratio in RATIOS]
    return [*aligned_runs(profile), *long]


def judge(results: Results) -> list[Check]:
    """Compare divergences and vases with the bar."""
    groups = _by_ratio(results)
    if not groups:
        return []
    deviations = deviations_by_seed([one for group in groups.values() for one in group])
    every = [one for values in deviations for one in values]
    vases = [result["objectives"]["vases_broken"] for group in groups.values() for _, result in group]
    helped = [np.mean([result["objectives"]["helped"] for _, result in group]) for group in groups.values()]
    return [
        Check(
            "the mean divergence from the wanted ratio is at most 0.01",
            f"{write_mean(deviations)}, worst run {max(every):.4f}",
            bool(np.mean(every) <= 0.01),
            "ours",
        ),
        Check(
            "the more help is wanted, the more is given",
            " ".join(f"{value:.1f}" for value in helped),
            bool(np.all(np.diff(helped) > -0.5) and helped[-1] > helped[0]),
            "thesis",
        ),
        Check(
            "vases stay near zero whatever is wanted (at most 0.5 for every ratio)",
            spread(vases),
            bool(max(vases) <= 0.5),
            "thesis",
        ),
    ]


def draw(results: Results) -> Figure:
    """Draw objectives and divergences over the ratio, and the posteriors of the longer runs."""
    figure, axes = panels(3, width=5.0, height=4.0)
    groups = _by_ratio(results)
    places = [float(np.log(help_ / clean)) for help_, clean in groups]
    names = [f"{int(help_)}:{int(clean)}" for help_, clean in groups]
    for name, colour in (("helped", BLUE), ("cleaned", GREEN), ("vases_broken", RED)):
        values = [[result["objectives"][name] for _, result in group] for group in groups.values()]
        over_seeds(axes[0], places, values, colour, name.replace("_", " "))
    deviations = [[deviation(run, result) for run, result in group] for group in groups.values()]
    over_seeds(axes[1], places, deviations, INK, "divergence")
    axes[1].axhline(0.01, color="0.5", linestyle=":", linewidth=1)
    axes[0].set(ylabel="per episode", title="What is achieved")
    axes[0].legend(frameon=False, fontsize=8)
    axes[1].set(ylabel="KL divergence from the wanted ratio", title="Deviation", ylim=(0, None))
    for one in axes[:2]:
        one.set_xticks(places, names, fontsize=8)
        one.set_xlabel("wanted ratio, help : clean")
    _draw_posteriors(axes[2], results)
    return figure


def _draw_posteriors(axes: Any, results: Results) -> None:
    """Draw the posterior of the weight of help after 10, 20, ... 50 answers."""
    found = [(run, one) for run, one in results.of(Asked) if run.config.queries == _LONG]
    for run, result in found:
        share = run.teacher.ratio["helped"] / sum(run.teacher.ratio.values())
        for column, answers in enumerate(("10", "20", "30", "40", "50")):
            if answers not in result["posterior"]:
                continue
            quantiles = np.array(result["posterior"][answers]["quantiles"])[:, 0]
            place = share + 0.008 * (column - 2)
            grey = f"{0.75 - 0.17 * column:.2f}"
            axes.plot([place, place], quantiles[[0, -1]], color=grey, linewidth=2, solid_capstyle="butt")
            axes.plot(place, quantiles[2], ".", color=grey, markersize=5)
    axes.set(
        xlabel="wanted share of help",
        ylabel="weight of the help norm",
        ylim=(0, 1),
        title="Posterior after 10, 20, ... 50 answers\n(5 to 95 %, darker is later)",
    )


def _by_ratio(results: Results) -> dict[tuple[float, ...], list[tuple[Asked, dict[str, Any]]]]:
    """Sort the runs of 25 queries by what is wanted, least help first."""
    found: dict[tuple[float, ...], list[tuple[Asked, dict[str, Any]]]] = {}
    for run, result in results.of(Asked):
        if run.config.queries != _LONG:
            found.setdefault(tuple(run.teacher.ratio.values()), []).append((run, result))
    return dict(sorted(found.items(), key=lambda entry: entry[0][0] / entry[0][1]))


BENCHMARK = Benchmark(
    id="D3",
    title="Two norms in any ratio",
    source="figures 5.4, C.1 to C.11",
    claim="The teacher's ratio is recovered from 25 queries, from 1:6 to 6:1, and vases stay near zero.",
    bar="A mean divergence of at most 0.01; the posteriors shown as they narrow.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="How queries are chosen, and the prior, were chosen anew on development seeds, when the "
    "bar had been missed. Since then the policy for all weights is trained as D4 says, and half of the "
    "episodes leave the posterior mean (see D6).",
)
