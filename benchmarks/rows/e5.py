"""E5: MORAL's way across the coverage set during 25 queries (thesis figure 4.3)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import CYCLE, INK, panels
from benchmarks.rows.e4 import exact_vertices, place, swept
from benchmarks.rows.e8 import moral
from benchmarks.stages import Aligned, Weighted
from benchmarks.stages.settings import seeds

_TOLERANCE = 0.02
"""By how much of each objective's range a point may lie below the front and count as on it."""


def runs(profile: Profile) -> list[Run]:
    """List MORAL with three seeds, and the sweep over fixed weights."""
    return [*(moral(profile, seed) for seed in seeds(profile)), *swept(profile)]


def judge(results: Results) -> list[Check]:
    """See where MORAL ends, and on which way."""
    front = _swept_points(results)
    found = [result for _, result in results.of(Aligned)]
    if not len(front) or not found:
        return []
    beyond = [_beyond(np.array(place(one)), front) for one in found]
    saved_first = [_saves_first(one) for one in found]
    return [
        Check(
            f"every seed ends on or above the swept front, to within {_TOLERANCE:.0%} of the ranges",
            spread(beyond, 3) + " (share of the ranges above it)",
            min(beyond) >= -_TOLERANCE,
            "ours",
        ),
        Check(
            "it first comes to save people, then moves along the front to more goal time",
            f"{sum(saved_first)} of {len(saved_first)} seeds",
            all(saved_first),
            "thesis",
        ),
    ]


def draw(results: Results) -> Figure:
    """Draw the way of each seed, a point for every query, beside the swept front and the exact one."""
    figure, (axes,) = panels(1, width=7.0, height=5.0)
    front = _swept_points(results)
    if len(front):
        axes.plot(*exact_vertices(results).T, "-", color=INK, linewidth=1, label="exact coverage set")
        axes.plot(*front.T, "D", color="0.6", markersize=4, label="fixed weights")
    for (run, result), colour in zip(results.of(Aligned), CYCLE, strict=False):
        steps = [one["objectives"] for one in result["path"] if one["objectives"]]
        points = np.array([(one["goal_time"], one["people_saved"]) for one in steps]).reshape(-1, 2)
        axes.plot(
            *points.T, "-o", color=colour, markersize=3.5, linewidth=0.8, label=f"MORAL, seed {run.seed}"
        )
        axes.plot(*place(result), "*", color=colour, markersize=15, markeredgecolor="white", zorder=5)
    axes.set(xlabel="goal time", ylabel="people saved", xlim=(-2, 75), ylim=(-0.2, 6.5))
    axes.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def _swept_points(results: Results) -> NDArray[np.float64]:
    """Place of every policy under fixed weights, shape (n, 2)."""
    return np.array([place(result) for _, result in results.of(Weighted)]).reshape(-1, 2)


def _beyond(point: NDArray[np.float64], front: NDArray[np.float64]) -> float:
    """How far a point lies above the convex front of others, in parts of the objectives' ranges.

    The least, over scalarisation weights, of the amount by which it scores more than the best of them.
    """
    ranges = np.ptp(front, axis=0)
    ranges[ranges == 0] = 1.0
    shares = np.linspace(0, 1, 201)
    weights = np.stack([shares, 1 - shares])
    return float(np.max((point / ranges) @ weights - ((front / ranges) @ weights).max(axis=0)))


def _saves_first(result: dict[str, Any]) -> bool:
    """Whether nearly everyone is saved before half of the final goal time is reached."""
    path = [one["objectives"] for one in result["path"] if one["objectives"]]
    saves = next((place_ for place_, one in enumerate(path) if one["people_saved"] >= 5), len(path))
    waits = next(
        (
            place_
            for place_, one in enumerate(path)
            if one["people_saved"] >= 5 and one["goal_time"] >= 0.9 * result["objectives"]["goal_time"]
        ),
        len(path),
    )
    return saves < waits


BENCHMARK = Benchmark(
    id="E5",
    title="MORAL's way across the coverage set",
    source="figure 4.3",
    claim="MORAL first maximises the number of people saved and then moves along the coverage set to match "
    "the preferences.",
    bar="The way, ending at or above the front of fixed weights.",
    runs=runs,
    judge=judge,
    draw=draw,
)
