"""``moral train``."""

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
from moral_algorithms.cli.people import People, ask_people
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.pipeline import MoralRun, TeacherConfig
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError
from moral_algorithms.worlds import WorldSpec

_KIND = "train"


@dataclass(frozen=True)
class Command(BaseCommand):
    """MORAL: train an agent under weights that are learned from pairwise preferences meanwhile.

    The reward vector holds the primary components, which the world pays, and one learned component for each
    expert. All are normalised by the return of a policy that pursues them alone; those for the primary
    components are trained first.

    With `--teacher web` a person answers on a web page, as in `moral live`, which has more options for it;
    with `--teacher terminal` here in the terminal.

    An interrupted run goes on from its last checkpoint with `moral train --resume --out DIR`; its options are
    those it was started with, of which only device, threads and tensorboard may be changed. No answered query
    is lost or asked again.
    """

    rewards: tuple[Path, ...]
    """Run directories of `moral airl`, one per expert; their components are learned_1, learned_2, ..."""
    out: Path
    """Run directory."""
    resume: bool = False
    """Go on with the run in the run directory."""
    world: str | None = None
    """emergency, burning_warehouse or delivery; without it and rules, the world that the first of the rewards
    was learned in."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of the world, or of emergency, that differ from its own, such as num_people 4 max_cycles 50."""
    primary: tuple[str, ...] = ("extinguish",)
    """Components of the world's reward vector that the agent is given."""
    teacher: Annotated[TeacherConfig, arg(name="")] = field(default_factory=TeacherConfig)
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[MoralConfig, arg(name="")] = field(default_factory=MoralConfig)
    normaliser: ExpertConfig = field(default_factory=pipeline.normaliser_config)
    """How the policies are trained that pursue one primary component alone."""
    returns: dict[str, float] = field(default_factory=dict)
    """Returns of such policies that are known already, such as extinguish 7.4: these are not trained."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

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
        run, setting = pipeline.read_moral_run(directory), pipeline.read_setting(directory, _KIND)
        # An unknown device is the options' to refuse.
        device: Any = setting.device
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
            returns=run.returns,
            machine=Machine(device, setting.threads),
            tensorboard=setting.tensorboard,
        )

    @property
    def name(self) -> str:
        """The command."""
        return _KIND

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
        how = pipeline.how_to_resume(directory, self.name)
        return f"{answered} of {self.config.queries} answers are saved; {how}"

    @property
    def people(self) -> People:
        """How people answer, where they are the teacher."""
        return People()

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        directory = RunDirectory(self.out)
        given = self.world is not None or self.rules
        world = (
            WorldSpec(self.world or "emergency", self.rules)
            if given
            else pipeline.world_of_rewards(self.rewards)
        )
        finished = self.resume and directory.summary.exists()
        run = MoralRun(
            self.rewards,
            world,
            self.primary,
            self.teacher,
            self.seed,
            self.config,
            self.normaliser,
            self.returns,
        )
        if self.resume and not finished:
            for warning in pipeline.changes_since_start(directory, _KIND, setting):
                console.error(f"moral: warning: {warning}")
        if self.teacher.asks_people:
            summary = ask_people(console, directory, run, setting, self.resume, self.people)
        else:
            summary = pipeline.moral(directory, run, setting, self.resume)
        if finished:
            console.print(f"The run in {self.out} was finished before.")
        console.objectives("last episodes", summary["objectives"])
        names = self.people.name_components(run) if self.teacher.asks_people else {}
        rows = [(names.get(name, name), f"{weight:.3f}") for name, weight in summary["weights"].items()]
        console.table(f"Weights after {summary['queries']} queries", ("component", "weight"), rows)
        console.print(f"The agent is in {self.out}; measure it with moral evaluate, see it with moral watch.")
