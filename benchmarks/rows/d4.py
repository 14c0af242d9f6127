"""D4: coverage sets of MORAL and of PPO on the true rewards (thesis figure 5.5)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import trapezoid  # type: ignore[import-untyped]

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.d3 import aligned_runs
from benchmarks.rows.drawing import panels
from benchmarks.stages import Asked, Weighted
from benchmarks.stages.settings import DELIVERY, delivery_coverage, seeds
from moral_algorithms.indicators import convex_coverage, hypervolume

_LAMBDAS = tuple(round(0.1 * tenths, 1) for tenths in range(11))
"""As many as there are ratios: a set of more policies spans more."""

_COUNTERS = ("helped", "cleaned", "vases_broken")


_TRUE = ("clean", "help")
"""Components of PPO's reward, as in the thesis."""
_SPARING = (*_TRUE, "vase")
"""The same and what both experts are paid for, which they weigh like their errand."""


def runs(profile: Profile) -> list[Run]:
    """List MORAL for every ratio and seed, and PPO for every lambda and seed, without and with vases."""
    lambdas = _LAMBDAS[::5] if profile == "smoke" else _LAMBDAS
    ppo = [
        Weighted(
            DELIVERY,
            (weight, round(1 - weight, 6), *(1.0 for _ in components[2:])),
            seed,
            components,
            config=delivery_coverage(profile),
        )
        for components in (_TRUE, _SPARING)
        for weight in lambdas
        for seed in seeds(profile)
    ]
    return [*aligned_runs(profile), *ppo]


class CoverageSet(NamedTuple):
    """What the policies of one method and seed achieve."""

    collected: NDArray[np.float64]
    """Mean (helped, cleaned) of each policy, shape (n, 2)."""
    vases: NDArray[np.float64]
    """Vases that each breaks on average, shape (n,)."""


class Comparison(NamedTuple):
    """The coverage sets of all methods, by seed."""

    moral: dict[int, CoverageSet]
    """MORAL on learned rewards."""
    ppo: dict[int, CoverageSet]
    """PPO on the true rewards of help and cleaning."""
    sparing: dict[int, CoverageSet]
    """PPO that also pays for the vases it breaks, as the experts do."""


def judge(results: Results) -> list[Check]:
    """Compare what the methods span, and what they break."""
    found = coverage_sets(results)
    both = sorted(found.moral.keys() & found.ppo.keys())
    checks = compare([found.moral[seed] for seed in both], [found.ppo[seed] for seed in both]) if both else []
    all_three = [seed for seed in both if seed in found.sparing]
    if all_three:
        price = [_volume(found.sparing[seed]) / _volume(found.ppo[seed]) for seed in all_three]
        ratios = [_volume(found.moral[seed]) / _volume(found.sparing[seed]) for seed in all_three]
        checks.append(
            Check(
                "MORAL spans at least 0.95 of the hypervolume of PPO that pays for vases as the experts do",
                f"{spread(ratios, 3)}; that PPO spans {np.mean(price):.3f} of the one that pays for none",
                bool(np.mean(ratios) >= 0.95),
                "ours",
            )
        )
    if both:
        areas = [mixed_area(found.moral[seed]) / mixed_area(found.ppo[seed]) for seed in both]
        checks.append(
            Check(
                "with mixtures of policies, for which it does not matter where on its front a set's policies "
                "lie: MORAL spans at least 0.95 of the area that PPO on the true rewards does",
                spread(areas, 3),
                bool(np.mean(areas) >= 0.95),
                "ours",
            )
        )
    return checks


def compare(moral: list[CoverageSet], ppo: list[CoverageSet]) -> list[Check]:
    """Compare coverage sets of MORAL and of PPO that does not pay for vases, seed by seed."""
    ratios = [_volume(ours) / _volume(true) for ours, true in zip(moral, ppo, strict=True)]
    broken, allowed = ([float(one.vases.mean()) for one in coverage_sets] for coverage_sets in (moral, ppo))
    return [
        Check(
            "MORAL spans at least 0.95 of the hypervolume of PPO on the true rewards, in the mean",
            spread(ratios, 3),
            bool(np.mean(ratios) >= 0.95),
            "ours",
        ),
        Check(
            "MORAL breaks far fewer vases (less than half)",
            f"{spread(broken)} against {spread(allowed)}",
            bool(np.mean(broken) < 0.5 * np.mean(allowed)),
            "thesis",
        ),
    ]


