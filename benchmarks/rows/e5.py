"""E5: MORAL's way across the coverage set during 25 queries (thesis figure 4.3)."""

from __future__ import annotations

from typing import Any, NamedTuple

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
from moral_algorithms.indicators import convex_coverage

_TOLERANCE = 0.02
"""Share of the range of goal time by which a policy may fall short of the front and count as on it."""

_NEARLY_ALL = 5.0
"""People saved, of six."""


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
    ways = [_way(one) for one in found]
    checks = [
        Check(
            f"every seed ends on or above the swept front: it lacks at most {_TOLERANCE:.0%} of the range of "
            "goal time of what a mixture of those policies spends that saves as many",
            spread(beyond, 3) + " (share of the range by which it is above)",
            min(beyond) >= -_TOLERANCE,
            "ours",
        ),
        Check(
            f"it first comes to save people: {_NEARLY_ALL:g} before half of its final goal time",
            _write([way.goal_before for way in ways], [way.goal_at_end for way in ways]),
            all(way.goal_before < way.goal_at_end / 2 for way in ways),
            "thesis",
        ),
    ]
    arrived = [way for way in ways if way.goal_on_arrival is not None]
    if arrived:
        starts = [way.goal_on_arrival or 0.0 for way in arrived]
        checks.append(
            Check(
                "from then on it moves along the front: goal time rises, and people stay saved",
                f"{_write(starts, [way.goal_at_end for way in arrived])}, "
                f"{spread([way.saved_at_end for way in arrived])} saved at the end",
                all(
                    way.goal_at_end > start and way.saved_at_end >= _NEARLY_ALL
                    for way, start in zip(arrived, starts, strict=True)
                ),
                "thesis",
            )
        )
    return checks


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
    """How much more goal time a policy spends than the best mixture of others that saves as many.

    Negative where it spends less; as a share of the range of the others' goal time.
    """
    hull = front[convex_coverage(front)]
    goal, saved = hull[np.argsort(hull[:, 1])].T
    spent, rescued = point
    # Who saves more than any of them is compared with who saves most.
    return float((spent - np.interp(rescued, saved, goal)) / max(np.ptp(front[:, 0]), 1.0))


class _Way(NamedTuple):
    """What a seed's episodes show during training."""

    goal_before: float
    """Most goal time before nearly everyone was saved for the first time."""
    goal_on_arrival: float | None
    """Goal time at that moment; None if it never came."""
    goal_at_end: float
    saved_at_end: float


def _way(result: dict[str, Any]) -> _Way:
    path = [one["objectives"] for one in result["path"] if one["objectives"]]
    saves = next((step for step, one in enumerate(path) if one["people_saved"] >= _NEARLY_ALL), len(path))
    before = max((one["goal_time"] for one in path[:saves]), default=0.0)
    return _Way(before, path[saves]["goal_time"] if saves < len(path) else None, *place(result))


def _write(before: list[float], after: list[float]) -> str:
    """Write goal times of the seeds before and after."""
    pairs = zip(before, after, strict=True)
    return "; ".join(f"{first:.0f} of {last:.0f}" for first, last in pairs) + " goal steps"


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
    changed="How the end is compared with the front and what counts as saving people first were defined "
    "anew: the first definitions could hardly fail. MORAL's likelihood expected no random answers first (see "
    "E7).",
)
