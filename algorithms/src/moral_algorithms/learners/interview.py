"""Queries about clips: which are asked, how answers are kept, and how a run that goes on finds them again."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.bridge import Replay
from moral_algorithms.learners.asking import restore_teacher
from moral_algorithms.learners.clips import Pairs, Recording, draw_pairs, play_again
from moral_algorithms.learners.reward_model import RewardModel, disagreement
from moral_algorithms.preferences import Preference, Query, Teacher
from moral_algorithms.preferences.teachers import ask, require_teacher
from moral_algorithms.run_directory import append_line, read_lines, repair_lines
from moral_algorithms.storage import StorageError
from moral_envs.world import World

# Answers whose episodes are played again at once when a run is resumed.
_RESTORING = 100


class Interview:
    """Chooses pairs of clips, puts them to a teacher and keeps the answers, on the disk first.

    A teacher sees of a clip what was counted within it. A line of the file holds a query's number, when it
    was asked (``env_steps``, and ``slot`` among those of the same moment), its episodes, which can be
    played again, what was shown, the ``preference`` and the teacher's state. A query that the teacher skips
    leaves no line; others come in its place at the next moment.

    Parameters
    ----------
    world
        The rules.
    reward
        Predicts the returns of clips, and holds the answers.
    teacher
        Answers.
    length
        Steps of a clip.
    candidates
        Random pairs per query, of which those that the ensemble disagrees about most are asked.
    seed
        Entropy of the pairs.
    path
        The file of answers.
    """

    def __init__(
        self,
        world: World,
        reward: RewardModel,
        teacher: Teacher,
        length: int,
        candidates: int,
        seed: int,
        path: Path,
    ) -> None:
        require_teacher(teacher)
        self._world = world
        self._reward = reward
        self._teacher = teacher
        self._length = length
        self._candidates = candidates
        self._rng = np.random.default_rng(seed)
        self._path = path
        # Answers that were given after the moment from which a run goes on.
        self._given: deque[dict[str, Any]] = deque()
        self._earlier: list[Replay] = []
        self._episodes = 0

    @property
    def num_answers(self) -> int:
        """Answers so far."""
        return len(self._reward.answers)

    def read(self, most: int) -> None:
        """Read the answers of an earlier process; they are used at the moments at which they were given.

        Parameters
        ----------
        most
            How many queries the run asks.

        Raises
        ------
        StorageError
            If the file is damaged or of another run.
        """
        repair_lines(self._path)
        answered = _read_answers(self._path, self._world, self._length)
        if len(answered) > most:
            raise StorageError(f"{self._path} has {len(answered)} answers; this run asks {most}")
        self._given.extend(answered)

    def ask(self, replays: list[Replay], count: int, env_steps: int) -> Recording:
        """Ask about some episodes, each beside another of them or an earlier one.

        A policy that has run after an error of the reward plays episodes that are all alike: comparing them
        with each other would not correct it.

        Parameters
        ----------
        replays
            The episodes, at least two, that were not asked about before.
        count
            How many queries.
        env_steps
            Environment steps so far.

        Returns
        -------
        Recording
            These episodes and earlier ones, in this order, played again.

        Raises
        ------
        StorageError
            If an answer cannot be written.
        """
        recording = play_again(self._world, [*replays, *self._earlier])
        rewards = self._reward.predict(recording)
        pairs = draw_pairs(self._rng, recording, self._length, count * self._candidates, len(replays))
        # Where all members agree, as one does with itself, the first are as random as any.
        chosen = np.argsort(-disagreement(rewards, pairs), kind="stable")[:count]
        returns = pairs.sums(rewards.mean(axis=0))
        for slot, index in enumerate(chosen.tolist()):
            if self._given and _moment(self._given[0]) <= (env_steps, slot):
                # Answered before a crash that came before the checkpoint: the teacher is not asked again.
                record = self._given.popleft()
                restore_teacher(self._teacher, record["teacher"], self._path)
                self._keep([record])
            elif not self._given:
                self._ask_one(recording, pairs, index, returns[index], (env_steps, slot))
            # Else it was skipped, for later ones were answered.
        self._remember(replays)
        return recording

    def _remember(self, replays: list[Replay]) -> None:
        """Keep a uniform sample of all episodes so far, of as many as there are in one moment."""
        for replay in replays:
            self._episodes += 1
            place = int(self._rng.integers(self._episodes))
            if len(self._earlier) < len(replays):
                self._earlier.append(replay)
            elif place < len(self._earlier):
                self._earlier[place] = replay

    def _ask_one(
        self,
        recording: Recording,
        pairs: Pairs,
        index: int,
        returns: NDArray[np.float64],
        moment: tuple[int, int],
    ) -> None:
        objectives = pairs.objectives(index, recording.counters)
        preference = ask(self._teacher, Query(returns[:, None], objectives))
        if preference is None:
            return
        env_steps, slot = moment
        record = {
            "query": self.num_answers,
            "env_steps": env_steps,
            "slot": slot,
            "returns": returns.tolist(),
            "objectives": objectives.tolist(),
            "episodes": [recording.replays[episode].to_json() for episode in pairs.episodes[index]],
            "starts": pairs.starts[index].tolist(),
            "length": self._length,
            "preference": preference.value,
            "teacher": self._teacher.state_dict(),
        }
        append_line(self._path, record)
        states, actions = pairs.cut(index, recording.states), pairs.cut(index, recording.actions)
        self._reward.answers.add(states, actions, preference)

    def _keep(self, records: list[dict[str, Any]]) -> None:
        """Keep answers that were given before."""
        replays = [Replay.from_json(episode) for record in records for episode in record["episodes"]]
        recording = play_again(self._world, replays)
        episodes = np.arange(2 * len(records)).reshape(-1, 2)
        pairs = Pairs(episodes, np.array([record["starts"] for record in records]), self._length)
        for index, record in enumerate(records):
            states, actions = pairs.cut(index, recording.states), pairs.cut(index, recording.actions)
            self._reward.answers.add(states, actions, Preference(record["preference"]))

    def state_dict(self) -> dict[str, Any]:
        """State that JSON can hold; the answers themselves are in the file."""
        return {
            "answers": self.num_answers,
            "episodes": self._episodes,
            "earlier": [replay.to_json() for replay in self._earlier],
            "pairs": self._rng.bit_generator.state,
            "teacher": self._teacher.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where :meth:`state_dict` was taken, once :meth:`read` has read the answers.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the state is damaged.
        StorageError
            If answers are missing from the file.
        """
        count = int(state["answers"])
        if len(self._given) < count:
            raise StorageError(f"{self._path} has {len(self._given)} answers; the checkpoint has {count}")
        for start in range(0, count, _RESTORING):
            self._keep([self._given.popleft() for _ in range(min(_RESTORING, count - start))])
        self._episodes = int(state["episodes"])
        self._earlier = [Replay.from_json(episode) for episode in state["earlier"]]
        self._rng.bit_generator.state = state["pairs"]
        self._teacher.load_state_dict(state["teacher"])


