"""Answering and playing in a terminal, key by key."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest

from moral_algorithms.answers import read_answers
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.live.playing import Plays
from moral_algorithms.live.session import LiveSession
from moral_algorithms.live.terminal import Interviewer, Player, draw, film
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.run_directory import read_lines
from tests.algorithms.live.runs import WORLD, prepare, query
from tests.algorithms.tiny import EMERGENCY


class Typed:
    """Keys that somebody types; then the input ends."""

    def __init__(self, keys: Iterable[str | None]) -> None:
        self._keys = iter(keys)

    def read(self, seconds: float) -> str | None:
        return next(self._keys, "eof")


def interview(run: Path, keys: Iterable[str | None], notice: str | None = None) -> list[list[str]]:
    shown: list[list[str]] = []
    session = LiveSession(run, "ada", notice)

    def show(lines: Sequence[str]) -> None:
        shown.append(list(lines))

    with pytest.raises(KeyboardInterrupt):
        Interviewer(session, lambda: "running", Typed(keys), show).run()
    return shown


def test_every_key_gives_its_answer(tmp_path: Path) -> None:
    run = prepare(tmp_path / "run", opened=4)
    interview(run, [None, "right", None, None, "left", "e", "c"])
    said = [(line["query"], line["preference"]) for line in read_lines(run / "queries.jsonl")]
    assert said == [(0, "second"), (1, "first"), (2, "equal"), (3, "cannot_tell")]


def test_the_last_answer_can_be_taken_back(tmp_path: Path) -> None:
    run = prepare(tmp_path / "run")
    interview(run, ["left", "u", "right"])
    (stands,) = read_answers(run / "queries.jsonl").standing.values()
    assert (stands.number, stands.said) == (0, "second")


def test_the_episodes_run_side_by_side_and_stop_and_step(tmp_path: Path) -> None:
    run = prepare(tmp_path / "run")
    shown = interview(run, [None, None, " ", None, None, ".", ",", "r", None])
    steps = [lines[2].split("step ")[1].split(" of")[0] for lines in shown]
    assert steps == ["0", "1", "2", "2", "2", "2", "3", "2", "0", "1"]
    assert "RIGHT  step" in shown[0][2]


def test_a_moment_shows_both_worlds_and_when_things_happen() -> None:
    films = [film(WORLD, episode) for episode in query(3).episodes]
    lines = draw(WORLD, films, 5, True, 80)
    left = films[0].frames[5].splitlines()
    right = films[1].frames[5].splitlines()
    for number, (one, other) in enumerate(zip(left, right, strict=True)):
        assert lines[1 + number].startswith(one)
        assert lines[1 + number].endswith(other.rstrip())
    saved = WORLD.objective_names.index("people_saved")
    text = next(line for line in lines if line.startswith("people_saved"))
    assert text.split()[1] == str(films[0].counters[5][saved])
    assert "people_saved 0" not in draw(WORLD, films, 5, False, 80)
    # Below each other where the terminal is narrow.
    narrow = draw(WORLD, films, 5, True, 20)
    assert max(map(len, narrow)) <= 25
    assert [line for line in narrow if line.startswith(("LEFT", "RIGHT"))] == [
        "LEFT  step 5 of 8",
        "RIGHT  step 5 of 8",
    ]


def test_a_stop_asks_for_no_more(tmp_path: Path) -> None:
    run = prepare(tmp_path / "run")
    interview(run, ["s"])
    assert QueryFolder(run).stopped


def test_a_notice_comes_first(tmp_path: Path) -> None:
    run = prepare(tmp_path / "run")
    shown = interview(run, ["left", "y", "left"], "I take part freely.")
    assert shown[0][0] == "I take part freely."
    assert [line["record"] for line in read_lines(run / "queries.jsonl")] == ["consent", "answer"]


def test_it_ends_with_training_and_says_what_it_waits_for(tmp_path: Path) -> None:
    run = prepare(tmp_path / "run", opened=0)
    shown: list[list[str]] = []
    states = iter(["running", "running", "stopped"])
    session = LiveSession(run, "ada")
    Interviewer(
        session, lambda: next(states), Typed([None, None]), lambda lines: shown.append(list(lines))
    ).run()
    assert shown[0][-1] == "The next question comes in a moment. 10%"


def test_episodes_are_played_reviewed_kept_and_discarded(tmp_path: Path) -> None:
    plays = Plays(EMERGENCY, tmp_path / "d.npz", 2, "Save them.")
    moves = ["right", "down", "w", " ", None, "x", "left", "up", "a", "d"]
    shown: list[list[str]] = []
    keys = [*moves, None, "x", *moves, None, None, "k", *moves, "k", "left"]
    Player(plays, Typed(keys), lambda lines: shown.append(list(lines))).run()
    kept = Demonstrations.load(tmp_path / "d.npz", EMERGENCY)
    assert kept.num_episodes == 2
    assert kept.actions.tolist() == [[3, 1, 5, 4, 2, 0, 7, 8]] * 2
    assert shown[0][:2] == ["Save them.", "0 of 2 episodes kept"]
    assert not any("people_saved" in line for lines in shown for line in lines)


def test_who_quits_keeps_what_was_kept(tmp_path: Path) -> None:
    plays = Plays(EMERGENCY, tmp_path / "d.npz", 5, "Save them.")
    Player(plays, Typed([*[" "] * 8, "k", " ", "q"]), lambda lines: None).run()
    assert Demonstrations.load(tmp_path / "d.npz").num_episodes == 1


def test_a_real_terminal(tmp_path: Path) -> None:
    """Arrows are escape sequences there; they play a whole episode, and k keeps it."""
    script = (
        "import sys\nfrom pathlib import Path\n"
        "from moral_algorithms.live.playing import Plays\n"
        "from moral_algorithms.live.terminal import play_in_terminal\n"
        "from tests.algorithms.tiny import EMERGENCY\n"
        "play_in_terminal(Plays(EMERGENCY, Path(sys.argv[1]), 1, 'Save them.'))\n"
    )
    ours, theirs = pty.openpty()
    out = tmp_path / "d.npz"
    process = subprocess.Popen([sys.executable, "-c", script, str(out)], stdin=theirs, stdout=theirs)
    os.close(theirs)
    seen = b""
    try:
        while chunk := os.read(ours, 4096):
            # What is typed before it shows something is thrown away.
            if b"Save them." in chunk and b"Save them." not in seen:
                os.write(ours, b"\x1b[A\x1b[B\x1bOC\x1b[D    k")
            seen += chunk
    except OSError:
        # So a pseudo-terminal of Linux says that the other side is closed.
        pass
    assert process.wait() == 0
    os.close(ours)
    assert Demonstrations.load(out, EMERGENCY).actions.tolist() == [[0, 1, 3, 2, 4, 4, 4, 4]]
    assert b"8 steps left" in seen
