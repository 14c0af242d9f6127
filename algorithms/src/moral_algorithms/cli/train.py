"""``moral train``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.pipeline import MoralRun, TeacherConfig
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class Command(BaseCommand):
    """MORAL: train an agent under weights that are learned from pairwise preferences meanwhile.

    The reward vector holds the primary components, which the world pays, and one learned component for each
    expert. All are normalised by the return of a policy that pursues them alone; those for the primary
    components are trained first.

    An interrupted run goes on from its last checkpoint with `moral train --resume --out DIR`; its options are
    those it was started with. No answered query is lost or asked again.
    """

    rewards: tuple[Path, ...]
    """Run directories of `moral airl`, one per expert; their components are learned_1, learned_2, ..."""
    out: Path
    """Run directory."""
    resume: bool = False
    """Go on with the run in the run directory."""
    world: str = "emergency"
    """emergency or delivery."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of the world that differ from its own, such as num_people 4 max_cycles 50 (steps)."""
    primary: tuple[str, ...] = ("extinguish",)
    """Components of the world's reward vector that the agent is given."""
    teacher: Annotated[TeacherConfig, arg(name="")] = field(default_factory=TeacherConfig)
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[MoralConfig, arg(name="")] = field(default_factory=MoralConfig)
    normaliser: ExpertConfig = field(default_factory=pipeline.normaliser_config)
    """How the policies are trained that pursue one primary component alone."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """When resumed, what the run was started with."""
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--resume", action="store_true")
        parser.add_argument("--out", type=Path)
        early, _ = parser.parse_known_args(list(options))
        if not early.resume or early.out is None:
            return None
        run = pipeline.read_moral_run(RunDirectory(early.out))
        return cls(
            rewards=run.rewards,
            out=early.out,
            resume=True,
            world=run.world.name,
            rules=run.world.rules,
            primary=run.primary,
            teacher=run.teacher,
            seed=run.seed,
            config=run.config,
            normaliser=run.normaliser,
        )

    @property
    def hint(self) -> str:
        """What is saved, and how to go on."""
        directory = RunDirectory(self.out)
        if not directory.config.exists():
            return "nothing was started"
        answered = len(read_lines(directory.queries))
        return f"{answered} of {self.config.queries} answers are saved; {pipeline.how_to_resume(directory)}"

    def execute(self, console: Console) -> None:
        """Do it."""
        setting = pipeline.Setting(self.machine.prepare(), self.tensorboard, console.stage)
        directory = RunDirectory(self.out)
        finished = self.resume and directory.summary.exists()
        run = MoralRun(
            self.rewards,
            WorldSpec(self.world, self.rules),
            self.primary,
            self.teacher,
            self.seed,
            self.config,
            self.normaliser,
        )
        summary = pipeline.moral(directory, run, setting, self.resume)
        if finished:
            console.print(f"The run in {self.out} was finished before.")
        console.objectives("last episodes", summary["objectives"])
        rows = [(name, f"{weight:.3f}") for name, weight in summary["weights"].items()]
        console.table(f"Weights after {summary['queries']} queries", ("component", "weight"), rows)
        console.print(f"The agent is in {self.out}; measure it with moral evaluate, see it with moral watch.")
