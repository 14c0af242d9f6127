"""Runs: frozen configurations that know how to be carried out, and by what they are recognised."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cached_property
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

    Fields are finite numbers, strings, booleans, None, and tuples, mappings with string keys and frozen
    dataclasses of those; runs may hold other runs. Two runs of the same class and fields are the same run and
    are done once; 1, 1.0 and -0.0, 0 are the same numbers.
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

    @cached_property
    def key(self) -> str:
        """Name under which its record is kept: its kind, and a hash of what differs from the defaults.

        Settings that are added later, with a default that keeps the old behaviour, leave it as it is. A
        default that changes is found by comparing the whole configuration; see :class:`Store`.

        Raises
        ------
        TypeError
            If a field holds what it may not.
        ValueError
            If a number is not finite.
        """
        return f"{self.kind}-{hashlib.sha256(_canonical(_differing(self)).encode()).hexdigest()[:16]}"

    def configuration(self) -> dict[str, Any]:
        """Every setting, as plain values; those of a dataclass with its name as ``kind``."""
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


def agrees(stored: Any, wanted: Any) -> bool:
    """Whether two configurations of the same key agree in all that the stored one knows.

    Settings of a dataclass that it does not know were added since it was stored, with a default.
    """
    if isinstance(stored, dict) and isinstance(wanted, dict):
        same_names = stored.keys() == wanted.keys() or ("kind" in stored and stored.keys() < wanted.keys())
        return same_names and all(agrees(entry, wanted[name]) for name, entry in stored.items())
    if isinstance(stored, list) and isinstance(wanted, list):
        return len(stored) == len(wanted) and all(map(agrees, stored, wanted))
    return _canonical(stored) == _canonical(wanted)


def _canonical(plain: Any) -> str:
    """Write plain values so that equal ones give equal text, and a boolean differs from a number."""
    return json.dumps(plain, sort_keys=True, allow_nan=False)


def _plain(value: Any) -> Any:
    """Turn a configuration into values that JSON can hold."""
    return _converted(value, lambda field, given: True)


def _differing(value: Any) -> Any:
    """Turn a configuration into plain values, without the settings that have their class's defaults."""
    return _converted(value, _differs_from_default)


def _differs_from_default(field: Field[Any], given: Any) -> bool:
    default = field.default if field.default_factory is MISSING else field.default_factory()
    return default is MISSING or _canonical(_plain(given)) != _canonical(_plain(default))


def _converted(value: Any, keep: Callable[[Field[Any], Any], bool]) -> Any:
    """Turn a value into what JSON can hold; of a dataclass, the fields that are to be kept."""
    if is_dataclass(value) and not isinstance(value, type):
        given = [(field, getattr(value, field.name)) for field in fields(value)]
        kept = {field.name: _converted(entry, keep) for field, entry in given if keep(field, entry)}
        return {"kind": type(value).__name__, **kept}
    if isinstance(value, Mapping):
        if not all(isinstance(name, str) for name in value):
            raise TypeError(f"a run holds {value!r}; the keys of a mapping must be strings")
        return {name: _converted(entry, keep) for name, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [_converted(entry, keep) for entry in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"a run holds {value}; its numbers must be finite")
        return int(value) if value.is_integer() else float(value)
    if value is None or isinstance(value, (str, bool, int)):
        return value
    raise TypeError(f"a run holds {value!r}; it may hold what JSON can, mappings, tuples and dataclasses")
