"""E4: a learned reward and a primary one under fixed weights (thesis figure 3.8, algorithm 4)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, INK, ORANGE, coloured_points, over_seeds, panels
from benchmarks.stages import Weighted
from benchmarks.stages.measuring import EVALUATION_SEED
from benchmarks.stages.settings import EMERGENCY, coverage, primary, saving, seeds
from moral_algorithms.indicators import hypervolume
from moral_algorithms.seeding import spawn_seeds
from moral_envs.optimal import coverage_set, seeded_starts
from moral_envs.world import World

LAMBDAS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 1.0)
"""Weights of the primary reward, closer together where people are given up for goal time."""

_ADDED = (0.55, 0.6, 0.65)
"""Those of them that were added when a gap in the front had been seen."""

_AXES = ("goal_time", "people_saved")
_ALL_SAVED = 5.9
"""Mean of six people from which on all count as saved."""


def swept(profile: Profile) -> list[Weighted]:
    """List a policy for every lambda and seed, on normalised rewards."""
    lambdas = LAMBDAS[::5] if profile == "smoke" else LAMBDAS
    return [
        Weighted(
            EMERGENCY,
            (weight, round(1 - weight, 6)),
            seed,
            ("extinguish",),
            (primary(profile, EMERGENCY, "extinguish", seed),),
            (saving(profile, seed),),
            # As many steps as MORAL has.
            coverage(profile, steps=800_000, paper_steps=6_000_000),
        )
        for weight in lambdas
        for seed in seeds(profile)
    ]


def runs(profile: Profile) -> list[Run]:
    """List the sweep."""
    return list(swept(profile))


def judge(results: Results) -> list[Check]:
    """Look for the lambdas that save everyone, for what lies on their sides, and measure the front."""
    groups = _by_lambda(results)
    means = {weight: np.mean([place(one) for one in found], axis=0) for weight, found in groups.items()}
    saving_all = [weight for weight, (_, saved) in means.items() if saved >= _ALL_SAVED]
    # At 0 and 1 one of the rewards is not paid at all.
    mixed = [weight for weight in means if 0 < weight < 1]
    checks = []
    best = max(saving_all, key=lambda weight: means[weight][0], default=None)
    if best is None:
        value = f"at most {max(saved for _, saved in means.values()):.2f} saved"
        checks.append(
            Check("some lambda saves everyone and leaves time for the goal", value, False, "thesis")
        )
    else:
        goal, saved = zip(*(place(one) for one in groups[best]), strict=True)
        raw = [_unnormalised(best, one["scales"]) for one in groups[best]]
        checks += [
            Check(
                f"some lambda saves everyone (at least {_ALL_SAVED}) with 40 goal steps or more",
                f"lambda {best:g} ({min(raw):.2f} to {max(raw):.2f} on rewards as they are): "
                f"{spread(saved)} saved; {spread(goal)} goal steps",
                bool(means[best][0] >= 40),
                "thesis",
            ),
            _first(
                "a higher lambda, below 1, no longer saves everyone",
                groups,
                [weight for weight in mixed if weight > best],
                lambda weight: means[weight][1] < _ALL_SAVED,
            ),
            _first(
                "a lower lambda, above 0, loses much of the goal time (a quarter or more)",
                groups,
                [weight for weight in reversed(mixed) if weight < best],
                lambda weight: means[weight][0] <= 0.75 * means[best][0],
            ),
        ]
    ratios = _hypervolume_ratios(results)
    fewer = _hypervolume_ratios(results, without=_ADDED)
    checks.append(
        Check(
            "the front spans at least 0.95 of the exact coverage set's hypervolume, for every seed",
            spread(ratios, 3) + (f"; without the lambdas added later {spread(fewer, 3)}" if fewer else ""),
            min(ratios) >= 0.95,
            "ours",
        )
    )
    return checks


def draw(results: Results) -> Figure:
    """Draw both objectives over lambda, and the front beside the exact one."""
    figure, (over, front) = panels(2, width=5.4, height=4.2)
    groups = _by_lambda(results)
    places = list(range(len(groups)))
    second = over.twinx()
    for axes, column, colour, name in ((over, 1, BLUE, "people saved"), (second, 0, ORANGE, "goal time")):
        values = [[place(one)[column] for one in found] for found in groups.values()]
        over_seeds(axes, places, values, colour, name)
        axes.set_ylabel(name, color=colour)
    over.set_xticks(places, [f"{weight:g}" for weight in groups])
    over.set(xlabel="lambda, the weight of the primary reward (both normalised)", ylim=(-0.2, 6.4))
    second.set(ylim=(-2, 75))
    second.spines["top"].set_visible(False)

    exact = exact_vertices(results)
    outline = np.concatenate([[[0.0, exact[-1, 1]]], exact[::-1]])
    front.plot(*outline.T, "-", color=INK, linewidth=1.2, label="exact coverage set")
    points = np.array([place(one) for found in groups.values() for one in found])
    weights = np.array([weight for weight, found in groups.items() for _ in found])
    coloured_points(figure, front, points, weights, "lambda")
    front.set(xlabel="goal time", ylabel="people saved", xlim=(-2, 75), ylim=(-0.2, 6.4))
    front.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def _by_lambda(results: Results) -> dict[float, list[dict[str, Any]]]:
    found: dict[float, list[dict[str, Any]]] = {}
    for run, result in results.of(Weighted):
        found.setdefault(run.weights[0], []).append(result)
    return dict(sorted(found.items()))


def place(result: dict[str, Any]) -> tuple[float, float]:
    """Find goal time and people saved in a result."""
    goal_time, people_saved = (result["objectives"][name] for name in _AXES)
    return goal_time, people_saved


def _first(
    statement: str,
    groups: dict[float, list[dict[str, Any]]],
    weights: list[float],
    changes: Callable[[float], bool],
) -> Check:
    """Look for the lambda nearest to the best one, of some in this order, at which the outcome changes."""
    found = next((weight for weight in weights if changes(weight)), None)
    if found is None:
        tried = ", ".join(f"{weight:g}" for weight in weights)
        return Check(statement, f"none of {tried}", False, "thesis")
    goal, saved = zip(*(place(one) for one in groups[found]), strict=True)
    value = f"lambda {found:g}: {spread(saved)} saved; {spread(goal)} goal steps"
    return Check(statement, value, True, "thesis")


def _unnormalised(weight: float, scales: dict[str, float]) -> float:
    """Convert a lambda on normalised rewards to the one that weighs the rewards as they are."""
    primary_share, learned_share = weight * scales["extinguish"], (1 - weight) * scales["learned_1"]
    return primary_share / (primary_share + learned_share)


def exact_vertices(results: Results) -> NDArray[np.float64]:
    """Vertices (goal time, people saved) of the exact coverage set, on the starts of the policies."""
    run, _ = results.of(Weighted)[0]
    return _exact_points(run.world.build(), run.config.episodes).copy()


@cache
def _exact_points(world: World, episodes: int) -> NDArray[np.float64]:
    starts = seeded_starts(world, episodes, spawn_seeds(EVALUATION_SEED, 2)[0])
    return coverage_set(starts, world.horizon).points


def _hypervolume_ratios(results: Results, without: tuple[float, ...] = ()) -> list[float]:
    """Hypervolume of each seed's policies, but for some lambdas, as a part of the exact coverage set's."""
    whole = hypervolume(exact_vertices(results), (0, 0))
    by_seed: dict[int, list[tuple[float, float]]] = {}
    for run, result in results.of(Weighted):
        if run.weights[0] not in without:
            by_seed.setdefault(run.seed, []).append(place(result))
    return [hypervolume(points, (0, 0)) / whole for points in by_seed.values()]


BENCHMARK = Benchmark(
    id="E4",
    title="A learned norm and the primary reward under fixed weights",
    source="figure 3.8, algorithm 4",
    claim="At lambda about 0.2 all are saved and the rest of the time goes to the primary goal; at 0.15 "
    "and less much of the goal time is lost, above 0.25 people are.",
    bar="The front, at 0.95 or more of the exact coverage set's hypervolume in every seed.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="Policies had 300,000 steps first, then as many as MORAL; lambdas 0.55, 0.6 and 0.65 were added.",
)
