"""Records of finished runs, found again by what the runs were configured with."""

from __future__ import annotations

import fcntl
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from benchmarks.harness.run import Run, Workspace, agrees
from benchmarks.provenance import provenance
from moral_algorithms.storage import StorageError, read_json, write_json

_BEGUN = "begun.json"
_RECORD = "record.json"

_FIELDS: dict[str, type | tuple[type, ...]] = {
    "configuration": dict,
    "result": dict,
    "versions": dict,
    "commit": (str, type(None)),
    "platform": str,
    "processor": str,
    "duration_seconds": (int, float),
}
"""What a record must hold, and of which type."""


class Store:
    """A folder of records, and of the files that runs leave for each other.

    ``records/KEY.json`` holds a finished run's configuration, its result and where that comes from.
    ``files/KEY/`` is where a run works. ``begun.json`` says in it for which configuration; of a run that
    other runs read the folder stays, with a copy of the record as the last file, which says that the others
    are complete. ``locks/KEY`` is locked while a process carries the run out.

    Parameters
    ----------
    folder
        Where they are; it is made when something is written.
    """

    def __init__(self, folder: Path) -> None:
        # Runs that go on compare the paths that they were started with.
        self.folder = folder.absolute()

    def require_writable(self) -> None:
        """Raise a StorageError if nothing can be written here."""
        with self._open_lock("sweep"):
            pass

    def record(self, run: Run) -> dict[str, Any] | None:
        """Read the record of a run that was finished with the same configuration; None if there is none.

        A record without settings that were added since counts: they have defaults that keep the run's key.

        Raises
        ------
        StorageError
            If the record is damaged.
        """
        return _read_record(self.record_path(run), run)

    def result(self, run: Run) -> dict[str, Any]:
        """Read the result of a finished run.

        Raises
        ------
        StorageError
            If it is not finished, or its record is damaged.
        """
        record = self.record(run)
        if record is None:
            raise StorageError(f"{run.key} is not finished: {self.record_path(run)} is not of such a run")
        result: dict[str, Any] = record["result"]
        return result

    def is_complete(self, run: Run, with_files: bool = True) -> bool:
        """Whether a run is finished and, if that is asked for, the files are here that other runs read.

        Raises
        ------
        StorageError
            If its record is damaged.
        """
        if self.record(run) is None:
            return False
        return not (with_files and run.leaves_files) or (
            _read_record(self.files(run) / _RECORD, run) is not None
        )

    def files(self, run: Run) -> Path:
        """Where a run works and leaves its files."""
        return self.folder / "files" / run.key

    def left_by(self, run: Run) -> list[Path]:
        """List the files and the record of a finished run; last come those that say that it is complete."""
        mark = self.files(run) / _RECORD
        files = [path for path in self.files(run).rglob("*") if path.is_file()]
        return [*sorted(files, key=lambda path: path == mark), self.record_path(run)]

    def record_path(self, run: Run) -> Path:
        """Where a run's record is kept."""
        return self.folder / "records" / f"{run.key}.json"

    def log_path(self, run: Run) -> Path:
        """Where what a run prints is kept, until it is finished."""
        return self.folder / "logs" / f"{run.key}.txt"

    @contextmanager
    def hold(self, run: Run) -> Iterator[None]:
        """Keep other processes from carrying out a run; waits while one does.

        The lock goes with the process, however it ends.

        Raises
        ------
        StorageError
            If the folder cannot be written to.
        """
        with self._open_lock(run.key) as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def is_held(self, run: Run) -> bool:
        """Whether a process is carrying out a run.

        Raises
        ------
        StorageError
            If the folder cannot be written to.
        """
        with self._open_lock(run.key) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    def perform(self, run: Run, commit: str | None) -> None:
        """Carry out a run whose needs are met, and keep its record.

        Nothing is done if it turns out to be complete. What another attempt at the same configuration has
        left in its folder is there for it to go on from. Where files alone were missing, the record is
        replaced: it tells of the files that are there.

        Parameters
        ----------
        run
            The run.
        commit
            Of the code, for the record.

        Raises
        ------
        StorageError
            If something cannot be written.
        """
        with self.hold(run):
            if not self.is_complete(run):
                self._perform(run, commit)

    def _perform(self, run: Run, commit: str | None) -> None:
        folder = self.files(run)
        record = _read_record(folder / _RECORD, run)
        if record is None:
            identity = {"kind": run.kind, "configuration": run.configuration()}
            self._begin(folder, identity)
            started = time.perf_counter()
            result = run.execute(Workspace(folder, self.files, self.result))
            record = {**identity, **provenance(started), "commit": commit, "result": result}
            if run.leaves_files:
                write_json(folder / _RECORD, record)
        write_json(self.record_path(run), record)
        if not run.leaves_files:
            shutil.rmtree(folder, ignore_errors=True)

    def _begin(self, folder: Path, identity: dict[str, Any]) -> None:
        """Make a run's folder; what an attempt at another configuration has left in it is removed."""
        begun = folder / _BEGUN
        if begun.exists() and agrees(read_json(begun), identity):
            return
        try:
            if folder.exists():
                shutil.rmtree(folder)
        except OSError as error:
            raise StorageError(f"cannot remove {folder}: {error.strerror}") from error
        write_json(begun, identity)

    def _open_lock(self, name: str) -> IO[str]:
        path = self.folder / "locks" / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            return path.open("w")
        except OSError as error:
            raise StorageError(f"cannot write to {self.folder}: {error.strerror}") from error


def _read_record(path: Path, run: Run) -> dict[str, Any] | None:
    try:
        if not path.exists():
            return None
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror}") from error
    record = read_json(path)
    if not isinstance(record, dict) or not all(
        name in record and isinstance(record[name], kind) for name, kind in _FIELDS.items()
    ):
        raise StorageError(f"{path} is damaged: it is no record of a run; remove it to do the run again")
    return record if agrees(record["configuration"], run.configuration()) else None
