"""A run's folder: everything it produced, and everything it needs to go on.

========================== ==================================================================================
``config.json``            the run's configuration, seed, versions of packages and of the format
``queries.jsonl``          one line per answered query, appended and flushed before it counts
``metrics.jsonl``          one line per rollout
``checkpoint.safetensors`` the whole state of training between two rollouts
``policy.safetensors``     the trained policy
``reward.safetensors``     a learned reward network (AIRL) or ensemble (DRLHP)
``learned_1.safetensors``  copies of the reward networks that a run of MORAL trains under, by component
``normalisers.json``       returns of policies that pursue one primary component alone (MORAL)
``people.json``            who answers, what they accept first and how components are called to them
``covering.safetensors``   a policy for all weights, from which queries make agents
``summary.json``           the result, written last
``run.lock``               held while a process writes here
========================== ==================================================================================
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from moral_algorithms.storage import (
    StorageError,
    StrPath,
    atomic_write,
    read_json,
    remove_remains,
    write_json,
)

FORMAT_VERSION = 1


class RunDirectory:
    """One run's folder, held by one process at a time.

    Parameters
    ----------
    path
        The folder; it is made if it does not exist.
    """

    def __init__(self, path: StrPath) -> None:
        self.path = path = Path(path)
        self.config = path / "config.json"
        self.queries = path / "queries.jsonl"
        self.metrics = path / "metrics.jsonl"
        self.checkpoint = path / "checkpoint.safetensors"
        self.policy = path / "policy.safetensors"
        self.summary = path / "summary.json"

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Keep other processes out until the block ends; the lock goes with the process, however it ends.

        What an earlier process that was killed has left of files it was writing is removed.

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
            except BlockingIOError as error:
                raise StorageError(f"{self.path} is in use by another process") from error
            except OSError as error:
                raise StorageError(f"cannot lock {self.path}: {error.strerror}") from error
            remove_remains(self.path)
            yield

    def require_new(self) -> None:
        """Raise a StorageError if a run has already been started here, whatever is left of it."""
        for path in (self.config, self.checkpoint, self.queries, self.summary):
            if path.exists():
                raise StorageError(
                    f"{self.path} holds a run already ({path.name}); choose another folder, or --resume it"
                )

    def write_config(self, config: dict[str, Any]) -> None:
        """Write the configuration, JSON-able values by name, with the versions it runs under.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        write_json(self.config, {"format_version": FORMAT_VERSION, **config, "versions": versions()})

    def read_config(self) -> dict[str, Any]:
        """Read the configuration of the run that was started here.

        Raises
        ------
        StorageError
            If it is missing, damaged or of another format.
        """
        config = read_json(self.config)
        if not isinstance(config, dict) or config.get("format_version") != FORMAT_VERSION:
            raise StorageError(f"{self.config} is not of format {FORMAT_VERSION}, which this release reads")
        return config

    def require_config(self, config: dict[str, Any]) -> None:
        """Raise a StorageError if the run here was started with another configuration."""
        stored = self.read_config()
        for name, value in json.loads(json.dumps(config)).items():
            for part, before, now in _differences(name, stored.get(name), value):
                raise StorageError(f"{self.path} was started with {part} = {before}; now it is {now}")


def _differences(name: str, before: Any, now: Any) -> Iterator[tuple[str, Any, Any]]:
    """Name what differs between two JSON values, as deep inside objects as it lies."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted({*before, *now}):
            yield from _differences(f"{name}.{key}", before.get(key), now.get(key))
    elif before != now:
        yield name, before, now


def append_line(path: Path, value: Any) -> None:
    """Append ``value`` as one JSON line and flush it to the disk.

    Raises
    ------
    StorageError
        If it cannot be written; a line that was begun is taken back.
    """
    line = json.dumps(value).encode() + b"\n"
    try:
        # Without a buffer: closing the file would write what is left in it of a line that was taken back.
        with path.open("ab", buffering=0) as file:
            start = file.tell()
            try:
                while line:
                    line = line[file.write(line) :]
                os.fsync(file.fileno())
            except OSError:
                os.ftruncate(file.fileno(), start)
                raise
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror}") from error


def read_lines(path: StrPath) -> list[Any]:
    """Read the complete JSON lines of a file; a last line cut off by a crash is not one of them.

    Raises
    ------
    StorageError
        If it cannot be read, or another line is damaged.
    """
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror}") from error
    lines = []
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        try:
            lines.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            raise StorageError(f"{path} is damaged in line {number}: {error}") from error
    return lines


def repair_lines(path: Path) -> None:
    """Remove a last line cut off by a crash, so that lines can be appended; the caller holds the folder.

    Raises
    ------
    StorageError
        If it cannot be read or written.
    """
    try:
        content = Path(path).read_bytes()
        complete = content.rfind(b"\n") + 1
        if complete < len(content):
            os.truncate(path, complete)
    except FileNotFoundError:
        return
    except OSError as error:
        raise StorageError(f"cannot repair {path}: {error.strerror}") from error


def write_lines(path: Path, values: Iterable[Any]) -> None:
    """Replace a file by one JSON line for each of ``values``.

    Raises
    ------
    StorageError
        If it cannot be written; the file is untouched then.
    """
    with atomic_write(path) as file:
        file.writelines(json.dumps(value).encode() + b"\n" for value in values)


def versions() -> dict[str, str]:
    """Find the versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    for name in ("moral-envs", "moral-algorithms", "numpy", "torch", "stable-baselines3", "gymnasium"):
        # In a source tree that is not installed, the packages themselves have no version.
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def commit() -> str | None:
    """Find the commit of the working tree that this code runs from, marked if changed; None without one."""
    here = Path(__file__)
    question = ["git", "-C", str(here.parent)]
    try:
        subprocess.run([*question, "ls-files", "--error-unmatch", here.name], capture_output=True, check=True)
        described = subprocess.run(
            [*question, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            capture_output=True,
            check=True,
            text=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return described.stdout.strip()
