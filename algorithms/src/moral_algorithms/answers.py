"""Answers: what a teacher was asked and what it said, in a plain file that only grows.

What queries.jsonl holds, version 1
-----------------------------------
``queries.jsonl`` has one JSON object per line, flushed to the disk before it counts. Every line has
``version`` (1) and ``record``, one of

``answer``
    ``query`` (its number in the run), ``posterior`` (how many answers the posterior held that chose it),
    ``env_steps`` (when), ``expected`` (the return that an answer was expected to save, null if unknown),
    ``repeats`` (the number of the query that this one repeats with its sides swapped, else null),
    ``returns`` (float (2, d), normalised vector returns), ``objectives`` (int (2, m), ground-truth counters
    at the ends), ``episodes`` (two, by reference: ``stream`` and ``actions``, which the engine plays again),
    ``preference`` (first, second, equal or cannot_tell) and ``who``.
    A person's answer also has ``seconds`` (response time), ``when`` (UTC, ISO 8601) and ``key`` (unique,
    drawn by whoever asked); a simulated teacher's has ``teacher``, its state after the answer. What is not
    known is null.
``undo``
    takes the answer to ``query`` back; with ``who``, ``when`` and ``key``. The query may be answered again.
``consent``
    ``who`` has accepted a notice, whose SHA-256 is ``notice``; with ``when`` and ``key``.

The answers that stand are those that no later ``undo`` takes back: at most one for each query.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from moral_algorithms.preferences import Preference, Query
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import append_line, read_lines, repair_lines
from moral_algorithms.storage import StorageError, StrPath, first_line

VERSION = 1

CANNOT_TELL = "cannot_tell"
"""What stands for the preference of somebody who has none; such an answer never reaches the posterior."""


@dataclass(frozen=True, eq=False)
class AskedQuery:
    """A query with all that it takes to show it and to learn from its answer."""

    number: int
    """Its number in the run."""
    posterior: int
    """Answers that the posterior held when it chose the query."""
    env_steps: int
    """Environment steps of the training at that time."""
    pair: Query
    """What inference and simulated teachers see."""
    episodes: tuple[Replay, Replay]
    """What a person sees."""
    expected: float | None = None
    """Return that an answer was expected to save: its expected regret. None: not known."""
    repeats: int | None = None
    """Number of the query that this one repeats with its sides swapped."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {
            "query": self.number,
            "posterior": self.posterior,
            "env_steps": self.env_steps,
            "expected": self.expected,
            "repeats": self.repeats,
            "returns": self.pair.returns.tolist(),
            "objectives": self.pair.objectives.tolist(),
            "episodes": [episode.to_json() for episode in self.episodes],
        }

    @classmethod
    def from_json(cls, value: Any) -> AskedQuery:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else.
        """
        fields = _Fields(value)
        first, second = (Replay.from_json(episode) for episode in fields.get("episodes", list))
        return cls(
            number=fields.count("query"),
            posterior=fields.count("posterior"),
            env_steps=fields.count("env_steps"),
            pair=Query(np.array(fields.get("returns", list)), np.array(fields.get("objectives", list))),
            episodes=(first, second),
            expected=fields.optional("expected", float),
            repeats=fields.optional("repeats", int),
        )


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a query."""

    asked: AskedQuery
    """The query."""
    preference: Preference | None
    """The answer; None: cannot tell."""
    who: str
    """Who gave it."""
    seconds: float | None = None
    """Response time."""
    when: str | None = None
    """When, in UTC."""
    key: str | None = None
    """Unique for each answer of a person."""
    teacher: dict[str, Any] | None = None
    """State of a simulated teacher after the answer."""

    @property
    def number(self) -> int:
        """The query's number."""
        return self.asked.number

    @property
    def said(self) -> str:
        """The answer as it is recorded."""
        return CANNOT_TELL if self.preference is None else self.preference.value

    def to_json(self) -> dict[str, Any]:
        """Plain values for a line of the file."""
        return {
            "version": VERSION,
            "record": "answer",
            **self.asked.to_json(),
            "preference": self.said,
            "who": self.who,
            "seconds": self.seconds,
            "when": self.when,
            "key": self.key,
            "teacher": self.teacher,
        }

    @classmethod
    def from_json(cls, value: Any) -> Answer:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else.
        """
        fields = _Fields(value)
        return cls(
            asked=AskedQuery.from_json(value),
            preference=read_preference(fields.get("preference", str)),
            who=fields.get("who", str),
            seconds=fields.optional("seconds", float),
            when=fields.optional("when", str),
            key=fields.optional("key", str),
            teacher=fields.optional("teacher", dict),
        )


@dataclass(frozen=True)
class Event:
    """An undo or a consent."""

    record: str
    """undo or consent."""
    about: int | str
    """The query whose answer is taken back, or the SHA-256 of the notice that is accepted."""
    who: str
    """Whose."""
    when: str
    """When, in UTC."""
    key: str
    """Unique for each."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for a line of the file."""
        name = _ABOUT[self.record]
        event = {"record": self.record, name: self.about, "who": self.who, "when": self.when, "key": self.key}
        return {"version": VERSION, **event}

    @classmethod
    def from_json(cls, value: Any) -> Event:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else.
        """
        fields = _Fields(value)
        record = fields.get("record", str)
        about: int | str = fields.count("query") if record == "undo" else fields.get("notice", str)
        return cls(record, about, *(fields.get(name, str) for name in ("who", "when", "key")))


_ABOUT = {"undo": "query", "consent": "notice"}


class Answers:
    """What a file of answers says, line after line.

    Attributes
    ----------
    standing : dict of int to Answer
        The answers that stand, by query, in the order in which they were given.
    undone : dict of int to AskedQuery
        The queries whose answers were taken back and that have no other yet.
    keys : set of str
        The keys of all records.
    notices : set of str
        Hashes of the notices that were accepted.
    """

    def __init__(self) -> None:
        self.standing: dict[int, Answer] = {}
        self.undone: dict[int, AskedQuery] = {}
        self.keys: set[str] = set()
        self.notices: set[str] = set()

    def require_fitting(self, record: Answer | Event) -> None:
        """Raise a ValueError if a record contradicts the earlier ones."""
        if record.key in self.keys:
            raise ValueError(f"key is {record.key!r}, which an earlier record has")
        if isinstance(record, Answer):
            if record.number in self.standing:
                raise ValueError(f"query is {record.number}, which is answered already")
        elif isinstance(record.about, int) and record.about not in self.standing:
            raise ValueError(f"query is {record.about}, which has no answer to take back")

    def add(self, record: Answer | Event) -> None:
        """Take in the next record.

        Raises
        ------
        ValueError
            If it contradicts the earlier ones.
        """
        self.require_fitting(record)
        if isinstance(record, Answer):
            self.standing[record.number] = record
            self.undone.pop(record.number, None)
        elif isinstance(record.about, int):
            self.undone[record.about] = self.standing.pop(record.about).asked
        else:
            self.notices.add(record.about)
        if record.key is not None:
            self.keys.add(record.key)

    @property
    def informative(self) -> list[Answer]:
        """The answers that stand and say something, in the order in which they were given."""
        return [answer for answer in self.standing.values() if answer.preference is not None]


def read_answers(path: StrPath) -> Answers:
    """Read a file of answers; a last line that is not complete, because it is being written, is left out.

    Raises
    ------
    StorageError
        If it cannot be read, or is damaged: that must not come to light in the middle of training.
    """
    return parse_answers(path, read_lines(path))


def parse_answers(path: StrPath, lines: Iterable[Any]) -> Answers:
    """Read the lines of a file of answers.

    Raises
    ------
    StorageError
        If one is damaged.
    """
    answers = Answers()
    for number, line in enumerate(lines, start=1):
        try:
            answers.add(_read_record(line))
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
            raise StorageError(f"{path} is damaged in line {number}: {first_line(error)}") from error
    return answers


class AnswerBook:
    """The file of answers of a run, written by one process at a time.

    Parameters
    ----------
    path
        The file; a last line that an earlier process was killed in is removed.
    who
        Who answers.

    Raises
    ------
    StorageError
        If it cannot be read, or is damaged.
    """

    def __init__(self, path: Path, who: str) -> None:
        repair_lines(path)
        self.answers = read_answers(path)
        self.who = who
        self._path = path

    def answer(self, asked: AskedQuery, preference: Preference | None, seconds: float, key: str) -> None:
        """Record an answer; it is on the disk afterwards.

        Raises
        ------
        ValueError
            If the query has an answer that stands, or the key was used before.
        StorageError
            If it cannot be written; nothing has changed then.
        """
        self._record(Answer(asked, preference, self.who, seconds, now(), key))

    def undo(self, query: int, key: str) -> None:
        """Take the answer to a query back.

        Raises
        ------
        ValueError
            If it has no answer that stands, or the key was used before.
        StorageError
            If it cannot be written; nothing has changed then.
        """
        self._record(Event("undo", query, self.who, now(), key))

    def consent(self, notice: str, key: str) -> None:
        """Record that a notice, named by its SHA-256, was accepted.

        Raises
        ------
        ValueError
            If the key was used before.
        StorageError
            If it cannot be written; nothing has changed then.
        """
        self._record(Event("consent", notice, self.who, now(), key))

    def _record(self, record: Answer | Event) -> None:
        self.answers.require_fitting(record)
        append_line(self._path, record.to_json())
        self.answers.add(record)


def read_preference(said: str) -> Preference | None:
    """Read an answer as it is recorded.

    Raises
    ------
    ValueError
        If it is none.
    """
    if said == CANNOT_TELL:
        return None
    try:
        return Preference(said)
    except ValueError as error:
        raise ValueError(
            f"preference is {said!r}; it must be first, second, equal or {CANNOT_TELL}"
        ) from error


def now() -> str:
    """Tell the time, in UTC."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


def _read_record(line: Any) -> Answer | Event:
    fields = _Fields(line)
    version, record = line.get("version"), line.get("record")
    if version != VERSION:
        raise ValueError(f"it has version {version!r}; this release reads {VERSION}")
    if record == "answer":
        return Answer.from_json(line)
    if record not in _ABOUT:
        raise ValueError(f"record is {record!r}; it must be answer, undo or consent")
    return Event.from_json(fields.value)


class _Fields:
    """The fields of a JSON object, checked as they are read."""

    def __init__(self, value: Any) -> None:
        if not isinstance(value, dict):
            raise ValueError(f"it is {type(value).__name__}, no object")
        self.value: dict[str, Any] = value

    def get(self, name: str, kind: type) -> Any:
        if type(self.value.get(name)) is not kind:
            raise ValueError(f"{name} is {self.value.get(name)!r}; it must be {kind.__name__}")
        return self.value[name]

    def count(self, name: str) -> int:
        number: int = self.get(name, int)
        if number < 0:
            raise ValueError(f"{name} is {number}; it must be 0 or more")
        return number

    def optional(self, name: str, kind: type) -> Any:
        return None if self.value.get(name) is None else self.get(name, kind)
