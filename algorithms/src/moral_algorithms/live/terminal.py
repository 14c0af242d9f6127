"""Answering and playing in a terminal, over SSH for instance: worlds as text, and keys."""

from __future__ import annotations

import os
import secrets
import select
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import zip_longest
from typing import Any, NamedTuple, Protocol

from moral_algorithms.answers import CANNOT_TELL
from moral_algorithms.live.frames import describe_episode, draw_frames
from moral_algorithms.live.playing import Plays
from moral_algorithms.live.session import LiveSession, Refusal
from moral_algorithms.replay import Replay
from moral_envs.play import single_keys
from moral_envs.world import World

ANSWERS = {"left": "first", "right": "second", "e": "equal", "c": CANNOT_TELL}
"""Answers by keys."""

_ACTIONS = {
    "up": 0,
    "down": 1,
    "left": 2,
    "right": 3,
    " ": 4,
    "w": 5,
    "s": 6,
    "a": 7,
    "d": 8,
}
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_HELP = (
    "Which is better? Left arrow: the left one; right arrow: the right one; e: equally good; "
    "c: cannot tell; u: undo the last answer; space: pause; , and .: step; r: again; n: counters; "
    "s: no more questions; q: quit"
)
# Seconds that a step is shown, and between two looks while nothing is to be answered.
_STEP = 0.12
_LOOK = 0.3
_MARK = "|"


class Film(NamedTuple):
    """An episode as text."""

    frames: list[str]
    """The start and the state after each step."""
    counters: list[list[int]]
    """Objectives in each of these states."""


def film(world: World, replay: Replay) -> Film:
    """Play an episode of one agent again, as text."""
    return Film(draw_frames(world, replay), describe_episode(world, replay)["counters"])


def draw(world: World, films: Sequence[Film], step: int, counted: bool, columns: int) -> list[str]:
    """Draw one moment of two episodes.

    Parameters
    ----------
    world
        Where they took place.
    films
        The two.
    step
        The moment; an episode that has ended stays at its end.
    counted
        Show the counters, too.
    columns
        Width of the terminal; where it is too narrow, the second is below the first.

    Returns
    -------
    list of str
        Lines.
    """
    blocks = [
        _block(world, one, min(step, len(one.frames) - 1), title, counted)
        for one, title in zip(films, ("LEFT", "RIGHT"), strict=True)
    ]
    width = max(map(len, blocks[0]))
    if 2 * width + 4 > columns:
        return [*blocks[0], "", *blocks[1]]
    rows = zip_longest(*blocks, fillvalue="")
    return [f"{left.ljust(width)}    {right}".rstrip() for left, right in rows]


