"""Playing whole episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.evaluation import RandomPolicy, play_episodes
from moral_envs import delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.faces import GridEnv
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, World
from tests.envs.worlds import seeds, small_worlds


class Fixed:
    """Always the same actions, one per episode; remembers how it was asked."""

    def __init__(self, actions: NDArray[Any]) -> None:
        self.actions = actions
        self.deterministic: set[bool] = set()

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], None]:
        self.deterministic.add(deterministic)
        return self.actions, None


@settings(max_examples=30)
@given(
    world=small_worlds(1).filter(lambda world: not world.ends_early),
    seed=seeds,
    num_episodes=st.integers(1, 3),
)
def test_plays_what_single_environments_play(world: World, seed: int, num_episodes: int) -> None:
    policy = RandomPolicy(world.num_actions, np.random.default_rng(seed))
    episodes = play_episodes(policy, world, num_episodes, seed)
    channels = len(world.plane_names)
    assert episodes.states.shape == (num_episodes, world.horizon + 1, channels, world.height, world.width)
    assert episodes.states.dtype == episodes.actions.dtype == np.uint8
    assert episodes.returns.dtype == np.float64
    assert episodes.objectives.dtype == np.int64
    for episode, stream in enumerate(spawn_streams(seed, num_episodes)):
        env = GridEnv(world)
        env.engine.seed(np.array([stream]))
        observation, _ = env.reset()
        np.testing.assert_array_equal(episodes.states[episode, 0], observation)
        total = np.zeros(len(world.reward_names))
        for step, action in enumerate(episodes.actions[episode]):
            observation, reward, _, truncated, info = env.step(int(action))
            np.testing.assert_array_equal(episodes.states[episode, step + 1], observation)
            total += reward
        assert truncated
        np.testing.assert_allclose(episodes.returns[episode], total, rtol=1e-6)
        np.testing.assert_array_equal(episodes.objectives[episode], info["objectives"])


def test_worlds_whose_episodes_differ_in_length_are_refused() -> None:
    policy = RandomPolicy(4, np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"world is windy_wall_v0; .* same number of steps"):
        play_episodes(policy, windy_wall_v0.world(), 2, 0)


@pytest.mark.parametrize("world", [emergency_v0.world(), delivery_v0.world()], ids=["emergency", "delivery"])
def test_returns_agree_with_the_objectives(world: World) -> None:
    policy = RandomPolicy(NUM_ACTIONS, np.random.default_rng(0))
    episodes = play_episodes(policy, world, 50, 0)
    pay = [0.1, 1.0] if len(world.reward_names) == 2 else [1.0, 1.0, 1.0, -1.0]
    np.testing.assert_allclose(episodes.returns, episodes.objectives * pay, rtol=1e-5)
    assert (episodes.objectives.sum(axis=0) > 0).all()


def test_the_same_seed_gives_every_policy_the_same_starts() -> None:
    world = emergency_v0.world()
    first = play_episodes(RandomPolicy(NUM_ACTIONS, np.random.default_rng(0)), world, 20, 5)
    second = play_episodes(Fixed(np.full(20, 4)), world, 20, 5)
    np.testing.assert_array_equal(first.states[:, 0], second.states[:, 0])
    assert (first.states[:, -1] != second.states[:, -1]).any()
    other = play_episodes(Fixed(np.full(20, 4)), world, 20, 6)
    assert (other.states[:, 0] != second.states[:, 0]).any()
    # More episodes begin with the same ones.
    more = play_episodes(Fixed(np.full(30, 4)), world, 30, 5)
    np.testing.assert_array_equal(more.states[:20], second.states)


@pytest.mark.parametrize("deterministic", [True, False])
def test_asks_the_policy_as_it_was_told(deterministic: bool) -> None:
    policy = Fixed(np.full(2, 4))
    play_episodes(policy, emergency_v0.world(max_cycles=3), 2, 0, deterministic)
    assert policy.deterministic == {deterministic}


def test_the_random_policy_chooses_all_actions_alike() -> None:
    policy = RandomPolicy(NUM_ACTIONS, np.random.default_rng(0))
    actions, state = policy.predict(np.zeros((90_000, 1), dtype=np.uint8))
    assert state is None
    # 10,000 expected each, with a standard deviation of 94.
    counts = np.bincount(actions)
    assert len(counts) == NUM_ACTIONS
    assert np.abs(counts - 10_000).max() < 500


def test_impossible_calls_are_refused() -> None:
    world = emergency_v0.world()
    with pytest.raises(ValueError, match="num_episodes is 0; it must be at least 1"):
        play_episodes(Fixed(np.zeros(0, dtype=int)), world, 0, 0)
    with pytest.raises(ValueError, match="actions contain 9"):
        play_episodes(Fixed(np.full(2, 9)), world, 2, 0)
    with pytest.raises(ValueError, match="must be integers"):
        play_episodes(Fixed(np.zeros(2)), world, 2, 0)
    with pytest.raises(AssertionError, match="actions"):
        play_episodes(Fixed(np.zeros((2, 1), dtype=int)), world, 2, 0)
