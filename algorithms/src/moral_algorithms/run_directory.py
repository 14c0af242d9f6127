"""A run's folder: everything it produced, and everything it needs to go on.

=========================  ==================================================================================
``config.json``            the run's configuration, seed, versions of packages and of the format
``queries.jsonl``          one line per answered query, appended and flushed before it counts
``metrics.jsonl``          one line per rollout
``checkpoint.safetensors`` the whole state of training between two rollouts
``policy.safetensors``     the trained policy
``summary.json``           the result, written last
``run.lock``               held while a process writes here
=========================  ==================================================================================
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from moral_algorithms.storage import StorageError, read_json, write_json

FORMAT_VERSION = 1


class RunDirectory:
    """One run's folder, held by one process at a time.

    Parameters
    ----------
    path
        The folder; it is made if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / "config.json"
        self.queries = path / "queries.jsonl"
        self.metrics = path / "metrics.jsonl"
        self.checkpoint = path / "checkpoint.safetensors"
        self.policy = path / "policy.safetensors"
        self.summary = path / "summary.json"

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Keep other processes out until the block ends; the lock goes with the process, however it ends.

        Raises
        ------
        StorageError
            If another process holds the folder, or it cannot be made.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            file = (self.path / "run.lock").open("w")
        except OSError as error:
            raise StorageError(f"cannot use {self.path} as a run directory: {error.strerror}") from error
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise StorageError(f"{self.path} is in use by another process") from error
            yield

    def require_new(self) -> None:
        """Raise a StorageError if a run has already been started here."""
        if self.config.exists():
            raise StorageError(f"{self.path} holds a run already; choose another folder, or --resume it")

    def write_config(self, config: dict[str, Any]) -> None:
        """Write the configuration, with the versions it runs under."""
        write_json(self.config, {"format_version": FORMAT_VERSION, **config, "versions": versions()})

    def read_config(self) -> dict[str, Any]:
        """Read the configuration of the run that was started here."""
        config = read_json(self.config)
        if not isinstance(config, dict) or config.get("format_version") != FORMAT_VERSION:
            raise StorageError(f"{self.config} is not of format {FORMAT_VERSION}, which this release reads")
        return config

    def require_config(self, config: dict[str, Any]) -> None:
        """Raise a StorageError if the run here was started with another configuration."""
        stored = self.read_config()
        for name, value in json.loads(json.dumps(config)).items():
            if stored.get(name) != value:
                raise StorageError(f"{self.path} was started with {name} = {stored.get(name)}; now it is {value}")


def append_line(path: Path, value: Any) -> None:
    """Append ``value`` as one JSON line and flush it to the disk.

    Raises
    ------
    StorageError
        If it cannot be written; a line that was begun is taken back.
    """
    try:
        with path.open("ab") as file:
            start = file.tell()
            try:
                file.write(json.dumps(value).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                os.ftruncate(file.fileno(), start)
                raise
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror}") from error


def read_lines(path: Path) -> list[Any]:
    """Read the complete JSON lines of a file; a last line cut off by a crash is removed from it.

    Raises
    ------
    StorageError
        If another line is damaged.
    """
    if not path.exists():
        return []
    content = path.read_bytes()
    complete = content[: content.rfind(b"\n") + 1]
    if complete != content:
        os.truncate(path, len(complete))
    try:
        return [json.loads(line) for line in complete.splitlines()]
    except ValueError as error:
        raise StorageError(f"{path} is damaged: {error}") from error


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    packages = ("moral-envs", "moral-algorithms", "numpy", "torch", "stable-baselines3", "gymnasium")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}
