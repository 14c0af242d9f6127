"""``moral airl``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.run_directory import RunDirectory


@dataclass(frozen=True)
class Command(BaseCommand):
    """Learn a reward network from demonstrations by adversarial inverse reinforcement learning.

    The run directory then holds the reward network, which `moral train` takes, and the imitation policy.
    """

    demonstrations: Path
    """File of `moral demonstrate`."""
    out: Path
    """Run directory."""
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[AIRLConfig, arg(name="")] = field(default_factory=AIRLConfig)
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        return f"no reward network is saved in {self.out}; start again"

    def execute(self, console: Console) -> None:
        """Do it."""
        setting = pipeline.Setting(self.machine.prepare(), self.tensorboard, console.stage)
        summary = pipeline.airl(RunDirectory(self.out), self.demonstrations, self.config, self.seed, setting)
        console.objectives("last episodes", summary["objectives"])
        console.print(f"The reward network is in {self.out}; train under it with moral train.")
