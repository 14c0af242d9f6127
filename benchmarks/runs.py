"""Results files to which runs are added one by one, so that a benchmark that was stopped goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from moral_algorithms.storage import read_json, write_json


def finished_runs(path: Path, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Read the runs of an earlier call with the same settings, if there was one.

    Parameters
    ----------
    path
        The results file.
    settings
        What makes runs comparable, in values that JSON can hold; they are compared with those in the file.
    """
    if not path.exists():
        return []
    stored = read_json(path)
    same = all(stored.get(name) == value for name, value in settings.items())
    return list(stored["runs"]) if same else []


def store_runs(
    path: Path, benchmark: str, settings: dict[str, Any], summary: Any, runs: Sequence[dict[str, Any]]
) -> None:
    """Write all runs so far, with what they were run with and what they come to."""
    record = {"command": f"python -m benchmarks.{benchmark}", **settings}
    write_json(path, {**record, "summary": summary, "runs": list(runs)})
