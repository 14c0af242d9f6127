"""Clips: what is cut out of an episode, what is counted in it, and that it is kept as it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.bridge import EngineVecEnv, Replay
from moral_algorithms.evaluation import RandomPolicy
from moral_algorithms.learners.clips import AnsweredClips, Pairs, draw_pairs, play_again, play_untrained
from moral_algorithms.preferences import Preference
from moral_envs import delivery_v0
from moral_envs.world import World
from tests.algorithms.tiny import EMERGENCY

WORLD = EMERGENCY.build()


@pytest.mark.parametrize(
    "world", [WORLD, delivery_v0.world(max_cycles=6)], ids=lambda world: f"{world.name}-{world.horizon}"
)
def test_an_episode_is_played_again_as_it_was(world: World) -> None:
    venv = EngineVecEnv(world, 3, seed=0)
    rng = np.random.default_rng(0)
    states: list[Any] = [venv.reset()]
    replays = []
    rewards, objectives = [], []
    for _ in range(world.horizon):
        venv.step_async(rng.integers(world.num_actions, size=3))
        observations, _, _, infos = venv.step_wait()
        states.append(observations)
        rewards.append([info["vector_reward"] for info in infos])
        replays += [info["replay"] for info in infos if "replay" in info]
        objectives += [info["objectives"] for info in infos if "objectives" in info]
    recording = play_again(world, replays)
    assert recording.replays == tuple(replays)
    np.testing.assert_array_equal(recording.states, np.stack(states[:-1], axis=1))
    np.testing.assert_array_equal(recording.actions, [replay.actions[:, 0] for replay in replays])
    np.testing.assert_array_equal(recording.counters[:, 0], 0)
    np.testing.assert_array_equal(recording.counters[:, -1], objectives)
    if world is WORLD:
        # In Emergency, each step's rewards tell what the counters of that step must do.
        paid = np.stack(rewards, axis=1) / np.array([0.1, 1.0])
        np.testing.assert_allclose(np.diff(recording.counters, axis=1), paid, rtol=1e-5)


def test_untrained_episodes_can_be_played_again() -> None:
    played: list[NDArray[np.uint8]] = []

    class Watched(RandomPolicy):
        def predict(self, observation: NDArray[np.uint8], *, deterministic: bool = False):  # type: ignore[no-untyped-def]
            played.append(observation)
            return super().predict(observation, deterministic=deterministic)

    replays = play_untrained(Watched(9, np.random.default_rng(0)), WORLD, 4, seed=1)
    recording = play_again(WORLD, replays)
    np.testing.assert_array_equal(recording.states, np.stack(played, axis=1))
    assert len({replay.stream for replay in replays}) == 4


def test_pairs_are_of_two_episodes_and_within_them() -> None:
    replays = play_untrained(RandomPolicy(9, np.random.default_rng(0)), WORLD, 5, seed=0)
    recording = play_again(WORLD, replays)
    pairs = draw_pairs(np.random.default_rng(0), recording, 3, 400)
    assert (pairs.episodes[:, 0] != pairs.episodes[:, 1]).all()
    assert set(pairs.episodes.ravel().tolist()) == set(range(5))
    assert set(pairs.starts.ravel().tolist()) == set(range(WORLD.horizon - 3 + 1))
    sides = np.stack([pairs.episodes, pairs.starts], axis=2).tolist()
    assert len({frozenset(map(tuple, pair)) for pair in sides}) == len(sides)
    # One of each pair is recent, in either place.
    recent = draw_pairs(np.random.default_rng(0), recording, 3, 400, recent=2).episodes
    assert ((recent < 2).any(axis=1)).all()
    assert set(recent[:, 0].tolist()) == set(recent[:, 1].tolist()) == set(range(5))
    # Whole episodes: of two there is one pair, shown in either order.
    shown = set()
    for seed in range(10):
        whole = draw_pairs(np.random.default_rng(seed), play_again(WORLD, replays[:2]), WORLD.horizon, 50)
        shown.add(tuple(map(tuple, whole.episodes.tolist())))
    assert shown == {((0, 1),), ((1, 0),)}
    assert not whole.starts.any()


def test_what_is_not_in_a_clip_is_not_counted() -> None:
    counters = np.array([[[0, 0], [1, 0], [2, 0], [2, 1]], [[0, 0], [0, 1], [0, 2], [5, 2]]])
    pairs = Pairs(np.array([[0, 1], [1, 0]]), np.array([[0, 1], [2, 2]]), 1)
    assert pairs.objectives(0, counters).tolist() == [[1, 0], [0, 1]]
    assert pairs.objectives(1, counters).tolist() == [[5, 0], [0, 1]]
    whole = Pairs(np.array([[0, 1]]), np.array([[0, 0]]), 3)
    assert whole.objectives(0, counters).tolist() == counters[:, -1].tolist()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_sums_are_those_of_the_steps(seed: int, length: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(2, 3, 6))
    episodes = rng.integers(3, size=(5, 2))
    starts = rng.integers(6 - length + 1, size=(5, 2))
    pairs = Pairs(episodes, starts, length)
    slow = [
        [
            [member[e, s : s + length].sum() for e, s in zip(es, ss, strict=True)]
            for es, ss in zip(episodes, starts, strict=True)
        ]
        for member in values
    ]
    np.testing.assert_allclose(pairs.sums(values), slow, atol=1e-12)
    for index in range(5):
        cut = pairs.cut(index, values[0])
        assert cut.shape == (2, length)
        np.testing.assert_allclose(cut.sum(axis=1), pairs.sums(values)[0, index], atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(4, 5, 5), (6, 3, 4), (1, 1, 1), (2, 4, 4)]))
def test_answers_are_kept_as_they_were(seed: int, shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(seed)
    kept = AnsweredClips(shape, 3, capacity=4)
    states = rng.integers(2, size=(3, 2, 3, *shape), dtype=np.uint8)
    actions = rng.integers(9, size=(3, 2, 3))
    for row, preference in enumerate(Preference):
        kept.add(states[row], actions[row], preference)
    assert len(kept) == 3
    got_states, got_actions, targets = kept.batch(np.array([2, 0, 1, 2]))
    np.testing.assert_array_equal(got_states, states[[2, 0, 1, 2]])
    np.testing.assert_array_equal(got_actions, actions[[2, 0, 1, 2]])
    assert targets.tolist() == [0.5, 1.0, 0.0, 0.5]


def test_a_replay_of_another_episode_is_another_one() -> None:
    replays = play_untrained(RandomPolicy(9, np.random.default_rng(0)), WORLD, 2, seed=0)
    mixed = [Replay(replays[0].stream, replays[1].actions), replays[1]]
    assert (play_again(WORLD, mixed).states[0] != play_again(WORLD, replays).states[0]).any()
