"""Which pairs of episodes become queries, and how a teacher who answers at once is asked."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from moral_algorithms.answers import Answer, AskedQuery, read_answers
from moral_algorithms.evaluation import Policy
from moral_algorithms.preferences import ACQUISITIONS, Posterior, Query, Teacher
from moral_algorithms.preferences.teachers import ask, require_teacher
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import append_line, repair_lines
from moral_algorithms.storage import StorageError, first_line

SIMULATED = "simulated"
"""Who answers where no person does."""


class Episode(NamedTuple):
    """What is kept of a finished episode for the next queries."""

    returns: NDArray[np.float32]
    """Undiscounted vector return, shape (d,)."""
    objectives: NDArray[np.int64]
    """Ground-truth counters at the end, shape (m,)."""
    replay: Replay
    """The episode itself."""


class Asker(Protocol):
    """How a learner puts queries to a teacher; it adds the answers to the posterior itself."""

    def read(self) -> None:
        """Read what an earlier process has left, before a checkpoint is loaded."""
        ...

    def act(self, env_steps: int, episodes: deque[Episode]) -> bool:
        """Do what is due between two rollouts; returns whether there was something."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """State that JSON can hold."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken; the posterior has been restored before."""
        ...


def play_once(policy: Policy, venv: VecEnv) -> list[Episode]:
    """Play the first episode from now on in every environment, whichever ends first.

    Parameters
    ----------
    policy
        Chooses the actions; it samples from PyTorch's global generator.
    venv
        `ScalarisedRewards`, or a wrapper around it; it is reset. Where all episodes are equally long they end
        at the same step.

    Returns
    -------
    list
        One episode per environment, in their order.
    """
    observations = venv.reset()
    assert isinstance(observations, np.ndarray)
    finished: dict[int, Episode] = {}
    while len(finished) < venv.num_envs:
        after, _, dones, infos = venv.step(policy.predict(observations)[0])
        assert isinstance(after, np.ndarray)
        observations = after
        for row in dones.nonzero()[0].tolist():
            info = infos[row]
            finished.setdefault(row, Episode(info["returns"], info["objectives"], info["replay"]))
    return [finished[row] for row in range(venv.num_envs)]


