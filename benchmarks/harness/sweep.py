"""A sweep: all runs that are not finished yet, in an order in which their needs are met."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.harness.executors import Executor, Outcome
from benchmarks.harness.run import Run, with_needs
from benchmarks.harness.store import Store

# How often progress is told while nothing ends, and runs are looked for that other sweeps have finished.
_TICK_SECONDS = 1.0


class Sweep:
    """Runs to be done, and how far they are.

    Several sweeps may work in the same store: none begins a run that another is carrying out.

    Parameters
    ----------
    store
        Where finished runs are found and new ones kept.
    runs
        The runs; what they need comes along.

    Raises
    ------
    StorageError
        If the record of one is damaged.
    """

    def __init__(self, store: Store, runs: Sequence[Run]) -> None:
        self._store = store
        wanted = with_needs(runs)
        self.total = len(wanted)
        self.todo = _unfinished(store, wanted)
        self.running: dict[str, Run] = {}
        self.failed: list[Outcome] = []
        self._needs = {run.key: {needed.key for needed in run.needs()} for run in self.todo}
        self._started: dict[str, float] = {}
        self._seconds: dict[str, list[float]] = {}
        for run in wanted:
            self._learn_duration(run)

    @property
    def done(self) -> int:
        """Runs that are finished."""
        return self.total - len(self.todo) - len(self.running) - len(self.failed)

    def carry_out(
        self,
        executor: Executor,
        on_progress: Callable[[Sweep], None],
        on_failure: Callable[[Outcome], None],
    ) -> None:
        """Carry out what is not finished; what is running is ended when this is interrupted.

        A run that fails takes those with it that need it; all others go on.

        Parameters
        ----------
        executor
            Where.
        on_progress
            Called when a run begins or ends, and every second.
        on_failure
            Called for every run that fails, as soon as it does.
        """
        try:
            while self.todo or self.running:
                self._start_ready(executor)
                on_progress(self)
                for outcome in executor.wait(_TICK_SECONDS):
                    self._end(outcome, on_failure)
                    on_progress(self)
        finally:
            executor.stop()

    def seconds_left(self, jobs: int, now: float | None = None) -> float | None:
        """Guess how long the rest takes, from runs of the same kinds; None while nothing is known.

        Parameters
        ----------
        jobs
            Runs at a time.
        now
            What the monotonic clock says; None asks it.
        """
        known = [seconds for durations in self._seconds.values() for seconds in durations]
        if not known:
            return None
        now = time.monotonic() if now is None else now
        overall = statistics.fmean(known)
        means = {kind: statistics.fmean(durations) for kind, durations in self._seconds.items()}
        left = [means.get(run.kind, overall) for run in self.todo]
        left += [
            max(0.0, means.get(run.kind, overall) - (now - self._started[key]))
            for key, run in self.running.items()
        ]
        # However many run at a time, the longest takes its time.
        return max([sum(left) / jobs, *left])

    def _start_ready(self, executor: Executor) -> None:
        waiting = {run.key for run in self.todo} | self.running.keys()
        for run in list(self.todo):
            if len(self.running) >= executor.jobs:
                return
            if self._needs[run.key] & waiting or self._store.is_held(run):
                continue
            self.todo.remove(run)
            if self._store.is_complete(run):
                # Another sweep has finished it.
                self._learn_duration(run)
                waiting.remove(run.key)
                continue
            executor.start(run)
            self.running[run.key] = run
            self._started[run.key] = time.monotonic()

    def _end(self, outcome: Outcome, on_failure: Callable[[Outcome], None]) -> None:
        run = self.running.pop(outcome.run.key)
        if outcome.error is None:
            self._learn_duration(run)
            return
        failed = [outcome]
        missing = {run.key}
        # What needs a run comes after it.
        for dependant in list(self.todo):
            cause = self._needs[dependant.key] & missing
            if cause:
                self.todo.remove(dependant)
                missing.add(dependant.key)
                failed.append(Outcome(dependant, f"it needs {min(cause)}, which failed"))
        self.failed += failed
        for one in failed:
            on_failure(one)

    def _learn_duration(self, run: Run) -> None:
        record: dict[str, Any] | None = self._store.record(run)
        if record is not None:
            self._seconds.setdefault(run.kind, []).append(record["duration_seconds"])


def _unfinished(store: Store, runs: Sequence[Run]) -> list[Run]:
    """Find what must be done: runs without a record, and those whose files such runs read and are missing."""
    todo: list[Run] = []
    read: set[str] = set()
    # Backwards: what reads a run's files comes after it.
    for run in reversed(runs):
        if not store.is_complete(run, with_files=run.key in read):
            todo.insert(0, run)
            read |= {needed.key for needed in run.needs()}
    return todo


def tell(seconds: float) -> str:
    """Write a duration for people."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
