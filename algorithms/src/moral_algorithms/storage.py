"""Files that survive crashes and full disks, and that are safe to load.

Everything is written to a temporary name, flushed to the disk and renamed: a file is either the last complete
one or the new complete one. What is loaded is JSON, NumPy arrays without pickles or safetensors: nothing in a
file can be executed.
"""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeGuard

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

StrPath = str | os.PathLike[str]
"""What a file may be named by."""


class StorageError(ValueError):
    """A file that cannot be read or written, in one line."""


@contextmanager
def atomic_write(path: StrPath) -> Iterator[IO[bytes]]:
    """Open a file that appears under ``path`` only when it is complete.

    Raises
    ------
    StorageError
        If it cannot be written, for instance on a full disk; what stood at ``path`` is untouched then.
    """
    path = Path(path)
    # Not the tempfile module: its files are readable by their owner alone, whatever the umask says.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_remains(folder: Path) -> None:
    """Remove what is left of files that a process was writing into ``folder`` when it was killed.

    Raises
    ------
    StorageError
        If it cannot be removed.
    """
    try:
        for path in folder.iterdir():
            if re.fullmatch(r"\..+\.[0-9a-f]{8}", path.name):
                path.unlink()
    except OSError as error:
        raise StorageError(f"cannot tidy up {folder}: {error.strerror or error}") from error


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as indented JSON.

    Raises
    ------
    StorageError
        If it cannot be written; what stood at ``path`` is untouched then.
    """
    with atomic_write(path) as file:
        file.write((json.dumps(value, indent=2) + "\n").encode())


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    StorageError
        If it is missing or not JSON.
    """
    return _read(path, lambda: json.loads(path.read_text(encoding="utf-8")))


def has_fields(value: Any, types: Mapping[str, type]) -> TypeGuard[dict[str, Any]]:
    """Whether a value that was read is an object with exactly these fields, each of its type."""
    return isinstance(value, dict) and {name: type(entry) for name, entry in value.items()} == types


def are_numbers(*tables: Mapping[str, Any]) -> bool:
    """Whether all values of tables that were read are numbers."""
    return all(type(value) in (int, float) for table in tables for value in table.values())


def write_tensors(path: StrPath, arrays: Mapping[str, NDArray[Any]], metadata: Mapping[str, Any]) -> None:
    """Write arrays and JSON-able metadata as one safetensors file.

    ``metadata["kind"]`` says what the file is, for :func:`read_tensors`.

    Raises
    ------
    StorageError
        If it cannot be written; what stood at ``path`` is untouched then.
    """
    # Not ascontiguousarray, which makes a vector of a scalar.
    payload = safetensors.numpy.save(
        {name: np.asarray(array, order="C") for name, array in arrays.items()},
        metadata={"moral": json.dumps(dict(metadata))},
    )
    with atomic_write(path) as file:
        file.write(payload)


def read_tensors(path: StrPath, kind: str) -> tuple[Arrays, dict[str, Any]]:
    """Read what :func:`write_tensors` wrote.

    Parameters
    ----------
    path
        The file.
    kind
        What ``metadata["kind"]`` must be.

    Returns
    -------
    arrays, metadata
        As they were given to :func:`write_tensors`.

    Raises
    ------
    StorageError
        If the file is missing, truncated or of another kind.
    """

    def read() -> tuple[Arrays, dict[str, Any]]:
        with safetensors.safe_open(path, framework="numpy") as file:
            metadata = json.loads((file.metadata() or {}).get("moral", "{}"))
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        return arrays, metadata

    arrays, metadata = _read(path, read)
    if not isinstance(metadata, dict) or metadata.get("kind") != kind:
        found = metadata.get("kind") if isinstance(metadata, dict) else None
        raise StorageError(f"{path} holds {found!r}; it must hold {kind!r}")
    return arrays, metadata


def arrays_under(arrays: Arrays, prefix: str) -> Arrays:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {name[len(prefix) :]: value for name, value in arrays.items() if name.startswith(prefix)}


def first_line(error: Exception) -> str:
    """Return what an error says in its first line, or its type where it says nothing."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _read(path: StrPath, read: Callable[[], Any]) -> Any:
    try:
        return read()
    except FileNotFoundError as error:
        raise StorageError(f"there is no file {path}") from error
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValueError, KeyError, RecursionError, safetensors.SafetensorError) as error:
        raise StorageError(f"{path} is damaged or not what it should be: {first_line(error)}") from error
