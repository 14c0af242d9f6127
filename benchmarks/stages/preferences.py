"""Agents trained by DRLHP, the baseline, from preferences alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.harness import Run, Workspace
from benchmarks.stages.covered import Asked
from benchmarks.stages.measuring import curve, measure, stage_seed
from moral_algorithms import pipeline
from moral_algorithms.learners.drlhp import DRLHPConfig
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class FromPreferences(Run):
    """One training with DRLHP."""

    world: WorldSpec
    """Where it acts."""
    teacher: pipeline.TeacherConfig
    """Who answers."""
    seed: int
    """Which of several."""
    config: DRLHPConfig = field(default_factory=DRLHPConfig)
    """How DRLHP trains and asks."""
    target: Asked | None = None
    """The teacher asks for what this agent achieves (eq. 5.13)."""
    episodes: int = 500
    """Episodes over which the agent is measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the agent that sets the target."""
        return () if self.target is None else (self.target,)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train the agent, or go on training it, and measure it."""
        teacher = self.teacher
        if self.target is not None:
            teacher = replace(teacher, target=workspace.result_of(self.target)["objectives"])
        directory = RunDirectory(workspace.folder)
        run = pipeline.DRLHPRun(self.world, teacher, stage_seed(self.seed, "drlhp"), self.config)
        resume = directory.config.exists()
        summary = pipeline.drlhp(directory, run, pipeline.Setting(), resume=resume)
        answers = read_lines(directory.queries)
        return {
            **measure(directory.policy, self.episodes),
            "answers": summary["queries"],
            "ties": sum(answer["preference"] == "equal" for answer in answers),
            "curve": curve(read_lines(directory.metrics), ("queries",)),
            "env_steps": summary["env_steps"],
            "seconds": summary["wall_seconds"],
            "whole": not resume,
        }
