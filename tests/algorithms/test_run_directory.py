"""A run's folder: one process at a time, and lines that are there as a whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moral_algorithms.run_directory import RunDirectory, append_line, read_lines, repair_lines, write_lines
from moral_algorithms.storage import StorageError, read_json, write_json
from tests.algorithms.full_disk import files_in, full_disk

HOLD = """
import sys
from moral_algorithms.run_directory import RunDirectory
with RunDirectory(sys.argv[1]).hold():
    print("held", flush=True)
    sys.stdin.read()
"""


def test_one_process_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "run"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdin is not None
    assert holder.stdout is not None
    with holder:
        assert holder.stdout.readline() == "held\n"
        with (
            pytest.raises(StorageError, match="is in use by another process") as error,
            RunDirectory(path).hold(),
        ):
            pytest.fail("the folder was held twice")
        assert "\n" not in str(error.value)
        # However the process ends, its lock goes with it.
        holder.kill()
    held = False
    with RunDirectory(path).hold():
        held = True
    assert held


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "run"
    with (
        pytest.raises(StorageError, match=r"cannot use .*file/run as a run directory"),
        RunDirectory(path).hold(),
    ):
        pytest.fail("there is no such folder")


def test_an_exception_inside_is_let_through(tmp_path: Path) -> None:
    with pytest.raises(BlockingIOError, match="mine"), RunDirectory(tmp_path).hold():
        raise BlockingIOError("mine")


def test_a_configuration_comes_back_and_is_compared(tmp_path: Path) -> None:
    directory = RunDirectory(tmp_path)
    directory.require_new()
    directory.write_config({"seed": 3, "weights": (1.0, 2.0)})
    config = directory.read_config()
    assert (config["seed"], config["weights"], config["format_version"]) == (3, [1, 2], 1)
    assert {"python", "numpy", "torch", "stable-baselines3", "gymnasium"} <= config["versions"].keys()
    directory.require_config({"seed": 3, "weights": (1.0, 2.0)})
    with pytest.raises(StorageError, match="was started with seed = 3; now it is 4"):
        directory.require_config({"seed": 4, "weights": (1.0, 2.0)})
    with pytest.raises(StorageError, match=r"holds a run already \(config\.json\)"):
        directory.require_new()


@pytest.mark.parametrize("name", ["checkpoint.safetensors", "queries.jsonl", "summary.json"])
def test_what_is_left_of_a_run_is_named(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(StorageError, match=rf"holds a run already \({name}\); choose another folder"):
        RunDirectory(tmp_path).require_new()


@pytest.mark.parametrize("value", [[], {}, {"format_version": 0}, {"format_version": "1"}])
def test_a_configuration_of_another_format_is_refused(tmp_path: Path, value: object) -> None:
    directory = RunDirectory(tmp_path)
    write_json(directory.config, value)
    with pytest.raises(StorageError, match="is not of format 1"):
        directory.read_config()


def test_a_missing_configuration_is_named(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"there is no file .*config\.json"):
        RunDirectory(tmp_path).read_config()


def test_lines_come_back(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    assert read_lines(path) == []
    values = [{"a": 1}, [1, 2], "é\n", None]
    for count, value in enumerate(values):
        append_line(path, value)
        assert read_lines(path) == values[: count + 1]
    assert len(path.read_bytes().splitlines()) == 4
    write_lines(path, values[:2])
    assert read_lines(path) == values[:2]
    append_line(path, 5)
    assert read_lines(path) == [*values[:2], 5]


@settings(max_examples=25)
@given(cut=st.integers(1, 29))
def test_a_torn_last_line_is_ignored_until_it_is_repaired(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    path = tmp_path_factory.mktemp("torn") / "lines"
    append_line(path, "whole")
    append_line(path, "a line of thirty bytes here")
    assert path.stat().st_size == 8 + 30
    os.truncate(path, 8 + cut)
    assert read_lines(path) == ["whole"]
    assert path.stat().st_size == 8 + cut
    repair_lines(path)
    assert path.read_bytes() == b'"whole"\n'
    repair_lines(path)
    append_line(path, "next")
    assert read_lines(path) == ["whole", "next"]


def test_another_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    path.write_bytes(b'"one"\n"tw\n"three"\n')
    with pytest.raises(StorageError, match="lines is damaged in line 2") as error:
        read_lines(path)
    assert "\n" not in str(error.value)
    with pytest.raises(StorageError, match="cannot read"):
        read_lines(tmp_path)
    with pytest.raises(StorageError, match="cannot repair"):
        repair_lines(tmp_path)


def test_no_lines_need_no_repair(tmp_path: Path) -> None:
    repair_lines(tmp_path / "lines")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_in_the_middle_of_a_line_takes_it_back(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    append_line(path, "first")
    before = path.read_bytes()
    with full_disk(100), pytest.raises(StorageError, match="cannot write") as error:
        append_line(path, "x" * 150)
    assert "\n" not in str(error.value)
    assert path.read_bytes() == before
    append_line(path, "second")
    assert read_lines(path) == ["first", "second"]


def test_a_line_that_does_not_reach_the_disk_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "lines"
    append_line(path, "first")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StorageError, match="No space left on device"):
        append_line(path, "second")
    assert read_lines(path) == ["first"]


def test_a_full_disk_leaves_the_lines_that_were_to_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    append_line(path, "first")
    with full_disk(100), pytest.raises(StorageError, match="cannot write"):
        write_lines(path, ["x" * 60, "y" * 60])
    assert read_lines(path) == ["first"]
    assert files_in(tmp_path) == ["lines"]


def test_files_have_the_names_that_are_documented(tmp_path: Path) -> None:
    directory = RunDirectory(tmp_path)
    write_json(directory.summary, {"queries": 25})
    assert read_json(tmp_path / "summary.json") == {"queries": 25}
    names = [p.name for p in (directory.config, directory.queries, directory.metrics, directory.checkpoint)]
    assert names == ["config.json", "queries.jsonl", "metrics.jsonl", "checkpoint.safetensors"]
    assert directory.policy.name == "policy.safetensors"
