"""What runs that can be resumed have in common."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from moral_algorithms.pipeline.stage import Setting, require_kind
from moral_algorithms.run_directory import RunDirectory, versions
from moral_algorithms.storage import StorageError


def read_resumable(directory: RunDirectory, kind: str) -> dict[str, Any]:
    """Read the configuration of the run of a kind in a directory.

    Raises
    ------
    StorageError
        If there is none.
    """
    if not directory.config.exists():
        raise StorageError(f"there is no run in {directory.path} to resume; start it without --resume")
    config = directory.read_config()
    require_kind(directory, config, kind)
    return config


def read_setting(directory: RunDirectory, kind: str) -> Setting:
    """Read how the run of a kind in a directory was started to be run.

    Raises
    ------
    StorageError
        If there is none, or its configuration is damaged.
    """
    try:
        return Setting.from_json(read_resumable(directory, kind).get("setting"))
    except ValueError as error:
        if isinstance(error, StorageError):
            raise
        raise StorageError(f"{directory.config} is damaged: {error}") from error


def how_to_resume(directory: RunDirectory, kind: str) -> str:
    """Say how to go on with a run that was interrupted."""
    return f"go on with: moral {kind} --resume --out {directory.path}"


@contextmanager
def resumable(directory: RunDirectory, kind: str) -> Iterator[None]:
    """Add to what stopped a run how to go on with it."""
    try:
        yield
    except (StorageError, OSError) as error:
        raise StorageError(f"{error}; {how_to_resume(directory, kind)}") from error


def changes_since_start(directory: RunDirectory, kind: str, setting: Setting) -> list[str]:
    """Say, in one line each, why a run that goes on may end otherwise than it would have uninterrupted."""
    stored = read_resumable(directory, kind).get("versions")
    known = stored if isinstance(stored, dict) else {}
    before, now = read_setting(directory, kind).to_json(), setting.to_json()
    machine = {name: (before[name], now[name]) for name in ("device", "threads")}
    packages = {name: (known.get(name), versions().get(name)) for name in sorted({*known, *versions()})}
    warnings = []
    for parts in (machine, packages):
        changed = [f"{name} {old}, now {new}" for name, (old, new) in parts.items() if old != new]
        if changed:
            warnings.append(f"the run was started with {', '.join(changed)}; results may differ")
    return warnings
