"""Ensembles of r(s, a): the thesis's layers, what they look at, how they are standardised and stored."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
import torch
from torch import nn

from moral_algorithms.bridge import LearnedActionReward, ScalarisedRewards, Transitions
from moral_algorithms.bridge.vec_env import EngineVecEnv
from moral_algorithms.networks.files import load_action_reward, load_reward, save_action_reward
from moral_algorithms.networks.rewards import (
    ACTION_REWARD_ARCHITECTURES,
    ActionRewardEnsemble,
    Shape,
)
from moral_algorithms.storage import StorageError
from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.world import World
from tests.algorithms.tiny import EMERGENCY, random_episodes, seeded_engine

WORLDS = {"emergency": emergency_v0.world(), "delivery": delivery_v0.world()}


def shape_of(world: World) -> Shape:
    return Engine(world).observation_shape


def batch(world: World, count: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    """States at the start of an episode and actions."""
    states = seeded_engine(world, count).observe()[:, 0]
    return torch.from_numpy(states), torch.arange(count) % world.num_actions


def ensemble(world: World, architecture: str = "fast", members: int = 2) -> ActionRewardEnsemble:
    torch.manual_seed(0)
    return ActionRewardEnsemble(shape_of(world), world.num_actions, architecture, members)


@pytest.mark.parametrize("architecture", ACTION_REWARD_ARCHITECTURES)
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_members_are_networks_of_their_own(architecture: str, world: World) -> None:
    network = ensemble(world, architecture, members=3)
    states, actions = batch(world)
    rewards = network(states, actions)
    assert rewards.shape == (3, 8)
    assert rewards.dtype == torch.float32
    assert not torch.equal(rewards[0], rewards[1])
    rewards[1].sum().backward()
    moved = [
        [p.grad is not None and bool(p.grad.any()) for p in member.parameters()] for member in network.members
    ]
    assert all(moved[1])
    assert not any(moved[0] + moved[2])


@pytest.mark.parametrize("architecture", ACTION_REWARD_ARCHITECTURES)
def test_the_action_counts(architecture: str) -> None:
    world = WORLDS["emergency"]
    state, _ = batch(world, 1)
    states = state.repeat(9, 1, 1, 1)
    with torch.no_grad():
        rewards = ensemble(world, architecture, 1)(states, torch.arange(9))[0]
    assert len(set(rewards.tolist())) == 9


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_paper_has_the_layers_of_appendix_b_1_3(world: World) -> None:
    channels, height, width = shape_of(world)
    (network,) = ensemble(world, "paper", 1).members
    (embedding, head) = (module for module in network.modules() if isinstance(module, nn.Linear))
    assert (embedding.in_features, embedding.out_features) == (9, channels * height * width)
    convolutions = [module for module in network.modules() if isinstance(module, nn.Conv2d)]
    sizes = [(2 * channels, 128), (128, 64), (64, 32)]
    assert [(c.in_channels, c.out_channels) for c in convolutions] == sizes
    assert (head.in_features, head.out_features) == (32 * (height - 3) * (width - 3), 1)
    slopes = [module.negative_slope for module in network.modules() if isinstance(module, nn.LeakyReLU)]
    assert slopes == [0.01] * 3


def test_paper_puts_the_embedded_action_beside_the_state() -> None:
    world = WORLDS["emergency"]
    network = ensemble(world, "paper", 1)
    (member,) = network.members
    states, actions = batch(world)
    with torch.no_grad():
        embedded = member.embedding.weight.T[actions] + member.embedding.bias  # type: ignore[union-attr,operator,index]
        planes = torch.cat([states.float(), embedded.reshape(states.shape)], dim=1)
        expected = member.layers(planes)[:, 0]  # type: ignore[operator]
        # The network may multiply in bfloat16.
        torch.testing.assert_close(network(states, actions)[0], expected, atol=1e-2, rtol=0)


def test_fast_sees_the_cells_that_an_action_can_touch() -> None:
    world = WORLDS["emergency"]
    network = ensemble(world, "fast", 1)
    states = torch.zeros(3, *shape_of(world))
    states[:, 0] = torch.from_numpy(Engine(world).observe()[0, 0, 0])
    states[:, 1, 3, 3] = 1
    states[1, 2, 3, 4] = 1
    states[2, 2, 3, 6] = 1
    with torch.no_grad():
        alone, beside, far = network(states, torch.full((3,), 8))[0].tolist()
    assert beside != alone
    assert far == alone


def test_a_new_ensemble_pays_nothing() -> None:
    states, actions = batch(WORLDS["emergency"])
    assert not ensemble(WORLDS["emergency"]).standardised(states, actions).any()


def test_every_member_is_standardised() -> None:
    network = ensemble(WORLDS["emergency"], members=3)
    states, actions = batch(WORLDS["emergency"], 200)
    network.standardise(states, actions)
    with torch.no_grad():
        rewards = network(states, actions)
        each = (rewards - network.means[:, None]) * network.scales[:, None]
        np.testing.assert_allclose(each.mean(dim=1), 0, atol=1e-4)
        np.testing.assert_allclose(each.std(dim=1, correction=0), 1, rtol=1e-3)
        torch.testing.assert_close(network.standardised(states, actions), each.mean(dim=0))


def test_a_constant_reward_stays_nothing() -> None:
    network = ensemble(WORLDS["emergency"])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
    states, actions = batch(WORLDS["emergency"])
    network.standardise(states, actions)
    assert not network.standardised(states, actions).any()


def test_the_component_pays_for_state_and_action() -> None:
    built = EMERGENCY.build()
    network = ensemble(built)
    venv = ScalarisedRewards(
        EngineVecEnv(built, 8, seed=0), [LearnedActionReward("preferred", network)], [2.0]
    )
    observations = venv.reset()
    network.standardise(*batch(built, 50))
    actions = np.arange(8)
    _, rewards, _, _ = venv.step(actions)
    with torch.no_grad():
        expected = network.standardised(torch.from_numpy(observations), torch.from_numpy(actions))
    np.testing.assert_allclose(rewards, 2 * expected.numpy(), rtol=1e-6)
    assert expected.any()


def test_the_component_looks_at_nothing_else() -> None:
    built = EMERGENCY.build()
    network = ensemble(built)
    states, actions = (part.numpy() for part in batch(built))
    network.standardise(*batch(built, 50))
    component = LearnedActionReward("preferred", network)
    rng = np.random.default_rng(0)
    paid = [
        component(
            Transitions(
                states,
                actions,
                rng.integers(2, size=states.shape, dtype=np.uint8),
                rng.normal(size=(8, 2)).astype(np.float32),
            )
        )
        for _ in range(2)
    ]
    np.testing.assert_array_equal(paid[0], paid[1])


@pytest.mark.parametrize("architecture", ACTION_REWARD_ARCHITECTURES)
def test_an_ensemble_pays_as_it_did(architecture: str, tmp_path: Path) -> None:
    path = tmp_path / "reward.safetensors"
    built = EMERGENCY.build()
    network = ensemble(built, architecture, members=2)
    played = random_episodes(EMERGENCY, 6, seed=0)
    states, actions = torch.from_numpy(played.states[:, 3]), torch.from_numpy(played.actions[:, 3])
    network.standardise(states, actions)
    save_action_reward(path, network, EMERGENCY)
    loaded, world = load_action_reward(path)
    assert (world, loaded.architecture, len(loaded.members)) == (EMERGENCY, architecture, 2)
    with torch.no_grad():
        assert torch.equal(loaded(states, actions), network(states, actions))
        assert torch.equal(loaded.standardised(states, actions), network.standardised(states, actions))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "has version 2; this release reads 1"),
        ({"architecture": "huge"}, "architecture is 'huge'"),
        ({"architecture": "paper"}, "Error.s. in loading state_dict"),
        ({"members": 3}, "Error.s. in loading state_dict"),
        ({"members": 0}, "members is 0; it must be at least 1"),
        ({"members": "many"}, "is damaged or not what it should be"),
        ({"num_actions": 4}, "size mismatch"),
    ],
)
def test_another_header_is_refused_in_one_line(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "reward.safetensors"
    save_action_reward(path, ensemble(EMERGENCY.build()), EMERGENCY)
    with safetensors.safe_open(path, framework="numpy") as file:
        header = json.loads(file.metadata()["moral"]) | changes
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    path.write_bytes(safetensors.numpy.save(arrays, metadata={"moral": json.dumps(header)}))
    with pytest.raises(StorageError, match=message) as refused:
        load_action_reward(path)
    assert "\n" not in str(refused.value)


def test_it_is_not_taken_for_a_reward_of_airl(tmp_path: Path) -> None:
    path = tmp_path / "reward.safetensors"
    save_action_reward(path, ensemble(EMERGENCY.build()), EMERGENCY)
    with pytest.raises(StorageError, match="holds 'moral-action-reward'; it must hold 'moral-reward'"):
        load_reward(path)


def test_impossible_ensembles_are_refused() -> None:
    with pytest.raises(ValueError, match=r"'resnet'; it must be one of \['fast', 'paper'\]"):
        ActionRewardEnsemble((4, 8, 8), 9, "resnet")
    with pytest.raises(ValueError, match="members is 0; it must be at least 1"):
        ActionRewardEnsemble((4, 8, 8), 9, "fast", 0)
    network = ActionRewardEnsemble((4, 8, 8), 9)
    with pytest.raises(AssertionError, match="is not"):
        network(torch.zeros(2, 4, 7, 8), torch.zeros(2))
    with pytest.raises(AssertionError, match="is not"):
        network(torch.zeros(2, 4, 8, 8), torch.zeros(3))
