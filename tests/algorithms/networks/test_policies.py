"""The policies' presets inside Stable-Baselines3's PPO."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from torch import nn

from moral_algorithms.networks.conditioned import ConditionedPolicy, conditioned_space
from moral_algorithms.networks.policies import (
    POLICIES,
    ConvolutionalPolicy,
    EgocentricPolicy,
    Encoded,
    EncodingRolloutBuffer,
)
from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.world import NUM_ACTIONS, World
from tests.algorithms.tiny import parameters, scalarised, seeded_engine

WORLDS = [emergency_v0.world(), delivery_v0.world(), emergency_v0.world(4, 6, 1)]


def build(name: str, world: World, **arguments: object) -> EgocentricPolicy | ConvolutionalPolicy:
    space = spaces.Box(0, 1, Engine(world).observation_shape, np.uint8)
    torch.manual_seed(0)
    return POLICIES[name](space, spaces.Discrete(NUM_ACTIONS), lambda _: 1e-3, **arguments)  # type: ignore[return-value, arg-type]


@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("world", WORLDS, ids=["emergency", "delivery", "small"])
def test_a_policy_gives_actions_values_and_probabilities(name: str, world: World) -> None:
    policy = build(name, world)
    engine = seeded_engine(world, 7)
    observations = torch.from_numpy(engine.observe()[:, 0])
    actions, values, log_probabilities = policy(observations)
    assert actions.shape == (7,)
    assert values.shape == (7, 1)
    assert log_probabilities.shape == (7,)
    assert values.dtype == log_probabilities.dtype == torch.float32
    again, evaluated, entropy = policy.evaluate_actions(observations, actions)
    torch.testing.assert_close(again, values)
    torch.testing.assert_close(evaluated, log_probabilities)
    # Before training every action is about as likely as any other.
    assert entropy is not None
    assert (entropy > 0.95 * np.log(NUM_ACTIONS)).all()
    predicted, _ = policy.predict(engine.observe()[:, 0], deterministic=True)
    best = policy.get_distribution(observations).distribution.probs.argmax(dim=1)  # type: ignore[union-attr]
    np.testing.assert_array_equal(predicted, best)


def test_the_fast_policy_evaluates_as_its_distribution_does() -> None:
    policy = build("fast", WORLDS[1])
    with torch.no_grad():
        # Before training all actions are alike.
        policy.action_net.weight *= 100
    observations = torch.from_numpy(seeded_engine(WORLDS[1], 40).observe()[:, 0])
    actions = torch.arange(40) % NUM_ACTIONS
    distribution = policy.get_distribution(observations)
    expected = distribution.log_prob(actions), distribution.entropy()
    values, *found = policy.evaluate_actions(observations, actions)
    torch.testing.assert_close(found, list(expected))
    torch.testing.assert_close(values, policy.predict_values(observations))
    assert distribution.entropy().std() > 0.01  # type: ignore[union-attr]


@pytest.mark.parametrize("conditioned", [False, True])
def test_a_rollout_is_encoded_once_and_handed_out_by_rows(
    conditioned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = emergency_v0.world(5, 5, 3, max_cycles=10)
    shape = Engine(world).observation_shape
    space = conditioned_space(shape, 2) if conditioned else spaces.Box(0, 1, shape, np.uint8)
    actions = spaces.Discrete(NUM_ACTIONS)
    torch.manual_seed(0)
    policy = (
        ConditionedPolicy.build(shape, NUM_ACTIONS, 2, 30.0)
        if conditioned
        else EgocentricPolicy(space, actions, lambda _: 1e-3)
    )
    with torch.no_grad():
        # Before training all states and actions are alike.
        policy.action_net.weight *= 100
        policy.value_net.weight *= 10
    buffer = EncodingRolloutBuffer(6, space, actions, n_envs=4)
    buffer.policy = policy
    encode, encoded = policy.encode, []

    def count(observations: NDArray[Any]) -> Encoded:
        encoded.append(len(observations))
        return encode(observations)

    monkeypatch.setattr(policy, "encode", count)
    rng = np.random.default_rng(0)
    engine = seeded_engine(world, 4)
    for _ in range(2):
        buffer.reset()
        seen = []
        for _ in range(6):
            observations = engine.observe()[:, 0]
            if conditioned:
                weights = rng.random((4, 2)) + 0.1
                observations = np.concatenate([observations.reshape(4, -1), weights], 1, dtype=np.float32)
            taken = rng.integers(NUM_ACTIONS, size=4)
            with torch.no_grad():
                value, logarithms, _ = policy.evaluate_actions(
                    torch.from_numpy(observations), torch.from_numpy(taken)
                )
            seen.append((observations, taken, value[:, 0], logarithms))
            buffer.add(observations, taken, rng.random(4), np.zeros(4), value, logarithms)
            engine.step(taken[:, None])
        buffer.compute_returns_and_advantage(torch.zeros(4), np.zeros(4))
        for _ in range(2):
            batches = list(buffer.get(10))
            assert [len(batch.actions) for batch in batches] == [10, 10, 4]
            for batch in batches:
                with torch.no_grad():
                    value, logarithms, _ = policy.evaluate_actions(
                        batch.observations, batch.actions.flatten()
                    )
                # The same to half precision, which rounds batches of other sizes differently.
                for found, old in ((value[:, 0], batch.old_values), (logarithms, batch.old_log_prob)):
                    assert (found - old).abs().max() < 0.1 * old.std()
            everything = np.sort(np.concatenate([batch.old_values.numpy() for batch in batches]))
            np.testing.assert_array_equal(everything, np.sort(np.concatenate([row[2] for row in seen])))
    assert encoded == [24, 24]


def test_a_buffer_without_a_policy_hands_out_observations() -> None:
    venv = scalarised(num_envs=4)
    model = PPO(
        EgocentricPolicy,
        venv,
        n_steps=10,
        batch_size=20,
        n_epochs=1,
        seed=0,
        rollout_buffer_class=EncodingRolloutBuffer,
    )
    before = parameters(model.policy)
    model.learn(40)
    after = parameters(model.policy)
    assert any((before[name] != after[name]).any() for name in before)


@pytest.mark.parametrize("name", POLICIES)
def test_an_update_reaches_every_parameter(name: str) -> None:
    venv = scalarised(num_envs=4)
    model = PPO(POLICIES[name], venv, n_steps=10, batch_size=20, n_epochs=2, seed=0)
    before = parameters(model.policy)
    model.learn(40)
    after = parameters(model.policy)
    assert before.keys() >= {name for name, _ in model.policy.named_parameters()}
    assert [name for name in before if (before[name] == after[name]).all()] == []


def test_the_fast_policy_has_the_sizes_asked_for() -> None:
    policy = build("fast", emergency_v0.world(), radius=2, hidden=(20, 30))
    sizes = [tuple(p.shape) for name, p in policy.named_parameters() if name.endswith("weight")]
    # Three planes of 5 x 5 cells; features of 30 for 9 actions and a value.
    assert sizes == [(20, 75), (30, 20), (9, 30), (1, 30)]


@pytest.mark.parametrize("world", [emergency_v0.world(), delivery_v0.world()], ids=["emergency", "delivery"])
def test_the_paper_policy_has_the_layers_of_the_thesis(world: World) -> None:
    policy = build("paper", world)
    convolutions = [module for module in policy.modules() if isinstance(module, nn.Conv2d)]
    channels = len(world.plane_names)
    # B.1.1: shared convolutions of 64 and 256 channels, one of 32 each for actor and critic, kernels of 2.
    assert [(c.in_channels, c.out_channels) for c in convolutions] == [
        (channels, 64),
        (64, 256),
        (256, 32),
        (256, 32),
    ]
    assert all(c.kernel_size == (2, 2) and c.stride == (1, 1) and c.padding == (0, 0) for c in convolutions)
    features = 32 * (world.height - 3) * (world.width - 3)
    assert (policy.action_net.in_features, policy.action_net.out_features) == (features, NUM_ACTIONS)
    assert (policy.value_net.in_features, policy.value_net.out_features) == (features, 1)
    assert sum(isinstance(module, nn.ReLU) for module in policy.modules()) == 4
    assert sum(isinstance(module, nn.Linear) for module in policy.modules()) == 2


def test_the_paper_policy_computes_what_its_layers_say() -> None:
    policy = build("paper", emergency_v0.world())
    observations = torch.from_numpy(seeded_engine(emergency_v0.world(), 50).observe()[:, 0]).float()
    shared_1, shared_2, actor, critic = (m for m in policy.modules() if isinstance(m, nn.Conv2d))
    with torch.no_grad():
        maps = shared_2(shared_1(observations).relu()).relu()
        logits = policy.action_net(actor(maps).relu().flatten(1))
        values = policy.value_net(critic(maps).relu().flatten(1))
        distribution = policy.get_distribution(observations).distribution
        got = policy.predict_values(observations)
    # The policy may multiply in bfloat16: see test_precision.
    for one, other in ((distribution.logits, logits.log_softmax(1)), (got, values)):  # type: ignore[union-attr]
        assert (one - other).abs().max() < 0.1 * other.std(dim=0).mean()
