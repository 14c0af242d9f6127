"""``moral expert``."""

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
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class Command(BaseCommand):
    """Train an expert: PPO on the world's own rewards under known weights, until it stops improving.

    The run directory then holds its policy; `moral demonstrate` records it. The defaults are those of the
    world: `moral expert --world delivery --help` shows Delivery's.
    """

    out: Path
    """Run directory."""
    weights: tuple[float, ...]
    """One weight per reward component: extinguish save in Emergency; deliver help clean vase in Delivery."""
    world: str = "emergency"
    """emergency, burning_warehouse or delivery."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of the world that differ from its own, such as num_people 4 max_cycles 50 (steps)."""
    seed: int = 0
    """Seed of everything random."""
    config: Annotated[ExpertConfig, arg(name="")] = field(default_factory=ExpertConfig)
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @classmethod
    def defaults(cls, options: Sequence[str]) -> Command | None:
        """Find what suits the world."""
        return cls(MISSING, MISSING, config=pipeline.expert_config(find_world(options)))

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        if RunDirectory(self.out).summary.exists():
            return f"the run is finished; the expert is in {self.out}"
        return f"no expert is saved in {self.out}; start again"

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        world = WorldSpec(self.world, self.rules)
        summary = pipeline.expert(
            RunDirectory(self.out), world, self.weights, self.config, self.seed, setting
        )
        console.objectives("last episodes", summary["objectives"])
        console.print(f"The expert is in {self.out}; record it with moral demonstrate.")
