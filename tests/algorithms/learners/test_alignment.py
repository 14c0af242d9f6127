"""Queries about a policy for all weights."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.learners.alignment import AlignmentConfig, ask_teacher
from moral_algorithms.learners.covering import CoveringConfig, train_covering
from moral_algorithms.learners.moral import AlignedAgent
from moral_algorithms.learners.ppo import Progress
from moral_algorithms.networks.conditioned import ConditionedPolicy
from moral_algorithms.preferences import LexicographicTeacher, NoisyTeacher, Preference, Query, Teacher
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError
from tests.algorithms.tiny import EMERGENCY, parameters, ppo_config

BUILT = EMERGENCY.build()
COMPONENTS = [
    PrimaryReward(BUILT.reward_names, "extinguish", 1.4),
    PrimaryReward(BUILT.reward_names, "save", 0.5),
]


@pytest.fixture(scope="module")
def policy() -> ConditionedPolicy:
    config = CoveringConfig(steps=15_000, span=30.0, ppo=ppo_config())
    return train_covering(EMERGENCY, COMPONENTS, config, seed=0).policy


def config(**changes: Any) -> AlignmentConfig:
    return AlignmentConfig(**{"queries": 6, "candidates": 200, "samples": 100, "episodes": 16, **changes})


def ask(policy: ConditionedPolicy, teacher: Teacher, folder: Path, **options: Any) -> AlignedAgent:
    resume = options.pop("resume", False)
    folder.mkdir(exist_ok=True)
    directory = RunDirectory(folder)
    return ask_teacher(EMERGENCY, COMPONENTS, policy, teacher, config(**options), 5, directory, resume=resume)


class Recorder(Teacher):
    """Prefers one objective, and remembers what it was asked."""

    def __init__(self, objective: str, skip: int = 0) -> None:
        self._teacher = LexicographicTeacher((objective,), BUILT.objective_names)
        self._skip = skip
        self.asked: list[Query] = []

    def prefer(self, query: Query) -> Preference | None:
        self.asked.append(query)
        return None if len(self.asked) <= self._skip else self._teacher.prefer(query)


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_weights_follow_the_teacher(policy: ConditionedPolicy, tmp_path: Path) -> None:
    time = ask(policy, Recorder("goal_time"), tmp_path / "time", concentration=1.0)
    saved = ask(policy, Recorder("people_saved"), tmp_path / "saved", concentration=1.0)
    # Equal before the first answer; an answer of a teacher with one wish can only move it one way.
    assert time.weights[0] > 0.6
    assert saved.weights[1] > 0.6
    last_time, last_saved = (lines(tmp_path / name / "metrics.jsonl")[-1] for name in ("time", "saved"))
    assert last_time["objectives"]["goal_time"] > last_saved["objectives"]["goal_time"] + 1
    assert last_saved["objectives"]["people_saved"] > last_time["objectives"]["people_saved"]


def test_a_run_records_what_it_did(policy: ConditionedPolicy, tmp_path: Path) -> None:
    agent = ask(policy, Recorder("people_saved"), tmp_path)
    answers, metrics = lines(tmp_path / "queries.jsonl"), lines(tmp_path / "metrics.jsonl")
    assert [answer["query"] for answer in answers] == list(range(6))
    # Episodes before each query and at the end, of eight steps each.
    steps = [16 * 8 * count for count in range(1, 8)]
    assert [line["env_steps"] for line in metrics] == steps
    assert [answer["env_steps"] for answer in answers] == steps[:-1]
    assert [line["queries"] for line in metrics] == list(range(7))
    assert agent.env_steps == steps[-1]
    assert metrics[0]["weights"] == {"extinguish": 0.5, "save": 0.5}
    np.testing.assert_allclose(list(metrics[-1]["weights"].values()), agent.weights, rtol=1e-6)
    wanted = parameters(policy.policy_at(agent.weights))
    found = parameters(agent.policy)
    assert all((wanted[name] == found[name]).all() for name in wanted)


@pytest.mark.parametrize("exploration", [0.0, 0.5, 1.0])
def test_every_other_episode_explores(exploration: float, policy: ConditionedPolicy, tmp_path: Path) -> None:
    class Spy:
        """Remembers the weights that the policy is shown in each step."""

        def __init__(self) -> None:
            self.seen: list[np.ndarray] = []

        def predict(self, observations: np.ndarray) -> Any:
            self.seen.append(observations[:, -2:].copy())
            return policy.predict(observations)

        def policy_at(self, weights: np.ndarray) -> Any:
            return policy.policy_at(weights)

    spy: Any = Spy()
    ask(spy, Recorder("goal_time"), tmp_path, exploration=exploration)
    guesses = [list(line["weights"].values()) for line in lines(tmp_path / "metrics.jsonl")]
    # Seven times eight steps.
    rounds = np.array(spy.seen).reshape(7, 8, 16, 2)
    assert (rounds == rounds[:, :1]).all()
    spread = []
    for played, guess in zip(rounds[:-1, 0], guesses, strict=False):
        np.testing.assert_allclose(played[::2], np.tile(guess, (8, 1)), rtol=1e-6)
        np.testing.assert_allclose(played.sum(axis=1), 1, rtol=1e-6)
        spread.append((played[1::2] - guess)[:, 0].std())
    # Uniform weights have a standard deviation of 0.29, those of the prior, of concentration 5, of 0.15.
    assert 0.08 * exploration <= spread[0] <= 0.25 * exploration
    # What is measured in the end follows the answer alone.
    np.testing.assert_allclose(rounds[-1, 0], np.tile(guesses[-1], (16, 1)), rtol=1e-6)


def test_answered_queries_are_not_asked_again(policy: ConditionedPolicy, tmp_path: Path) -> None:
    def noisy() -> tuple[Recorder, NoisyTeacher]:
        recorder = Recorder("people_saved")
        return recorder, NoisyTeacher(recorder, 0.3, np.random.default_rng(3))

    whole = ask(policy, noisy()[1], tmp_path / "whole")
    queries = (tmp_path / "whole" / "queries.jsonl").read_bytes()
    for kept in (0, 2, 6):
        folder = tmp_path / f"kept {kept}"
        folder.mkdir()
        # As it was left in the middle of writing the next answer.
        head = b"".join(queries.splitlines(keepends=True)[:kept]) + (b'{"env_st' if kept < 6 else b"")
        (folder / "queries.jsonl").write_bytes(head)
        with pytest.raises(StorageError, match="is there already"):
            ask(policy, noisy()[1], folder)
        recorder, teacher = noisy()
        resumed = ask(policy, teacher, folder, resume=True)
        assert len(recorder.asked) <= 6 - kept
        np.testing.assert_array_equal(resumed.weights, whole.weights)
        for name in ("queries.jsonl", "metrics.jsonl"):
            assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_skipped_query_is_replaced(policy: ConditionedPolicy, tmp_path: Path) -> None:
    teacher = Recorder("people_saved", skip=2)
    agent = ask(policy, teacher, tmp_path, queries=3)
    assert len(lines(tmp_path / "queries.jsonl")) == 3
    assert len(teacher.asked) == 5
    assert agent.env_steps == (3 + 2 + 1) * 16 * 8
    assert (teacher.asked[0].returns != teacher.asked[1].returns).any()


def test_a_teacher_who_skips_is_resumed_exactly(policy: ConditionedPolicy, tmp_path: Path) -> None:
    class EveryOther(Recorder):
        """Skips every other query, those that it was asked before a crash included."""

        def prefer(self, query: Query) -> Preference | None:
            answer = super().prefer(query)
            return answer if len(self.asked) % 2 == 0 else None

        def state_dict(self) -> dict[str, Any]:
            return {"asked": len(self.asked)}

        def load_state_dict(self, state: Mapping[str, Any]) -> None:
            self.asked = [Query(np.zeros((2, 2)), np.zeros((2, 2), dtype=np.int64))] * state["asked"]

    whole = ask(policy, EveryOther("goal_time"), tmp_path / "whole", queries=4)
    assert whole.env_steps == (2 * 4 + 1) * 16 * 8
    queries = (tmp_path / "whole" / "queries.jsonl").read_bytes()
    for kept in (1, 2, 4):
        folder = tmp_path / f"kept {kept}"
        folder.mkdir()
        (folder / "queries.jsonl").write_bytes(b"".join(queries.splitlines(keepends=True)[:kept]))
        resumed = ask(policy, EveryOther("goal_time"), folder, queries=4, resume=True)
        np.testing.assert_array_equal(resumed.weights, whole.weights)
        for name in ("queries.jsonl", "metrics.jsonl"):
            assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_progress_ends_at_its_total(policy: ConditionedPolicy, tmp_path: Path) -> None:
    told: list[Progress] = []
    teacher = Recorder("goal_time", skip=2)
    ask_teacher(
        EMERGENCY, COMPONENTS, policy, teacher, config(queries=3), 5, RunDirectory(tmp_path), told.append
    )
    assert [progress.steps for progress in told] == [128 * count for count in range(1, 7)]
    assert all(progress.steps <= progress.total_steps for progress in told)
    assert told[-1].steps == told[-1].total_steps


def test_a_teacher_who_skips_everything_is_asked_no_more(policy: ConditionedPolicy, tmp_path: Path) -> None:
    teacher = Recorder("people_saved", skip=1000)
    agent = ask(policy, teacher, tmp_path, queries=3)
    assert (len(teacher.asked), agent.queries) == (6, 0)
    np.testing.assert_allclose(agent.weights, 0.5)


def test_a_teacher_may_answer_by_a_string(policy: ConditionedPolicy, tmp_path: Path) -> None:
    class Plain(Recorder):
        def prefer(self, query: Query) -> Any:
            answer = super().prefer(query)
            return answer and answer.value

    agent, plain = (
        ask(policy, kind("goal_time"), tmp_path / kind.__name__, queries=2) for kind in (Recorder, Plain)
    )
    np.testing.assert_array_equal(agent.weights, plain.weights)
    assert plain.queries == 2


class _Yes(Recorder):
    def prefer(self, query: Query) -> Any:
        return True


class _Numpy(Recorder):
    def state_dict(self) -> dict[str, Any]:
        return {"asked": np.int64(3)}


class _NoTeacher:
    def prefer(self, query: Query) -> Preference:
        return Preference.FIRST


@pytest.mark.parametrize(
    ("teacher", "message"),
    [
        (_Yes("goal_time"), "preference is True; it must be 'first', 'second' or 'equal'"),
        (_Numpy("goal_time"), "teacher has a state that JSON cannot hold: Object of type int64"),
        (_NoTeacher(), r"teacher is a _NoTeacher without state_dict\(\); it must be a subclass of Teacher"),
    ],
)
def test_who_is_no_teacher_is_refused(
    teacher: Any, message: str, policy: ConditionedPolicy, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        ask(policy, teacher, tmp_path)


def test_without_queries_there_is_the_prior(policy: ConditionedPolicy, tmp_path: Path) -> None:
    agent = ask(policy, Recorder("goal_time"), tmp_path, queries=0)
    np.testing.assert_allclose(agent.weights, 0.5)
    assert agent.env_steps == 16 * 8


def test_damaged_answers_are_refused(policy: ConditionedPolicy, tmp_path: Path) -> None:
    (tmp_path / "queries.jsonl").write_text("{}\n")
    with pytest.raises(StorageError, match="is damaged in line 1"):
        ask(policy, Recorder("goal_time"), tmp_path, resume=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"episodes": 1}, "episodes is 1; it must be at least 2"),
        ({"exploration": -0.1}, "exploration is -0.1; it must be at least 0 and at most 1"),
        ({"exploration": 1.1}, "exploration is 1.1; it must be at least 0 and at most 1"),
        ({"exploration": math.nan}, "exploration is nan; it must be at least 0"),
        ({"queries": -1}, "queries is -1; it must be at least 0"),
        ({"lapse": 1.0}, "lapse is 1.0; it must be at least 0 and below 1"),
        (
            {"prior": "ball", "concentration": 1.0, "likelihood": "exponential", "lapse": 0.1},
            "lapse is 0.1; it must be 0 with",
        ),
        ({"prior": "ball", "concentration": 5.0}, "concentration is 5.0; it must be 1 with the ball prior"),
        ({"rationality": 3.0}, "rationality is 3.0; it belongs to the ball prior, the other infers it"),
        (
            {"prior": "ball", "concentration": 1.0, "rationality": math.inf},
            "rationality is inf; it must be pos",
        ),
        ({"centred": 0.0}, "centred is 0.0; it must be above 0 and at most 1"),
        ({"concentration": 0.5}, "concentration is 0.5; it must be at least 1 and finite"),
    ],
)
def test_impossible_configurations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        config(**changes)
