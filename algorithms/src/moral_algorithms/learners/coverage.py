"""Coverage sets: one policy for each of many scalarisation weights (thesis, algorithm 4).

Under fixed weights a reward vector is an ordinary reward, for which PPO finds a policy. Done for many
weights, this approximates the convex coverage set of the vector's components, whatever they are: the primary
reward and a learned one, as in the thesis's lambda * r_P + (1 - lambda) * f, or the world's own rewards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy

from moral_algorithms.bridge import EngineVecEnv, RewardComponent, ScalarisedRewards
from moral_algorithms.learners.asking import play_once
from moral_algorithms.learners.ppo import (
    OnProgress,
    PPOConfig,
    learn,
    make_ppo,
    sampling_seed,
    standard_callbacks,
)
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class CoverageConfig:
    """How each policy of a coverage set is trained and measured."""

    steps: int = 300_000
    """Environment steps of each policy."""
    episodes: int = 1000
    """Starts on which each policy is measured, the same for all."""
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(
            batch_size=800, epochs=5, gae_lambda=0.9, entropy_start=0.05, entropy_end=0.0
        )
    )
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        for name in ("steps", "episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")


class TrainedPolicy(NamedTuple):
    """What PPO found under fixed weights."""

    policy: ActorCriticPolicy
    """The policy."""
    env_steps: int
    """Environment steps it took."""


class Solution(NamedTuple):
    """One policy of a coverage set, measured."""

    weights: NDArray[np.float32]
    """Scalarisation weights that it was trained under, shape (d,)."""
    returns: NDArray[np.float64]
    """Mean undiscounted return in each component of the reward vector, shape (d,)."""
    objectives: NDArray[np.int64]
    """Ground-truth counters at the end of each episode, shape (n, m)."""
    policy: ActorCriticPolicy
    """The policy itself."""
    env_steps: int
    """Environment steps that training took; measuring is not counted."""


def train_weighted(
    world: WorldSpec,
    components: Sequence[RewardComponent],
    weights: ArrayLike,
    config: PPOConfig,
    steps: int,
    seed: int,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
    callbacks: Sequence[BaseCallback] = (),
) -> TrainedPolicy:
    """Train a policy by PPO on ``weights @ components(s, a, s')``.

    Parameters
    ----------
    world
        Where it acts.
    components
        The reward vector.
    weights
        Scalarisation weights, shape (d,), not negative and not all zero.
    config
        Hyperparameters of PPO.
    steps
        Environment steps, unless a callback ends training before.
    seed
        Entropy of environments, networks and actions.
    device
        Where networks live.
    tensorboard
        Folder for TensorBoard's event files.
    on_progress
        Called after every rollout.
    callbacks
        More of Stable-Baselines3's callbacks, called after the usual ones.

    Raises
    ------
    ValueError
        If the weights do not fit the components.
    """
    built = world.build()
    venv = ScalarisedRewards(EngineVecEnv(built, config.num_envs, seed=seed), components, weights)
    model = make_ppo(config, venv, seed, device, tensorboard)
    learn(model, steps, [*standard_callbacks(config, steps, built.objective_names, on_progress), *callbacks])
    return TrainedPolicy(model.policy, model.num_timesteps)


def solve(
    world: WorldSpec,
    components: Sequence[RewardComponent],
    weights: ArrayLike,
    config: CoverageConfig,
    seed: int,
    evaluation_seed: int = 0,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
) -> Solution:
    """Train a policy under fixed weights and measure it: one pass of algorithm 4's loop.

    Parameters
    ----------
    world
        Where it acts; its episodes must all take the same number of steps.
    components
        The reward vector, normalised (eq. 5.2): the return of a policy that pursues one component alone is
        about one for a primary component, and about minus one for a learned one. Otherwise the weights that
        matter depend on the components' scales.
    weights
        Scalarisation weights, shape (d,), not negative and not all zero.
    config
        How it is trained and measured.
    seed
        Entropy of training.
    evaluation_seed
        Entropy of the starts on which the policy is measured, and of its actions there: the same for all
        policies that are to be compared.
    device
        Where networks live.
    on_progress
        Called after every rollout.

    Raises
    ------
    ValueError
        If the weights do not fit the components, or episodes of this world are not all equally long.
    """
    built = world.build()
    if built.ends_early:
        raise ValueError(f"world is {built.name}; its episodes must all take the same number of steps")
    starts_seed, actions_seed = spawn_seeds(evaluation_seed, 2)
    venv = ScalarisedRewards(EngineVecEnv(built, config.episodes, seed=starts_seed), components, weights)
    policy, env_steps = train_weighted(
        world, components, weights, config.ppo, config.steps, seed, device, on_progress=on_progress
    )
    with sampling_seed(actions_seed):
        episodes = play_once(policy, venv)
    objectives = np.stack([episode.objectives for episode in episodes])
    return Solution(venv.weights, venv.returns.mean(axis=0, dtype=np.float64), objectives, policy, env_steps)
