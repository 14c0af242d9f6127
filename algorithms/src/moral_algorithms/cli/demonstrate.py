"""``moral demonstrate``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console


@dataclass(frozen=True)
class Command(BaseCommand):
    """Record episodes of an expert into a demonstration file."""

    expert: Path
    """Run directory of the expert."""
    out: Path = Path("demonstrations.npz")
    """The file."""
    episodes: int = 1000
    """Number of episodes."""
    seed: int = 0
    """Seed of starts and actions."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        return f"{self.out} is not written; start again"

    def execute(self, console: Console) -> None:
        """Do it."""
        from moral_algorithms import pipeline

        setting = pipeline.Setting(self.machine.prepare(), self.machine.threads, stage=console.stage)
        summary = pipeline.demonstrate(
            pipeline.find_policy(self.expert), self.out, self.episodes, self.seed, setting
        )
        console.objectives("episodes", summary["objectives"])
        console.print(f"The demonstrations are in {self.out}; learn from them with moral airl.")
