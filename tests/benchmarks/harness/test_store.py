"""Records and files of runs: found again, made anew where they are of something else, never half written."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from benchmarks.harness import Run, Store, Workspace
from moral_algorithms.storage import StorageError
from tests.algorithms.full_disk import full_disk
from tests.benchmarks.harness.runs import Square, Total, Written, times_carried_out


def perform(store: Store, *runs: Run) -> None:
    for run in runs:
        store.perform(run, "0123abc")


def test_a_finished_run_is_found_by_an_equal_one(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert store.record(Square(3)) is None
    perform(store, Square(3))
    record = Store(tmp_path).record(Square(3.0))
    assert record is not None
    assert record["result"] == {"square": 9}
    assert record["configuration"] == {"kind": "Square", "number": 3, "notes": ""}
    assert record["commit"] == "0123abc"
    assert record["duration_seconds"] >= 0
    assert store.result(Square(3)) == {"square": 9}
    assert not store.files(Square(3)).exists()
    with pytest.raises(StorageError, match="is not finished"):
        store.result(Square(4))


def test_a_complete_run_is_not_done_again(tmp_path: Path) -> None:
    store, run = Store(tmp_path), Written(3, str(tmp_path))
    perform(store, run, run)
    assert times_carried_out(tmp_path, run) == 1


def test_the_record_is_of_the_files_that_were_made_again(tmp_path: Path) -> None:
    store, run = Store(tmp_path), Written(3, str(tmp_path))
    perform(store, run)
    (store.files(run) / "record.json").unlink()
    assert store.is_complete(run, with_files=False)
    assert not store.is_complete(run)
    store.perform(run, "another")
    assert store.is_complete(run)
    record = store.record(run)
    assert record is not None
    assert record["commit"] == "another"
    assert record == json.loads((store.files(run) / "record.json").read_text())
    assert times_carried_out(tmp_path, run) == 2


def test_what_says_that_a_run_is_complete_is_listed_last(tmp_path: Path) -> None:
    store = Store(tmp_path)
    perform(store, Written(3))
    for name in ("a", "z"):
        (store.files(Written(3)) / name).touch()
    first, *_, mark, record = store.left_by(Written(3))
    assert (mark.name, mark.parent) == ("record.json", first.parent)
    assert record == store.record_path(Written(3))
    assert len(store.left_by(Written(3))) == 6


def test_a_lost_record_is_found_beside_the_files(tmp_path: Path) -> None:
    store, run = Store(tmp_path), Written(3, str(tmp_path))
    perform(store, run)
    record = store.record_path(run).read_bytes()
    store.record_path(run).unlink()
    assert not store.is_complete(run)
    perform(store, run)
    assert store.record_path(run).read_bytes() == record
    assert times_carried_out(tmp_path, run) == 1


def test_an_attempt_goes_on_where_another_was_cut_off(tmp_path: Path) -> None:
    @dataclass(frozen=True)
    class Slow(Run):
        steps: int = 3

        def execute(self, workspace: Workspace) -> dict[str, Any]:
            found = len(list(workspace.folder.glob("step*")))
            (workspace.folder / f"step{found}").touch()
            if found + 1 < self.steps:
                raise KeyboardInterrupt
            return {"steps": found + 1}

    store = Store(tmp_path)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            perform(store, Slow())
        assert store.record(Slow()) is None
    perform(store, Slow())
    assert store.result(Slow()) == {"steps": 3}


def grown(default: int) -> Run:
    """A run of the same key, whatever its default; with what an earlier attempt has left for a result."""

    @dataclass(frozen=True)
    class Grown(Run):
        leaves_files: ClassVar[bool] = True
        size: int = default

        def execute(self, workspace: Workspace) -> dict[str, Any]:
            found = sorted(path.name for path in workspace.folder.glob("size*"))
            (workspace.folder / f"size{self.size}").touch()
            return {"size": self.size, "found": found}

    return Grown()


def test_the_record_of_a_run_with_other_defaults_is_replaced_and_so_are_its_files(tmp_path: Path) -> None:
    store, before, now = Store(tmp_path), grown(1), grown(2)
    assert before.key == now.key
    perform(store, before)
    assert store.record(now) is None
    assert not store.is_complete(now)
    perform(store, now)
    assert store.result(now) == {"size": 2, "found": []}
    assert not (store.files(now) / "size1").exists()
    assert store.record(before) is None


def test_needed_files_and_results_are_at_hand(tmp_path: Path) -> None:
    store = Store(tmp_path)
    perform(store, Written(2), Square(3), Total((Written(2), Square(3))))
    assert store.result(Total((Written(2), Square(3)))) == {"total": 13}


@pytest.mark.parametrize("content", ["", "[]", '{"result": {}}', "\0"])
def test_a_damaged_record_is_told_in_one_line(content: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    perform(store, Square(3))
    store.record_path(Square(3)).write_text(content)
    with pytest.raises(StorageError, match="is damaged") as caught:
        store.record(Square(3))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["configuration", "result", "versions", "commit", "processor", "platform"])
@pytest.mark.parametrize("value", [None, 3])
def test_a_record_that_lacks_something_is_damaged(name: str, value: object, tmp_path: Path) -> None:
    store = Store(tmp_path)
    perform(store, Square(3))
    record = json.loads(store.record_path(Square(3)).read_text())
    if value is None:
        del record[name]
    else:
        record[name] = value
    store.record_path(Square(3)).write_text(json.dumps(record))
    with pytest.raises(StorageError, match="is damaged"):
        store.record(Square(3))


def test_a_full_disk_leaves_no_record_but_what_was_computed(tmp_path: Path) -> None:
    @dataclass(frozen=True)
    class Large(Run):
        def execute(self, workspace: Workspace) -> dict[str, Any]:
            (workspace.folder / "computed").touch()
            return {"numbers": list(range(10_000))}

    store = Store(tmp_path)
    with full_disk(4096), pytest.raises(StorageError, match=r"cannot write .*records"):
        perform(store, Large())
    assert store.record(Large()) is None
    assert not list((tmp_path / "records").iterdir())
    assert (store.files(Large()) / "computed").exists()
    perform(store, Large())
    assert json.loads(store.record_path(Large()).read_text())["result"]["numbers"][-1] == 9_999


def test_a_run_is_held_by_one(tmp_path: Path) -> None:
    store, other = Store(tmp_path), Store(tmp_path)
    assert not store.is_held(Square(3))
    with store.hold(Square(3)):
        assert other.is_held(Square(3))
        assert not other.is_held(Square(4))
    assert not other.is_held(Square(3))


def test_a_folder_that_cannot_be_written_to_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    store = Store(tmp_path / "file" / "out")
    assert store.record(Square(3)) is None
    with pytest.raises(StorageError, match=r"cannot write to .*out: Not a directory"):
        store.require_writable()
