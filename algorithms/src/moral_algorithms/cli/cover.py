"""``moral cover``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro import MISSING
from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.worlds import find_world
from moral_algorithms.learners.covering import CoveringConfig
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.pipeline import CoverRun
from moral_algorithms.run_directory import RunDirectory


@dataclass(frozen=True)
class Command(BaseCommand):
    """Train one policy for all scalarisation weights of a reward vector.

    The reward vector is that of `moral train`: primary components, which the world pays, and one learned
    component for each expert. Every episode has weights of its own, which the network is shown. `moral align`
    then finds the weights that a teacher wants, in seconds, as often as there are teachers.

    A run that was interrupted starts again, but for the policies that normalise the primary components.
    """

    out: Path
    """Run directory."""
    rewards: tuple[Path, ...] = ()
    """Run directories of `moral airl`, one per expert; their components are learned_1, learned_2, ...
    Without any, the reward vector is that of the primary components."""
    world: str | None = None
    """emergency, burning_warehouse or delivery; without it and rules, the world that the first of the rewards
    was learned in, or emergency."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of the world, or of emergency, that differ from its own, such as num_people 4 max_cycles 50."""
    primary: tuple[str, ...] = ()
    """Components of the world's reward vector that the agent is given."""
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[CoveringConfig, arg(name="")] = field(default_factory=CoveringConfig)
    normaliser: ExpertConfig = field(default_factory=pipeline.normaliser_config)
    """How the policies are trained that pursue one primary component alone; the defaults are the world's."""
    returns: dict[str, float] = field(default_factory=dict)
    """Returns of such policies that are known already, such as deliver 9.7: these are not trained."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """Find what suits the world."""
        return cls(MISSING, normaliser=pipeline.normaliser_config(find_world(options)))

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        if RunDirectory(self.out).summary.exists():
            return f"the run is finished; the policy is in {self.out}"
        return f"no policy is saved in {self.out}; start again"

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        world = pipeline.choose_world(self.world, self.rules, self.rewards)
        run = CoverRun(
            self.rewards, world, self.primary, self.seed, self.config, self.normaliser, self.returns
        )
        summary = pipeline.cover(RunDirectory(self.out), run, setting)
        console.objectives("last episodes, over all weights", summary["objectives"])
        console.print(f"The policy for all weights is in {self.out}; ask a teacher with moral align.")
