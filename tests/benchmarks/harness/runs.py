"""Runs of no time at all, which processes made for them import by name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run, Workspace


@dataclass(frozen=True)
class Square(Run):
    """Squares a number, and notes in a folder that it was carried out."""

    number: float
    notes: str = ""

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        note(self)
        return {"square": self.number**2}


@dataclass(frozen=True)
class Written(Square):
    """Squares a number, and leaves it in a file."""

    leaves_files: ClassVar[bool] = True

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        result = super().execute(workspace)
        (workspace.folder / "square.txt").write_text(str(result["square"]))
        return result


@dataclass(frozen=True)
class Total(Run):
    """Adds up what others leave in files, or have for a result."""

    of: tuple[Square, ...]
    notes: str = ""

    def needs(self) -> tuple[Run, ...]:
        return self.of

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        note(self)
        written = [one for one in self.of if isinstance(one, Written)]
        told = [one for one in self.of if one not in written]
        total = sum(float((workspace.of(one) / "square.txt").read_text()) for one in written)
        return {"total": total + sum(workspace.result_of(one)["square"] for one in told)}


@dataclass(frozen=True)
class Failing(Square):
    """Says something and fails, or is killed by the system, or ends without a word."""

    how: str = "error"

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        print("so far so good")
        if self.how == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.how == "exit":
            os._exit(3)
        raise RuntimeError("it was not to be")


@dataclass(frozen=True)
class Endless(Run):
    """Writes down its process and waits to be ended."""

    notes: str

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        unfinished = Path(self.notes) / ".pid"
        unfinished.write_text(str(os.getpid()))
        unfinished.rename(unfinished.with_name("pid"))
        while True:
            time.sleep(1)


@dataclass(frozen=True)
class Threads(Run):
    """Tells with how many threads it runs, and which copy of the packages."""

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        import torch

        import benchmarks

        return {
            "torch": torch.get_num_threads(),
            "omp": os.environ.get("OMP_NUM_THREADS"),
            "package": benchmarks.__path__[0],
            "results": len(list((Path(benchmarks.__path__[0]) / "results").rglob("*.json"))),
        }


def note(run: Run) -> None:
    """Leave a file for every time that a run is carried out."""
    notes = getattr(run, "notes", "")
    if notes:
        (Path(notes) / f"{run.key}.{time.monotonic_ns()}").touch()


def times_carried_out(notes: Path, run: Run) -> int:
    return len(list(notes.glob(f"{run.key}.*")))


def benchmark(runs: Sequence[Run], **changes: Any) -> Benchmark:
    """A benchmark of squares; its check is met if one is above ten."""

    def judge(results: Results) -> list[Check]:
        squares = [result["square"] for _, result in results.of(Square)]
        return [Check("one is above ten", f"{max(squares)}", max(squares) > 10, "ours")] if squares else []

    def draw(results: Results) -> Figure:
        figure = Figure(figsize=(2, 1))
        figure.add_subplot().plot([result["square"] for _, result in results.of(Square)])
        return figure

    def listed(profile: Profile) -> Sequence[Run]:
        return runs

    values: dict[str, Any] = {
        "id": "X1",
        "title": "Squares",
        "source": "figure 0",
        "claim": "They grow.",
        "bar": "Above ten.",
        "runs": listed,
        "judge": judge,
        "draw": draw,
    }
    return Benchmark(**{**values, **changes})
