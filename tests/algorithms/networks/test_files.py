"""Networks come back from their files as they were, and nothing else is taken for one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy

from moral_algorithms.networks.files import load_policy, load_reward, save_policy, save_reward
from moral_algorithms.networks.policies import POLICIES
from moral_algorithms.networks.rewards import REWARD_ARCHITECTURES, ShapedRewardNetwork
from moral_algorithms.storage import StorageError
from moral_algorithms.worlds import WORLDS, WorldSpec
from moral_envs import windy_wall_v0
from moral_envs.engine import Engine
from moral_envs.world import NUM_ACTIONS
from tests.algorithms.tiny import EMERGENCY, random_episodes

SHAPE = Engine(EMERGENCY.build()).observation_shape


def saved_policy(path: Path, preset: str = "fast") -> Any:
    observations = spaces.Box(0, 1, shape=SHAPE, dtype=np.uint8)
    policy = POLICIES[preset](observations, spaces.Discrete(NUM_ACTIONS), lambda _: 1e-3)
    save_policy(path, policy, preset, EMERGENCY)
    return policy


def change_header(path: Path, **changes: Any) -> None:
    """Write the file again with other values in its header; None leaves one out."""
    with safetensors.safe_open(path, framework="numpy") as file:
        header = json.loads(file.metadata()["moral"])
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    header = {name: value for name, value in {**header, **changes}.items() if value is not None}
    path.write_bytes(safetensors.numpy.save(arrays, metadata={"moral": json.dumps(header)}))


@pytest.mark.parametrize("preset", POLICIES)
def test_a_policy_acts_as_it_did(preset: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    policy = saved_policy(path, preset)
    loaded, world = load_policy(str(path))
    assert world == EMERGENCY
    assert type(loaded) is POLICIES[preset]
    states = torch.from_numpy(random_episodes(EMERGENCY, 3, seed=0).states[:, 0])
    with torch.no_grad():
        expected = policy.get_distribution(states).distribution.logits
        assert torch.equal(loaded.get_distribution(states).distribution.logits, expected)  # type: ignore[attr-defined]
        assert torch.equal(loaded.predict_values(states), policy.predict_values(states))


def test_what_could_not_be_read_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    observations = spaces.Box(0, 1, shape=SHAPE, dtype=np.uint8)
    actions = spaces.Discrete(NUM_ACTIONS)
    fast = POLICIES["fast"](observations, actions, lambda _: 1e-3)
    with pytest.raises(ValueError, match=r"preset is 'nonsense'; it must be one of \['fast', 'paper'\]"):
        save_policy(path, fast, "nonsense", EMERGENCY)
    other = ActorCriticPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    for policy, preset in ((fast, "paper"), (other, "fast")):
        with pytest.raises(ValueError, match=f"that is not as the preset '{preset}' makes it"):
            save_policy(path, policy, preset, EMERGENCY)
    assert not path.exists()
    torch.manual_seed(0)
    before = torch.get_rng_state()
    save_policy(path, fast, "fast", EMERGENCY)
    assert torch.equal(torch.get_rng_state(), before)


def test_a_world_of_fewer_actions_has_its_policies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(WORLDS, "windy", windy_wall_v0.world)
    world = WorldSpec("windy")
    built = world.build()
    observations = spaces.Box(0, 1, shape=Engine(built).observation_shape, dtype=np.uint8)
    assert built.num_actions < NUM_ACTIONS
    policy = POLICIES["fast"](observations, spaces.Discrete(built.num_actions), lambda _: 1e-3)
    save_policy(tmp_path / "policy.safetensors", policy, "fast", world)
    assert load_policy(tmp_path / "policy.safetensors").world == world


@pytest.mark.parametrize("architecture", REWARD_ARCHITECTURES)
def test_a_reward_network_pays_as_it_did(architecture: str, tmp_path: Path) -> None:
    path = tmp_path / "reward.safetensors"
    network = ShapedRewardNetwork(SHAPE, architecture, gamma=0.5)
    save_reward(str(path), network, 2.5, EMERGENCY)
    loaded, normaliser, world = load_reward(path)
    assert (normaliser, world, loaded.gamma, loaded.architecture) == (2.5, EMERGENCY, 0.5, architecture)
    states = torch.from_numpy(random_episodes(EMERGENCY, 3, seed=0).states)
    with torch.no_grad():
        assert torch.equal(loaded(states[:, 0], states[:, 1]), network(states[:, 0], states[:, 1]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "has version 2; this release reads 1"),
        ({"kind": "moral-reward"}, "holds 'moral-reward'; it must hold 'moral-policy'"),
        ({"preset": "huge"}, "is damaged or not what it should be: 'huge'"),
        ({"preset": None}, "is damaged or not what it should be"),
        ({"preset": "paper"}, "Error.s. in loading state_dict"),
        ({"world": {"name": "mars", "rules": {}}}, "world is 'mars'"),
        ({"world": {"name": "emergency", "rules": {"num_people": 400}}}, "free cells"),
        ({"world": {"name": "delivery", "rules": {}}}, "size mismatch"),
    ],
)
def test_another_header_is_refused_in_one_line(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    saved_policy(path)
    change_header(path, **changes)
    with pytest.raises(StorageError, match=message) as refused:
        load_policy(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("normaliser", [0.0, -3.2, float("nan"), float("inf")])
def test_a_normaliser_that_cannot_divide_is_not_written(normaliser: float, tmp_path: Path) -> None:
    path = tmp_path / "reward.safetensors"
    with pytest.raises(ValueError, match=f"normaliser is {normaliser}; it must be positive and finite"):
        save_reward(path, ShapedRewardNetwork(SHAPE), normaliser, EMERGENCY)
    assert not path.exists()


@pytest.mark.parametrize("normaliser", [0.0, -1.0, float("nan"), float("inf"), "much", None])
def test_a_normaliser_that_cannot_divide_is_refused(normaliser: Any, tmp_path: Path) -> None:
    path = tmp_path / "reward.safetensors"
    save_reward(path, ShapedRewardNetwork(SHAPE), 1.0, EMERGENCY)
    change_header(path, normaliser=normaliser)
    with pytest.raises(StorageError, match=r"is damaged or not what it should be"):
        load_reward(path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_truncated_file_is_refused(share: float, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    saved_policy(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(StorageError, match="is damaged or not what it should be"):
        load_policy(path)
