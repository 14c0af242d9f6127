"""``moral demonstrate``."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.live.launch import Serving, require_web, serve

if TYPE_CHECKING:
    from moral_algorithms.live.playing import Plays

_SYNTHETIC_EPISODES, _HUMAN_EPISODES = 1000, 10


@dataclass(frozen=True)
class Command(BaseCommand):
    """Record episodes of an expert into a demonstration file: of a trained one, or of a person.

    With `--human` you play yourself, on a web page or in the terminal. You look at each episode again and
    keep or discard it; those you keep are added to the file, which `moral airl` takes like any other.
    """

    expert: Path | None = None
    """Run directory of the expert, unless it is a person."""
    out: Path = Path("demonstrations.npz")
    """The file; only a person's episodes are added to one that is there."""
    episodes: int | None = None
    """Number of episodes: 1000 of a trained expert; 10 are asked of a person, who may stop earlier."""
    seed: int = 0
    """Seed of starts and actions of a trained expert."""
    human: bool = False
    """A person is the expert."""
    terminal: bool = False
    """The person plays in this terminal instead of on a page."""
    world: str = "emergency"
    """Where a person plays: emergency or delivery."""
    rules: dict[str, int] = field(default_factory=dict)
    """Rules of that world that differ from its own, such as num_people 4 max_cycles 50."""
    norm: str | None = None
    """What a person is asked to do: save or extinguish in emergency; deliver, help or clean in delivery."""
    serving: Annotated[Serving, arg(name="")] = field(default_factory=Serving)
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        if self.human:
            if not self.out.exists():
                return "no episode was kept; start again"
            return f"what was kept is in {self.out}; start again to add to it"
        return f"{self.out} is not written; start again"

    def execute(self, console: Console) -> None:
        """Do it."""
        if self.human:
            self._ask_person(console)
        else:
            self._ask_expert(console)

    def _ask_expert(self, console: Console) -> None:
        from moral_algorithms import pipeline

        if self.expert is None:
            raise ValueError("expert is None; it must be a run directory, or --human be given")
        episodes = _SYNTHETIC_EPISODES if self.episodes is None else self.episodes
        setting = pipeline.Setting(self.machine.prepare(), self.machine.threads, stage=console.stage)
        summary = pipeline.demonstrate(
            pipeline.find_policy(self.expert), self.out, episodes, self.seed, setting
        )
        console.objectives("episodes", summary["objectives"])
        self._say_what_next(console)

    def _ask_person(self, console: Console) -> None:
        from moral_algorithms.live.playing import Plays, find_instruction, hold_plays
        from moral_algorithms.worlds import WorldSpec

        if self.expert is not None:
            raise ValueError(f"expert is {self.expert}; with --human there must be none")
        spec = WorldSpec(self.world, self.rules)
        wanted = _HUMAN_EPISODES if self.episodes is None else self.episodes
        instruction = find_instruction(spec, self.norm)
        if self.terminal:
            from moral_algorithms.live.terminal import require_keys

            require_keys()
        else:
            require_web()
        with hold_plays(self.out) as folder:
            plays = Plays(spec, self.out, wanted, instruction)
            if self.terminal:
                from moral_algorithms.live.terminal import play_in_terminal

                play_in_terminal(plays)
            else:
                self._serve(console, plays, folder)
        if plays.num_kept == 0:
            raise KeyboardInterrupt
        console.print(f"Episodes in the file: {plays.num_kept}")
        self._say_what_next(console)

    def _serve(self, console: Console, plays: Plays, folder: Path) -> None:
        from moral_algorithms.live.server import make_app

        def announce(link: str) -> None:
            console.print(f"Play here: {link}")
            console.print("Ctrl-C ends it; what was kept is in the file.")

        with suppress(KeyboardInterrupt):
            serve(
                folder,
                self.serving,
                lambda token, port, hosts: make_app(token, port, hosts, plays=plays),
                announce,
            )

    def _say_what_next(self, console: Console) -> None:
        console.print(f"The demonstrations are in {self.out}; learn from them with moral airl.")
