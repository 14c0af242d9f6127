"""``moral align``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.answers import read_answers
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.learners.alignment import AlignmentConfig
from moral_algorithms.pipeline import AlignRun, TeacherConfig
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError

_KIND = "align"


@dataclass(frozen=True)
class Command(BaseCommand):
    """MORAL without training: learn weights from pairwise preferences about a policy for all weights.

    The policy of `moral cover` plays fresh episodes under the weights that are the best guess so far; the
    teacher compares two of them; the answer improves the guess. The run directory then holds the policy under
    the last guess, for `moral evaluate` and `moral watch`.

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
        """When resumed, what the run was started with."""
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--resume", action="store_true")
        parser.add_argument("--out", type=Path, nargs="?")
        early, _ = parser.parse_known_args(list(options))
        if not early.resume or early.out is None:
            return None
        directory = RunDirectory(early.out)
        run, setting = pipeline.read_align_run(directory), pipeline.read_setting(directory, _KIND)
        # An unknown device is the options' to refuse.
        device: Any = setting.device
        machine = Machine(device, setting.threads)
        return cls(run.covered, early.out, True, run.teacher, run.seed, run.config, machine)

    @property
    def hint(self) -> str:
        """What is saved, and how to go on."""
        directory = RunDirectory(self.out)
        if not directory.config.exists():
            return "nothing was started"
        if directory.summary.exists():
            return f"the run is finished; the agent is in {self.out}"
        try:
            answered = len(read_answers(directory.queries).informative)
        except StorageError as error:
            return f"{error}"
        how = pipeline.how_to_resume(directory, _KIND)
        return f"{answered} of {self.config.queries} answers are saved; {how}"

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, stage=console.stage)
        directory = RunDirectory(self.out)
        finished = self.resume and directory.summary.exists()
        run = AlignRun(self.covered, self.teacher, self.seed, self.config)
        if self.resume and not finished:
            for warning in pipeline.changes_since_start(directory, _KIND, setting):
                console.error(f"moral: warning: {warning}")
        summary = pipeline.align(directory, run, setting, self.resume)
        if finished:
            console.print(f"The run in {self.out} was finished before.")
        console.objectives("last episodes", summary["objectives"])
        rows = [(name, f"{weight:.3f}") for name, weight in summary["weights"].items()]
        console.table(f"Weights after {summary['queries']} queries", ("component", "weight"), rows)
        console.print(f"The agent is in {self.out}; measure it with moral evaluate, see it with moral watch.")
