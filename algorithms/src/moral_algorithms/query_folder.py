"""Posted queries: the folder in which training leaves them for whoever puts them to a person.

===================  =======================================================================================
``queue/N.json``     query N as it was posted (:class:`~moral_algorithms.answers.AskedQuery`); never changed
``queue/open.json``  ``version`` (1) and ``open``: the queries to be answered now, the most useful first, each
                     with its number (``query``) and what its answer is ``expected`` to save
``live/stop.json``   is there if somebody wants no more queries
===================  =======================================================================================
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from moral_algorithms.answers import AskedQuery
from moral_algorithms.storage import (
    StorageError,
    first_line,
    has_fields,
    read_json,
    remove_remains,
    write_json,
)

VERSION = 1

_ENTRY = {"query": int, "expected": float}


class QueryFolder:
    """The posted queries of a run.

    Parameters
    ----------
    run
        The run directory.
    """

    def __init__(self, run: Path) -> None:
        self.path = run / "queue"
        self.open_path = self.path / "open.json"
        self._stop = run / "live" / "stop.json"

    def prepare(self) -> None:
        """Make the folder; the process that posts calls this first.

        Raises
        ------
        StorageError
            If it cannot be made.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot make {self.path}: {error.strerror}") from error
        remove_remains(self.path)

    def post(self, asked: AskedQuery) -> None:
        """Write a query; it is not open yet.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        write_json(self._file(asked.number), asked.to_json())

    def numbers(self) -> list[int]:
        """Numbers of all queries that were ever posted, in order."""
        names = (path.name for path in self.path.iterdir()) if self.path.exists() else ()
        return sorted(int(name[:-5]) for name in names if re.fullmatch(r"[0-9]+\.json", name))

    def read(self, number: int) -> AskedQuery | None:
        """Read a query; None if there is none of that number.

        Raises
        ------
        StorageError
            If it is damaged.
        """
        path = self._file(number)
        if not path.exists():
            return None
        try:
            asked = AskedQuery.from_json(read_json(path))
            if asked.number != number:
                raise ValueError(f"it holds query {asked.number}")
        except StorageError:
            raise
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
            raise StorageError(f"{path} is damaged: {first_line(error)}") from error
        return asked

    def write_open(self, expected: dict[int, float]) -> None:
        """Say which queries are open, and how much return each is expected to save.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        best_first = sorted(expected, key=lambda number: -expected[number])
        entries = [{"query": number, "expected": expected[number]} for number in best_first]
        write_json(self.open_path, {"version": VERSION, "open": entries})

    def read_open(self) -> dict[int, float]:
        """Read what `write_open` wrote, the most useful query first; empty before the first.

        Raises
        ------
        StorageError
            If it is damaged.
        """
        if not self.open_path.exists():
            return {}
        content = read_json(self.open_path)
        entries: Any = None
        if isinstance(content, dict) and content.get("version") == VERSION:
            entries = content.get("open")
        if not isinstance(entries, list) or not all(has_fields(entry, _ENTRY) for entry in entries):
            raise StorageError(f"{self.open_path} is damaged, or not of version {VERSION}")
        return {entry["query"]: entry["expected"] for entry in entries}

    @property
    def stopped(self) -> bool:
        """Whether somebody wants no more queries."""
        return self._stop.exists()

    def stop(self) -> None:
        """Ask for no more queries; the training then closes.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        write_json(self._stop, {"version": VERSION})

    def _file(self, number: int) -> Path:
        return self.path / f"{number}.json"
