"""Ethics shaping: the human policy, the shaping term, the table, and what a shaped agent learns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import Episodes, play_episodes
from moral_algorithms.learners.ethics_shaping import (
    EthicsShapingConfig,
    TabularPolicy,
    human_policy,
    shaping,
    train_ethics_shaping,
)
from moral_algorithms.learners.features import CONTEXTS, StateTable, nearest_person
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.tiny import EMERGENCY, random_episodes

WORLD = EMERGENCY.build()


class Rescuer:
    """Walks to the nearest person, saves it, and does anything at all where nobody is left."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], None]:
        agent, person, steps = nearest_person(WORLD, observation)
        width = observation.shape[-1]
        (row, column), (its_row, its_column) = np.divmod(agent, width), np.divmod(person, width)
        vertical = np.where(its_row < row, 0, 1)
        horizontal = np.where(its_column < column, 2, 3)
        towards = np.where(its_row != row, vertical, horizontal)
        # Beside it the agent interacts; on its cell it has to step off.
        actions = np.select([steps == 1, steps == 0], [5 + towards, np.where(row > 1, 0, 1)], towards)
        return np.where(steps < 0, self._rng.integers(9, size=len(actions)), actions), None


def rescue(num_episodes: int, seed: int) -> Episodes:
    return play_episodes(Rescuer(seed), WORLD, num_episodes, seed)


@pytest.fixture(scope="module")
def demonstrations() -> Demonstrations:
    episodes = rescue(200, seed=0)
    return Demonstrations(EMERGENCY, episodes.states, episodes.actions, episodes.objectives)


def config(**changes: Any) -> EthicsShapingConfig:
    values: dict[str, Any] = {
        "steps": 40_000,
        "num_envs": 32,
        "features": "nearest",
        "primary": ("extinguish",),
        "penalty": 1.0,
        "bonus": 1.0,
        "rare": 0.04,
        "common": 0.25,
        "consistency": 0.0,
        "pseudo_counts": 0.1,
        "gamma": 0.9,
        "learning_rate": 0.1,
        "temperature_start": 0.3,
        "temperature_end": 0.02,
    }
    return EthicsShapingConfig(**{**values, **changes})


