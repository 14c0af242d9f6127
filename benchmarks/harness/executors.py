"""Where runs are carried out: in processes of this machine, or on a cluster of Ray."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from multiprocessing import forkserver
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from benchmarks.harness.errors import UsageError
from benchmarks.harness.run import Run, with_needs
from benchmarks.harness.store import Store
from moral_algorithms.processes import prepare_process
from moral_algorithms.run_directory import commit
from moral_algorithms.storage import StorageError, atomic_write

Files = dict[str, bytes]
"""Contents of files by their paths relative to a store's folder."""


class Outcome(NamedTuple):
    """How a run ended."""

    run: Run
    error: str | None
    """What went wrong, the reason in its last line; None if nothing did."""


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
    """Every run in a process of its own, on one core.

    They end with this process, however it ends.

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
        # Of the code as it is now, whatever becomes of the working tree while a long sweep runs.
        self._commit = commit()
        self._context = multiprocessing.get_context("forkserver")
        if sys.platform == "linux":
            # Imported once, with all that they import, every process begins as a copy that has them.
            # Elsewhere it is not safe to copy a process that has loaded the system's linear algebra.
            self._context.set_forkserver_preload([name for name in sys.modules if name.startswith(_OWN)])
        self._running: dict[int, tuple[Run, ForkServerProcess]] = {}

    def start(self, run: Run) -> None:
        """Begin a run whose needs are met."""
        arguments = (run, self._store.folder, self._commit)
        process = self._context.Process(target=_perform_here, args=arguments, name=run.key)
        with _inherited_by_processes():
            forkserver.ensure_running()
        process.start()
        self._running[process.sentinel] = run, process

    def wait(self, timeout: float) -> list[Outcome]:
        """Wait up to ``timeout`` seconds for runs to end; list those that did."""
        ended = []
        for sentinel in wait(list(self._running), timeout):
            assert isinstance(sentinel, int)
            run, process = self._running.pop(sentinel)
            process.join()
            ended.append(Outcome(run, self._error(run, process.exitcode)))
        return ended

    def stop(self) -> None:
        """End everything that is still running."""
        for _, process in self._running.values():
            process.kill()
        for _, process in self._running.values():
            process.join()
        self._running.clear()

    def _error(self, run: Run, exit_code: int | None) -> str | None:
        if exit_code == 0:
            return None
        if exit_code is not None and exit_code < 0:
            why = ", as the system does when memory runs out" if exit_code == -signal.SIGKILL else ""
            return f"its process was ended by signal {-exit_code}{why}"
        log = self._store.log_path(run)
        printed = log.read_text(encoding="utf-8", errors="replace").strip() if log.exists() else ""
        return printed or f"its process ended with exit code {exit_code}"


class RayCluster:
    """Every run as a task of a Ray cluster, with one processor each.

    The machines share no disk with this one: a task is sent the files that it needs and sends back those it
    leaves. They need the same versions of the packages; the benchmarks and both distributions are sent along.
    A task whose machine is lost starts again from the beginning.

    Parameters
    ----------
    store
        Where records and files go, on this machine.
    address
        Of the cluster that this machine is part of, such as ``10.0.0.1:6379``; of any other's client server,
        such as ``ray://10.0.0.1:10001``; ``local`` starts a cluster on this machine.
    jobs
        Runs at a time; None: as many as the cluster has processors.
    modules
        Names of further modules that runs are defined in, which are sent along.

    Raises
    ------
    UsageError
        If Ray is not installed, or no cluster answers there.
    """

    def __init__(
        self, store: Store, address: str, jobs: int | None = None, modules: Sequence[str] = ()
    ) -> None:
        try:
            self._ray = importlib.import_module("ray")
        except ImportError as error:
            raise UsageError(f"ray is {address!r}, but Ray is not installed: pip install ray") from error
        sent = {name.partition(".")[0] for name in (*_SENT, *modules)}
        # Nothing is to be taken from the records, which may be large.
        environment = {
            "py_modules": [_location(name) for name in sorted(sent)],
            "excludes": ["/results/", "__pycache__/"],
            "env_vars": _ONE_THREAD,
        }
        own: dict[str, Any] = {"num_cpus": jobs, "num_gpus": 0, "include_dashboard": False}
        try:
            if address != "local":
                _require_answer(address)
            self._ray.init(
                address=address,
                runtime_env=environment,
                log_to_driver=False,
                logging_level="error",
                **(own if address == "local" else {}),
            )
        # Ray raises whatever it likes, down to a bare Exception.
        except Exception as error:
            reason = str(error).partition("\n")[0]
            raise UsageError(f"ray is {address!r}, where no cluster answers: {reason}") from error
        self.jobs = jobs or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._perform = self._ray.remote(num_cpus=1, max_retries=2)(_perform_there)
        self._store = store
        self._commit = commit()
        self._running: dict[Any, tuple[Run, ExitStack]] = {}
        self._sent: dict[str, Any] = {}

    def start(self, run: Run) -> None:
        """Begin a run whose needs are met."""
        with ExitStack() as stack:
            stack.enter_context(self._store.hold(run))
            for needed in with_needs(run.needs()):
                if needed.key not in self._sent:
                    self._sent[needed.key] = self._ray.put(_read_files(self._store, needed))
            files = [self._sent[needed.key] for needed in with_needs(run.needs())]
            self._running[self._perform.remote(run, self._commit, *files)] = run, stack.pop_all()

    def wait(self, timeout: float) -> list[Outcome]:
        """Wait up to ``timeout`` seconds for runs to end; list those that did."""
        if not self._running:
            time.sleep(timeout)
            return []
        ended = []
        for reference in self._ray.wait(list(self._running), timeout=timeout)[0]:
            run, lock = self._running.pop(reference)
            with lock:
                error = None
                try:
                    files, error = self._ray.get(reference)
                    _write_files(self._store, files)
                except (self._ray.exceptions.RayError, StorageError) as failure:
                    error = str(failure).strip() or type(failure).__name__
                _write_log(self._store, run, error)
                ended.append(Outcome(run, error))
        return ended

    def stop(self) -> None:
        """End everything that is still running."""
        for reference, (_, lock) in self._running.items():
            self._ray.cancel(reference, force=True)
            lock.close()
        self._running.clear()
        self._ray.shutdown()


_OWN = "benchmarks."

_SENT = ("benchmarks", "moral_algorithms", "moral_envs")

_ONE_THREAD = {"OMP_NUM_THREADS": "1"}
"""Environment of a process that runs on one core: NumPy's libraries read it when they are loaded."""


