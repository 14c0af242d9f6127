"""Worlds and configurations small enough to train in a test; nothing here depends on a default's value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moral_algorithms.bridge import EngineVecEnv, PrimaryReward, ScalarisedRewards
from moral_algorithms.evaluation import Episodes, RandomPolicy, play_episodes
from moral_algorithms.learners.ppo import PPOConfig
from moral_algorithms.worlds import WorldSpec
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, World

EMERGENCY = WorldSpec("emergency", {"height": 5, "width": 5, "num_people": 2, "max_cycles": 8})
"""Nine free cells, two people, eight steps."""


def ppo_config(**changes: Any) -> PPOConfig:
    """PPO that learns the tiny world in seconds; every hyperparameter is given."""
    values: dict[str, Any] = {
        "policy": "fast",
        "num_envs": 32,
        "rollout_steps": 16,
        "batch_size": 128,
        "epochs": 4,
        "learning_rate": 3e-3,
        "gamma": 0.95,
        "gae_lambda": 0.9,
        "clip_range": 0.2,
        "entropy_start": 0.01,
        "entropy_end": 0.01,
    }
    return PPOConfig(**{**values, **changes})


def scalarised(
    world: WorldSpec = EMERGENCY,
    num_envs: int = 4,
    weights: ArrayLike = (1.0, 1.0),
    seed: int = 0,
    names: Sequence[str] | None = None,
) -> ScalarisedRewards:
    """The world's own rewards under weights."""
    built = world.build()
    components = [PrimaryReward(built.reward_names, name) for name in names or built.reward_names]
    return ScalarisedRewards(EngineVecEnv(built, num_envs, seed=seed), components, weights)


def random_episodes(world: WorldSpec, num_episodes: int, seed: int) -> Episodes:
    """Episodes of the policy that chooses every action with the same probability."""
    policy = RandomPolicy(NUM_ACTIONS, np.random.default_rng(seed))
    return play_episodes(policy, world.build(), num_episodes, seed)


def seeded_engine(world: World, num_envs: int, seed: int = 0) -> Engine:
    """Environments at the start of an episode, the same for the same seed."""
    engine = Engine(world, num_envs)
    engine.seed(spawn_streams(seed, num_envs))
    engine.reset()
    return engine


def parameters(policy: Any) -> dict[str, NDArray[Any]]:
    """Copies of a network's parameters and buffers."""
    return {name: tensor.detach().numpy().copy() for name, tensor in policy.state_dict().items()}
