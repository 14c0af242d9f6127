"""P1: AIRL and the primary reward in a single loop (part II of the thesis, first paper, figure 2)."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run, Workspace
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, INK, ORANGE, panels
from benchmarks.stages import TrainedExpert, Weighted
from benchmarks.stages.measuring import measure, stage_seed
from benchmarks.stages.settings import WAREHOUSE, coverage, rescuer, seeds, single_loop
from moral_algorithms import pipeline
from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.learners.single_loop import train_single_loop
from moral_algorithms.networks.files import save_policy
from moral_algorithms.run_directory import RunDirectory

_LAMBDAS = (0.05, 0.1, 0.15, 0.2, 0.3, 1.0)
_EPISODES = 100
_GOAL_REWARD = 10.0
"""What the world pays at the goal, 0.1 a step, is multiplied with this: 1 as for most rewards of papers."""
_BOTH = (1.0, 5.0)
"""Weights of (extinguish, save) under which people come first."""


@dataclass(frozen=True)
class SingleLoop(Run):
    """One training on the primary reward and on a reward that is learned meanwhile (eq. 2)."""

    expert: TrainedExpert
    """Who demonstrates."""
    imitation_weight: float
    """The paper's lambda."""
    seed: int
    """Which of several."""
    demonstrations: int = 10
    """Episodes of the expert."""
    primary: str = "extinguish"
    """The primary component."""
    primary_scale: float = _GOAL_REWARD
    """What it is multiplied with."""
    config: AIRLConfig = field(default_factory=AIRLConfig)
    """How it trains."""
    episodes: int = _EPISODES
    """Episodes over which the policy is measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the expert."""
        return (self.expert,)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Record the expert, train and measure the policy."""
        started = time.perf_counter()
        world = self.expert.world
        recorded = workspace.folder / "demonstrations.npz"
        recorded.unlink(missing_ok=True)
        expert = RunDirectory(workspace.of(self.expert)).policy
        seed = stage_seed(self.seed, "demonstrations")
        shown = pipeline.demonstrate(expert, recorded, self.demonstrations, seed, pipeline.Setting())
        found = train_single_loop(
            Demonstrations.load(recorded, world),
            PrimaryReward(world.build().reward_names, self.primary, self.primary_scale),
            self.imitation_weight,
            self.config,
            stage_seed(self.seed, "airl"),
        )
        policy = workspace.folder / "policy.safetensors"
        save_policy(policy, found.policy, self.config.ppo.policy, world)
        return {
            **measure(policy, self.episodes),
            "demonstrated": shown["objectives"],
            "env_steps": found.env_steps,
            "seconds": round(time.perf_counter() - started, 1),
        }


def runs(profile: Profile) -> list[Run]:
    """List every lambda and seed, and PPO on the true rewards, as far as it goes, for every seed."""
    lambdas = _LAMBDAS[::5] if profile == "smoke" else _LAMBDAS
    true = replace(coverage(profile, steps=400_000, paper_steps=1_000_000), episodes=_EPISODES)
    found: list[Run] = []
    for seed in seeds(profile):
        expert = rescuer(profile, seed)
        found += [SingleLoop(expert, weight, seed, config=single_loop(profile)) for weight in lambdas]
        found.append(Weighted(WAREHOUSE, _BOTH, seed, ("extinguish", "save"), config=true))
    return found


def judge(results: Results) -> list[Check]:
    """Look for a lambda that serves both, and compare the ends."""
    groups = _by_lambda(results)
    if not groups:
        return []
    saved = {weight: _values(found, "people_saved") for weight, found in groups.items()}
    goal = {weight: _values(found, "goal_time") for weight, found in groups.items()}

    def tell(weight: float) -> str:
        return f"lambda {weight:g}: {spread(saved[weight])} saved; {spread(goal[weight])} goal steps"

    least, most = min(groups), max(groups)
    serving = {w: np.mean(goal[w]) for w in groups if np.mean(saved[w]) >= 0.75 * 6 and w < most}
    best = max(serving, key=lambda weight: serving[weight], default=least)
    return [
        Check(
            "some lambda serves both: three quarters of the people saved, half of the time at the goal",
            tell(best),
            bool(serving.get(best, 0.0) >= 50),
            "thesis",
        ),
        Check(
            "with all weight on the demonstrations, people are saved (5.4 or more) and the goal is neglected",
            tell(most),
            bool(np.mean(saved[most]) >= 5.4 and np.mean(goal[most]) < 15),
            "thesis",
        ),
        Check(
            "with hardly any, the goal takes most of the time and few people are saved",
            tell(least),
            bool(np.mean(saved[least]) < 3 and np.mean(goal[least]) > 70),
            "thesis",
        ),
    ]


def draw(results: Results) -> Figure:
    """Draw both objectives over lambda; bars are two standard errors over the episodes of one policy."""
    figure, (saved, goal) = panels(2, width=5.0, height=3.8)
    groups = _by_lambda(results)
    bounds = [result for _, result in results.of(Weighted)]
    for axes, name, colour in ((saved, "people_saved", BLUE), (goal, "goal_time", ORANGE)):
        for place, found in enumerate(groups.values()):
            values = _values(found, name)
            errors = [2 * one["standard_errors"][name] for one in found]
            x = place + 0.12 * (np.arange(len(found)) - (len(found) - 1) / 2)
            axes.errorbar(x, values, errors, fmt="o", color=colour, markersize=4, capsize=2, linewidth=1.2)
            axes.plot([place - 0.28, place + 0.28], [np.mean(values)] * 2, color=colour, linewidth=2)
        if bounds:
            reached = float(np.mean(_values(bounds, name)))
            axes.axhline(reached, color=INK, linestyle=":", linewidth=1.2, label="PPO on the true rewards")
        axes.set_xticks(range(len(groups)), [f"{weight:g}" for weight in groups])
        axes.set(xlabel="lambda, the weight of the demonstrations", ylabel=name.replace("_", " "))
    saved.set(ylim=(-0.1, 6.4))
    goal.set(ylim=(-2, 102))
    if bounds:
        goal.legend(frameon=False, fontsize=8)
    return figure


def _by_lambda(results: Results) -> dict[float, list[dict[str, Any]]]:
    found: dict[float, list[dict[str, Any]]] = {}
    for run, result in results.of(SingleLoop):
        found.setdefault(run.imitation_weight, []).append(result)
    return dict(sorted(found.items()))


def _values(found: list[dict[str, Any]], objective: str) -> list[float]:
    return [one["objectives"][objective] for one in found]


BENCHMARK = Benchmark(
    id="P1",
    title="A norm and the primary reward in a single loop",
    source="part II, first paper, figure 2, equation 2",
    claim="From ten demonstrations and one million steps, the agent adheres to the demonstrated norm and "
    "pursues the primary goal, for lambda 0.1 for example.",
    bar="The sweep of lambda: both objectives, with two-sigma bars over 100 episodes.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="With half of the steps not all statements held.",
)
