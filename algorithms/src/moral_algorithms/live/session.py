"""A session of questions: what stands in a run directory, and the answers that go into it."""

from __future__ import annotations

import fcntl
import hashlib
import secrets
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from moral_algorithms.answers import AnswerBook, AskedQuery, read_preference
from moral_algorithms.live.frames import describe_episode
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.storage import StorageError, read_json, remove_remains
from moral_algorithms.worlds import WorldSpec

# Points of a curve.
_POINTS = 200


class Refusal(Exception):
    """A request that is not granted.

    Parameters
    ----------
    status
        The HTTP status.
    code
        One word for programs.
    detail
        One line for people.
    more
        Further fields of the error.
    """

    def __init__(self, status: int, code: str, detail: str, **more: Any) -> None:
        super().__init__(detail)
        self.status = status
        self.body = {"error": code, "detail": detail, **more}


class LiveSession:
    """Questions from a run directory, and answers into it; safe for several threads.

    Parameters
    ----------
    run
        The run directory; it must have been prepared (`moral_algorithms.pipeline.begin_moral`). The caller
        holds it (:func:`hold_session`).
    who
        Who answers.
    notice
        What must be accepted before the first question; None: nothing.
    names
        What people read for components of the reward vector, by component.

    Raises
    ------
    StorageError
        If something in the directory is missing or damaged.
    """

    def __init__(
        self, run: Path, who: str, notice: str | None = None, names: Mapping[str, str] | None = None
    ) -> None:
        directory = RunDirectory(run)
        config = directory.read_config()
        self.run = run
        self.who = who
        self.notice = notice
        self.names = dict(names or {})
        self.world = WorldSpec.from_json(config.get("world")).build()
        self._queries = int(config["moral"]["queries"])
        self._directory = directory
        self._folder = QueryFolder(run)
        self._book = AnswerBook(directory.queries, who)
        self._lock = threading.Lock()
        self._known: dict[int, AskedQuery] = {}
        self._name = secrets.token_hex(4)
        self._revision = 0
        self._told: dict[str, Any] = {}

    @property
    def consent(self) -> dict[str, Any] | None:
        """The notice, and whether it was accepted."""
        if self.notice is None:
            return None
        return {"text": self.notice, "given": self._notice_hash in self._book.answers.notices}

    def status(self) -> dict[str, Any] | None:
        """STATUS; None until training has written one."""
        status = self._read_status()
        if status is not None:
            status.pop("episode", None)
        return status

    def queue(self) -> dict[str, Any]:
        """QUEUE: what is to be answered."""
        with self._lock:
            return self._queue()

    def curves(self) -> dict[str, Any]:
        """CURVES: how the training went."""
        lines = read_lines(self._directory.metrics)
        # The last one always, and the others evenly.
        step = max(1, -(-len(lines) // _POINTS))
        lines = lines[::-1][::step][::-1]
        return {
            "env_steps": [line["env_steps"] for line in lines],
            "answers": [line["queries"] for line in lines],
            "weights": [list(line["weights"].values()) for line in lines],
            "objectives": [list(line["objectives"].values()) for line in lines],
        }

    def query(self, number: int) -> dict[str, Any]:
        """Tell a query with its two episodes, whatever has become of it.

        Raises
        ------
        Refusal
            If it was never posted.
        """
        asked = self._find(number)
        answers = self._book.answers
        if number in answers.standing:
            state = "answered"
        elif number in answers.undone or number in self._folder.read_open():
            state = "open"
        else:
            state = "retired"
        return {
            "query": number,
            "posterior": asked.posterior,
            "expected": asked.expected,
            "state": state,
            "episodes": [describe_episode(self.world, episode) for episode in asked.episodes],
        }

    def find(self, number: int) -> AskedQuery:
        """Find a query.

        Raises
        ------
        Refusal
            If it was never posted.
        """
        return self._find(number)

    def episode(self) -> dict[str, Any]:
        """Tell the agent's latest episode.

        Raises
        ------
        Refusal
            If there is none yet.
        """
        status = self._read_status()
        if status is None or status.get("episode") is None:
            raise Refusal(404, "unknown", "the agent has not finished an episode yet")
        replay = Replay.from_json(status["episode"])
        return {"env_steps": status["env_steps"], "episode": describe_episode(self.world, replay)}

    def answer(self, number: int, said: str, seconds: float, key: str) -> dict[str, Any]:
        """Record an answer; it is on the disk afterwards, and counts once.

        Raises
        ------
        Refusal
            If the query is unknown or answered already, ``said`` is no answer, or nothing more is taken.
        StorageError
            If it could not be written; nothing has changed then.
        """
        try:
            preference = read_preference(said)
        except ValueError as error:
            raise Refusal(400, "malformed", str(error)) from error
        asked = self._find(number)
        with self._lock:
            answers = self._book.answers
            duplicate = key in answers.keys
            if not duplicate:
                self._require_open()
                if number in answers.standing:
                    stands = answers.standing[number].said
                    detail = f"query {number} has an answer already: {stands}"
                    raise Refusal(409, "answered", detail, query=number, preference=stands)
                self._book.answer(asked, preference, seconds, key)
            return {"recorded": True, "duplicate": duplicate, "queue": self._queue()}

    def undo(self, number: int, key: str) -> dict[str, Any]:
        """Take an answer back.

        Raises
        ------
        Refusal
            If the query is unknown or has no answer that stands, or nothing more is taken.
        StorageError
            If it could not be written; nothing has changed then.
        """
        self._find(number)
        with self._lock:
            answers = self._book.answers
            duplicate = key in answers.keys
            if not duplicate:
                self._require_open()
                if number not in answers.standing:
                    raise Refusal(409, "not_answered", f"query {number} has no answer that stands")
                self._book.undo(number, key)
            return {"recorded": True, "duplicate": duplicate, "queue": self._queue()}

    def accept(self, key: str) -> dict[str, Any]:
        """Record that the notice was accepted.

        Raises
        ------
        Refusal
            If there is none.
        StorageError
            If it could not be written; nothing has changed then.
        """
        if self.notice is None:
            raise Refusal(404, "unknown", "this session has no notice")
        with self._lock:
            answers = self._book.answers
            if self._notice_hash not in answers.notices and key not in answers.keys:
                self._book.consent(self._notice_hash, key)
        return {"given": True}

    def stop(self) -> dict[str, Any]:
        """Ask for no more questions.

        Raises
        ------
        StorageError
            If that could not be written.
        """
        with self._lock:
            if not self._folder.stopped:
                self._folder.stop()
        return {"stopping": True}

    @property
    def _notice_hash(self) -> str:
        return hashlib.sha256((self.notice or "").encode()).hexdigest()

    def _queue(self) -> dict[str, Any]:
        """Tell QUEUE, under the lock, so that of two which differ the later one has the larger revision."""
        answers = self._book.answers
        again = {number: asked.expected or 0.0 for number, asked in answers.undone.items()}
        expected = again | {n: value for n, value in self._folder.read_open().items() if n not in again}
        last = next(reversed(answers.standing.values()), None)
        told = {
            "open": [
                {"query": number, "expected": value}
                for number, value in expected.items()
                if number not in answers.standing
            ],
            "answered": len(answers.informative),
            "queries": self._queries,
            "stopping": self._folder.stopped,
            "last": None if last is None else {"query": last.number, "preference": last.said},
        }
        if told != self._told:
            self._told = told
            self._revision += 1
        return {"session": self._name, "revision": self._revision, **told}

    def _find(self, number: int) -> AskedQuery:
        if number not in self._known:
            asked = self._folder.read(number)
            if asked is None:
                raise Refusal(404, "unknown", f"there is no query {number}")
            self._known[number] = asked
        return self._known[number]

    def _require_open(self) -> None:
        consent = self.consent
        if consent is not None and not consent["given"]:
            raise Refusal(403, "consent", "the notice has not been accepted yet")
        status = self._read_status()
        if status is not None and status["phase"] == "finished":
            raise Refusal(409, "finished", "training has ended; nothing more is taken")

    def _read_status(self) -> dict[str, Any] | None:
        path = self.run / "status.json"
        if not path.exists():
            return None
        status = read_json(path)
        if not isinstance(status, dict) or status.get("version") != 1:
            raise StorageError(f"{path} is damaged, or not of version 1")
        return status


@contextmanager
def hold_session(run: Path) -> Iterator[None]:
    """Keep other processes from taking answers for a run until the block ends.

    Raises
    ------
    StorageError
        If another process does so already, or the folder cannot be made.
    """
    with hold(run / "live", f"{run} has a live session already, in another process"):
        yield


@contextmanager
def hold(folder: Path, refusal: str) -> Iterator[None]:
    """Make a folder and keep other processes from holding it until the block ends.

    Raises
    ------
    StorageError
        With ``refusal``, if another process holds it, or if it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / "live.lock").open("w")
    except OSError as error:
        raise StorageError(f"cannot use {folder}: {error.strerror}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StorageError(refusal) from error
        remove_remains(folder)
        yield
