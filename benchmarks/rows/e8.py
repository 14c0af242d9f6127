"""E8: MORAL and DRLHP in Emergency (thesis table 4.1, figure 4.7), and whoever else wants to compete.

A contender is a function of profile and seed that makes a run. The run's result holds ``objectives`` (mean
counters by name), ``env_steps`` and ``seconds`` (all that it took, what it needed included), ``preferences``
and, if it is to be drawn, ``curve`` (lists ``env_steps``, ``people_saved`` and ``goal_time``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run, Workspace
from benchmarks.harness.statistics import exceeds, spread
from benchmarks.rows.drawing import CYCLE, INK, THESIS_MARK, curves, panels
from benchmarks.stages import Aligned, FromPreferences
from benchmarks.stages.settings import (
    EMERGENCY,
    SAVE_FIRST,
    drlhp,
    emergency_moral,
    episodes,
    primary,
    saving,
    seeds,
)
from moral_algorithms.plotting import THESIS
from moral_envs.emergency_v0 import vector_env
from moral_envs.optimal import coverage_set

_SEEDS = 5
_FEWER = (100, 25)


@dataclass(frozen=True)
class Contender(Run):
    """Brings a run of this package into the form in which contenders are compared."""

    name: str
    """What it is called."""
    seed: int
    """Which of several."""
    run: Aligned | FromPreferences
    """What is compared."""

    def needs(self) -> tuple[Run, ...]:
        """Name the run, and the stages before it."""
        return (self.run, *_stages(self.run))

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Add up what the stages took."""
        found = workspace.result_of(self.run)
        stages = [found, *(workspace.result_of(stage) for stage in _stages(self.run))]
        return {
            "objectives": found["objectives"],
            "optimum": found["optimum"],
            "env_steps": sum(stage["env_steps"] for stage in stages),
            "seconds": round(sum(stage["seconds"] for stage in stages), 1),
            # DRLHP counts its answers: a teacher may skip queries.
            "preferences": found.get("answers", self.run.config.queries),
            "before": sum(stage["env_steps"] for stage in stages[1:]),
            "curve": found["curve"],
        }


def _stages(run: Aligned | FromPreferences) -> tuple[Run, ...]:
    if isinstance(run, FromPreferences):
        return ()
    return (*(norm.expert for norm in run.norms), *run.norms, *run.primary)


def moral(profile: Profile, seed: int, queries: int = 25) -> Aligned:
    """MORAL as the demo trains it."""
    return Aligned(
        norms=(saving(profile, seed),),
        primary=(primary(profile, EMERGENCY, "extinguish", seed),),
        teacher=SAVE_FIRST,
        seed=seed,
        config=emergency_moral(profile, queries),
        episodes=episodes(profile),
    )


def from_preferences(profile: Profile, seed: int, queries: int = 1000) -> FromPreferences:
    """DRLHP with so many preferences."""
    config = drlhp(profile, EMERGENCY, queries)
    return FromPreferences(EMERGENCY, SAVE_FIRST, seed, config, episodes=episodes(profile))


CONTENDERS: dict[str, Callable[[Profile, int], Run]] = {
    "MORAL": lambda profile, seed: Contender("MORAL", seed, moral(profile, seed)),
    "DRLHP": lambda profile, seed: Contender("DRLHP", seed, from_preferences(profile, seed)),
}
"""Who is compared, by name, with five seeds each. A learner of your own is added here."""


def runs(profile: Profile) -> list[Run]:
    """List every contender with every seed, and DRLHP with fewer preferences."""
    found = [make(profile, seed) for make in CONTENDERS.values() for seed in seeds(profile, _SEEDS)]
    found += [
        Contender(f"DRLHP, {queries} preferences", seed, from_preferences(profile, seed, queries))
        for queries in _FEWER
        for seed in seeds(profile)
    ]
    return found


