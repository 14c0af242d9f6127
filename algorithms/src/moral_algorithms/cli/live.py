"""``moral live``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import arg

from moral_algorithms.cli import train
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.people import People
from moral_algorithms.pipeline import TeacherConfig


@dataclass(frozen=True)
class Command(train.Command):
    """A person in the loop: train an agent while somebody answers questions about it on a web page.

    It trains as `moral train` does, with you as the teacher, and prints a link. The page shows two of the
    agent's episodes side by side and asks which is better. Training never waits for an answer, and you may
    take your time: it ends after the last answer, or when you stop.

    Ctrl-C ends the session; `moral live --resume --out DIR` goes on with it, with the same person, notice and
    names unless others are given; host and allow-host must be given again. No answer is lost.
    """

    teacher: Annotated[TeacherConfig, arg(name="")] = field(
        default_factory=lambda: TeacherConfig(teacher="web")
    )
    asking: Annotated[People, arg(name="")] = field(default_factory=People)

    def execute(self, console: Console) -> None:
        """Do it."""
        if self.teacher.teacher != "web":
            raise ValueError(f"teacher is {self.teacher.teacher!r}; for moral live it must be 'web'")
        super().execute(console)

    @property
    def name(self) -> str:
        """The command."""
        return "live"

    @property
    def people(self) -> People:
        """How people answer."""
        return self.asking
