"""Options that commands share, and how they are read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from inspect import cleandoc
from io import StringIO
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import tyro
from docstring_parser.attrdoc import AttributeDocstrings

if TYPE_CHECKING:
    from moral_algorithms.cli.console import Console


@dataclass(frozen=True)
class Machine:
    """What a command runs on."""

    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """Where networks live; auto takes a GPU if there is one."""
    threads: int = 1
    """Threads of PyTorch: two train small networks faster where nothing else runs, more pay only for the
    thesis's large ones. 0 takes one per core."""

    def prepare(self) -> str:
        """Set the threads and return the device.

        Raises
        ------
        ValueError
            If there is no such device, or there can be no such number of threads.
        """
        import torch

        from moral_algorithms.processes import prepare_process

        prepare_process(self.threads)
        if self.device == "cuda" and not torch.cuda.is_available():
            raise ValueError("device is 'cuda', which PyTorch does not find here; it must be 'cpu' or 'auto'")
        if self.device == "auto":
            return "cuda" if torch.cuda.is_available() else "cpu"
        return self.device


class BaseCommand:
    """What every command is: a dataclass of options with something to do."""

    @classmethod
    def defaults(cls: type[Command], options: Sequence[str]) -> Command | None:
        """Find defaults that depend on the options; None takes those of the dataclass."""
        return None

    @property
    def hint(self) -> str:
        """What is saved after an interruption and how to go on."""
        return ""

    def execute(self, console: Console) -> None:
        """Do it."""
        raise NotImplementedError


Command = TypeVar("Command", bound=BaseCommand)


def parse(command: type[Command], options: Sequence[str], program: str) -> Command:
    """Read a command's options; ``--help`` ends the process.

    Parameters
    ----------
    command
        A dataclass.
    options
        The command line after the command's name.
    program
        What the help calls the command.

    Raises
    ------
    ValueError
        If an option is unknown, missing or malformed, or a dataclass refuses a value.
    """
    default = command.defaults(options)
    errors = StringIO()

    def read(console_outputs: bool) -> Command:
        arguments = list(options)
        if default is None:
            return tyro.cli(command, args=arguments, prog=program, console_outputs=console_outputs)
        return tyro.cli(
            command, args=arguments, prog=program, console_outputs=console_outputs, default=default
        )

    try:
        # It is silent about most errors when asked to be, but not about all.
        with redirect_stderr(StringIO()), _help_in_paragraphs():
            return read(console_outputs=False)
    except SystemExit as exit_:
        refusal = _refusal(exit_)
        if refusal is not None:
            raise refusal from None
    try:
        # Once more, to show the help or to hear what tyro itself found wrong.
        with redirect_stderr(errors), _help_in_paragraphs():
            return read(console_outputs=True)
    except SystemExit as exit_:
        if not exit_.code:
            raise
    raise ValueError(f"{_in_one_line(errors.getvalue())}; see {program} --help")


@contextmanager
def _help_in_paragraphs() -> Iterator[None]:
    """Let tyro join the lines of an option's docstring.

    It does, but for lines that begin with a space; and it is told docstrings with their indentation.
    """
    told = AttributeDocstrings.get_attr_docs

    def without_indentation(self: AttributeDocstrings, component: Any) -> Any:
        return {name: (cleandoc(text), *rest) for name, (text, *rest) in told(self, component).items()}

    AttributeDocstrings.get_attr_docs = without_indentation  # type: ignore[method-assign]
    try:
        yield
    finally:
        AttributeDocstrings.get_attr_docs = told  # type: ignore[method-assign]


def _in_one_line(box: str) -> str:
    """Join the sections of tyro's box, without its borders, title, explanations and hint at the help."""
    # Where the terminal has no such characters, borders are spaces and rules are hyphens.
    plain = re.sub(r"\x1b\[[0-9;]*m", "", box).translate(str.maketrans("│╭╮╰╯", "     "))
    sections: list[list[str]] = [[]]
    for line in plain.splitlines()[1:]:
        if set(line.strip()) in ({"─"}, {"-"}):
            sections.append([])
        # Options are indented; their explanations twice.
        elif line.strip() and not line.startswith(" " * 10):
            sections[-1].append(line.removeprefix("  ").rstrip())
    told = []
    for title, *others in filter(None, sections):
        if title.startswith("For full helptext"):
            continue
        if title == "Argument helptext:":
            told.append(f"it must be: {others[0].strip()}")
        elif others and others[0].startswith("    "):
            told.append(f"{title} {', '.join(map(str.strip, others))}")
        else:
            told.append(" ".join(map(str.strip, [title, *others])))
    return "; ".join(told).rstrip(".!")


def _refusal(error: BaseException) -> ValueError | None:
    """Find the ValueError of a dataclass of this project that led to an error, if one did."""
    cause: BaseException | None = error
    while cause is not None:
        frame = cause.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        raised_in = "" if frame is None else str(frame.tb_frame.f_globals.get("__name__"))
        if isinstance(cause, ValueError) and raised_in.startswith(("moral_algorithms.", "moral_envs.")):
            return cause
        cause = cause.__context__
    return None
