"""Policy orchestration: the bandit, the values of the arms, and what the orchestrator learns to do when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.evaluation import CarelessPolicy, RandomPolicy, play_episodes
from moral_algorithms.learners.policy_orchestration import (
    Arm,
    ArmConfig,
    LinearThompsonSampling,
    OrchestratedPolicy,
    OrchestrationConfig,
    train_arm,
    train_orchestrator,
)
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.learners.test_airl import Walker
from tests.algorithms.test_ethics_shaping import Rescuer
from tests.algorithms.tiny import EMERGENCY, ppo_config, random_episodes

WORLD = EMERGENCY.build()


class Always:
    """Chooses one action."""

    def __init__(self, action: int) -> None:
        self._action = action

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], None]:
        return np.full(len(observation), self._action), None


def config(**changes: Any) -> OrchestrationConfig:
    values: dict[str, Any] = {
        "steps": 6000,
        "value_episodes": 50,
        "num_envs": 32,
        "context": "distances",
        "gamma": 0.9,
        "ridge": 1.0,
        "exploration": 0.1,
    }
    return OrchestrationConfig(**{**values, **changes})


def arms() -> list[Arm]:
    """One walks to the extinguisher, one saves people."""
    fire = PrimaryReward(WORLD.reward_names, "extinguish", 2.0)
    save = PrimaryReward(WORLD.reward_names, "save", 0.5)
    return [Arm(Walker(0), fire), Arm(Rescuer(0), save)]


def orchestrated(weights: tuple[float, float], **changes: Any) -> NDArray[np.float64]:
    """Mean objectives under given weights of the two rewards."""
    found = train_orchestrator(EMERGENCY, arms(), weights, config(**changes), seed=0)
    means: NDArray[np.float64] = play_episodes(found.policy, WORLD, 300, seed=1).objectives.mean(axis=0)
    return means


@given(st.integers(0, 2**32 - 1))
def test_the_posterior_mean_is_that_of_a_ridge_regression(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bandit = LinearThompsonSampling(2, 3, ridge=0.5, exploration=0.1, rng=rng)
    contexts, rewards = rng.normal(size=(40, 3)), rng.normal(size=40)
    chosen = rng.integers(2, size=40)
    for part in (slice(0, 15), slice(15, 40)):
        bandit.update(contexts[part], chosen[part], rewards[part])
    for arm in range(2):
        x, y = contexts[chosen == arm], rewards[chosen == arm]
        expected = np.linalg.solve(x.T @ x + 0.5 * np.eye(3), x.T @ y)
        np.testing.assert_allclose(bandit.means[arm], expected, atol=1e-9)


def test_samples_are_spread_as_the_posterior_is() -> None:
    # One feature, with a precision of 1 + 3: a deviation of 0.5 / sqrt(4). The other arm's mean is 0 and its
    # deviation 0.5, so this one wins with the probability that N(0.75, 0.25^2 + 0.5^2) is positive: 0.910.
    bandit = LinearThompsonSampling(2, 1, ridge=1.0, exploration=0.5, rng=np.random.default_rng(0))
    bandit.update(np.ones((3, 1)), np.zeros(3, dtype=np.int64), np.ones(3))
    np.testing.assert_allclose(bandit.means, [[0.75], [0.0]])
    wins = np.mean([bandit.choose(np.ones((1, 1)))[0] == 0 for _ in range(4000)])
    # Three standard errors.
    assert abs(wins - 0.910) < 3 * np.sqrt(0.91 * 0.09 / 4000)


def test_without_exploration_the_better_arm_of_each_context_is_chosen() -> None:
    bandit = LinearThompsonSampling(2, 2, 1e-6, 0.0, np.random.default_rng(0))
    contexts = np.eye(2)[[0, 1, 0, 1]]
    bandit.update(contexts, np.array([0, 0, 1, 1]), np.array([1.0, 0.0, 0.0, 1.0]))
    assert bandit.choose(np.eye(2)).tolist() == [0, 1]


def test_each_arm_acts_where_it_is_chosen() -> None:
    states = random_episodes(EMERGENCY, 30, seed=0).states.reshape(-1, 4, 5, 5)
    states[::3, 2] = 0
    # The first arm pays 1 where somebody is left, the second half that always.
    means = np.array([[0.0, 1, 0, 0, 0, 0], [0.5, 0, 0, 0, 0, 0]])
    policy = OrchestratedPolicy(WORLD, [Always(7), Always(2)], means, "distances")
    somebody = states[:, 2].any(axis=(1, 2))
    assert somebody.any()
    assert not somebody.all()
    np.testing.assert_array_equal(policy.predict(states)[0], np.where(somebody, 7, 2))
    np.testing.assert_array_equal(policy.arms(states), np.where(somebody, 0, 1))


@pytest.mark.parametrize("context", ["distances", "planes"])
def test_the_ends_of_the_front_are_the_arms(context: str) -> None:
    # Alone, the walker stands 6.8 of 8 steps by the extinguisher and the rescuer saves 1.9 of 2 people.
    goal_time, saved = orchestrated((1.0, 0.0), context=context)
    assert goal_time > 5.5
    assert saved < 0.5
    goal_time, saved = orchestrated((0.0, 1.0), context=context)
    assert saved > 1.5


def test_between_the_ends_it_saves_people_and_then_goes_to_the_extinguisher() -> None:
    # The rescuer alone stands 0.6 of 8 steps by the extinguisher, the orchestrated policy 4.0.
    goal_time, saved = orchestrated((0.05, 0.95))
    assert saved > 1.5
    assert goal_time > 2.5


def test_what_it_learns_is_the_same_for_the_same_seed() -> None:
    states = random_episodes(EMERGENCY, 20, seed=0).states.reshape(-1, 4, 5, 5)
    short = config(steps=1000, value_episodes=5)
    first, second = (
        train_orchestrator(EMERGENCY, arms(), (0.5, 0.5), short, seed=3).policy.arms(states) for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_environment_steps_are_counted() -> None:
    short = config(steps=1000, value_episodes=5, num_envs=32)
    # Two arms, 5 episodes of 8 steps each, and what is left of 1,000 in batches of 32.
    assert train_orchestrator(EMERGENCY, arms(), (0.5, 0.5), short, seed=0).env_steps == 80 + 29 * 32


def test_an_arm_pursues_its_reward() -> None:
    # Chance stands 0.9 of 8 steps by the extinguisher; an expert trained as long 6.8.
    reward = PrimaryReward(WORLD.reward_names, "extinguish")
    policy = train_arm(EMERGENCY, reward, ArmConfig(15_000, ppo_config()), seed=0)
    with sampling_seed(0):
        assert play_episodes(policy, WORLD, 100, seed=1).objectives[:, 0].mean() > 5.5


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"steps": 0}, "steps is 0"),
        ({"value_episodes": 0}, "value_episodes is 0"),
        ({"context": "all"}, "context is 'all'"),
        ({"gamma": 1.0}, "gamma is 1.0"),
        ({"ridge": 0.0}, "ridge is 0.0"),
        ({"exploration": -0.1}, "exploration is -0.1"),
        ({"ridge": float("inf")}, "ridge is inf"),
    ],
)
def test_settings_check_themselves(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        config(**changes)


def test_an_arm_needs_steps() -> None:
    with pytest.raises(ValueError, match="steps is 0"):
        ArmConfig(0)


def test_arms_and_weights_must_fit() -> None:
    one, other = arms()
    with pytest.raises(ValueError, match="at least two, of different names"):
        train_orchestrator(EMERGENCY, [one], [1.0], config(), 0)
    with pytest.raises(ValueError, match="at least two, of different names"):
        train_orchestrator(EMERGENCY, [one, one], [0.5, 0.5], config(), 0)
    with pytest.raises(ValueError, match="weights are"):
        train_orchestrator(EMERGENCY, [one, other], [1.0], config(), 0)
    with pytest.raises(ValueError, match="must be Emergency"):
        train_orchestrator(WorldSpec("delivery"), [one, other], [0.5, 0.5], config(), 0)


def test_a_careless_policy_errs_as_often_as_it_should() -> None:
    states = random_episodes(EMERGENCY, 250, seed=0).states[:, :-1].reshape(-1, 4, 5, 5)
    careless = CarelessPolicy(Always(4), 0.45, 9, np.random.default_rng(0))
    # A ninth of the random actions is the one that was meant: 0.4 differ, of 2,000.
    assert abs(np.mean(careless.predict(states)[0] != 4) - 0.4) < 3 * np.sqrt(0.4 * 0.6 / 2000)
    with pytest.raises(ValueError, match=r"share is 1\.5"):
        CarelessPolicy(RandomPolicy(9, np.random.default_rng(0)), 1.5, 9, np.random.default_rng(0))
