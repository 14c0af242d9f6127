"""Queries for people: posted into the run directory, answered in their own time.

Training never waits for an answer and nobody waits for training: the two meet in the run directory alone.
Queries go to the folder ``queue`` (:mod:`moral_algorithms.query_folder`); answers come from ``queries.jsonl``
(:mod:`moral_algorithms.answers`), written by whoever receives them.

At the start of each rollout the answers that have arrived go to the posterior. A query that has become
pointless, as its expected regret has fallen far below the best candidate's, leaves ``open.json``, and another
one comes in its place. Should it be answered all the same, the answer counts: it is evidence.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.answers import Answers, AskedQuery, read_answers
from moral_algorithms.learners.asking import Episode, QueryChooser, as_query
from moral_algorithms.learners.pace import Pace
from moral_algorithms.preferences import Posterior, Query, expected_regret
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.run_directory import RunDirectory

ENOUGH = 0.01
"""Expected regret below which another answer would change little: a hundredth of what a policy earns that
pursues one primary component alone."""

# Queries that are open at a time.
_OPEN = 3
# An open query is pointless when its expected regret is below this share of the best candidate's.
_POINTLESS = 0.25
# Rollouts after which candidates are looked at although no answer has come.
_LOOK_EVERY = 5
# Regret is judged as the greatest of so many looks: a few episodes that are alike tell little.
_LOOKS = 4
# Answers without which nobody is told that it is enough: early episodes tell little, too.
_FEWEST_ANSWERS = 5
# A query is repeated when so many others have been answered since.
_BETWEEN_REPEATS = 3
# Environment steps without an answer after which training rests.
_PATIENCE = 3_000_000


@dataclass(frozen=True)
class People:
    """People as teachers: they answer through the run directory, in their own time."""

    repeat_every: int = 0
    """Every so many-th query repeats an answered one, sides swapped, to measure consistency; 0: none does."""

    def __post_init__(self) -> None:
        if self.repeat_every < 0:
            raise ValueError(f"repeat_every is {self.repeat_every}; it must be at least 0")


class QueryQueue:
    """Keeps a few good queries open, and takes in answers when they come.

    Parameters
    ----------
    people
        Who answers.
    chooser
        Chooses the queries.
    posterior
        Takes the answers.
    pace
        How far the training is, and how many queries may be asked.
    directory
        Where they go.
    """

    def __init__(
        self,
        people: People,
        chooser: QueryChooser,
        posterior: Posterior,
        pace: Pace,
        directory: RunDirectory,
    ) -> None:
        self.pace = pace
        self._people = people
        self._chooser = chooser
        self._posterior = posterior
        self._path = directory.queries
        self._folder = QueryFolder(directory.path)
        self._prior = posterior.state_dict()
        self._open: dict[int, AskedQuery] = {}
        self._repeated: set[int] = set()
        self._next = 0
        self._taken: list[list[Any]] = []
        self._changed = False
        self._answers = Answers()
        self._bytes = -1
        self._last_answer = 0
        self._looked = 0
        self._regrets: deque[float] = deque(maxlen=_LOOKS)

    def read(self) -> None:
        """Find the queries that an earlier process has posted.

        Raises
        ------
        StorageError
            If one is damaged.
        """
        self._folder.prepare()
        posted = {number: self._folder.read(number) for number in self._folder.numbers()}
        self._next = 1 + max(posted, default=-1)
        asked = [query for query in posted.values() if query is not None]
        self._repeated = {query.repeats for query in asked if query.repeats is not None}
        still_open = self._folder.read_open()
        self._open = {query.number: query for query in asked if query.number in still_open}

    def act(self, env_steps: int, episodes: deque[Episode]) -> bool:
        """Take answers in, retire what has become pointless and post what is missing."""
        self.take_in(env_steps)
        changed, self._changed = self._changed, False
        self._looked += 1
        if self.pace.closing:
            if self._open:
                self._open = {}
                self._folder.write_open({})
        elif len(episodes) > 1 and (changed or self._missing(env_steps) > 0 or self._looked >= _LOOK_EVERY):
            self._looked = 0
            self._look(env_steps, episodes)
        return changed

    def take_in(self, env_steps: int) -> None:
        """Bring the posterior up to date with the answers."""
        self._read_answers()
        informative = self._answers.informative
        self.pace.update(env_steps, len(informative), self._folder.stopped)
        now = [[answer.number, answer.key] for answer in informative]
        if now == self._taken:
            return
        if now[: len(self._taken)] != self._taken:
            # One was taken back: what the others teach is found from the start.
            self._posterior.load_state_dict(self._prior)
            self._taken = []
        for answer in informative[len(self._taken) :]:
            assert answer.preference is not None
            self._posterior.add(answer.asked.pair.returns, answer.preference)
        self._taken = now
        self._last_answer = env_steps
        self._changed = True

    def is_idle(self, env_steps: int) -> bool:
        """Whether nobody has answered for so long that training had better rest."""
        return not self.pace.closing and env_steps - self._last_answer > _PATIENCE

    def advice(self) -> dict[str, Any] | None:
        """Say whether more answers would change anything; None before there is anything to say."""
        if not self._regrets:
            return None
        regret = max(self._regrets)
        enough = (
            regret < ENOUGH
            and len(self._regrets) == _LOOKS
            and self._posterior.num_queries >= _FEWEST_ANSWERS
        )
        return {"regret": regret, "threshold": ENOUGH, "enough": enough}

    def _read_answers(self) -> None:
        try:
            size = self._path.stat().st_size
        except FileNotFoundError:
            size = 0
        if size != self._bytes:
            self._answers = read_answers(self._path)
            self._bytes = size
            for number in self._answers.standing:
                self._open.pop(number, None)

    def _missing(self, env_steps: int) -> int:
        """How many queries may be posted now."""
        answers = self._answers
        waiting = len(self._open) + sum(number not in self._open for number in answers.undone)
        return min(_OPEN, self.pace.due(env_steps) - len(answers.informative)) - waiting

    def _look(self, env_steps: int, episodes: deque[Episode]) -> None:
        """Look at candidates: retire open queries beside them, and post the best."""
        pairs, returns = self._chooser.draw(episodes)
        best = float(self._regret(returns).max())
        self._regrets.append(best)
        expected = self._expected(list(self._open.values()))
        for number, asked in list(self._open.items()):
            if asked.repeats is None and expected[number] < _POINTLESS * best:
                del self._open[number]
        for _ in range(self._missing(env_steps)):
            chosen = self._repeat(env_steps) or self._new(env_steps, episodes, pairs, returns)
            if chosen is None:
                break
            self._folder.post(chosen)
            self._open[self._next] = chosen
            self._next += 1
        self._folder.write_open(self._expected(list(self._open.values())))

    def _new(
        self,
        env_steps: int,
        episodes: deque[Episode],
        pairs: NDArray[np.int64],
        returns: NDArray[np.float64],
    ) -> AskedQuery | None:
        """Ask the best candidate; None if there is none that nobody was shown yet."""
        shown = [answer.asked for answer in self._answers.standing.values()]
        shown += [*self._answers.undone.values(), *self._open.values()]
        known = {frozenset(episode.stream for episode in asked.episodes) for asked in shown}
        streams = [episode.replay.stream for episode in episodes]
        fresh = np.array([frozenset(streams[i] for i in pair) not in known for pair in pairs.tolist()])
        if not fresh.any():
            return None
        pairs, returns = pairs[fresh], returns[fresh]
        index = self._chooser.best(returns, self._imagine(list(self._open.values())))
        first, second = (episodes[episode] for episode in pairs[index])
        expected = float(self._regret(returns[index : index + 1])[0])
        return as_query(self._next, self._posterior.num_queries, env_steps, first, second, expected)

    def _repeat(self, env_steps: int) -> AskedQuery | None:
        """Repeat an answered query with its sides swapped, if one is due."""
        every = self._people.repeat_every
        if every == 0 or self._next % every != every - 1:
            return None
        answered = [answer.asked for answer in self._answers.informative][:-_BETWEEN_REPEATS]
        fresh = [asked for asked in answered if asked.repeats is None and asked.number not in self._repeated]
        if not fresh:
            return None
        asked = fresh[int(self._chooser.rng.integers(len(fresh)))]
        self._repeated.add(asked.number)
        return replace(
            asked,
            number=self._next,
            posterior=self._posterior.num_queries,
            env_steps=env_steps,
            pair=Query(asked.pair.returns[::-1], asked.pair.objectives[::-1]),
            episodes=(asked.episodes[1], asked.episodes[0]),
            expected=float(self._regret(asked.pair.returns[None])[0]),
            repeats=asked.number,
        )

    def _imagine(self, unanswered: Sequence[AskedQuery]) -> NDArray[np.float64]:
        """Draw samples of the posterior as if one of them had answered the open queries.

        Else the next query would ask once more what the open ones ask already.
        """
        samples = self._posterior.samples
        if not unanswered:
            return samples
        rng = self._chooser.rng
        differences = np.array([asked.pair.returns[0] - asked.pair.returns[1] for asked in unanswered])
        imagined = np.sign(differences @ samples[rng.integers(len(samples))])
        log_weights = self._posterior.likelihood.log_probability(samples @ differences.T * imagined).sum(
            axis=1
        )
        weights = np.exp(log_weights - log_weights.max())
        picked: NDArray[np.float64] = samples[
            rng.choice(len(samples), size=len(samples), p=weights / weights.sum())
        ]
        return picked

    def _expected(self, queries: Sequence[AskedQuery]) -> dict[int, float]:
        """Compute the expected regret of queries, by number."""
        if not queries:
            return {}
        regrets = self._regret(np.array([asked.pair.returns for asked in queries]))
        return dict(zip((asked.number for asked in queries), regrets.tolist(), strict=True))

    def _regret(self, returns: NDArray[np.float64]) -> NDArray[np.float64]:
        posterior = self._posterior
        return expected_regret(posterior.samples, returns, posterior.likelihood, self._chooser.rng)

    def state_dict(self) -> dict[str, Any]:
        """State that JSON can hold; queries and answers are in their files."""
        return {
            "candidates": self._chooser.rng.bit_generator.state,
            "pace": self.pace.state_dict(),
            "taken": self._taken,
            "last_answer": self._last_answer,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the state is damaged.
        """
        self._chooser.rng.bit_generator.state = state["candidates"]
        self.pace.load_state_dict(state["pace"])
        self._taken = [[int(number), str(key)] for number, key in state["taken"]]
        self._last_answer = int(state["last_answer"])
