"""What people read for the components of a reward vector, and what is remembered of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from moral_algorithms.cli import live, people
from moral_algorithms.cli.arguments import parse
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.people import Answering, People, ask_people
from moral_algorithms.live import launch
from moral_algorithms.pipeline import MoralRun, Setting, TeacherConfig, begin_moral
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError

ONE = MoralRun(rewards=(Path("airl"),))
KNOWN = {"extinguish": 7.0, "save": 5.7}
TWO = MoralRun(rewards=(Path("help"), Path("clean")), primary=("deliver",))


def test_learned_components_are_called_experts() -> None:
    assert Answering().name_components(ONE) == {"extinguish": "extinguish", "learned_1": "the expert"}
    assert list(Answering().name_components(TWO).values()) == ["deliver", "expert 1", "expert 2"]


def test_components_are_called_as_the_person_who_asks_wants() -> None:
    names = {"learned_2": "cleaning up", "deliver": "parcels"}
    called = Answering(names=names).name_components(TWO)
    assert list(called.values()) == ["parcels", "expert 1", "cleaning up"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"learned_2": "saving"}, "names has 'learned_2'; it must be one of extinguish, learned_1"),
        ({"learned_1": "extinguish"}, "names makes them extinguish, extinguish; no two may be the same"),
        ({"learned_1": " "}, "the name of learned_1 is ' '; it must have 1 to 18 characters"),
        ({"learned_1": "x" * 19}, f"the name of learned_1 is '{'x' * 19}'; it must have 1 to 18 characters"),
    ],
)
def test_names_that_say_nothing_are_refused(names: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Answering(names=names).name_components(ONE)


def interrupted(directory: RunDirectory, options: People, resume: bool = False) -> None:
    """Let a session begin, or go on, that somebody interrupts before the first answer."""
    run = MoralRun((), primary=("extinguish", "save"), teacher=TeacherConfig("web"), returns=KNOWN)
    with pytest.raises(KeyboardInterrupt):
        ask_people(Console(), directory, run, Setting(tensorboard=False), resume, options)


def leave(*_: object) -> None:
    """Stand in for a server that is interrupted at once."""
    raise KeyboardInterrupt


@contextmanager
def no_training(*_: object) -> Iterator[SimpleNamespace]:
    """Stand in for the process that trains, which would import PyTorch first."""
    yield SimpleNamespace(state=lambda: "running")


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunDirectory:
    """A session that was interrupted; the file with its notice is gone."""
    monkeypatch.setattr(people, "_serve", leave)
    monkeypatch.setattr(launch, "training", no_training)
    notice = tmp_path / "consent.txt"
    notice.write_text("I take part.\n")
    directory = RunDirectory(tmp_path / "run")
    interrupted(directory, People("ada", notice, {"save": "saving people"}))
    notice.unlink()
    return directory


def test_a_run_that_goes_on_knows_who_answers(begun: RunDirectory) -> None:
    interrupted(begun, going_on(begun).people, resume=True)
    assert Answering.saved(begun) == Answering("ada", "I take part.", {"save": "saving people"})


def test_what_is_given_to_a_run_that_goes_on_counts(begun: RunDirectory, tmp_path: Path) -> None:
    notice = tmp_path / "other.txt"
    notice.write_text("I take part again.")
    options = ("--who", "bob", "--notice", str(notice), "--names", "extinguish", "the fire")
    interrupted(begun, going_on(begun, *options).people, resume=True)
    names = {"save": "saving people", "extinguish": "the fire"}
    assert Answering.saved(begun) == Answering("bob", "I take part again.", names)


def going_on(directory: RunDirectory, *options: str) -> live.Command:
    """Read the command that goes on with a session."""
    return parse(live.Command, ("--resume", "--out", str(directory.path), *options), "moral live")


def test_a_run_that_begins_knows_nobody(tmp_path: Path) -> None:
    directory = RunDirectory(tmp_path / "run")
    begin_moral(directory, MoralRun((), primary=("extinguish", "save"), returns=KNOWN), Setting())
    assert Answering.saved(directory) == Answering()


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        '{"who": 1, "notice": null, "names": {}}',
        '{"who": "ada", "notice": 1, "names": {}}',
        '{"who": "ada", "notice": null, "names": {"save": 3}}',
        '{"who": "ada", "names": {}}',
        "{",
    ],
)
def test_a_damaged_record_of_people_takes_one_line(content: str, tmp_path: Path) -> None:
    (tmp_path / "people.json").write_text(content)
    with pytest.raises(StorageError, match=r"people\.json"):
        Answering.saved(RunDirectory(tmp_path))
