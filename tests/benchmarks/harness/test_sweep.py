"""Sweeps: the order of runs, what happens when some fail or are ended, and two sweeps at a time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.harness import Run, Store, executors
from benchmarks.harness.executors import LocalProcesses, Outcome
from benchmarks.harness.sweep import Sweep, tell
from tests.benchmarks.harness.runs import Endless, Failing, Square, Threads, Total, Written, times_carried_out

ROOT = Path(__file__).parents[3]


class InTurn:
    """Carries runs out one after the other, the last one first, in this process; remembers the order."""

    def __init__(self, store: Store, jobs: int = 2) -> None:
        self.jobs = jobs
        self.order: list[Run] = []
        self.most = 0
        self.stopped = False
        self._store = store
        self._running: list[Run] = []

    def start(self, run: Run) -> None:
        assert all(self._store.is_complete(needed) for needed in run.needs())
        self._running.append(run)
        self.most = max(self.most, len(self._running))

    def wait(self, timeout: float) -> list[Outcome]:
        if not self._running:
            return []
        run = self._running.pop()
        self.order.append(run)
        try:
            self._store.perform(run, None)
        except RuntimeError as error:
            return [Outcome(run, str(error))]
        return [Outcome(run, None)]

    def stop(self) -> None:
        self.stopped = True


def carry_out(sweep: Sweep, executor: InTurn | LocalProcesses) -> list[Outcome]:
    """Carry a sweep out; returns the failures it told of."""
    told: list[Outcome] = []
    sweep.carry_out(executor, lambda sweep: None, told.append)
    assert told == sweep.failed
    return told


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait for something that happens in another process, however slow the machine is."""
    while not holds():
        time.sleep(0.02)


def test_runs_wait_for_what_they_need_and_are_done_once(tmp_path: Path) -> None:
    store = Store(tmp_path)
    shared = Written(2)
    runs = [Total((shared, Square(3))), Total((shared,)), shared]
    executor = InTurn(store)
    sweep = Sweep(store, runs)
    assert (sweep.total, sweep.done) == (4, 0)
    assert carry_out(sweep, executor) == []
    assert (sweep.done, sweep.todo, sweep.running) == (4, [], {})
    assert sorted(executor.order, key=lambda run: run.key) == sorted(
        {*runs, Square(3)}, key=lambda run: run.key
    )
    assert executor.most == 2
    assert executor.stopped
    assert Sweep(store, runs).todo == []


def test_files_are_made_again_only_for_runs_that_read_them(tmp_path: Path) -> None:
    store = Store(tmp_path)
    needed, more = Written(2), Written(3)
    carry_out(Sweep(store, [Total((needed,)), more]), InTurn(store))
    for run in (needed, more):
        (store.files(run) / "record.json").unlink()
    assert Sweep(store, [Total((needed,)), more]).todo == []
    assert Sweep(store, [Total((needed,)), more, Total((needed, Square(1)))]).todo == [
        needed,
        Square(1),
        Total((needed, Square(1))),
    ]


def test_what_needs_a_failed_run_fails_and_all_else_goes_on(tmp_path: Path) -> None:
    store = Store(tmp_path)
    failing = Failing(2)
    direct = Total((failing,))
    runs = [direct, Square(3), Total((Square(4),))]
    sweep = Sweep(store, runs)
    failed = carry_out(sweep, InTurn(store))
    assert failed == [
        Outcome(failing, "it was not to be"),
        Outcome(direct, f"it needs {failing.key}, which failed"),
    ]
    assert sweep.done == 3
    assert Sweep(store, runs).todo == [failing, direct]


def test_runs_that_another_sweep_carries_out_are_left_to_it(tmp_path: Path) -> None:
    store, other = Store(tmp_path), Store(tmp_path)
    held, free = Square(3), Square(4)
    executor = InTurn(store, jobs=1)

    class Waiting(InTurn):
        """When nothing runs here any more, the other sweep finishes its run."""

        def wait(self, timeout: float) -> list[Outcome]:
            if not self._running:
                lock.__exit__(None, None, None)
                other.perform(held, "other")
            return super().wait(timeout)

    executor = Waiting(store, jobs=1)
    sweep = Sweep(store, [held, free])
    lock = other.hold(held)
    lock.__enter__()
    carry_out(sweep, executor)
    assert executor.order == [free]
    assert sweep.done == 2
    record = store.record(held)
    assert record is not None
    assert record["commit"] == "other"


