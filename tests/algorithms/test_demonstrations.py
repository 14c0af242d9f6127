"""Demonstrations: what comes back from a file, and all that must not."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.storage import StorageError
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.full_disk import files_in, full_disk
from tests.algorithms.test_storage import Bomb
from tests.algorithms.tiny import EMERGENCY, random_episodes


def record(num_episodes: int = 3) -> Demonstrations:
    episodes = random_episodes(EMERGENCY, num_episodes, seed=0)
    return Demonstrations(EMERGENCY, episodes.states, episodes.actions, episodes.objectives)


def header(**changes: Any) -> np.ndarray:
    value = {"format": "moral-demonstrations", "version": 1, "world": EMERGENCY.to_json(), **changes}
    return np.frombuffer(json.dumps(value).encode(), dtype=np.uint8)


def arrays(**changes: Any) -> dict[str, Any]:
    demonstrations = record()
    return {
        "header": header(),
        "states": demonstrations.states,
        "actions": demonstrations.actions,
        "objectives": demonstrations.objectives,
        **changes,
    }


def refused(path: Path, world: WorldSpec | None = None) -> str:
    """Load, expect one line that names the file, and return it."""
    with pytest.raises(StorageError) as error:
        Demonstrations.load(path, world)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    return str(error.value)


def test_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "demonstrations.npz"
    demonstrations = record(5)
    demonstrations.save(path)
    assert files_in(path.parent) == ["demonstrations.npz"]
    for loaded in (Demonstrations.load(str(path)), Demonstrations.load(path, EMERGENCY)):
        assert loaded.world == EMERGENCY
        assert loaded.num_episodes == 5
        for name in ("states", "actions", "objectives"):
            np.testing.assert_array_equal(getattr(loaded, name), getattr(demonstrations, name))
            assert getattr(loaded, name).dtype == getattr(demonstrations, name).dtype


def test_the_file_is_what_its_documentation_says(tmp_path: Path) -> None:
    record().save(tmp_path / "file")
    with np.load(tmp_path / "file", allow_pickle=False) as archive:
        assert sorted(archive) == ["actions", "header", "objectives", "states"]
        assert archive["header"].dtype == np.uint8
        assert json.loads(archive["header"].tobytes()) == {
            "format": "moral-demonstrations",
            "version": 1,
            "world": {"name": "emergency", "rules": EMERGENCY.rules},
        }
        assert archive["states"].shape == (3, 9, 4, 5, 5)


def test_the_same_world_in_other_words_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "file"
    record().save(path)
    # The default height is 8; that of width is spelled out here and left out there.
    rules = {"height": 8, "num_people": 1, "max_cycles": 3}
    world = WorldSpec("emergency", rules)
    episodes = random_episodes(world, 1, seed=0)
    Demonstrations(world, episodes.states, episodes.actions, episodes.objectives).save(path)
    loaded = Demonstrations.load(path, WorldSpec("emergency", {"num_people": 1, "max_cycles": 3}))
    assert loaded.num_episodes == 1


def test_another_world_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    record().save(path)
    message = refused(path, WorldSpec("emergency"))
    assert "was demonstrated in" in message
    refused(path, WorldSpec("delivery"))


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    record(2).save(path)
    rng = np.random.default_rng(0)
    many = record(400)
    noise = Demonstrations(
        many.world, many.states, rng.integers(9, size=many.actions.shape, dtype=np.uint8), many.objectives
    )
    with full_disk(2000), pytest.raises(StorageError, match="cannot write"):
        noise.save(path)
    assert Demonstrations.load(path).num_episodes == 2
    assert files_in(tmp_path) == ["file"]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "there is no demonstration file" in refused(tmp_path / "missing")
    refused(tmp_path)


@settings(max_examples=60)
@given(part=st.floats(0, 1, exclude_max=True))
@example(part=0.0)
def test_a_truncated_file_is_refused(tmp_path_factory: pytest.TempPathFactory, part: float) -> None:
    path = tmp_path_factory.mktemp("truncated") / "file"
    record().save(path)
    os.truncate(path, int(part * path.stat().st_size))
    refused(path)


@settings(max_examples=150)
@given(place=st.integers(0), value=st.integers(0, 255))
def test_a_wrong_byte_is_refused_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, place: int, value: int
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "file"
    demonstrations = record()
    demonstrations.save(path)
    content = bytearray(path.read_bytes())
    content[place % len(content)] = value
    path.write_bytes(content)
    message, loaded = "", demonstrations
    try:
        # Some bytes, such as those of a date, no reader looks at.
        loaded = Demonstrations.load(path)
    except StorageError as error:
        message = str(error)
    assert "\n" not in message
    for name in ("states", "actions", "objectives"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(demonstrations, name))


@pytest.mark.parametrize("name", ["header", "states", "actions", "objectives", "all"])
def test_objects_are_never_unpickled(tmp_path: Path, name: str) -> None:
    path, trace = tmp_path / "file.npz", tmp_path / "trace"
    bomb = np.empty(1, dtype=object)
    bomb[0] = Bomb(trace)
    content = arrays(**{name: bomb}) if name != "all" else dict.fromkeys(arrays(), bomb)
    np.savez(path, **content)
    refused(path)
    assert not trace.exists()
    with np.load(path, allow_pickle=True) as archive:
        archive["header" if name == "all" else name]
    assert trace.exists(), "the pickle would have left its trace"


def test_files_of_other_formats_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "file.npy"
    np.save(path, np.zeros(3))
    refused(path)
    path.write_bytes(b"no archive at all")
    refused(path)
    path = tmp_path / "file.npz"
    np.savez(path, states=np.zeros(3))
    assert "has no array 'header'; it is no demonstration file" in refused(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"header": header(format="other")}, "is no demonstration file"),
        ({"header": header(version=2)}, "has version 2; this release reads 1"),
        ({"header": header(version=None)}, "has version None; this release reads 1"),
        ({"header": header(world={"name": "warehouse", "rules": {}})}, "world is 'warehouse'"),
        ({"header": header(world="emergency")}, "it must be an object with 'name' and 'rules'"),
        ({"header": header(world={"name": "emergency", "rules": {"height": "5"}})}, "must be an integer"),
        ({"header": np.frombuffer(b"[1]", dtype=np.uint8)}, "is no demonstration file"),
        ({"header": np.frombuffer(b"\xff", dtype=np.uint8)}, "damaged"),
        ({"states": record().states[:, 1:]}, r"states are uint8 \(3, 8, 4, 5, 5\)"),
        ({"states": record().states[:2]}, "states are uint8"),
        ({"states": record().states.astype(np.int64)}, "states are int64"),
        ({"states": 2 * record().states}, "states contain 2; planes hold 0 and 1"),
        ({"states": 0 * record().states}, "states contain one with 0 agents"),
        ({"actions": record().actions[:, :-1]}, r"actions are uint8 \(3, 7\)"),
        ({"actions": record().actions[0]}, r"actions have shape \(8,\)"),
        ({"actions": record().actions[:0]}, "at least one"),
        ({"actions": record().actions.astype(np.int8)}, "actions are int8"),
        ({"actions": record().actions + np.uint8(9)}, "actions contain"),
        ({"objectives": record().objectives[:, :1]}, r"objectives are int64 \(3, 1\)"),
        ({"objectives": record().objectives.astype(np.float64)}, "objectives are float64"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "file.npz"
    np.savez(path, **arrays(**changes))
    with pytest.raises(StorageError, match=message):
        Demonstrations.load(path)
    refused(path)


def test_two_agents_in_a_state_are_refused() -> None:
    demonstrations = record()
    states = demonstrations.states.copy()
    states[1, 4, 1, 1:3, 1:3] = 1
    with pytest.raises(ValueError, match="states contain one with 4 agents; each must have one"):
        Demonstrations(EMERGENCY, states, demonstrations.actions, demonstrations.objectives)


def test_the_world_alone_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "walks.npz"
    demonstrations = record()
    demonstrations.save(path)
    assert Demonstrations.world_of(path) == demonstrations.world
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(StorageError, match="damaged"):
        Demonstrations.world_of(path)
    with pytest.raises(StorageError, match="there is no demonstration file"):
        Demonstrations.world_of(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"hello\n", b"", b"\x93NUMPY"])
def test_what_is_no_archive_is_said_to_be_none(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(content)
    with pytest.raises(StorageError, match=r"it is no archive of arrays$"):
        Demonstrations.load(path)
