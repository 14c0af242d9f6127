"""Policies for all weights, and agents that a teacher's preferences choose among theirs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from benchmarks.harness import Run, Workspace
from benchmarks.stages.aligned import PrimaryReturn, path, posteriors
from benchmarks.stages.measuring import curve, measure, stage_seed
from benchmarks.stages.norms import LearnedNorm
from moral_algorithms import pipeline
from moral_algorithms.learners.alignment import AlignmentConfig
from moral_algorithms.learners.covering import CoveringConfig
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import read_json

# More than the parts that a run spawns from its own seed.
_PARTS = 100


@dataclass(frozen=True)
class Covered(Run):
    """One policy for all weights of a reward vector. It leaves the policy and the reward vector."""

    leaves_files: ClassVar[bool] = True

    norms: tuple[LearnedNorm, ...]
    """Learned rewards, the components learned_1, learned_2 and so on."""
    seed: int
    """Which of several."""
    primary: tuple[PrimaryReturn, ...] = ()
    """Primary components, each with its normaliser."""
    config: CoveringConfig = field(default_factory=CoveringConfig)
    """How it is trained."""

    def needs(self) -> tuple[Run, ...]:
        """Name the normalisers and the norms; the short runs come first, beside the experts."""
        return (*self.primary, *self.norms)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train the policy."""
        directory = RunDirectory(workspace.folder)
        returns = {one.component: workspace.result_of(one)["return"] for one in self.primary}
        run = pipeline.CoverRun(
            rewards=tuple(workspace.of(norm) for norm in self.norms),
            world=self.norms[0].expert.world,
            primary=tuple(returns),
            returns=returns,
            seed=stage_seed(self.seed, "moral"),
            config=self.config,
        )
        if directory.summary.exists():
            summary = read_json(directory.summary)
        else:
            summary = pipeline.cover(directory, run, pipeline.Setting())
        return {
            "objectives": summary["objectives"],
            "env_steps": summary["env_steps"]["cover"],
            "seconds": summary["wall_seconds"]["cover"],
        }


@dataclass(frozen=True)
class Asked(Run):
    """One agent that MORAL's queries find among those of a policy for all weights."""

    covered: Covered
    """The policy."""
    teacher: pipeline.TeacherConfig
    """Who answers."""
    seed: int
    """Which of several."""
    config: AlignmentConfig = field(default_factory=AlignmentConfig)
    """How the teacher is asked."""
    episodes: int = 500
    """Episodes over which the agent is measured."""
    stream: int = 0
    """Which of several with this seed: each has a teacher's noise, starts and candidates of its own."""

    def needs(self) -> tuple[Run, ...]:
        """Name the policy."""
        return (self.covered,)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Ask, or go on asking, and measure the agent."""
        directory = RunDirectory(workspace.folder)
        seed = stage_seed(self.seed, "moral")
        if self.stream:
            seed = spawn_seeds(seed, _PARTS + self.stream)[-1]
        run = pipeline.AlignRun(workspace.of(self.covered), self.teacher, seed, self.config)
        resume = directory.config.exists()
        summary = pipeline.align(directory, run, pipeline.Setting(), resume=resume)
        lines = read_lines(directory.metrics)
        dim = len(self.covered.primary) + len(self.covered.norms)
        return {
            **measure(directory.policy, self.episodes),
            "weights": summary["weights"],
            "path": path(lines),
            "posterior": posteriors(self.config, dim, read_lines(directory.queries)),
            "curve": curve(lines, ("queries",)),
            "env_steps": summary["env_steps"]["align"],
            "seconds": summary["wall_seconds"]["align"],
            "whole": not resume,
        }
