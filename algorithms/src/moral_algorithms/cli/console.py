"""What a command shows: progress bars and tables in a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich.box
import rich.console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars
from rich.table import Column, Table
from rich.text import Text

if TYPE_CHECKING:
    from moral_algorithms.learners.ppo import OnProgress, Progress

# Where there is no terminal, a stage reports as often as this.
_PLAIN_REPORTS = 5
_TITLE_WIDTH = 14


class Console:
    """A command's output.

    Parameters
    ----------
    started
        `time.perf_counter` when the command started; by default now.

    Attributes
    ----------
    started : float
        `time.perf_counter` when the command started.
    """

    def __init__(self, started: float | None = None) -> None:
        self.started = time.perf_counter() if started is None else started
        self._out = rich.console.Console(highlight=False)

    @contextmanager
    def stage(self, title: str) -> Iterator[OnProgress]:
        """Show a stage's progress; what it yields is called after every rollout."""
        with self._bar(title) if self._out.is_terminal else self._lines(title) as on_progress:
            yield on_progress

    def print(self, text: str) -> None:
        """Print a line."""
        self._out.print(text, markup=False, soft_wrap=True)

    def objectives(self, of: str, objectives: Mapping[str, float]) -> None:
        """Print mean counters, if there are any."""
        if objectives:
            self.print(f"Mean of the {of}: {_describe_objectives(objectives)}")

    def table(self, title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table whose first column is text and whose others are figures."""
        table = Table(box=rich.box.SIMPLE_HEAD)
        for index, name in enumerate(header):
            table.add_column(name, justify="right" if index else "left", no_wrap=True)
        for row in rows:
            # As it is: what people have named may look like markup.
            table.add_row(*map(Text, row))
        self._out.print(title, markup=False, style="bold")
        self._out.print(table)

    def aligned(
        self,
        out: Path,
        summary: Mapping[str, Any],
        asked: str = "queries",
        names: Mapping[str, str] | None = None,
    ) -> None:
        """Print what MORAL found, by the summary of its run; components may have names for people."""
        self.objectives("last episodes", summary["objectives"])
        shown = names or {}
        rows = [(shown.get(name, name), f"{weight:.3f}") for name, weight in summary["weights"].items()]
        self.table(f"Weights after {summary['queries']} {asked}", ("component", "weight"), rows)
        self.print(f"The agent is in {out}; measure it with moral evaluate, see it with moral watch.")

    def error(self, text: str) -> None:
        """Print one line to stderr."""
        print(" ".join(text.split()), file=sys.stderr)

    @contextmanager
    def _bar(self, title: str) -> Iterator[OnProgress]:
        columns = (
            TextColumn(f"{{task.description:{_TITLE_WIDTH}}}"),
            BarColumn(bar_width=8),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeElapsedColumn(Column(min_width=7)),
            TextColumn("{task.fields[text]}", table_column=Column(no_wrap=True, overflow="ellipsis")),
        )
        with Bars(*columns, console=self._out) as bars:
            task = bars.add_task(title, total=None, text="")

            def show(progress: Progress) -> None:
                text = _describe(progress)
                bars.update(task, completed=progress.steps, total=progress.total_steps, text=text)

            yield show
            # A stage may end before its last step, and some have no steps to count.
            total = bars.tasks[0].completed or 1
            bars.update(task, completed=total, total=total)

    @contextmanager
    def _lines(self, title: str) -> Iterator[OnProgress]:
        started = time.perf_counter()
        reported = 0

        def show(progress: Progress) -> None:
            nonlocal reported
            due = progress.steps * _PLAIN_REPORTS // progress.total_steps
            if due > reported:
                reported = due
                # The last rollout may go a little beyond the end.
                steps = f"{min(progress.steps, progress.total_steps):,} of {progress.total_steps:,} steps"
                self.print(f"{title:{_TITLE_WIDTH}} {steps}  {_describe(progress)}".rstrip())
                sys.stdout.flush()

        yield show
        self.print(f"{title:{_TITLE_WIDTH}} done in {time.perf_counter() - started:.1f} s")
        sys.stdout.flush()


def end_with_reader(command: Callable[[], int]) -> int:
    """Carry out a command whose output may be read in part only, as by ``head``.

    Returns
    -------
    int
        The command's exit status; 1, and nothing is said, where the reader of its output has gone.
    """
    try:
        try:
            return command()
        finally:
            # Here a failure can be caught; when Python itself does it at its end, it cannot.
            # None where the output was closed from the start.
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        # What is still buffered goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C until the block ends, which must not take long."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _describe_objectives(objectives: Mapping[str, float]) -> str:
    """Mean counters in words."""
    return "  ".join(f"{name} {mean:.3g}" for name, mean in objectives.items())


def _describe(progress: Progress) -> str:
    queries = f"queries {progress.queries}  " if progress.queries else ""
    return queries + _describe_objectives(progress.objectives)
