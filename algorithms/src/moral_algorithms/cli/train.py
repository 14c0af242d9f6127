"""``moral train``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from tyro import MISSING
from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.answers import read_answers
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.people import Answering, People, ask_people
from moral_algorithms.cli.resuming import find_resumed, going_on, saved_answers
from moral_algorithms.cli.worlds import find_world
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.pipeline import MoralRun, TeacherConfig
from moral_algorithms.run_directory import RunDirectory

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

    out: Path
    """Run directory."""
    rewards: tuple[Path, ...] = ()
    """Run directories of `moral airl`, one per expert; their components are learned_1, learned_2, ...
    Without any, the weights are those of the primary components."""
    resume: bool = False
    """Go on with the run in the run directory."""
    world: str | None = None
    """emergency, burning_warehouse or delivery; without it and rules, the world that the first of the rewards
    was learned in, or emergency."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of the world, or of emergency, that differ from its own, such as num_people 4 max_cycles 50."""
    primary: tuple[str, ...] = ("extinguish",)
    """Components of the world's reward vector that the agent is given."""
    teacher: Annotated[TeacherConfig, arg(name="")] = field(default_factory=TeacherConfig)
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[MoralConfig, arg(name="")] = field(default_factory=MoralConfig)
    normaliser: ExpertConfig = field(default_factory=pipeline.normaliser_config)
    """How the policies are trained that pursue one primary component alone; the defaults are the world's."""
    returns: dict[str, float] = field(default_factory=dict)
    """Returns of such policies that are known already, such as extinguish 7.4: these are not trained."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """Find what the run was started with when it is resumed, else what suits the world."""
        resumed = find_resumed(options, _KIND)
        if resumed is None:
            world = find_world(options)
            fresh = cls(MISSING, normaliser=pipeline.normaliser_config(world))
            return replace(fresh, teacher=replace(fresh.teacher, order=pipeline.teacher_order(world)))
        run = pipeline.read_moral_run(resumed.directory)
        return cls(
            out=resumed.directory.path,
            rewards=run.rewards,
            resume=True,
            world=run.world.name,
            rules=run.world.rules,
            primary=run.primary,
            teacher=run.teacher,
            seed=run.seed,
            config=run.config,
            normaliser=run.normaliser,
            returns=run.returns,
            machine=resumed.machine,
            tensorboard=resumed.tensorboard,
        )

    @property
    def name(self) -> str:
        """The command."""
        return _KIND

    @property
    def hint(self) -> str:
        """What is saved, and how to go on."""
        return saved_answers(
            self.out, self.name, self.config.queries, lambda path: read_answers(path).informative
        )

    @property
    def people(self) -> People:
        """How people answer, where they are the teacher."""
        return People()

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        directory = RunDirectory(self.out)
        world = pipeline.choose_world(self.world, self.rules, self.rewards)
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
        with going_on(console, directory, _KIND, setting, self.resume):
            if self.teacher.asks_people:
                summary = ask_people(console, directory, run, setting, self.resume, self.people)
            else:
                summary = pipeline.moral(directory, run, setting, self.resume)
        names = Answering.saved(directory).name_components(run) if self.teacher.asks_people else {}
        console.aligned(self.out, summary, names=names)
