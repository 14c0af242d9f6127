"""Files that survive crashes and full disks, and that are safe to load."""

from __future__ import annotations

import json
import os
import pickle
import stat
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moral_algorithms.storage import (
    StorageError,
    atomic_write,
    read_json,
    read_tensors,
    write_json,
    write_tensors,
)
from tests.algorithms.full_disk import files_in, full_disk

ARRAYS = {
    "scalar": np.array(1.5, dtype=np.float32),
    "empty": np.zeros((0, 3)),
    "streams": np.array([2**64 - 1, 0], dtype=np.uint64),
    "flags": np.array([True, False]),
    "transposed": np.arange(6, dtype=np.int64).reshape(2, 3).T,
    "strided": np.arange(10, dtype=np.uint8)[::3],
}


def require_one_line(error: pytest.ExceptionInfo[StorageError], path: Path) -> None:
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


class Bomb:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.trace),)


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "file"
    with atomic_write(path) as file:
        file.write(b"one")
        assert not path.exists()
    assert path.read_bytes() == b"one"
    with atomic_write(path) as file:
        file.write(b"two")
        assert path.read_bytes() == b"one"
    assert path.read_bytes() == b"two"
    assert files_in(path.parent) == ["file"]


def test_an_exception_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def interrupted() -> None:
        with atomic_write(path) as file:
            file.write(b"new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_bytes() == b"old"
    assert files_in(tmp_path) == ["file"]


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_json(path, list(range(5000))),
        lambda path: write_tensors(path, {"zeros": np.zeros(5000)}, {"kind": "test"}),
    ],
)
def test_a_full_disk_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with full_disk(10_000), pytest.raises(StorageError, match="cannot write") as error:
        write(path)
    require_one_line(error, path)
    assert path.read_bytes() == b"old"
    assert files_in(tmp_path) == ["file"]


def test_a_disk_that_is_full_when_flushed_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "file"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StorageError, match="No space left on device"), atomic_write(path) as file:
        file.write(b"new")
    assert path.read_bytes() == b"old"
    assert files_in(tmp_path) == ["file"]


def test_a_path_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "file" / "below", tmp_path / "folder"):
        with pytest.raises(StorageError, match="cannot write") as error:
            write_json(path, 1)
        require_one_line(error, path)
    assert files_in(tmp_path) == ["file", "folder"]


def test_files_are_as_readable_as_any_other(tmp_path: Path) -> None:
    plain, path = tmp_path / "plain", tmp_path / "file"
    plain.touch()
    write_json(path, 1)
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_json_comes_back(tmp_path: Path) -> None:
    value = {"a": [1, 2.5, None, "é"], "b": {"c": True}}
    write_json(tmp_path / "file", value)
    assert read_json(tmp_path / "file") == value


def test_tensors_come_back_with_shape_and_type(tmp_path: Path) -> None:
    metadata = {"kind": "test", "nested": {"seed": 2**100, "list": [1.5, "x"]}}
    write_tensors(tmp_path / "file", ARRAYS, metadata)
    arrays, found = read_tensors(tmp_path / "file", "test")
    assert found == metadata
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        assert arrays[name].shape == array.shape
        np.testing.assert_array_equal(arrays[name], array)


@pytest.mark.parametrize("read", [read_json, lambda path: read_tensors(path, "test")])
def test_a_missing_file_is_named(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    path = tmp_path / "missing"
    with pytest.raises(StorageError, match="there is no file") as error:
        read(path)
    require_one_line(error, path)
    with pytest.raises(StorageError) as error:
        read(tmp_path)
    require_one_line(error, tmp_path)


def test_another_kind_of_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_tensors(path, ARRAYS, {"kind": "reward"})
    with pytest.raises(StorageError, match="holds 'reward'; it must hold 'policy'") as error:
        read_tensors(path, "policy")
    require_one_line(error, path)
    for header in ({}, {"__metadata__": {"moral": "[1]"}}, {"__metadata__": {"other": "x"}}):
        encoded = json.dumps(header).encode()
        path.write_bytes(struct.pack("<Q", len(encoded)) + encoded)
        with pytest.raises(StorageError, match="holds None; it must hold 'policy'"):
            read_tensors(path, "policy")


@settings(max_examples=40)
@given(part=st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_named(tmp_path_factory: pytest.TempPathFactory, part: float) -> None:
    path = tmp_path_factory.mktemp("truncated") / "file"
    write_tensors(path, ARRAYS, {"kind": "test"})
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(StorageError) as error:
        read_tensors(path, "test")
    require_one_line(error, path)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b"{} {}", b"[" * 100_000])
def test_damaged_json_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(StorageError, match="damaged") as error:
        read_json(path)
    require_one_line(error, path)


@pytest.mark.parametrize("read", [read_json, lambda path: read_tensors(path, "test")])
def test_a_pickle_is_never_opened(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    path, trace = tmp_path / "file.safetensors", tmp_path / "trace"
    path.write_bytes(pickle.dumps(Bomb(trace)))
    with pytest.raises(StorageError, match="damaged"):
        read(path)
    assert not trace.exists()
    pickle.loads(path.read_bytes())  # noqa: S301
    assert trace.exists(), "the pickle would have left its trace"