def coverage_sets(results: Results) -> Comparison:
    """Sort the policies by method and seed."""
    moral = [(run.seed, result) for run, result in results.of(Asked)]
    ppo = [(run.seed, result) for run, result in results.of(Weighted) if run.primary == _TRUE]
    sparing = [(run.seed, result) for run, result in results.of(Weighted) if run.primary == _SPARING]
    return Comparison(*(_by_seed(found) for found in (moral, ppo, sparing)))


def _by_seed(found: list[tuple[int, dict[str, Any]]]) -> dict[int, CoverageSet]:
    rows: dict[int, list[list[float]]] = {}
    for seed, result in found:
        rows.setdefault(seed, []).append([result["objectives"][name] for name in _COUNTERS])
    policies = {seed: np.array(achieved) for seed, achieved in rows.items()}
    return {seed: CoverageSet(row[:, :2], row[:, 2]) for seed, row in policies.items()}


def _volume(one: CoverageSet) -> float:
    return hypervolume(one.collected, (0, 0))


def mixed_area(one: CoverageSet) -> float:
    """Hypervolume of all mixtures of a set's policies: the area under its convex coverage set."""
    edge = one.collected[convex_coverage(one.collected)]
    x, y = edge[np.argsort(edge[:, 0])].T
    # The best policy of either objective is as good as any that does less of the other.
    return float(trapezoid(np.r_[y[0], y], np.r_[0.0, x]))


def draw(results: Results) -> Figure:
    """Draw the policies of all methods, coloured by vases, and each seed's convex coverage set."""
    figure, axes = panels(3, width=4.4, height=4.2)
    found = coverage_sets(results)
    titles = (
        "MORAL, learned rewards",
        "PPO, true rewards of help and cleaning",
        "PPO, true rewards with the price of vases",
    )
    drawn = [one for by_seed in found for one in by_seed.values()]
    most = max((one.vases.max() for one in drawn), default=1.0)
    reach = max((one.collected.max() for one in drawn), default=1.0)
    for one, title, by_seed in zip(axes, titles, found, strict=True):
        _draw_sets(one, list(by_seed.values()), most)
        one.set(xlabel="helped", ylabel="cleaned", title=title, xlim=(0, reach + 0.5), ylim=(0, reach + 0.5))
    figure.colorbar(axes[-1].collections[0], ax=axes, label="vases broken", pad=0.01)
    return figure


def _draw_sets(axes: Axes, found: list[CoverageSet], most: float) -> None:
    for one in found:
        edge = one.collected[convex_coverage(one.collected)]
        axes.plot(*edge[np.argsort(edge[:, 0])].T, "-", color="0.75", linewidth=1, zorder=1)
    rows = [np.column_stack([one.collected, one.vases]) for one in found]
    x, y, vases = np.concatenate([*rows, np.empty((0, 3))]).T
    axes.scatter(x, y, c=vases, s=36, cmap="plasma", vmin=0, vmax=most, edgecolors="white", linewidths=0.5)


BENCHMARK = Benchmark(
    id="D4",
    title="Coverage sets of MORAL and of PPO on the true rewards",
    source="figure 5.5",
    claim="MORAL's coverage set has the shape of PPO's and a slightly smaller volume, and breaks far fewer "
    "vases.",
    bar="MORAL spans 0.95 or more of PPO's hypervolume over (helped, cleaned).",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="As for D3; then PPO that pays for vases was added, to tell their price from what is lost "
    "otherwise. When the bar had still been missed, the policy for all weights was given larger steps, and "
    "as many as PPO's eleven policies together; theirs were made as large. The area of mixtures "
    "came last: eleven ratios put fewer policies in the middle of the front than eleven lambdas do.",
)
