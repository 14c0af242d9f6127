"""Policies and reward networks as files: parameters in safetensors, with a header that says what they are.

The header, JSON under ``moral``, holds ``kind``, ``version`` (1), ``world`` and how to build the network:
``preset`` for a policy; ``components`` and ``span`` for a policy for all weights; ``architecture``, ``gamma``
and ``normaliser`` for AIRL's reward network; ``architecture``, ``num_actions`` and ``members`` for an
ensemble learned from preferences.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from moral_algorithms.networks.conditioned import ConditionedPolicy
from moral_algorithms.networks.policies import POLICIES
from moral_algorithms.networks.rewards import ActionRewardEnsemble, ShapedRewardNetwork
from moral_algorithms.storage import StorageError, StrPath, read_tensors, write_tensors
from moral_algorithms.worlds import WorldSpec
from moral_envs.engine import Engine

VERSION = 1
_POLICY, _REWARD, _ACTION_REWARD = "moral-policy", "moral-reward", "moral-action-reward"
_CONDITIONED = "moral-conditioned-policy"

Network = TypeVar("Network", bound=nn.Module)


class StoredPolicy(NamedTuple):
    """A policy that was read from a file."""

    policy: ActorCriticPolicy
    """Ready to act."""
    world: WorldSpec
    """Where it was trained."""


class StoredConditionedPolicy(NamedTuple):
    """A policy for all weights that was read from a file."""

    policy: ConditionedPolicy
    """Makes the policy for given weights."""
    world: WorldSpec
    """Where it was trained."""


class StoredReward(NamedTuple):
    """A reward network that was read from a file."""

    network: ShapedRewardNetwork
    """The reward f(s, s')."""
    normaliser: float
    """``|J|``, the absolute mean return of the imitation policy under it (eq. 5.2)."""
    world: WorldSpec
    """Where it was learned."""


class StoredActionReward(NamedTuple):
    """An ensemble of reward networks that was read from a file."""

    network: ActionRewardEnsemble
    """The reward r(s, a), with the scales of its members."""
    world: WorldSpec
    """Where it was learned."""


def save_policy(path: StrPath, policy: ActorCriticPolicy, preset: str, world: WorldSpec) -> None:
    """Write a policy.

    Parameters
    ----------
    path
        The file.
    policy
        What is written.
    preset
        Its name in :data:`~moral_algorithms.networks.policies.POLICIES`.
    world
        Where it was trained.

    Raises
    ------
    ValueError
        If there is no such preset, or the policy's networks are not those that it makes for this world.
    StorageError
        If it cannot be written.
    """
    if preset not in POLICIES:
        raise ValueError(f"preset is {preset!r}; it must be one of {sorted(POLICIES)}")
    # Making one draws random numbers, which saving must not.
    with torch.random.fork_rng():
        expected = _shapes(_make_policy(preset, world))
    if _shapes(policy) != expected:
        raise ValueError(
            f"policy is a {type(policy).__name__} that is not as the preset {preset!r} makes it for this "
            "world; save it with stable_baselines3"
        )
    _save(path, _POLICY, policy, world, preset=preset)


def _make_policy(preset: str, world: WorldSpec) -> ActorCriticPolicy:
    observations = spaces.Box(0, 1, shape=_state_shape(world), dtype=np.uint8)
    return POLICIES[preset](observations, spaces.Discrete(world.build().num_actions), lambda _: 0.0)


def _shapes(policy: ActorCriticPolicy) -> dict[str, torch.Size]:
    return {name: tensor.shape for name, tensor in policy.state_dict().items()}


def load_policy(path: StrPath, device: str = "cpu") -> StoredPolicy:
    """Read a policy.

    Raises
    ------
    StorageError
        If the file is missing, damaged, or holds something else.
    """

    def build(header: dict[str, Any], world: WorldSpec) -> ActorCriticPolicy:
        return _make_policy(header["preset"], world)

    policy, _, world = _load(path, _POLICY, build)
    policy.to(device).set_training_mode(False)
    return StoredPolicy(policy, world)


def save_conditioned_policy(path: StrPath, policy: ConditionedPolicy, world: WorldSpec) -> None:
    """Write a policy for all weights.

    Parameters
    ----------
    path
        The file.
    policy
        What is written.
    world
        Where it was trained.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    _save(path, _CONDITIONED, policy, world, components=policy.components, span=policy.span)


def load_conditioned_policy(path: StrPath, device: str = "cpu") -> StoredConditionedPolicy:
    """Read a policy for all weights.

    Raises
    ------
    StorageError
        If the file is missing, damaged, or holds something else.
    """

    def build(header: dict[str, Any], world: WorldSpec) -> ConditionedPolicy:
        components, span = int(header["components"]), float(header["span"])
        if not (components > 0 and math.isfinite(span) and span > 1):
            raise ValueError(f"it has {components} components and a span of {span}")
        num_actions = world.build().num_actions
        return ConditionedPolicy.build(_state_shape(world), num_actions, components, span)

    policy, _, world = _load(path, _CONDITIONED, build)
    policy.to(device).set_training_mode(False)
    return StoredConditionedPolicy(policy, world)


def save_reward(path: StrPath, network: ShapedRewardNetwork, normaliser: float, world: WorldSpec) -> None:
    """Write a reward network.

    Parameters
    ----------
    path
        The file.
    network
        What is written.
    normaliser
        What its rewards are divided by, positive (eq. 5.2).
    world
        Where it was learned.

    Raises
    ------
    ValueError
        If the normaliser is not positive.
    StorageError
        If it cannot be written.
    """
    if not (math.isfinite(normaliser) and normaliser > 0):
        raise ValueError(f"normaliser is {normaliser}; it must be positive and finite")
    architecture, gamma = network.architecture, network.gamma
    _save(path, _REWARD, network, world, architecture=architecture, gamma=gamma, normaliser=normaliser)


def load_reward(path: StrPath, device: str = "cpu") -> StoredReward:
    """Read a reward network.

    Raises
    ------
    StorageError
        If the file is missing, damaged, or holds something else.
    """

    def build(header: dict[str, Any], world: WorldSpec) -> ShapedRewardNetwork:
        normaliser = float(header["normaliser"])
        if not (math.isfinite(normaliser) and normaliser > 0):
            raise ValueError(f"its normaliser is {normaliser}; it must be positive and finite")
        return ShapedRewardNetwork(_state_shape(world), header["architecture"], float(header["gamma"]))

    network, header, world = _load(path, _REWARD, build)
    return StoredReward(network.to(device), float(header["normaliser"]), world)


def save_action_reward(path: StrPath, network: ActionRewardEnsemble, world: WorldSpec) -> None:
    """Write an ensemble of reward networks.

    Parameters
    ----------
    path
        The file.
    network
        What is written.
    world
        Where it was learned.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    architecture, num_actions, members = network.architecture, network.num_actions, len(network.members)
    _save(
        path,
        _ACTION_REWARD,
        network,
        world,
        architecture=architecture,
        num_actions=num_actions,
        members=members,
    )


def load_action_reward(path: StrPath, device: str = "cpu") -> StoredActionReward:
    """Read an ensemble of reward networks.

    Raises
    ------
    StorageError
        If the file is missing, damaged, or holds something else.
    """

    def build(header: dict[str, Any], world: WorldSpec) -> ActionRewardEnsemble:
        shape, num_actions, members = _state_shape(world), int(header["num_actions"]), int(header["members"])
        return ActionRewardEnsemble(shape, num_actions, header["architecture"], members)

    network, _, world = _load(path, _ACTION_REWARD, build)
    return StoredActionReward(network.to(device), world)


def _save(path: StrPath, kind: str, network: nn.Module, world: WorldSpec, **build: Any) -> None:
    arrays = {name: tensor.detach().cpu().numpy() for name, tensor in network.state_dict().items()}
    write_tensors(path, arrays, {"kind": kind, "version": VERSION, "world": world.to_json(), **build})


def _load(
    path: StrPath, kind: str, build: Callable[[dict[str, Any], WorldSpec], Network]
) -> tuple[Network, dict[str, Any], WorldSpec]:
    arrays, header = read_tensors(path, kind)
    if header.get("version") != VERSION:
        raise StorageError(f"{path} has version {header.get('version')!r}; this release reads {VERSION}")
    try:
        world = WorldSpec.from_json(header["world"])
        network = build(header, world)
        network.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise StorageError(
            f"{path} is damaged or not what it should be: {' '.join(str(error).split())}"
        ) from error
    return network, header, world


def _state_shape(world: WorldSpec) -> tuple[int, int, int]:
    return Engine(world.build(), 1).observation_shape