@contextmanager
def _inherited_by_processes() -> Iterator[None]:
    """Let processes that are started meanwhile use one thread, and leave Ctrl-C to this one."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
        signal.signal(signal.SIGINT, handler)


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended, even if that was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _perform_here(run: Run, folder: Path, commit: str | None) -> None:
    """Carry out a run in a process made for it; what it prints, and its traceback, go to a log."""
    _end_with_parent()
    prepare_process()
    store = Store(folder)
    log = store.log_path(run)
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w", buffering=1, encoding="utf-8") as file, redirect_stdout(file), redirect_stderr(file):
        try:
            store.perform(run, commit)
        except Exception:
            traceback.print_exc()
            raise SystemExit(1) from None
    # Another sweep, which began the same run in the same moment and waited for this one, may have removed it.
    log.unlink(missing_ok=True)


def _perform_there(run: Run, commit: str | None, *needed: Files) -> tuple[Files, str | None]:
    """Carry out a run on a machine that has none of its files; returns its own, or what went wrong."""
    prepare_process()
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        for files in needed:
            _write_files(store, files)
        try:
            store.perform(run, commit)
        except Exception:
            return {}, traceback.format_exc().strip()
        return _read_files(store, run), None


def _location(name: str) -> str:
    """Find the folder of a package, or the file of a module."""
    module = importlib.import_module(name)
    # A package without __init__.py may have several folders; the first is the one that shadows the others.
    return str(next(iter(module.__path__)) if hasattr(module, "__path__") else module.__file__)


def _require_answer(address: str) -> None:
    """Raise an OSError or ValueError if nothing listens at an address: Ray itself would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdecimal():
        raise ValueError("it must be HOST:PORT, ray://HOST:PORT or local")
    with socket.create_connection((host, int(port)), timeout=10):
        pass


def _write_log(store: Store, run: Run, error: str | None) -> None:
    log = store.log_path(run)
    if error is None:
        log.unlink(missing_ok=True)
    else:
        with atomic_write(log) as file:
            file.write(f"{error}\n".encode())


def _read_files(store: Store, run: Run) -> Files:
    """Read a finished run's record and the files it leaves."""
    return {str(path.relative_to(store.folder)): path.read_bytes() for path in store.left_by(run)}


def _write_files(store: Store, files: Files) -> None:
    for name, content in files.items():
        with atomic_write(store.folder / name) as file:
            file.write(content)
