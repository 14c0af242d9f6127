"""Monte Carlo control: one episode by hand, the schedule of its exploration, and what it learns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from moral_algorithms.learners.monte_carlo import MonteCarloConfig, monte_carlo_control


class Corridor(gymnasium.Env[int, int]):
    """Cells 0, 1, 2 in a row: action 1 goes on, action 0 stays; a step costs 1, the one onto 2 nothing."""

    observation_space = Discrete(3)
    action_space = Discrete(2)

    def __init__(self, horizon: int = 1000) -> None:
        self.horizon = horizon

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.cell, self.steps = 0, 0
        return self.cell, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.cell += action
        self.steps += 1
        there = self.cell == 2
        return self.cell, 0.0 if there else -1.0, there, self.steps == self.horizon, {}


class Scripted(Corridor):
    """The corridor, whatever is chosen; it writes down what would have been chosen."""

    def __init__(self, script: Sequence[int]) -> None:
        super().__init__()
        self.script = list(script)
        self.chosen: list[int] = []

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.chosen.append(action)
        return super().step(self.script[len(self.chosen) - 1])


def learn(env: gymnasium.Env[Any, int], seed: int = 0, **settings: Any) -> Any:
    return monte_carlo_control(env, int, 3, MonteCarloConfig(**settings), seed)


def test_values_are_means_over_every_visit_by_hand() -> None:
    """Stay, go, stay, go: what follows is worth -1.75, -1.5, -1 and 0 with the discount 1/2."""
    env = Scripted([0, 1, 0, 1])
    found = learn(env, episodes=1, discount=0.5)
    expected = np.zeros((3, 2))
    for cell, action, to_go in zip((0, 0, 1, 1), env.chosen, (-1.75, -1.5, -1.0, 0.0), strict=True):
        visits = [chosen for at, chosen in zip((0, 0, 1, 1), env.chosen, strict=True) if at == cell]
        expected[cell, action] += to_go / visits.count(action)
    np.testing.assert_allclose(found.values, expected)
    assert found.visited.tolist() == [True, True, False]
    assert found.greedy.tolist() == expected.argmax(axis=1).tolist()
    assert (found.returns.tolist(), found.env_steps) == ([-3.0], 4)


def test_without_discount_the_values_are_the_steps_left() -> None:
    found = learn(Corridor(), episodes=300, discount=1.0, decay=0.05)
    assert found.greedy[:2].tolist() == [1, 1]
    # Going on from cell 1 ends without cost; staying there costs 1 and leads there again.
    assert found.values[1, 1] == 0.0
    assert found.values[1, 0] <= -1.0
    assert (found.returns[-100:] == -1.0).all()


def test_exploration_decays_from_its_start() -> None:
    """With a policy that goes on, the share of steps that stay is half the exploration."""
    never = learn(Corridor(), episodes=400, decay=0.0, exploration=1.0)
    assert never.env_steps / 400 == pytest.approx(4, rel=0.15)
    at_once = learn(Corridor(), episodes=400, decay=100.0, exploration=1.0)
    assert (at_once.returns[-300:] == -1.0).all()
    half = learn(Corridor(), episodes=400, decay=0.0, exploration=0.5)
    assert half.env_steps / 400 == pytest.approx(2 / 0.75, rel=0.15)


def test_an_episode_that_truncates_counts_as_ended() -> None:
    class Wall(Corridor):
        def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
            return super().step(0)

    found = learn(Wall(horizon=3), episodes=1, discount=1.0)
    assert found.returns.tolist() == [-3.0]
    assert found.values[0].sum() <= -2.0
    assert not found.visited[1:].any()


def test_the_same_seed_learns_the_same() -> None:
    first, again, other = (learn(Corridor(), seed, episodes=20) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.values, again.values)
    np.testing.assert_array_equal(first.returns, again.returns)
    assert first.returns.tolist() != other.returns.tolist()


def test_vectors_of_one_reward_count_and_longer_ones_are_refused() -> None:
    class Vector(Corridor):
        components = 1

        def step(self, action: int) -> Any:
            observation, reward, *rest = super().step(action)
            return observation, np.full(self.components, reward, dtype=np.float32), *rest

    np.testing.assert_array_equal(learn(Vector(), episodes=5).values, learn(Corridor(), episodes=5).values)
    Vector.components = 2
    with pytest.raises(ValueError, match="size 1"):
        learn(Vector(), episodes=1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"episodes": 0}, "episodes is 0; it must be at least 1"),
        ({"decay": -0.1}, "decay is -0.1"),
        ({"decay": float("nan")}, "decay is nan"),
        ({"exploration": 0.0}, "exploration is 0.0"),
        ({"discount": 1.5}, "discount is 1.5"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MonteCarloConfig(**settings)


def test_actions_must_be_discrete() -> None:
    env = Corridor()
    env.action_space = Box(0, 1)  # type: ignore[assignment]
    with pytest.raises(ValueError, match="they must be Discrete"):
        learn(env)
