"""``moral align``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro import MISSING
from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.answers import read_answers
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.resuming import find_resumed, going_on, saved_answers
from moral_algorithms.cli.worlds import find_world
from moral_algorithms.learners.alignment import AlignmentConfig
from moral_algorithms.pipeline import AlignRun, TeacherConfig
from moral_algorithms.run_directory import RunDirectory

_KIND = "align"


@dataclass(frozen=True)
class Command(BaseCommand):
    """MORAL without training: learn weights from pairwise preferences about a policy for all weights.

    The policy of `moral cover` plays fresh episodes, half of them under the weights that are the best guess
    so far and half under others that are likely; the teacher compares two of them; the answer improves the
    guess. The run directory then holds the policy under the last guess, for `moral evaluate` and `moral
    watch`.

    An interrupted run goes on with `moral align --resume --out DIR`; its options are those it was started
    with, of which only device and threads may be changed. No answered query is lost or asked again.
    """

    covered: Path
    """Run directory of `moral cover`."""
    out: Path
    """Run directory."""
    resume: bool = False
    """Go on with the run in the run directory."""
    teacher: Annotated[TeacherConfig, arg(name="")] = field(default_factory=TeacherConfig)
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[AlignmentConfig, arg(name="")] = field(default_factory=AlignmentConfig)
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """Find what the run was started with when it is resumed, else what suits the world."""
        resumed = find_resumed(options, _KIND)
        if resumed is None:
            teacher = TeacherConfig(order=pipeline.teacher_order(find_world(options)))
            return cls(MISSING, MISSING, teacher=teacher)
        run = pipeline.read_align_run(resumed.directory)
        out, machine = resumed.directory.path, resumed.machine
        return cls(run.covered, out, True, run.teacher, run.seed, run.config, machine)

    @property
    def hint(self) -> str:
        """What is saved, and how to go on."""
        return saved_answers(
            self.out, _KIND, self.config.queries, lambda path: read_answers(path).informative
        )

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, stage=console.stage)
        directory = RunDirectory(self.out)
        run = AlignRun(self.covered, self.teacher, self.seed, self.config)
        with going_on(console, directory, _KIND, setting, self.resume):
            summary = pipeline.align(directory, run, setting, self.resume)
        console.aligned(self.out, summary)
