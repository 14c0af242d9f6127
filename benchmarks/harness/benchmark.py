"""Benchmarks: which runs a figure or table takes, how their results are judged and how they are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeVar

from matplotlib.figure import Figure

from benchmarks.harness.run import Run

Profile = Literal["smoke", "laptop", "paper"]
"""Size of a benchmark: does it work at all (seconds), two cores and an evening, or the thesis's own sizes."""

PROFILES: tuple[Profile, ...] = ("smoke", "laptop", "paper")

Verdict = Literal["holds", "differs", "fails", "not run"]

AnyRun = TypeVar("AnyRun", bound=Run)


class Check(NamedTuple):
    """One statement, and what was measured about it."""

    statement: str
    """What should be seen."""
    value: str
    """What was seen, with its spread."""
    met: bool
    """Whether that is so."""
    of: Literal["thesis", "ours"]
    """Who states it: the thesis, or the bar that this project has set itself."""


class Results:
    """Results of those of some runs that are finished.

    Parameters
    ----------
    found
        Runs and their results, in the order in which a benchmark lists them.
    """

    def __init__(self, found: Sequence[tuple[Run, dict[str, Any]]]) -> None:
        self._found = {run.key: (run, result) for run, result in found}

    def __getitem__(self, run: Run) -> dict[str, Any]:
        """Return the result of one run; a KeyError if it is not finished."""
        return self._found[run.key][1]

    def __contains__(self, run: Run) -> bool:
        """Whether a run is finished."""
        return run.key in self._found

    def __len__(self) -> int:
        """How many runs are finished."""
        return len(self._found)

    def of(self, kind: type[AnyRun]) -> list[tuple[AnyRun, dict[str, Any]]]:
        """List the runs of a class and their results."""
        return [(run, result) for run, result in self._found.values() if isinstance(run, kind)]


@dataclass(frozen=True)
class Benchmark:
    """One figure or table."""

    id: str
    """Its row in the list of figures to reproduce, such as E3."""
    title: str
    """What it is about, in a line."""
    source: str
    """Where the thesis shows it."""
    claim: str
    """What the thesis reports."""
    bar: str
    """What this project wants to show."""
    runs: Callable[[Profile], Sequence[Run]]
    """The runs whose results it shows; what they need comes along by itself."""
    judge: Callable[[Results], list[Check]]
    """Compares results, as far as there are some, with claim and bar."""
    draw: Callable[[Results], Figure]
    """Draws results, as far as there are some."""
    changed: str = ""
    """What of the runs or of their judgement was changed after results of these seeds had been seen."""


def verdict(checks: Sequence[Check]) -> Verdict:
    """All statements are met: *holds*; some: *differs*; none: *fails*; there are none: *not run*."""
    met = [check.met for check in checks]
    if not met:
        return "not run"
    if all(met):
        return "holds"
    return "differs" if any(met) else "fails"