def test_the_human_policy_is_the_relative_frequency_of_actions() -> None:
    counts = np.array([[3.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    found = human_policy(counts, config(pseudo_counts=1.0))
    np.testing.assert_allclose(found, [[4 / 7, 2 / 7, 1 / 7], [1 / 3, 1 / 3, 1 / 3]])


def test_the_likelihood_of_counts_is_that_of_the_paper() -> None:
    counts = np.array([[3.0, 1.0, 0.0]])
    # c^n (1 - c)^(4 - n), for n of 3, 1 and 0, normalised.
    likelihood = np.array([0.6**3 * 0.4, 0.6 * 0.4**3, 0.4**4])
    found = human_policy(counts, config(consistency=0.6, pseudo_counts=1e-9))
    np.testing.assert_allclose(found[0], likelihood / likelihood.sum(), rtol=1e-6)


def test_no_count_makes_the_likelihood_vanish() -> None:
    found = human_policy(np.array([[5000.0, 0.0]]), config(consistency=0.9))
    assert (found > 0).all()
    assert found[0, 0] > 0.999


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        # People hardly do action 0, the agent mostly does: punished by c_n times the divergence.
        (0, -2.0 * (0.7 * math.log(0.7 / 0.02) + 0.1 * math.log(0.1 / 0.6) + 0.2 * math.log(0.2 / 0.38))),
        # People mostly do action 1, the agent seldom: rewarded by c_p times the same divergence.
        (1, 3.0 * (0.7 * math.log(0.7 / 0.02) + 0.1 * math.log(0.1 / 0.6) + 0.2 * math.log(0.2 / 0.38))),
        # Action 2 is neither.
        (2, 0.0),
    ],
)
def test_the_shaping_term_by_hand(action: int, expected: float) -> None:
    policy, human = np.array([[0.7, 0.1, 0.2]]), np.array([[0.02, 0.6, 0.38]])
    settings = config(penalty=2.0, bonus=3.0, rare=0.1, common=0.5)
    np.testing.assert_allclose(shaping(policy, human, np.array([action]), settings), [expected])


def test_there_is_no_shaping_where_the_agent_is_already_like_people() -> None:
    # It does action 1 more often than they do, and action 0 less often.
    policy, human = np.array([[0.01, 0.99]] * 2), np.array([[0.02, 0.98]] * 2)
    found = shaping(policy, human, np.array([0, 1]), config(rare=0.1, common=0.5))
    np.testing.assert_array_equal(found, [0.0, 0.0])


def test_an_action_that_the_agent_never_takes_adds_nothing_to_the_divergence() -> None:
    policy, human = np.array([[0.0, 1.0]]), np.array([[0.99, 0.01]])
    found = shaping(policy, human, np.array([1]), config(penalty=1.0, rare=0.1))
    np.testing.assert_allclose(found, [-math.log(1 / 0.01)])


@given(st.integers(0, 2**32 - 1))
def test_shaping_has_the_sign_of_the_threshold_that_is_crossed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    policy, human = rng.dirichlet(np.full(4, 0.3), 20) + 1e-9, rng.dirichlet(np.full(4, 0.3), 20) + 1e-9
    actions = rng.integers(4, size=20)
    settings = config(rare=0.2, common=0.4)
    found = shaping(policy, human, actions, settings)
    for row, action in enumerate(actions):
        agent, people = policy[row, action], human[row, action]
        expected = -1 if people < min(0.2, agent) else 1 if people > max(0.4, agent) else 0
        assert np.sign(found[row]) in (expected, 0.0)


def test_the_nearest_person_is_found_as_by_a_loop() -> None:
    states = random_episodes(EMERGENCY, 20, seed=1).states.reshape(-1, 4, 5, 5)
    found = np.stack(nearest_person(WORLD, states), axis=1)
    for state, (agent, person, steps) in zip(states, found, strict=True):
        here = np.argwhere(state[1])[0]
        people = np.argwhere(state[2])
        apart = [int(np.abs(here - there).sum()) for there in people]
        assert agent == here[0] * 5 + here[1]
        assert steps == (min(apart) if apart else -1)
        nearest = people[apart.index(min(apart))] if apart else None
        assert person == (-1 if nearest is None else nearest[0] * 5 + nearest[1])


def test_distances_are_a_bias_and_five_features() -> None:
    state = np.zeros((1, 4, 5, 5), dtype=np.uint8)
    state[0, 1, 1, 1] = state[0, 2, 1, 3] = state[0, 3, 3, 3] = 1
    # One of two people is left, two steps away; the extinguisher is four steps away; rows and columns are 10.
    np.testing.assert_allclose(CONTEXTS["distances"](WORLD, state), [[1, 1, 0.5, 0.2, 0.4, 0]])
    state[0, 2] = 0
    state[0, 1] = state[0, 3]
    np.testing.assert_allclose(CONTEXTS["distances"](WORLD, state), [[1, 0, 0, 0, 0, 1]])


def test_a_table_numbers_states_in_order_and_tells_apart_what_its_features_do() -> None:
    states = np.zeros((3, 4, 5, 5), dtype=np.uint8)
    states[:, 1, 1, 1] = states[:, 2, 1, 2] = states[:, 3, 3, 3] = 1
    states[1, 2, 3, 3] = 1  # another person, further away
    states[2, 1] = 0
    states[2, 1, 2, 2] = 1
    assert StateTable(WORLD, "nearest").add(states).tolist() == [0, 0, 1]
    table = StateTable(WORLD, "planes")
    assert table.add(states[:2]).tolist() == [0, 1]
    assert table.find(states).tolist() == [0, 1, -1]
    assert len(table) == 2


def test_a_state_that_was_never_met_gets_any_action() -> None:
    states = random_episodes(EMERGENCY, 1, seed=1).states[0, :1]
    table = StateTable(WORLD, "nearest")
    policy = TabularPolicy(table, np.zeros((0, 9)), np.random.default_rng(0))
    np.testing.assert_allclose(policy.probabilities(states), np.full((1, 9), 1 / 9))


def test_shaping_brings_an_agent_to_save_people_beside_its_primary_goal(
    demonstrations: Demonstrations,
) -> None:
    # Of 2 people chance saves 0.4 and the demonstrator 2; without shaping three seeds saved 0.1 to 0.3.
    saved, goal_time = WORLD.objective_names.index("people_saved"), WORLD.objective_names.index("goal_time")
    shaped, selfish = (
        play_episodes(
            train_ethics_shaping(demonstrations, config(penalty=scale, bonus=scale), 0).policy, WORLD, 200, 1
        ).objectives.mean(axis=0)
        for scale in (3.0, 0.0)
    )
    assert shaped[saved] > 1.5 > 3 * selfish[saved]
    # Chance stands 0.9 of 8 steps by the extinguisher.
    assert selfish[goal_time] > 5
    assert selfish[goal_time] > shaped[goal_time]


def test_raw_planes_are_too_many_states_for_a_table() -> None:
    world = WorldSpec("emergency")
    episodes = random_episodes(world, 20, seed=0)
    shown = Demonstrations(world, episodes.states, episodes.actions, episodes.objectives)
    small, large = (
        train_ethics_shaping(shown, config(steps=20_000, features=features), 0).states
        for features in ("nearest", "planes")
    )
    assert small <= 36 * 37
    # Every fourth step meets a state that was never seen before.
    assert large > 5 * small


def test_training_is_the_same_for_the_same_seed(demonstrations: Demonstrations) -> None:
    short = config(steps=2000)
    first, second, other = (train_ethics_shaping(demonstrations, short, seed) for seed in (3, 3, 4))
    states = demonstrations.states[:5].reshape(-1, 4, 5, 5)
    one, two, three = (agent.policy.probabilities(states) for agent in (first, second, other))
    np.testing.assert_array_equal(one, two)
    assert (one != three).any()
    assert first.env_steps == 2016


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"features": "all"}, "features is 'all'"),
        ({"steps": 0}, "steps is 0"),
        ({"penalty": -1.0}, "penalty is -1.0"),
        ({"temperature_start": float("inf")}, "temperature_start is inf"),
        ({"rare": 1.5}, "rare is 1.5"),
        ({"consistency": 0.5}, r"consistency is 0.5"),
        ({"pseudo_counts": 0.0}, "pseudo_counts is 0.0"),
        ({"gamma": 1.0}, "gamma is 1.0"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0"),
        ({"temperature_end": 0.0}, "temperature_end is 0.0"),
    ],
)
def test_settings_check_themselves(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        config(**changes)


def test_other_worlds_are_refused() -> None:
    episodes = random_episodes(WorldSpec("delivery", {"max_cycles": 2}), 1, seed=0)
    shown = Demonstrations(
        WorldSpec("delivery", {"max_cycles": 2}), episodes.states, episodes.actions, episodes.objectives
    )
    with pytest.raises(ValueError, match="must be Emergency"):
        train_ethics_shaping(shown, config(primary=("deliver",)), 0)
