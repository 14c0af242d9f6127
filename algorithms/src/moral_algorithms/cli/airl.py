"""``moral airl``."""

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
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class Command(BaseCommand):
    """Learn a reward network from demonstrations by adversarial inverse reinforcement learning.

    The run directory then holds the reward network, which `moral train` and `moral cover` take, and the
    imitation policy. The defaults are those of the world that the demonstrations are of; see them
    with `moral airl --demonstrations FILE --help`.
    """

    demonstrations: Path
    """File of `moral demonstrate`."""
    out: Path
    """Run directory."""
    world: str | None = None
    """World that the demonstrations must be of, emergency, burning_warehouse or delivery; by default any."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of that world, or of emergency, that differ from its own, such as num_people 4 max_cycles 50."""
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[AIRLConfig, arg(name="")] = field(default_factory=AIRLConfig)
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """Find what suits the world of the demonstrations."""
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--demonstrations", type=Path, nargs="?")
        path = parser.parse_known_args(list(options))[0].demonstrations
        try:
            world = WorldSpec() if path is None else Demonstrations.world_of(path)
        except StorageError:
            # The command itself says so.
            return None
        return cls(MISSING, MISSING, config=pipeline.airl_config(world.name))

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        if RunDirectory(self.out).summary.exists():
            return f"the run is finished; the reward network is in {self.out}"
        return f"no reward network is saved in {self.out}; start again"

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        world = WorldSpec(self.world or "emergency", self.rules) if self.world or self.rules else None
        summary = pipeline.airl(
            RunDirectory(self.out), self.demonstrations, self.config, self.seed, setting, world
        )
        console.objectives("last episodes", summary["objectives"])
        console.print(f"The reward network is in {self.out}; train under it with moral train.")
