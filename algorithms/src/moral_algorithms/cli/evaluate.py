"""``moral evaluate``."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console

# Far beyond the parts that any command spawns from its seed.
_BRANCH = 100


@dataclass(frozen=True)
class Command(BaseCommand):
    """Measure a policy on seeded starts, in Emergency beside the exact optimum on the same starts.

    The optimum saves as many people as can be saved and then has the most goal time.
    """

    run: Path
    """Run directory of `moral train`, live, replay, align, drlhp, expert, airl or demo."""
    episodes: int = 1000
    """Number of starts, one episode from each."""
    seed: int = 0
    """Seed of starts and actions."""
    deterministic: bool = False
    """Take the likeliest action instead of sampling."""
    json: bool = False
    """Print JSON instead of a table."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        return "nothing is changed"

    def execute(self, console: Console) -> None:
        """Do it."""
        from moral_algorithms import pipeline
        from moral_algorithms.networks.files import load_policy

        policy, world = load_policy(pipeline.find_policy(self.run), self.machine.prepare())
        # From the starts that other commands draw the agent has learned.
        seed = pipeline.spawn_seeds(self.seed, _BRANCH + 1)[_BRANCH]
        found = pipeline.evaluate(policy, world, self.episodes, seed, self.deterministic)
        if self.json:
            result = {
                "episodes": self.episodes,
                "seed": self.seed,
                "deterministic": self.deterministic,
                "objectives": found.objectives,
                "standard_errors": found.standard_errors,
                "optimum": found.optimum,
            }
            print(json.dumps(result, indent=2))
            return
        measured = (_describe(m, found.standard_errors[name]) for name, m in found.objectives.items())
        rows = [("policy", *measured)]
        if found.optimum is not None:
            rows.append(("exact optimum", *(f"{mean:.2f}" for mean in found.optimum.values())))
        title = f"Means of {self.episodes} episodes in {world.name}, with standard errors"
        console.table(title, ("", *found.objectives), rows)


def _describe(mean: float, standard_error: float | None) -> str:
    """Give a mean and, where there is one, its standard error."""
    return f"{mean:.2f}" if standard_error is None else f"{mean:.2f} +- {standard_error:.2f}"
