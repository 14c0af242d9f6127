"""What people read for the components of a reward vector, and what is remembered of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from moral_algorithms.cli import live, people, train
from moral_algorithms.cli.console import Console
from moral_algorithms.cli.people import People, ask_people, saved_people
from moral_algorithms.pipeline import MoralRun, Setting, TeacherConfig, begin_moral
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError

ONE = MoralRun(rewards=(Path("airl"),))
KNOWN = {"extinguish": 7.0, "save": 5.7}
TWO = MoralRun(rewards=(Path("help"), Path("clean")), primary=("deliver",))


def test_learned_components_are_called_experts() -> None:
    assert People().name_components(ONE) == {"extinguish": "extinguish", "learned_1": "the expert"}
    assert list(People().name_components(TWO).values()) == ["deliver", "expert 1", "expert 2"]


def test_components_are_called_as_the_person_who_asks_wants() -> None:
    names = {"learned_2": "cleaning up", "deliver": "parcels"}
    assert list(People(names=names).name_components(TWO).values()) == ["parcels", "expert 1", "cleaning up"]


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
        People(names=names).name_components(ONE)


def test_a_run_that_goes_on_knows_who_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(people, "_serve", leave)
    notice = tmp_path / "consent.txt"
    notice.write_text("I take part.\n")
    directory = RunDirectory(tmp_path / "run")
    run = MoralRun((), primary=("extinguish", "save"), teacher=TeacherConfig("web"), returns=KNOWN)
    asked = People("ada", notice, {"save": "saving people"})
    with pytest.raises(KeyboardInterrupt):
        ask_people(Console(), directory, run, Setting(tensorboard=False), resume=False, people=asked)
    notice.unlink()
    options = ("--resume", "--out", str(directory.path))
    going_on = live.Command.defaults(options)
    assert going_on is not None
    assert (going_on.asking.who, going_on.asking.names) == ("ada", {"save": "saving people"})
    assert going_on.asking.read_notice() == "I take part."
    again = train.Command.defaults(options)
    assert again is not None
    assert again.people == going_on.asking


def test_a_run_that_begins_knows_nobody(tmp_path: Path) -> None:
    directory = RunDirectory(tmp_path / "run")
    begin_moral(directory, MoralRun((), primary=("extinguish", "save"), returns=KNOWN), Setting())
    assert saved_people(directory) == People()


@pytest.mark.parametrize(
    "content", ["[]", '{"who": 1, "names": {}}', '{"who": "ada", "names": {"save": 3}}', "{"]
)
def test_a_damaged_record_of_people_takes_one_line(content: str, tmp_path: Path) -> None:
    (tmp_path / "people.json").write_text(content)
    with pytest.raises(StorageError, match=r"people\.json"):
        saved_people(RunDirectory(tmp_path))