def _block(world: World, one: Film, step: int, title: str, counted: bool) -> list[str]:
    lines = one.frames[step].splitlines()
    width = len(lines[0])
    last = len(one.frames) - 1
    lines.insert(0, f"{title}  step {step} of {last}")
    lines.append("time ".ljust(width, "-"))
    for column, name in enumerate(world.objective_names):
        steps = [s for s in range(1, last + 1) if one.counters[s][column] > one.counters[s - 1][column]]
        marks = ["."] * width
        for happened in steps:
            marks[(happened - 1) * width // max(last, 1)] = _MARK
        count = f" {one.counters[step][column]}" if counted else ""
        lines += [f"{name}{count}", "".join(marks)]
    here = max(step - 1, 0) * width // max(last, 1)
    lines.append(" " * here + "^")
    return lines


class KeySource(Protocol):
    """Where keys come from."""

    def read(self, seconds: float) -> str | None:
        """Wait some seconds for the next key; None if there is none, ``eof`` at the end of the input."""
        ...


class Keys:
    """Keys of the terminal, or characters of a pipe."""

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno()
        self._pending = ""

    def read(self, seconds: float) -> str | None:
        """Wait some seconds for the next key; None if there is none, ``eof`` at the end of the input."""
        if not self._pending:
            if not select.select([self._descriptor], [], [], seconds)[0]:
                return None
            self._pending = os.read(self._descriptor, 64).decode(errors="replace")
            if not self._pending:
                return "eof"
        # An arrow is one escape sequence, which comes in one piece.
        if self._pending[:2] in ("\x1b[", "\x1bO") and len(self._pending) > 2:
            key, self._pending = _ARROWS.get(self._pending[2], ""), self._pending[3:]
            return key
        key, self._pending = self._pending[0].lower(), self._pending[1:]
        return "eof" if key == "\x04" else key


class Interviewer:
    """Shows the questions of a session one after the other and takes the answers.

    Parameters
    ----------
    session
        The questions.
    trainer
        Tells how the training process is: running, stopped or failed.
    keys
        Where keys come from.
    show
        Shows lines instead of those before.
    """

    def __init__(
        self,
        session: LiveSession,
        trainer: Callable[[], str],
        keys: KeySource,
        show: Callable[[Sequence[str]], None],
    ) -> None:
        self._session = session
        self._trainer = trainer
        self._keys = keys
        self._show = show
        self._counted = False
        self._quit = False
        self._notice = ""

    def run(self) -> None:
        """Ask until training has ended or the person quits.

        Raises
        ------
        KeyboardInterrupt
            If the person quits.
        """
        self._ask_consent()
        while self._trainer() == "running" and not self._quit:
            queue = self._session.queue()
            if queue["open"]:
                self._ask(queue)
            else:
                self._show([*self._head(queue), "", self._waiting()])
                self._do_common(self._keys.read(_LOOK), queue)
        if self._quit:
            raise KeyboardInterrupt

    def _ask_consent(self) -> None:
        consent = self._session.consent
        while consent is not None and not consent["given"]:
            self._show([consent["text"], "", "y: I agree; q: quit"])
            key = self._keys.read(_LOOK)
            if key == "y":
                self._session.accept(secrets.token_hex(8))
            elif key in ("q", "eof"):
                raise KeyboardInterrupt
            consent = self._session.consent

    def _ask(self, queue: dict[str, Any]) -> None:
        number = queue["open"][0]["query"]
        films = [film(self._session.world, episode) for episode in self._session.find(number).episodes]
        last = max(len(one.frames) for one in films) - 1
        asked, step, paused = time.monotonic(), 0, False
        while not self._quit and self._trainer() == "running":
            columns = shutil.get_terminal_size().columns
            lines = draw(self._session.world, films, step, self._counted, columns)
            self._show([*self._head(queue), "", *lines, "", *textwrap.wrap(_HELP, columns), self._notice])
            key = self._keys.read(_STEP)
            if key in ANSWERS:
                seconds = round(time.monotonic() - asked, 3)
                self._try(partial(self._session.answer, number, ANSWERS[key], seconds, secrets.token_hex(8)))
                return
            if key == " ":
                paused = not paused
            elif key in (",", "."):
                paused, step = True, min(max(step + (1 if key == "." else -1), 0), last)
            elif key == "r":
                paused, step = False, 0
            elif self._do_common(key, queue):
                return
            elif not paused:
                step = (step + 1) % (last + 1)

    def _do_common(self, key: str | None, queue: dict[str, Any]) -> bool:
        """Do what keys do everywhere; returns whether questions may have changed."""
        if key in ("q", "eof"):
            self._quit = True
        elif key == "n":
            self._counted = not self._counted
        elif key == "s":
            self._session.stop()
            self._notice = "No more questions; training closes."
            return True
        elif key == "u" and queue["last"] is not None:
            last = queue["last"]["query"]
            self._try(partial(self._session.undo, last, secrets.token_hex(8)))
            return True
        return False

    def _try(self, act: Callable[[], object]) -> None:
        """Do what the session may refuse, and say so if it does."""
        self._notice = ""
        try:
            act()
        except Refusal as refusal:
            self._notice = str(refusal)

    def _head(self, queue: dict[str, Any]) -> list[str]:
        status = self._session.status()
        advice = None if status is None else status["advice"]
        lines = [f"{queue['answered']} of {queue['queries']} questions answered"]
        if advice is not None and advice["enough"]:
            lines.append("More answers would change little: s ends the questions.")
        return lines

    def _waiting(self) -> str:
        status = self._session.status()
        phase = "preparing" if status is None else status["phase"]
        texts = {
            "preparing": "Training prepares itself; the first question comes in a moment.",
            "training": "The next question comes in a moment.",
            "resting": "Training rests until the next answer.",
            "closing": "Thank you: training now closes under your answers.",
            "finished": "Training has ended.",
        }
        share = "" if status is None else f" {status['progress']:.0%}"
        return texts[phase] + share


class Player:
    """Lets a person play episodes, look at them again, and keep or discard them.

    Parameters
    ----------
    plays
        The episodes.
    keys
        Where keys come from.
    show
        Shows lines instead of those before.
    """

    def __init__(self, plays: Plays, keys: KeySource, show: Callable[[Sequence[str]], None]) -> None:
        self._plays = plays
        self._keys = keys
        self._show = show

    def run(self) -> None:
        """Play until as many episodes as wanted are kept, or the person quits."""
        while self._plays.num_kept < self._plays.wanted and self._play() and self._judge():
            pass

    def _play(self) -> bool:
        """Play one episode to its end; returns whether the person goes on."""
        self._name = self._plays.begin()["play"]
        while not (play := self._plays.look(self._name))["over"]:
            left = play["horizon"] - play["step"]
            frame = self._plays.frame(self._name).splitlines()
            keys = "arrows: move; w, s, a, d: act on the cell above, below, left, right; space: wait; q: quit"
            self._show([*self._head(), *frame, "", f"{left} steps left", keys])
            key = self._keys.read(_LOOK)
            if key in ("q", "eof"):
                return False
            action = _ACTIONS.get(key or "")
            if action is not None and action < self._plays.world.num_actions:
                self._plays.step(self._name, action, play["step"])
        return True

    def _judge(self) -> bool:
        """Keep or discard the episode, after looking at it again; returns whether the person goes on."""
        frames = self._plays.frames(self._name)
        step = 0
        while True:
            keys = "k: keep this episode; x: discard it; q: discard it and quit"
            again = f"what you did, step {step} of {len(frames) - 1}"
            self._show([*self._head(), *frames[step].splitlines(), "", again, keys])
            key = self._keys.read(_STEP)
            if key == "k":
                self._plays.keep(self._name)
                return True
            if key in ("x", "q", "eof"):
                self._plays.discard(self._name)
                return key == "x"
            step = (step + 1) % len(frames)

    def _head(self) -> list[str]:
        kept = f"{self._plays.num_kept} of {self._plays.wanted} episodes kept"
        return [self._plays.instruction, kept, ""]


def require_keys() -> None:
    """Raise a ValueError if no keys can come, as where standard input is closed."""
    if sys.stdin is None or sys.stdin.closed:
        raise ValueError("standard input is closed; it must be open for keys to come from it")


def play_in_terminal(plays: Plays) -> None:
    """Let a person play in the terminal until enough is kept or they quit."""
    with _screen() as (keys, show):
        Player(plays, keys, show).run()


def answer_in_terminal(session: LiveSession, trainer: Callable[[], str]) -> None:
    """Ask in the terminal until training has ended.

    Raises
    ------
    KeyboardInterrupt
        If the person quits or interrupts it.
    """
    with _screen() as (keys, show):
        Interviewer(session, trainer, keys, show).run()


@contextmanager
def _screen() -> Iterator[tuple[Keys, Callable[[Sequence[str]], None]]]:
    """Take the terminal over: keys, and a function that shows lines instead of those before."""
    on_terminal = sys.stdin.isatty() and sys.stdout.isatty()
    shown: list[str] = []

    def show(lines: Sequence[str]) -> None:
        if list(lines) == shown:
            return
        shown[:] = lines
        # From the top left corner over the old screen; what is left of its lines and below is cleared.
        text = "\x1b[H" + "\x1b[K\n".join(lines) + "\x1b[J" if on_terminal else "\n".join([*lines, ""])
        print(text, flush=True)

    if on_terminal:
        print("\x1b[2J", end="")
    with single_keys():
        yield Keys(), show
