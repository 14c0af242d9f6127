"""Where runs are carried out: in processes of this machine, or on a cluster of Ray."""

from __future__ import annotations

import importlib
import multiprocessing
import signal
import sys
import tempfile
import traceback
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import torch

from benchmarks.harness.run import Run, with_needs
from benchmarks.harness.store import Store
from moral_algorithms.storage import StorageError, atomic_write

Files = dict[str, bytes]
"""Contents of files by their paths relative to a store's folder."""


class Outcome(NamedTuple):
    """How a run ended."""

    run: Run
    error: str | None
    """What went wrong, with its traceback; None if nothing did."""


class Executor(Protocol):
    """Carries out runs side by side."""

    jobs: int
    """How many at a time."""

    def start(self, run: Run) -> None:
        """Begin a run whose needs are met."""
        ...

    def wait(self, timeout: float) -> list[Outcome]:
        """Wait up to ``timeout`` seconds for runs to end; list those that did."""
        ...

    def stop(self) -> None:
        """End everything that is still running."""
        ...


class LocalProcesses:
    """Every run in a process of its own, with one thread of PyTorch.

    Parameters
    ----------
    store
        Where records and files go.
    jobs
        Processes at a time.
    """

    def __init__(self, store: Store, jobs: int) -> None:
        self.jobs = jobs
        self._store = store
        self._context = multiprocessing.get_context("forkserver")
        # Imported once; every process begins as a copy that has them.
        self._context.set_forkserver_preload(["benchmarks.harness.executors", "stable_baselines3"])
        self._running: dict[int, tuple[Run, ForkServerProcess]] = {}

    def start(self, run: Run) -> None:
        """Begin a run whose needs are met."""
        process = self._context.Process(target=_perform_here, args=(run, self._store.folder), name=run.key)
        process.start()
        self._running[process.sentinel] = run, process

    def wait(self, timeout: float) -> list[Outcome]:
        """Wait up to ``timeout`` seconds for runs to end; list those that did."""
        ended = []
        for sentinel in wait(list(self._running), timeout):
            assert isinstance(sentinel, int)
            run, process = self._running.pop(sentinel)
            process.join()
            error = None
            if process.exitcode != 0:
                log = _log(self._store, run)
                error = f"exit code {process.exitcode}\n{log.read_text() if log.exists() else ''}"
            ended.append(Outcome(run, error))
        return ended

    def stop(self) -> None:
        """End everything that is still running."""
        for _, process in self._running.values():
            process.terminate()
        for _, process in self._running.values():
            process.join()
        self._running.clear()


class RayCluster:
    """Every run as a task of a Ray cluster, with one processor each.

    The machines share no disk with this one: a task is sent the files that it needs and sends back those it
    leaves. They need the same versions of the packages; the benchmarks and both distributions are sent along.
    A task that is killed starts again from the beginning.

    Parameters
    ----------
    store
        Where records and files go, on this machine.
    address
        Of the cluster's head, such as ``10.0.0.1:6379``; ``local`` starts a cluster on this machine.

    Raises
    ------
    ValueError
        If Ray is not installed, or does not answer there.
    """

    def __init__(self, store: Store, address: str) -> None:
        try:
            self._ray = importlib.import_module("ray")
        except ImportError as error:
            raise ValueError(f"ray is {address!r}, but Ray is not installed: pip install ray") from error
        modules = [str(Path(sys.modules[name].__path__[0])) for name in _SENT]
        try:
            self._ray.init(address=address, runtime_env={"py_modules": modules}, log_to_driver=False)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise ValueError(f"ray is {address!r}, where no cluster answers: {error}") from error
        self.jobs = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._perform = self._ray.remote(num_cpus=1, max_retries=2)(_perform_there)
        self._store = store
        self._running: dict[Any, Run] = {}

    def start(self, run: Run) -> None:
        """Begin a run whose needs are met."""
        files: Files = {}
        for needed in with_needs(list(run.needs())):
            files |= _read_files(self._store, needed)
        self._running[self._perform.remote(run, files)] = run

    def wait(self, timeout: float) -> list[Outcome]:
        """Wait up to ``timeout`` seconds for runs to end; list those that did."""
        ended = []
        for reference in self._ray.wait(list(self._running), timeout=timeout)[0]:
            run = self._running.pop(reference)
            error = None
            try:
                files, error = self._ray.get(reference)
                _write_files(self._store, files)
            except (self._ray.exceptions.RayError, StorageError) as failure:
                error = str(failure)
            ended.append(Outcome(run, error))
        return ended

    def stop(self) -> None:
        """End everything that is still running."""
        for reference in self._running:
            self._ray.cancel(reference, force=True)
        self._running.clear()
        self._ray.shutdown()


_SENT = ("benchmarks", "moral_algorithms", "moral_envs")


def prepare_process() -> None:
    """Give this process one thread of PyTorch, and spare it checks of every distribution's arguments."""
    torch.set_num_threads(1)
    torch.distributions.Distribution.set_default_validate_args(False)


def _perform_here(run: Run, folder: Path) -> None:
    """Carry out a run in a process made for it; what it prints, and its traceback, go to a log."""
    # Ctrl-C reaches the whole group: the sweep ends its processes itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepare_process()
    store = Store(folder)
    log = _log(store, run)
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w", buffering=1) as file, redirect_stdout(file), redirect_stderr(file):
        try:
            store.perform(run)
        except Exception:
            traceback.print_exc()
            raise SystemExit(1) from None
    log.unlink()


def _perform_there(run: Run, files: Files) -> tuple[Files, str | None]:
    """Carry out a run on a machine that has none of its files; returns its own, or what went wrong."""
    prepare_process()
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        _write_files(store, files)
        try:
            store.perform(run)
        except Exception:
            return {}, traceback.format_exc()
        return _read_files(store, run), None


def _log(store: Store, run: Run) -> Path:
    return store.folder / "logs" / f"{run.key}.txt"


def _read_files(store: Store, run: Run) -> Files:
    """Read a finished run's record and the files it leaves."""
    paths = [store.record_path(run), *(path for path in store.files(run).rglob("*") if path.is_file())]
    return {str(path.relative_to(store.folder)): path.read_bytes() for path in paths}


def _write_files(store: Store, files: Files) -> None:
    for name, content in files.items():
        with atomic_write(store.folder / name) as file:
            file.write(content)