def judge(results: Results) -> list[Check]:
    """Compare with the thesis's figures and our bar."""
    found = _by_name(results)
    checks = []
    if "MORAL" in found:
        saved, goal = _values(found["MORAL"], "people_saved"), _values(found["MORAL"], "goal_time")
        both = f"{spread(saved)} saved; {spread(goal)} goal steps"
        thesis = THESIS["MORAL"]
        checks += [
            Check(
                "MORAL saves as many and spends as many goal steps as the thesis reports, 5.76 and 40.08",
                both,
                bool(np.mean(saved) >= thesis["people_saved"] and np.mean(goal) >= thesis["goal_time"]),
                "thesis",
            ),
            Check(
                "MORAL: at least 5.95 and 55 in the mean, no seed under 5.85 and 50",
                both,
                bool(
                    np.mean(saved) >= 5.95 and np.mean(goal) >= 55 and min(saved) >= 5.85 and min(goal) >= 50
                ),
                "ours",
            ),
        ]
    if "DRLHP" in found:
        saved, goal = _values(found["DRLHP"], "people_saved"), _values(found["DRLHP"], "goal_time")
        steps = [one["env_steps"] for one in found["DRLHP"]]
        checks.append(
            Check(
                "DRLHP with 1,000 preferences: as good as the thesis reports, 5.62 and 12.32, in at most 12 "
                "million environment steps",
                f"{spread(saved)} saved; {spread(goal)} goal steps; {max(steps) / 1e6:.2f} million steps",
                bool(
                    np.mean(saved) >= THESIS["DRLHP"]["people_saved"]
                    and np.mean(goal) >= THESIS["DRLHP"]["goal_time"]
                    and max(steps) <= 12_000_000
                ),
                "ours",
            )
        )
    if {"MORAL", "DRLHP"} <= found.keys():
        ours, theirs = (_values(found[name], "goal_time") for name in ("MORAL", "DRLHP"))
        checks.append(
            Check(
                "MORAL ends at more goal time than DRLHP with forty times its preferences, by more than two "
                "standard errors",
                f"{spread(ours)} against {spread(theirs)}; in the median {np.median(ours):.2f} against "
                f"{np.median(theirs):.2f}",
                exceeds(ours, theirs),
                "thesis",
            )
        )
    few = "DRLHP, 25 preferences"
    if {"MORAL", few} <= found.keys():
        ours, theirs = (_values(found[name], "people_saved") for name in ("MORAL", few))
        checks.append(
            Check(
                "MORAL saves more people than DRLHP with as many preferences, by more than two standard "
                "errors",
                f"{spread(ours)} against {spread(theirs)}",
                exceeds(ours, theirs),
                "ours",
            )
        )
    return checks


def draw(results: Results) -> Figure:
    """Draw final objectives of all contenders beside the exact coverage set, and the training curves."""
    figure, (front, saved, goal) = panels(3, width=5.2, height=4.2)
    starts, _ = vector_env(200).reset(seed=0)
    front.plot(
        *coverage_set(starts, 75).points.T, "-", color="0.6", linewidth=1.2, label="exact coverage set"
    )
    for (name, found), colour in zip(_by_name(results).items(), CYCLE, strict=False):
        points = np.array(
            [(one["objectives"]["goal_time"], one["objectives"]["people_saved"]) for one in found]
        )
        front.plot(*points.T, "o", color=colour, markersize=5, alpha=0.8, label=name)
        drawn = [one for one in found if one.get("curve")]
        if drawn:
            before = float(np.mean([one.get("before", 0) for one in drawn]))
            for axes, objective in ((saved, "people_saved"), (goal, "goal_time")):
                curves(axes, [one["curve"] for one in drawn], objective, colour, name, before)
    for name, figures in THESIS.items():
        front.plot(figures["goal_time"], figures["people_saved"], **THESIS_MARK)
        front.annotate(
            f"{name},\nthesis",
            (figures["goal_time"], figures["people_saved"]),
            (6, -16),
            textcoords="offset points",
            fontsize=8,
            color=INK,
        )
    front.set(xlabel="goal time", ylabel="people saved", ylim=(0, 6.4), title="Final policies, every seed")
    saved.set(ylabel="people saved", title="Training, steps of all stages")
    goal.set(ylabel="goal time", title="Training, steps of all stages")
    front.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def _by_name(results: Results) -> dict[str, list[dict[str, Any]]]:
    """Sort results by contender; what a module of a user's has added goes by its class."""
    found: dict[str, list[dict[str, Any]]] = {}
    for run, result in results.of(Run):
        name = run.name if isinstance(run, Contender) else run.kind
        found.setdefault(name, []).append(result)
    return found


def _values(found: list[dict[str, Any]], objective: str) -> list[float]:
    return [one["objectives"][objective] for one in found]


BENCHMARK = Benchmark(
    id="E8",
    title="MORAL against DRLHP in Emergency",
    source="table 4.1, figure 4.7",
    claim="MORAL saves 5.76 (0.13) people with 40.08 (2.9) goal steps from 25 preferences in 3 + 3 million "
    "steps; DRLHP 5.62 (0.17) with 12.32 (3.0) from 1,000 preferences in 12 million.",
    bar="MORAL: at least 5.95 and 55 in the mean of five seeds, none under 5.85 and 50. DRLHP at least as "
    "good as the thesis's.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="An error in DRLHP was found while looking at seeds 0 to 2. Later its last queries fell due when "
    "no episode ended any more, and one of five seeds lost most of its goal time. MORAL had to spend more "
    "goal time by any amount first, and its likelihood expected no random answers (see E7).",
)
