"""Experts, and what AIRL learns from their demonstrations."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.harness import Run, Workspace
from benchmarks.stages.measuring import EVALUATION_SEED, curve, measure, stage_seed
from moral_algorithms import pipeline
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.airl import AIRLConfig, episode_returns
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.networks.files import load_policy, load_reward
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.storage import read_json
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class TrainedExpert(Run):
    """An expert: PPO under weights of the world's own reward vector. It leaves its policy."""

    leaves_files: ClassVar[bool] = True

    world: WorldSpec
    """Where it acts."""
    weights: tuple[float, ...]
    """Weights of the world's reward vector."""
    seed: int
    """Which of several."""
    config: ExpertConfig = field(default_factory=ExpertConfig)
    """How it is trained."""
    episodes: int = 500
    """Episodes over which it is measured."""

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train and measure it."""
        directory = RunDirectory(workspace.folder)
        seed = stage_seed(self.seed, "expert")
        if directory.summary.exists():
            summary = read_json(directory.summary)
        else:
            summary = pipeline.expert(
                directory, self.world, self.weights, self.config, seed, pipeline.Setting()
            )
        return {
            **measure(directory.policy, self.episodes),
            "env_steps": summary["env_steps"],
            "seconds": summary["wall_seconds"],
        }


@dataclass(frozen=True)
class LearnedNorm(Run):
    """A reward that AIRL learns from an expert's demonstrations. It leaves the reward and the imitator."""

    leaves_files: ClassVar[bool] = True

    expert: TrainedExpert
    """Who demonstrates."""
    seed: int
    """Which of several."""
    demonstrations: int = 1000
    """Episodes of the expert."""
    config: AIRLConfig = field(default_factory=AIRLConfig)
    """How AIRL trains."""
    episodes: int = 500
    """Episodes over which the imitator is measured."""
    random_actions: float = 0.0
    """Share of the demonstrated actions that are random instead."""

    def needs(self) -> tuple[Run, ...]:
        """Name the expert."""
        return (self.expert,)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Record the expert, learn from the record and measure the imitator."""
        directory = RunDirectory(workspace.folder)
        recorded = workspace.folder / "demonstrations.npz"
        shown = self.record(workspace.of(self.expert), recorded)
        setting = pipeline.Setting()
        if directory.summary.exists():
            summary = read_json(directory.summary)
        else:
            summary = pipeline.airl(directory, recorded, self.config, stage_seed(self.seed, "airl"), setting)
        # Large, and made again from the expert in no time.
        recorded.unlink()
        return {
            **measure(directory.policy, self.episodes),
            "demonstrated": shown["objectives"],
            "normaliser": summary["normaliser"],
            "learned_returns": self._learned_returns(directory, workspace),
            "curve": curve(read_lines(directory.metrics), ("fake_accuracy", "real_accuracy")),
            "env_steps": summary["env_steps"],
            "seconds": summary["wall_seconds"],
        }

    def record(self, expert: Path, path: Path) -> dict[str, Any]:
        """Record the demonstrations in a file, always the same ones.

        Parameters
        ----------
        expert
            Folder of the expert.
        path
            The file; one that is there is replaced.

        Returns
        -------
        dict
            As :func:`~moral_algorithms.pipeline.demonstrate` does.
        """
        path.unlink(missing_ok=True)
        return pipeline.demonstrate(
            RunDirectory(expert).policy,
            path,
            self.demonstrations,
            stage_seed(self.seed, "demonstrations"),
            pipeline.Setting(),
            self.random_actions,
        )

    def _learned_returns(self, directory: RunDirectory, workspace: Workspace) -> dict[str, dict[str, float]]:
        """Mean and spread of the learned reward's returns, for the expert and the imitator, on new starts."""
        network = load_reward(directory.path / "reward.safetensors").network
        found = {}
        for name, folder in (("expert", workspace.of(self.expert)), ("imitator", directory.path)):
            policy, world = load_policy(RunDirectory(folder).policy)
            with sampling_seed(EVALUATION_SEED):
                played = play_episodes(policy, world.build(), self.episodes, EVALUATION_SEED)
            returns = episode_returns(network, played.states)
            found[name] = {"mean": float(returns.mean()), "standard_deviation": float(np.std(returns))}
        return found
