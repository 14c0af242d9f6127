"""Policies of coverage sets: PPO under fixed weights (algorithm 4)."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from benchmarks.harness import Run, Workspace
from benchmarks.stages.aligned import PrimaryReturn
from benchmarks.stages.measuring import EVALUATION_SEED, stage_seed
from benchmarks.stages.norms import LearnedNorm
from moral_algorithms.bridge import LearnedReward, PrimaryReward, RewardComponent
from moral_algorithms.learners.coverage import CoverageConfig, solve
from moral_algorithms.networks.files import load_reward
from moral_algorithms.pipeline.stage import name_values
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class Weighted(Run):
    """PPO under fixed weights on primary and learned components."""

    world: WorldSpec
    """Where it acts."""
    weights: tuple[float, ...]
    """Of the primary components and, after them, of the learned ones."""
    seed: int
    """Which of several."""
    primary: tuple[str, ...] = ()
    """Primary components."""
    normalisers: tuple[PrimaryReturn, ...] = ()
    """Returns that some of them are divided by; the others are what the world pays."""
    norms: tuple[LearnedNorm, ...] = ()
    """Learned rewards, divided by their imitators' returns; the components learned_1, learned_2 and so on."""
    config: CoverageConfig = field(default_factory=CoverageConfig)
    """How it is trained and measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the normalisers and the norms."""
        return (*self.normalisers, *self.norms)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train and measure the policy."""
        started = time.perf_counter()
        world = self.world.build()
        earned = {one.component: workspace.result_of(one)["return"] for one in self.normalisers}
        scales = {name: 1 / earned.get(name, 1.0) for name in self.primary}
        components: list[RewardComponent] = [
            PrimaryReward(world.reward_names, name, scale) for name, scale in scales.items()
        ]
        for number, norm in enumerate(self.norms, start=1):
            name, found = f"learned_{number}", load_reward(workspace.of(norm) / "reward.safetensors")
            scales[name] = 1 / found.normaliser
            components.append(LearnedReward(name, found.network, scales[name]))
        seed = stage_seed(self.seed, "coverage")
        solution = solve(self.world, components, self.weights, self.config, seed, EVALUATION_SEED)
        return {
            "objectives": name_values(world.objective_names, solution.objectives.mean(axis=0)),
            "returns": name_values(tuple(scales), solution.returns),
            "scales": scales,
            "env_steps": solution.env_steps,
            "seconds": round(time.perf_counter() - started, 1),
        }
