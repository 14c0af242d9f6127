"""Runs: frozen configurations that know how to be carried out, and by what they are recognised."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple


class Workspace(NamedTuple):
    """What a run finds when it is carried out."""

    folder: Path
    """The run's own files. What a killed attempt has left in it is still there."""
    of: Callable[[Run], Path]
    """Finds the folder of a needed run that leaves files."""
    result_of: Callable[[Run], dict[str, Any]]
    """Finds the result of a needed run."""


@dataclass(frozen=True)
class Run:
    """One run of a benchmark; a subclass adds fields that JSON can hold, and `execute`.

    Fields are numbers, strings, booleans, None, and tuples, mappings and frozen dataclasses of those; runs
    may hold other runs. Two runs of the same class and fields are the same run and are done once.
    """

    leaves_files: ClassVar[bool] = False
    """Whether other runs read its folder; that of any other run is removed when it is done."""

    def needs(self) -> tuple[Run, ...]:
        """List the runs that must be done before this one."""
        return ()

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Carry it out.

        Parameters
        ----------
        workspace
            Its folder, and where the needed runs are found.

        Returns
        -------
        dict
            The result, in values that JSON can hold.
        """
        raise NotImplementedError

    @property
    def kind(self) -> str:
        """Name of the class."""
        return type(self).__name__

    @property
    def key(self) -> str:
        """Name under which its record is kept: its kind, and a hash of what differs from the defaults.

        Settings that are added later, with a default that keeps the old behaviour, leave it as it is. A
        default that changes is found by comparing the whole configuration; see :class:`Store`.
        """
        canonical = json.dumps(_differing(self), sort_keys=True)
        return f"{self.kind}-{hashlib.sha256(canonical.encode()).hexdigest()[:16]}"

    def configuration(self) -> dict[str, Any]:
        """Every setting, as plain values."""
        configuration: dict[str, Any] = _plain(self)
        return configuration


def with_needs(runs: Sequence[Run]) -> list[Run]:
    """List runs and all that they need, each once, needed ones first."""
    found: dict[str, Run] = {}

    def visit(run: Run) -> None:
        if run.key not in found:
            for needed in run.needs():
                visit(needed)
            found[run.key] = run

    for run in runs:
        visit(run)
    return list(found.values())


def _plain(value: Any) -> Any:
    """Turn a configuration into values that JSON can hold."""
    if is_dataclass(value):
        plain = {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
        return {"kind": value.kind, **plain} if isinstance(value, Run) else plain
    return _container(value, _plain)


def _differing(value: Any) -> Any:
    """Turn a configuration into plain values, without the settings that have their class's defaults."""
    if is_dataclass(value):
        plain = {field.name: _differing(given) for field, given in _given(value)}
        return {"kind": value.kind, **plain} if isinstance(value, Run) else plain
    return _container(value, _differing)


def _given(value: Any) -> Iterator[tuple[Field[Any], Any]]:
    for field in fields(value):
        given = getattr(value, field.name)
        default = field.default if field.default_factory is MISSING else field.default_factory()
        if default is MISSING or given != default:
            yield field, given


def _container(value: Any, convert: Callable[[Any], Any]) -> Any:
    if isinstance(value, Mapping):
        return {str(name): convert(entry) for name, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [convert(entry) for entry in value]
    if value is None or isinstance(value, (str, int, float, bool)):
        return value
    raise TypeError(f"a run holds {value!r}; it may hold what JSON can, mappings, tuples and dataclasses")
