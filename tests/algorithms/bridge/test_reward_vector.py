"""Reward components and their scalarisation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecMonitor
from torch import nn

from moral_algorithms.bridge import (
    EngineVecEnv,
    LearnedReward,
    PrimaryReward,
    RewardComponent,
    ScalarisedRewards,
    Transitions,
)
from moral_algorithms.networks.optimisers import EagerAdam
from moral_algorithms.networks.rewards import ShapedRewardNetwork
from moral_algorithms.networks.sparse import Rows
from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.world import NUM_ACTIONS
from tests.algorithms.tiny import EMERGENCY, scalarised

DELIVERY = delivery_v0.world(7, 7, 3, 3, 3, 3, max_cycles=5)


class ActionReward:
    """Pays what an action's index is times a factor: a component that looks at the transition."""

    def __init__(self, name: str, factor: float) -> None:
        self.name = name
        self.factor = factor

    def __call__(self, transitions: Transitions) -> NDArray[np.float32]:
        rewards: NDArray[np.float32] = (transitions.actions * self.factor).astype(np.float32)
        return rewards


class GoneReward(ShapedRewardNetwork):
    """The number of the agent's cell in s, plus ten for each object that is gone in s'."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        super().__init__(shape, "mlp", gamma=1.0)
        self.ten = nn.Parameter(torch.tensor(10.0))

    def values(self, states: Rows) -> tuple[torch.Tensor, torch.Tensor]:
        assert isinstance(states, torch.Tensor)
        return states[:, 1].flatten(1).int().argmax(dim=1), -self.ten * states[:, 2:].sum(dim=(1, 2, 3))


weight_vectors = st.lists(st.floats(0, 100, width=32), min_size=4, max_size=4).filter(any)


@settings(max_examples=30)
@given(weights=weight_vectors, later=weight_vectors, seed=st.integers(0, 1000))
def test_the_reward_is_weights_times_components(weights: list[float], later: list[float], seed: int) -> None:
    names = ("deliver", "clean", "vase")
    components: list[RewardComponent] = [
        *(PrimaryReward(DELIVERY.reward_names, name, 0.5) for name in names),
        ActionReward("a", 0.25),
    ]
    venv = ScalarisedRewards(EngineVecEnv(DELIVERY, 3, seed=seed), components, weights)
    rng = np.random.default_rng(seed)
    venv.reset()
    returns = np.zeros((3, 4))
    for step in range(2 * DELIVERY.horizon + 1):
        actions = rng.integers(NUM_ACTIONS, size=3)
        # Between asking for a step and taking it: the new weights hold from this step on.
        venv.step_async(actions)
        if step == 3:
            venv.weights = later
        _, rewards, dones, infos = venv.step_wait()
        raw = np.array([info["vector_reward"] for info in infos])
        vector = np.column_stack([raw[:, 0] / 2, raw[:, 2] / 2, raw[:, 3] / 2, actions / 4])
        np.testing.assert_allclose(rewards, vector @ (later if step >= 3 else weights), rtol=1e-5, atol=1e-5)
        assert rewards.dtype == np.float32
        returns += vector
        np.testing.assert_allclose(venv.returns, returns, rtol=1e-5)
        for row, info in enumerate(infos):
            assert ("returns" in info) == dones[row]
            if dones[row]:
                np.testing.assert_allclose(info["returns"], returns[row], rtol=1e-5)
        returns[dones] = 0


def test_returns_in_an_info_stay_as_they_were() -> None:
    venv = ScalarisedRewards(EngineVecEnv(DELIVERY, 2, seed=0), [ActionReward("a", 1.0)], [1.0])
    venv.reset()
    for _ in range(DELIVERY.horizon):
        _, _, _, infos = venv.step(np.array([4, 6]))
    for _ in range(3):
        assert [info["returns"].tolist() for info in infos] == [[5 * 4], [5 * 6]]
        venv.step(np.array([1, 3]))


def test_a_reset_starts_returns_anew() -> None:
    venv = ScalarisedRewards(EngineVecEnv(DELIVERY, 2, seed=0), [ActionReward("a", 1.0)], [1.0])
    venv.reset()
    venv.step(np.array([3, 4]))
    np.testing.assert_array_equal(venv.returns[:, 0], [3, 4])
    venv.reset()
    np.testing.assert_array_equal(venv.returns[:, 0], [0, 0])
    venv.step(np.array([1, 2]))
    np.testing.assert_array_equal(venv.returns[:, 0], [1, 2])


def test_a_learned_reward_sees_the_true_next_state() -> None:
    world = emergency_v0.world(5, 5, 3, max_cycles=3)
    engine = EngineVecEnv(world, 16, seed=4)
    learned = LearnedReward("gone", GoneReward(engine.engine.observation_shape), scale=2.0)
    venv = ScalarisedRewards(engine, [learned], [1.0])
    rng = np.random.default_rng(0)
    observations = venv.reset()
    for _ in range(3):
        before = observations
        observations, rewards, dones, infos = venv.step(rng.integers(NUM_ACTIONS, size=16))
        cells = before[:, 1].reshape(16, -1).argmax(axis=1)
        saved = np.array([info["vector_reward"][1] for info in infos])
        np.testing.assert_allclose(rewards, 2 * (cells + 10 * saved))
    assert dones.all()


def test_networks_share_encodings_and_pay_what_each_pays_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    encoded: list[str] = []
    valued: list[ShapedRewardNetwork] = []
    encode, values = ShapedRewardNetwork.encode, ShapedRewardNetwork.values

    def count_encoded(network: ShapedRewardNetwork, states: NDArray[np.uint8]) -> Rows:
        encoded.append(network.architecture)
        return encode(network, states)

    def count_valued(network: ShapedRewardNetwork, states: Rows) -> tuple[torch.Tensor, torch.Tensor]:
        valued.append(network)
        return values(network, states)

    monkeypatch.setattr(ShapedRewardNetwork, "encode", count_encoded)
    monkeypatch.setattr(ShapedRewardNetwork, "values", count_valued)
    engine = EngineVecEnv(DELIVERY, 8, seed=1)
    torch.manual_seed(0)
    networks = [
        ShapedRewardNetwork(engine.engine.observation_shape, architecture)
        for architecture in ("counting", "counting", "fast")
    ]
    optimiser = EagerAdam(networks[2].parameters(), lr=0.01, fused=True)
    learned = [LearnedReward(str(number), network, 2.0) for number, network in enumerate(networks)]
    venv = ScalarisedRewards(engine, learned, [1.0, 1.0, 1.0])
    assert learned[0].encoded is learned[1].encoded
    assert learned[0].encoded is not learned[2].encoded
    rng = np.random.default_rng(0)
    venv.reset()
    steps = 3 * DELIVERY.horizon
    for step in range(steps):
        venv.step(rng.integers(NUM_ACTIONS, size=8))
        assert engine.transitions is not None
        states = torch.from_numpy(engine.transitions.observations)
        next_states = torch.from_numpy(engine.transitions.next_observations)
        done = len(encoded)
        with torch.no_grad():
            alone = np.stack([2 * network(states, next_states).numpy() for network in networks], axis=1)
        del encoded[done:]
        # Together in one batch or one after the other, and rounded differently where half precision is used.
        np.testing.assert_allclose(venv.rewards, alone, atol=0.01)
        if step == steps // 2:
            # Trained in the meantime, as AIRL does.
            with torch.no_grad():
                networks[1].g[0].weight += 1
        if step == steps // 2 + 5:
            networks[2](states, next_states).sum().backward()
            del encoded[done:]
            optimiser.step()
    # Of each of three episodes the first state, and every next state; once more where a network has changed.
    # What was seen of the states then is still known.
    assert encoded.count("counting") == encoded.count("fast") == 3 + steps
    assert [valued.count(network) for network in networks] == [3 + steps, 4 + steps, 4 + steps]


def test_goes_on_exactly_from_a_saved_state() -> None:
    venv, twin = scalarised(weights=(1.0, 2.0), seed=3), scalarised(weights=(5.0, 1.0), seed=4)
    rng = np.random.default_rng(0)
    venv.reset()
    # Up to the end of an episode: the returns are to be set back at the next step.
    for _ in range(EMERGENCY.build().horizon):
        observations, *_ = venv.step(rng.integers(NUM_ACTIONS, size=4))
    np.testing.assert_array_equal(twin.load_state_dict(venv.state_dict()), observations)
    np.testing.assert_array_equal(twin.weights, [1, 2])
    for _ in range(10):
        actions = rng.integers(NUM_ACTIONS, size=4)
        expected, got = venv.step(actions), twin.step(actions)
        np.testing.assert_array_equal(expected[1], got[1])
        np.testing.assert_array_equal(venv.returns, twin.returns)


def test_a_state_of_other_environments_is_refused_and_changes_nothing() -> None:
    venv = scalarised(num_envs=4)
    venv.reset()
    with pytest.raises(ValueError, match="history"):
        venv.load_state_dict(scalarised(num_envs=3, weights=(3.0, 1.0)).state_dict())
    with pytest.raises(ValueError, match="weights"):
        venv.load_state_dict(scalarised(num_envs=4, names=["save"], weights=(1.0,)).state_dict())
    np.testing.assert_array_equal(venv.weights, [1, 1])


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ([1.0], r"weights are \[1.0\]; there must be 2"),
        ([1.0, 1.0, 1.0], "there must be 2"),
        ([[1.0, 1.0]], "there must be 2"),
        (1.0, "there must be 2"),
        ([1.0, -0.5], "not negative"),
        ([1.0, float("nan")], "finite"),
        ([1.0, float("inf")], "finite"),
        ([0.0, 0.0], "not all zero"),
    ],
)
def test_impossible_weights_are_refused_and_change_nothing(weights: object, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        scalarised(weights=weights)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    venv = scalarised(weights=(1.0, 2.0))
    with pytest.raises(ValueError, match=message):
        venv.weights = weights
    np.testing.assert_array_equal(venv.weights, [1, 2])


def test_weights_are_taken_and_handed_out_as_a_copy() -> None:
    given = np.array([1, 2], dtype=np.float32)
    venv = scalarised(weights=given)  # type: ignore[arg-type]
    given[:] = -1
    venv.weights[:] = 7
    np.testing.assert_array_equal(venv.weights, [1, 2])
    state = venv.state_dict()
    venv.load_state_dict(state)
    state["weights"][:] = 9
    np.testing.assert_array_equal(venv.weights, [1, 2])


def test_an_unknown_component_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'rescue'; it must be one of \('extinguish', 'save'\)"):
        PrimaryReward(EMERGENCY.build().reward_names, "rescue")


def test_two_components_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="every name must be another"):
        scalarised(names=["save", "save"])


def test_a_component_of_another_shape_is_refused() -> None:
    class Scalar(ActionReward):
        def __call__(self, transitions: Transitions) -> NDArray[np.float32]:
            return np.ones(1, dtype=np.float32)

    venv = ScalarisedRewards(EngineVecEnv(DELIVERY, 2, seed=0), [Scalar("scalar", 1.0)], [1.0])
    venv.reset()
    with pytest.raises(AssertionError, match="scalar"):
        venv.step(np.array([0, 0]))


def test_alone_a_learned_reward_looks_at_what_it_is_given() -> None:
    component = LearnedReward("learned", GoneReward(Engine(DELIVERY).observation_shape))
    before, after = np.zeros((2, 1, *Engine(DELIVERY).observation_shape), dtype=np.uint8)
    still = Transitions(before, np.zeros(1, dtype=np.int64), after, np.zeros((1, 4), dtype=np.float32))
    assert component(still) == [0.0]
    # Into the same arrays, as into the buffers of whoever relabels recorded transitions.
    before[0, 2, 1, 1] = 1
    assert component(still) == [10.0]


def test_weights_are_reached_through_wrappers() -> None:
    inner = scalarised(num_envs=3)
    venv = VecMonitor(inner)
    venv.set_attr("weights", [0.25, 4.0])
    np.testing.assert_array_equal(inner.weights, [0.25, 4.0])
    found = venv.get_attr("weights", [0, 2])
    assert len(found) == 2
    found[0][:] = 9.0
    np.testing.assert_array_equal(inner.weights, [0.25, 4.0])
    with pytest.raises(ValueError, match=r"indices are \[1\]; all environments have the same weights"):
        venv.set_attr("weights", [1.0, 1.0], [1])
    with pytest.raises(ValueError, match="there must be 2, one for each of"):
        venv.set_attr("weights", [1.0])
