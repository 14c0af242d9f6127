"""Records of finished runs, found again by what the runs were configured with."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

from benchmarks.harness.run import Run, Workspace
from benchmarks.provenance import provenance
from moral_algorithms.storage import StorageError, read_json, write_json

_RECORD = "record.json"


class Store:
    """A folder of records, and of the files that runs leave for each other.

    ``records/KEY.json`` holds a finished run's configuration, its result and where that comes from.
    ``files/KEY/`` is where a run works; of a run that other runs read it stays, with a copy of the record as
    the last file, which says that the others are complete.

    Parameters
    ----------
    folder
        Where they are; it is made when something is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

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

    def has_files(self, run: Run) -> bool:
        """Whether the files that a run leaves are here, complete and of the same configuration."""
        return _read_record(self.files(run) / _RECORD, run) is not None

    def files(self, run: Run) -> Path:
        """Where a run works and leaves its files."""
        return self.folder / "files" / run.key

    def perform(self, run: Run) -> None:
        """Carry out a run whose needs are met, and keep its record.

        A record that is there already stays: this may be a run whose files alone are missing.

        Raises
        ------
        StorageError
            If something cannot be written.
        """
        folder = self.files(run)
        folder.mkdir(parents=True, exist_ok=True)
        started = time.perf_counter()
        result = run.execute(Workspace(folder, self.files, self.result))
        record = {
            "kind": run.kind,
            "configuration": run.configuration(),
            **provenance(started),
            "result": result,
        }
        if run.leaves_files:
            write_json(folder / _RECORD, record)
        if self.record(run) is None:
            write_json(self.record_path(run), record)
        if not run.leaves_files:
            shutil.rmtree(folder)

    def record_path(self, run: Run) -> Path:
        """Where a run's record is kept."""
        return self.folder / "records" / f"{run.key}.json"


def _read_record(path: Path, run: Run) -> dict[str, Any] | None:
    if not path.exists():
        return None
    record = read_json(path)
    if not isinstance(record, dict) or not {"configuration", "result"} <= record.keys():
        raise StorageError(f"{path} is damaged: it is no record of a run")
    return record if _agrees(record["configuration"], run.configuration()) else None


def _agrees(stored: Any, wanted: Any) -> bool:
    """Whether two configurations agree in all that the stored one knows."""
    if isinstance(stored, dict) and isinstance(wanted, dict):
        return all(name in wanted and _agrees(entry, wanted[name]) for name, entry in stored.items())
    if isinstance(stored, list) and isinstance(wanted, list):
        return len(stored) == len(wanted) and all(map(_agrees, stored, wanted))
    return bool(stored == wanted)
