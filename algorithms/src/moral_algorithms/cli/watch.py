"""``moral watch``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console


@dataclass(frozen=True)
class Command(BaseCommand):
    """Play an episode of a policy into a GIF, or into an MP4 with the extra moral-algorithms[video]."""

    run: Path
    """Run directory of `moral train`, live, replay, align, drlhp, expert, airl or demo."""
    out: Path = Path("episode.gif")
    """The picture, .gif or .mp4; one that is there is replaced."""
    seed: int = 0
    """Seed of start and actions."""
    deterministic: bool = False
    """Take the likeliest action instead of sampling."""
    fps: int = 6
    """Steps per second."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        return f"{self.out} is not written"

    def execute(self, console: Console) -> None:
        """Do it."""
        from moral_algorithms import pipeline, watching
        from moral_algorithms.networks.files import load_policy

        watching.require_format(self.out, self.fps)
        policy, world = load_policy(pipeline.find_policy(self.run), self.machine.prepare())
        frames, objectives = watching.film(policy, world.build(), self.seed, self.deterministic)
        watching.write_film(self.out, frames, self.fps)
        counters = "  ".join(f"{name} {count}" for name, count in objectives.items())
        console.print(f"{self.out}: {len(frames) - 1} steps, {counters}")