def test_a_run_that_two_sweeps_begin_in_the_same_moment_fails_for_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, run = Store(tmp_path), Square(3)

    def perform(self: Store, run: Run, commit: str | None) -> None:
        # The other's process ends while this one waits for it, and takes the log along.
        self.log_path(run).unlink()

    monkeypatch.setattr(executors, "_end_with_parent", lambda: None)
    monkeypatch.setattr(executors, "prepare_process", lambda: None)
    monkeypatch.setattr(Store, "perform", perform)
    executors._perform_here(run, store.folder, None)
    assert not store.log_path(run).exists()


def test_time_left_by_hand(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for run, seconds in ((Square(1), 10.0), (Square(2), 30.0), (Written(1), 100.0)):
        store.perform(run, None)
        record = store.record_path(run)
        measured = store.record(run)
        assert measured is not None
        record.write_text(
            record.read_text().replace(
                f'"duration_seconds": {measured["duration_seconds"]}', f'"duration_seconds": {seconds}'
            )
        )
    assert Sweep(Store(tmp_path / "new"), [Square(1)]).seconds_left(1) is None
    finished = [Square(1), Square(2), Written(1)]
    todo = [Square(number) for number in range(3, 9)]
    sweep = Sweep(store, [*finished, *todo])
    assert sweep.seconds_left(1) == 6 * 20
    assert sweep.seconds_left(2) == 3 * 20
    assert sweep.seconds_left(100) == 20
    # Nothing is known of its kind: the mean of all.
    assert Sweep(store, [*finished, Total(())]).seconds_left(1) == pytest.approx(140 / 3)
    started = 1000.0
    running = sweep.todo.pop()
    sweep.running[running.key] = running
    sweep._started[running.key] = started
    assert sweep.seconds_left(1, now=started + 15) == 5 * 20 + 5
    assert sweep.seconds_left(1, now=started + 50) == 5 * 20


def test_durations_are_written_for_people() -> None:
    assert [tell(seconds) for seconds in (0.4, 89, 90, 3600, 5400, 9000)] == [
        *("0 s", "89 s", "2 min", "60 min", "1.5 h", "2.5 h")
    ]


def test_processes_of_this_machine(tmp_path: Path) -> None:
    store = Store(tmp_path / "out")
    notes = str(tmp_path)
    failing = [Failing(2, notes), Failing(2, notes, "killed"), Failing(2, notes, "exit")]
    total = Total((Written(2, notes), Square(3, notes)), notes)
    sweep = Sweep(store, [total, Threads(), *failing, Total((failing[1],))])
    failed = {outcome.run.key: outcome.error or "" for outcome in carry_out(sweep, LocalProcesses(store, 2))}
    assert store.result(total) == {"total": 13}
    assert times_carried_out(tmp_path, total) == 1
    assert store.result(Threads())["torch"] == 1
    assert store.result(Threads())["omp"] == "1"
    assert len(failed) == 4
    assert failed[failing[0].key].splitlines()[0] == "so far so good"
    assert failed[failing[0].key].endswith("\nRuntimeError: it was not to be")
    assert "signal 9, as the system does when memory runs out" in failed[failing[1].key]
    assert failed[failing[2].key] == "so far so good"
    logs = {path.stem for path in (tmp_path / "out" / "logs").iterdir()}
    assert logs == {run.key for run in failing}


SWEEP = """
import signal
import sys
from pathlib import Path
from benchmarks.harness import Store
from benchmarks.harness.executors import LocalProcesses
from benchmarks.harness.sweep import Sweep
from tests.benchmarks.harness.runs import Endless

if __name__ == "__main__":
    # In the background of a shell it would be ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    store = Store(Path(sys.argv[1]))
    sweep = Sweep(store, [Endless(sys.argv[1])])
    sweep.carry_out(LocalProcesses(store, 1), lambda sweep: None, print)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_no_run_outlives_its_sweep(how: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "sweep.py"
    script.write_text(SWEEP)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    sweep = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)],
        env=environment,
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: (tmp_path / "pid").exists() or sweep.poll() is not None)
    assert sweep.poll() is None
    run = int((tmp_path / "pid").read_text())
    store = Store(tmp_path)
    assert store.is_held(Endless(str(tmp_path)))
    if how is signal.SIGINT:
        # As from a terminal: every process of the group is sent it.
        os.killpg(sweep.pid, how)
    else:
        sweep.kill()
    _, errors = sweep.communicate()

    def ended() -> bool:
        try:
            os.kill(run, 0)
        except ProcessLookupError:
            return True
        return False

    wait_until(ended)
    wait_until(lambda: not store.is_held(Endless(str(tmp_path))))
    assert sweep.returncode == -how
    assert errors.count("Traceback") == (1 if how is signal.SIGINT else 0)
