"""``moral drlhp``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro import MISSING
from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.resuming import find_resumed, going_on, saved_answers
from moral_algorithms.learners.drlhp import DRLHPConfig
from moral_algorithms.pipeline import DRLHPRun, TeacherConfig
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.worlds import WorldSpec

_KIND = "drlhp"


@dataclass(frozen=True)
class Command(BaseCommand):
    """DRLHP, the baseline: train an agent on a reward that is learned from pairwise preferences alone.

    The run directory then holds the policy and the reward networks.

    An interrupted run goes on from its last checkpoint with `moral drlhp --resume --out DIR`; its options are
    those it was started with, of which only device, threads and tensorboard may be changed. No answered query
    is lost or asked again.
    """

    out: Path
    """Run directory."""
    resume: bool = False
    """Go on with the run in the run directory."""
    preset: str = "fast"
    """Defaults of all that follows: fast, or paper (the thesis's networks and hyperparameters)."""
    world: str = "emergency"
    """emergency, burning_warehouse or delivery."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of the world that differ from its own, such as num_people 4 max_cycles 50."""
    teacher: Annotated[TeacherConfig, arg(name="")] = field(default_factory=TeacherConfig)
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[DRLHPConfig, arg(name="")] = field(default_factory=DRLHPConfig)
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """When resumed, what the run was started with, else the preset."""
        resumed = find_resumed(options, _KIND)
        if resumed is not None:
            if any(option.partition("=")[0] == "--preset" for option in options):
                raise ValueError("preset is for a new run; one that goes on has its settings")
            run = pipeline.read_drlhp_run(resumed.directory)
            return cls(
                out=resumed.directory.path,
                resume=True,
                world=run.world.name,
                rules=run.world.rules,
                teacher=run.teacher,
                seed=run.seed,
                config=run.config,
                machine=resumed.machine,
                tensorboard=resumed.tensorboard,
            )
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--out", type=Path, nargs="?")
        parser.add_argument("--preset", nargs="?", default="fast")
        parser.add_argument("--world", nargs="?", default="emergency")
        parser.add_argument("--rules", nargs="*", default=[])
        early, _ = parser.parse_known_args(list(options))
        rules = _read_rules(early.rules)
        if early.world is None or early.preset is None or rules is None:
            return None
        config = pipeline.drlhp_preset(early.preset, WorldSpec(early.world, rules))
        teacher = TeacherConfig(order=pipeline.teacher_order(early.world))
        out = MISSING if early.out is None else early.out
        return cls(out=out, preset=early.preset, teacher=teacher, config=config)

    @property
    def hint(self) -> str:
        """What is saved, and how to go on."""
        return saved_answers(self.out, _KIND, self.config.queries, read_lines)

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        directory = RunDirectory(self.out)
        run = DRLHPRun(WorldSpec(self.world, self.rules), self.teacher, self.seed, self.config)
        with going_on(console, directory, _KIND, setting, self.resume):
            summary = pipeline.drlhp(directory, run, setting, self.resume)
        console.objectives("last episodes", summary["objectives"])
        console.print(f"Answers: {summary['queries']}")
        console.print(f"The agent is in {self.out}; measure it with moral evaluate, see it with moral watch.")


def _read_rules(words: Sequence[str]) -> dict[str, int] | None:
    """Read names and numbers; None where they are malformed, which is the options' to refuse."""
    try:
        return {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)}
    except ValueError:
        return None
