"""Progress in a terminal and elsewhere."""

from __future__ import annotations

import io
import signal
import sys

import pytest
import rich.console

from moral_algorithms.cli.console import Console, end_with_reader, uninterrupted
from moral_algorithms.learners.ppo import Progress


def play(console: Console) -> None:
    with console.stage("moral") as show:
        for steps in range(100, 1101, 100):
            show(Progress(steps, 1050, {"goal_time": steps / 100, "people_saved": 5.987}, steps // 500))


def test_without_a_terminal_there_are_a_few_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    play(Console())
    *lines, last = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    assert lines[0] == "moral          300 of 1,050 steps  goal_time 3  people_saved 5.99"
    assert lines[-1] == "moral          1,050 of 1,050 steps  queries 2  goal_time 11  people_saved 5.99"
    assert last.startswith("moral          done in ")


def test_tables_show_text_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    Console().table("Weights", ("component", "weight"), [("people [all] [/b]", "0.5")])
    assert "people [all] [/b]" in capsys.readouterr().out


def test_output_that_is_closed_from_the_start_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert end_with_reader(lambda: 0) == 0


def test_in_a_terminal_a_bar_ends_full(monkeypatch: pytest.MonkeyPatch) -> None:
    file = io.StringIO()
    console = Console()
    terminal = rich.console.Console(file=file, force_terminal=True, width=100, legacy_windows=False)
    monkeypatch.setattr(console, "_out", terminal)
    play(console)
    assert "\x1b" in file.getvalue()
    assert "100%" in file.getvalue()
    assert "queries 2" in file.getvalue()


def test_ctrl_c_is_ignored_for_a_moment_and_no_longer() -> None:
    with uninterrupted():
        signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