def _moment(record: dict[str, Any]) -> tuple[int, int]:
    """When a query was asked: after how many environment steps, and as which of that moment."""
    return int(record["env_steps"]), int(record["slot"])


def _read_answers(path: Path, world: World, length: int) -> list[dict[str, Any]]:
    """Read the answered queries, checked: a damaged one must not come to light in the middle of training."""
    answers = read_lines(path)
    before = (-1, -1)
    for number, record in enumerate(answers):
        try:
            Query(np.array(record["returns"])[:, None], np.array(record["objectives"]))
            Preference(record["preference"])
            replays = [Replay.from_json(episode) for episode in record["episodes"]]
            starts = np.array(record["starts"])
            valid = (
                record["query"] == number
                and record["length"] == length
                and isinstance(record["teacher"], dict)
                and [len(replay.actions) for replay in replays] == [world.horizon] * 2
                and all((replay.actions < world.num_actions).all() for replay in replays)
                and starts.shape == (2,)
                and starts.dtype.kind == "i"
                and bool(((starts >= 0) & (starts <= world.horizon - length)).all())
                and before < _moment(record)
            )
            before = _moment(record)
        except (KeyError, TypeError, ValueError, OverflowError, IndexError):
            valid = False
        if not valid:
            raise StorageError(
                f"{path} is damaged in line {number + 1}: it is not the answer to query {number}"
            )
    return answers
