"""A policy for all weights: what it is shown, what it is paid, and the policies that it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.learners.asking import play_once
from moral_algorithms.learners.covering import (
    ConditionedRewards,
    CoveringConfig,
    CoveringPolicy,
    draw_weights,
    train_covering,
)
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.networks.conditioned import ConditionedPolicy
from tests.algorithms.tiny import EMERGENCY, parameters, ppo_config, scalarised

BUILT = EMERGENCY.build()
SHAPE = (4, 5, 5)
CELLS = 4 * 5 * 5
# One over the return of a policy that does nothing else, about.
COMPONENTS = [
    PrimaryReward(BUILT.reward_names, "extinguish", 1.4),
    PrimaryReward(BUILT.reward_names, "save", 0.5),
]


def config(**changes: Any) -> CoveringConfig:
    return CoveringConfig(**{"steps": 15_000, "span": 30.0, "ppo": ppo_config(), **changes})


def conditioned_rewards(num_envs: int, seed: int = 0) -> ConditionedRewards:
    rng = np.random.default_rng(seed)
    venv = scalarised(EMERGENCY, num_envs, seed=seed)
    return ConditionedRewards(venv, lambda count: draw_weights(count, np.ones(2), 30.0, rng))


@pytest.fixture(scope="module")
def covering() -> CoveringPolicy:
    return train_covering(EMERGENCY, COMPONENTS, config(), seed=0)


@pytest.fixture(scope="module")
def untrained() -> ConditionedPolicy:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        return ConditionedPolicy.build(SHAPE, BUILT.num_actions, 3, 50.0)


def test_every_row_is_shown_and_paid_its_own_weights() -> None:
    venv, plain = conditioned_rewards(6), scalarised(EMERGENCY, 6)
    observations, planes = venv.reset(), plain.reset()
    rng = np.random.default_rng(1)
    weights = venv.weights.copy()
    assert len(np.unique(weights, axis=0)) == 6
    for step in range(3 * BUILT.horizon):
        np.testing.assert_array_equal(observations[:, :CELLS], planes.reshape(6, -1))
        np.testing.assert_array_equal(observations[:, CELLS:], weights)
        actions = rng.integers(BUILT.num_actions, size=6)
        stepped, rewards, dones, infos = venv.step(actions)
        plain_stepped, _, plain_dones, plain_infos = plain.step(actions)
        assert isinstance(stepped, np.ndarray)
        assert isinstance(plain_stepped, np.ndarray)
        observations, planes = stepped, plain_stepped
        for row in range(6):
            assert rewards[row] == pytest.approx(float(plain.rewards[row] @ weights[row]), abs=1e-6)
        np.testing.assert_array_equal(dones, plain_dones)
        assert dones.all() == ((step + 1) % BUILT.horizon == 0)
        for row in dones.nonzero()[0]:
            # The end of an episode belongs to the weights it was played under.
            last = infos[row]["terminal_observation"]
            np.testing.assert_array_equal(last[CELLS:], weights[row])
            np.testing.assert_array_equal(last[:CELLS], plain_infos[row]["terminal_observation"].ravel())
            assert (venv.weights[row] != weights[row]).any()
        if not dones.any():
            np.testing.assert_array_equal(venv.weights, weights)
        weights = venv.weights.copy()


@settings(max_examples=30, deadline=None)
@given(
    scales=st.lists(st.floats(0.1, 10), min_size=1, max_size=4).map(np.array),
    span=st.floats(1.5, 100),
    seed=st.integers(0, 99),
)
def test_weights_stay_in_their_ranges(scales: NDArray[np.float64], span: float, seed: int) -> None:
    weights = draw_weights(50, scales, span, np.random.default_rng(seed))
    assert weights.shape == (50, len(scales))
    assert weights.dtype == np.float32
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
    ratios = (weights / scales)[:, :, None] / (weights / scales)[:, None, :]
    assert ratios.max() <= span * 1.001


def test_weights_are_even_on_a_logarithmic_scale() -> None:
    weights = draw_weights(100_000, np.array([7.0, 1.0]), 50.0, np.random.default_rng(0))
    logarithms = np.log(weights[:, 0] / weights[:, 1] / 7) / np.log(50)
    # The difference of two uniform variables: mean 0, variance 1/6; five standard errors.
    assert abs(logarithms.mean()) < 5 * np.sqrt(1 / 6 / 100_000)
    assert logarithms.var() == pytest.approx(1 / 6, rel=0.02)


@settings(max_examples=10, deadline=None)
@given(weights=st.lists(st.floats(0, 10), min_size=3, max_size=3).filter(lambda all_: max(all_) > 0.1))
def test_a_fixed_weighting_folds_into_a_fast_policy(
    untrained: ConditionedPolicy, weights: list[float]
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        # Half precision, where there is any, would round biases and inputs differently.
        patch.setattr("moral_algorithms.networks.precision.has_fast_bfloat16", lambda device_type: False)
        planes = scalarised(EMERGENCY, 20, seed=5).reset()
        given_weights = np.tile(np.array(weights, dtype=np.float32), (20, 1))
        shown = np.concatenate([planes.reshape(20, -1), given_weights], axis=1, dtype=np.float32)
        seen = torch.from_numpy(shown)
        folded = untrained.policy_at(weights)
        with torch.no_grad():
            wanted = untrained.get_distribution(seen).distribution
            found = folded.get_distribution(torch.from_numpy(planes)).distribution
            torch.testing.assert_close(found.logits, wanted.logits, rtol=0, atol=1e-5)
            values = untrained.predict_values(seen)
            torch.testing.assert_close(
                folded.predict_values(torch.from_numpy(planes)), values, rtol=0, atol=1e-5
            )


def test_folded_policies_are_copies(covering: CoveringPolicy) -> None:
    before = parameters(covering.policy)
    folded = covering.policy.policy_at([1, 1])
    with torch.no_grad():
        for parameter in folded.parameters():
            parameter.zero_()
    after = parameters(covering.policy)
    assert all((before[name] == after[name]).all() for name in before)


def test_only_ratios_of_weights_matter(covering: CoveringPolicy) -> None:
    one, other = (parameters(covering.policy.policy_at(weights)) for weights in ([1, 3], [0.25, 0.75]))
    for name in one:
        np.testing.assert_allclose(one[name], other[name], atol=1e-6)


def test_the_weights_decide_what_the_policy_does(covering: CoveringPolicy) -> None:
    venv = scalarised(EMERGENCY, 200, seed=9)
    achieved = []
    for weights in ((0.03, 0.97), (0.97, 0.03)):
        with sampling_seed(1):
            episodes = play_once(covering.policy.policy_at(weights), venv)
        achieved.append(np.mean([episode.objectives for episode in episodes], axis=0))
    (saver_time, saved), (fighter_time, left) = achieved
    # Four seeds: 1.9 to 2.9 and 6.8 to 6.9 goal steps; 0.8 and 0.1 to 0.5 people.
    assert fighter_time > saver_time + 3
    assert saved > left + 0.2


def test_a_policy_is_the_same_for_the_same_seed() -> None:
    short = config(steps=500, ppo=ppo_config(num_envs=8, rollout_steps=8, batch_size=32))
    one, two, three = (
        parameters(train_covering(EMERGENCY, COMPONENTS, short, seed).policy) for seed in (3, 3, 4)
    )
    assert all((one[name] == two[name]).all() for name in one)
    assert any((one[name] != three[name]).any() for name in one)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps is 0; it must be at least 1"),
        ({"span": 1.0}, "span is 1.0; it must be above 1"),
        ({"span": np.inf}, "span is inf; it must be above 1 and finite"),
        ({"primary_weight": 0.0}, "primary_weight is 0.0; it must be positive"),
        ({"ppo": ppo_config(policy="paper")}, "ppo.policy is 'paper'; it must be 'fast'"),
    ],
)
def test_impossible_configurations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        config(**changes)


@pytest.mark.parametrize("weights", [[1.0], [0.0, 0.0], [-1.0, 2.0], [np.nan, 1.0]])
def test_impossible_weights_are_refused(weights: list[float], covering: CoveringPolicy) -> None:
    with pytest.raises(ValueError, match="weights are"):
        covering.policy.policy_at(weights)