class QueryChooser:
    """Draws random pairs of episodes and finds the one to ask.

    Parameters
    ----------
    posterior
        What is known of the weights.
    acquisition
        Name of the acquisition function.
    candidates
        How many pairs are drawn.
    seed
        Entropy of the pairs.
    centred
        Share of the pairs that stay candidates, above 0: those that lie nearest to symmetric about the mean
        of the episodes.
    """

    def __init__(
        self, posterior: Posterior, acquisition: str, candidates: int, seed: int, centred: float = 1.0
    ) -> None:
        self._posterior = posterior
        self._acquisition = acquisition
        self._candidates = candidates
        self._centred = centred
        self.rng = np.random.default_rng(seed)

    def draw(
        self, episodes: Sequence[Episode] | deque[Episode]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Draw candidates among at least two episodes.

        Returns
        -------
        pairs : int64, shape (P, 2)
            Indices of episodes.
        returns : float64, shape (P, 2, d)
            Their returns.
        """
        returns = np.array([episode.returns for episode in episodes], dtype=np.float64)
        count = len(returns)
        first = self.rng.integers(count, size=self._candidates)
        second = (first + self.rng.integers(1, count, size=self._candidates)) % count
        pairs = np.stack([first, second], axis=1)
        # Equal returns teach nothing, yet volume removal under a logistic likelihood likes them best.
        differ = ~np.isclose(returns[first], returns[second]).all(axis=1)
        pairs = pairs[differ] if differ.any() else pairs
        if self._centred < 1.0:
            kept = max(round(self._centred * len(pairs)), 1)
            pairs = pairs[np.argsort(_eccentricities(returns, pairs), kind="stable")[:kept]]
        return pairs, returns[pairs]

    def best(self, returns: NDArray[np.float64], samples: NDArray[np.float64] | None = None) -> int:
        """Index of the candidate to ask, of those with returns (P, 2, d); under other samples if given."""
        known = self._posterior.samples if samples is None else samples
        acquisition = ACQUISITIONS[self._acquisition]
        return int(np.argmax(acquisition(known, returns, self._posterior.likelihood, self.rng)))


def _eccentricities(returns: NDArray[np.float64], pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """Squared Mahalanobis distances (P,) of the midpoints of pairs from the mean of returns (n, d)."""
    midpoints = returns[pairs].mean(axis=1) - returns.mean(axis=0)
    # A component that is the same in all episodes has no spread to measure it by.
    precision = np.linalg.pinv(np.atleast_2d(np.cov(returns, rowvar=False)), hermitian=True)
    distances: NDArray[np.float64] = np.einsum("pd,de,pe->p", midpoints, precision, midpoints)
    return distances


class TeacherAsker:
    """Asks a teacher who answers at once, at even intervals; training waits for the answer.

    Parameters
    ----------
    teacher
        Who answers.
    chooser
        Chooses the queries.
    posterior
        Takes the answers.
    span
        Environment steps over which the queries are spread.
    queries
        How many there are.
    path
        The file of answers.
    """

    def __init__(
        self,
        teacher: Teacher,
        chooser: QueryChooser,
        posterior: Posterior,
        span: float,
        queries: int,
        path: Path,
    ) -> None:
        require_teacher(teacher)
        self._teacher = teacher
        self._chooser = chooser
        self._posterior = posterior
        self._span = span
        self._queries = queries
        self._path = path
        self._answered: list[Answer] = []

    def read(self) -> None:
        """Read the answers of an earlier process; they are used when their turn comes.

        Raises
        ------
        StorageError
            If the file is damaged.
        """
        repair_lines(self._path)
        self._answered = list(read_answers(self._path).standing.values())
        for number, answer in enumerate(self._answered):
            if answer.number != number or answer.preference is None or answer.teacher is None:
                raise StorageError(
                    f"{self._path} is damaged in line {number + 1}: "
                    f"it is not a teacher's answer to query {number}"
                )

    def act(self, env_steps: int, episodes: deque[Episode]) -> bool:
        """Ask the queries that are due; return whether there was one."""
        asked = False
        while self._is_due(env_steps) and len(episodes) > 1:
            self.ask(env_steps, episodes)
            asked = True
        return asked

    def _is_due(self, env_steps: int) -> bool:
        asked = self._posterior.num_queries
        return asked < self._queries and env_steps >= self._span * (asked + 1) / self._queries

    def ask(self, env_steps: int, episodes: deque[Episode]) -> None:
        """Ask the next query, of two of at least two episodes; they are removed if the teacher skips it."""
        number = self._posterior.num_queries
        pairs, returns = self._chooser.draw(episodes)
        first, second = (episodes[index] for index in pairs[self._chooser.best(returns)])
        if number < len(self._answered):
            # Answered before a crash that came before the checkpoint: the teacher is not asked again.
            answer = self._answered[number]
            if answer.asked.env_steps > env_steps:
                # This try was skipped, and a later one answered.
                episodes.clear()
                return
            restore_teacher(self._teacher, answer.teacher or {}, self._path)
        else:
            asked = as_query(number, number, env_steps, first, second)
            preference = ask(self._teacher, asked.pair)
            if preference is None:
                # Skipped: the next try waits for other episodes.
                episodes.clear()
                return
            answer = Answer(asked, preference, SIMULATED, teacher=self._teacher.state_dict())
            append_line(self._path, answer.to_json())
            self._answered.append(answer)
        assert answer.preference is not None
        self._posterior.add(answer.asked.pair.returns, answer.preference)

    def state_dict(self) -> dict[str, Any]:
        """State of the candidates and of the teacher."""
        return {"candidates": self._chooser.rng.bit_generator.state, "teacher": self._teacher.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken, with the answers that `read` has found.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the state is damaged.
        StorageError
            If answers are missing from the file.
        """
        self._chooser.rng.bit_generator.state = state["candidates"]
        self._teacher.load_state_dict(state["teacher"])
        used = self._posterior.num_queries
        if len(self._answered) < used:
            raise StorageError(f"{self._path} has {len(self._answered)} answers; the checkpoint has {used}")


def as_query(
    number: int,
    answers: int,
    env_steps: int,
    first: Episode,
    second: Episode,
    expected: float | None = None,
) -> AskedQuery:
    """Make a query of two episodes, chosen by a posterior of so many answers."""
    pair = Query(
        np.array([first.returns, second.returns], dtype=np.float64),
        np.array([first.objectives, second.objectives]),
    )
    return AskedQuery(number, answers, env_steps, pair, (first.replay, second.replay), expected)


def restore_teacher(teacher: Teacher, state: dict[str, Any], path: Path) -> None:
    """Give a teacher the state that a file of answers holds.

    Raises
    ------
    StorageError
        If the teacher cannot have it.
    """
    try:
        teacher.load_state_dict(state)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise StorageError(
            f"{path} is damaged: it holds a state that its teacher cannot have: {first_line(error)}"
        ) from error
