"""A sweep: all runs that are not finished yet, in an order in which their needs are met."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.harness.executors import Executor, Outcome
from benchmarks.harness.run import Run, with_needs
from benchmarks.harness.store import Store

# How often progress is told while nothing ends.
_TICK_SECONDS = 1.0


class Sweep:
    """Runs to be done, and how far they are.

    Parameters
    ----------
    store
        Where finished runs are found and new ones kept.
    runs
        The runs; what they need comes along.
    """

    def __init__(self, store: Store, runs: Sequence[Run]) -> None:
        self._store = store
        wanted = with_needs(runs)
        self.total = len(wanted)
        self.todo = _unfinished(store, wanted)
        self.running: dict[str, Run] = {}
        self.failed: list[Outcome] = []
        self._seconds: dict[str, list[float]] = {}
        for run in wanted:
            self._learn_duration(store.record(run), run)

    @property
    def done(self) -> int:
        """Runs that need nothing more."""
        return self.total - len(self.todo) - len(self.running)

    def carry_out(self, executor: Executor, on_change: Callable[[Sweep], None]) -> None:
        """Carry out what is not finished; what is running is ended when this is interrupted.

        Parameters
        ----------
        executor
            Where.
        on_change
            Called when a run begins or ends, and every second.
        """
        try:
            while self.todo or self.running:
                self._start_ready(executor)
                on_change(self)
                for outcome in executor.wait(_TICK_SECONDS):
                    del self.running[outcome.run.key]
                    if outcome.error is None:
                        self._learn_duration(self._store.record(outcome.run), outcome.run)
                    else:
                        self.failed.append(outcome)
                        self._drop_dependants(outcome.run)
                    on_change(self)
        finally:
            executor.stop()

    def seconds_left(self, jobs: int) -> float | None:
        """Guess how long the rest takes, from runs of the same kinds; None while nothing is known."""
        known = [seconds for durations in self._seconds.values() for seconds in durations]
        if not known:
            return None
        overall = statistics.fmean(known)
        means = {kind: statistics.fmean(durations) for kind, durations in self._seconds.items()}
        left = sum(means.get(run.kind, overall) for run in self.todo)
        left += sum(means.get(run.kind, overall) / 2 for run in self.running.values())
        return left / jobs

    def _start_ready(self, executor: Executor) -> None:
        waiting = {run.key for run in (*self.todo, *self.running.values())}
        for run in list(self.todo):
            if len(self.running) >= executor.jobs:
                return
            if not any(needed.key in waiting for needed in run.needs()):
                self.todo.remove(run)
                self.running[run.key] = run
                executor.start(run)

    def _drop_dependants(self, failed: Run) -> None:
        for run in list(self.todo):
            if any(needed.key == failed.key for needed in with_needs(run.needs())):
                self.todo.remove(run)
                self.failed.append(Outcome(run, f"needs {failed.key}, which failed"))

    def _learn_duration(self, record: dict[str, Any] | None, run: Run) -> None:
        if record is not None:
            self._seconds.setdefault(run.kind, []).append(record["duration_seconds"])


def _unfinished(store: Store, runs: Sequence[Run]) -> list[Run]:
    """Find what must be done: runs without a record, and those whose files such runs read and are missing."""
    todo: list[Run] = []
    read: set[str] = set()
    # Backwards: what reads a run's files comes after it.
    for run in reversed(runs):
        missing = run.key in read and run.leaves_files and not store.has_files(run)
        if store.record(run) is None or missing:
            todo.insert(0, run)
            read |= {needed.key for needed in run.needs()}
    return todo


def tell(seconds: float) -> str:
    """Write a duration for people."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
