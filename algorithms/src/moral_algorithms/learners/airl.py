"""Adversarial inverse reinforcement learning: a reward network from demonstrations (thesis, algorithm 3).

Two networks play against each other. The discriminator D = exp(f) / (exp(f) + pi) (eq. 3.9) tells demonstrated
transitions from the policy's own; the policy is trained by PPO on the reward f. What the entropy term of
``log D - log(1 - D) = f - log pi`` asks for is left to PPO's entropy bonus.

What it needs to work, beside a bootstrap at the horizon and rewards rescaled by the spread of returns: a generous
entropy bonus, without which the policy runs after every ripple of f and the discriminator after the policy; and an
average of the discriminator's weights over training, which is what is returned as the learned reward.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from torch.nn import functional

from moral_algorithms.bridge import EngineVecEnv, LearnedReward, ScalarisedRewards, Transitions
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.ppo import (
    OnProgress,
    PPOConfig,
    learn,
    make_ppo,
    sampling_seed,
    standard_callbacks,
)
from moral_algorithms.networks.rewards import ShapedRewardNetwork


@dataclass(frozen=True)
class AIRLConfig:
    """How AIRL trains."""

    steps: int = 500_000
    """Environment steps."""
    architecture: str = "fast"
    """Reward network: fast (egocentric), mlp (thesis figure 3.5) or conv (thesis B.1.2)."""
    discriminator_updates: int = 16
    """Gradient steps of the discriminator per rollout."""
    discriminator_batch: int = 512
    """Demonstrated transitions, and as many of the policy's, per gradient step."""
    discriminator_learning_rate: float = 1e-3
    """Adam's step size at the start; it falls linearly to a fiftieth."""
    averaging: float = 0.995
    """Memory, per gradient step, of the average of the discriminator's weights that becomes the reward."""
    normaliser_episodes: int = 200
    """Episodes of the imitation policy over which its return is averaged (eq. 5.2)."""
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(entropy_start=0.2, entropy_end=0.2))
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        for name in ("steps", "discriminator_updates", "discriminator_batch", "normaliser_episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        if not 0 <= self.averaging < 1:
            raise ValueError(f"averaging is {self.averaging}; it must be at least 0 and below 1")


class Imitation(NamedTuple):
    """What AIRL found."""

    network: ShapedRewardNetwork
    """The learned reward f."""
    normaliser: float
    """|J|, the absolute mean return of the imitation policy under f (eq. 5.2)."""
    policy: ActorCriticPolicy
    """The imitation policy."""
    env_steps: int
    """Environment steps it took, those for the normaliser included."""


def train_airl(
    demonstrations: Demonstrations,
    config: AIRLConfig,
    seed: int,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
) -> Imitation:
    """Learn a reward and an imitation policy from demonstrations.

    Parameters
    ----------
    demonstrations
        Episodes of one expert.
    config
        How AIRL trains.
    seed
        Entropy of environments, networks, batches and actions.
    device
        Where networks live.
    tensorboard
        Folder for TensorBoard's event files.
    on_progress
        Called after every rollout.
    """
    world = demonstrations.world.build()
    engine = EngineVecEnv(world, config.ppo.num_envs, seed=seed)
    channels, height, width = engine.engine.observation_shape
    with sampling_seed(seed):
        network = ShapedRewardNetwork((channels, height, width), config.architecture, config.ppo.gamma)
    component = LearnedReward("imitate", network.to(device))
    venv = ScalarisedRewards(engine, [component], [1.0])
    model = make_ppo(config.ppo, venv, seed, device, tensorboard)
    discriminator = Discriminator(engine, network, demonstrations, config, seed)
    standard = standard_callbacks(config.ppo, config.steps, world.objective_names, on_progress)
    learn(model, config.steps, [*standard, discriminator])

    averaged = discriminator.averaged
    with sampling_seed(seed):
        episodes = play_episodes(model.policy, world, config.normaliser_episodes, seed)
    normaliser = abs(float(episode_returns(averaged, episodes.states).mean()))
    env_steps = model.num_timesteps + config.normaliser_episodes * world.horizon
    return Imitation(averaged, normaliser, model.policy, env_steps)


def episode_returns(network: ShapedRewardNetwork, states: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Undiscounted returns under a reward network.

    Parameters
    ----------
    network
        The reward f(s, s').
    states
        uint8 planes of shape (n, T + 1, C, H, W).

    Returns
    -------
    float64 array of shape (n,)
    """
    device = next(network.parameters()).device
    total = np.zeros(len(states))
    with torch.no_grad():
        for step in range(states.shape[1] - 1):
            now, after = (torch.from_numpy(states[:, step + i].copy()).to(device) for i in (0, 1))
            total += network(now, after).cpu().numpy()
    return total


class Discriminator(BaseCallback):
    """Trains the reward network after every rollout to tell demonstrations from the policy (eq. 3.10).

    Parameters
    ----------
    venv
        The environments that PPO acts in.
    network
        The reward f; its weights change in place.
    demonstrations
        The expert's episodes.
    config
        Sizes and step sizes.
    seed
        Entropy of the batches.

    Attributes
    ----------
    averaged : ShapedRewardNetwork
        The network with exponentially averaged weights.
    """

    def __init__(
        self,
        venv: EngineVecEnv,
        network: ShapedRewardNetwork,
        demonstrations: Demonstrations,
        config: AIRLConfig,
        seed: int,
    ) -> None:
        super().__init__()
        self._venv = venv
        self._network = network
        self.averaged = copy.deepcopy(network)
        self._config = config
        self._rng = np.random.default_rng(seed)
        self._optimiser = torch.optim.Adam(network.parameters(), lr=config.discriminator_learning_rate, fused=True)
        self._demonstrations = demonstrations
        self._rollout: list[Transitions] = []

    def _on_step(self) -> bool:
        assert self._venv.transitions is not None
        self._rollout.append(self._venv.transitions)
        return True

    def _on_rollout_end(self) -> None:
        config = self._config
        remaining = max(1 - self.num_timesteps / config.steps, 0.02)
        for group in self._optimiser.param_groups:
            group["lr"] = config.discriminator_learning_rate * remaining
        accuracies = [self._update() for _ in range(config.discriminator_updates)]
        fake, real = np.mean(accuracies, axis=0)
        self.logger.record("airl/fake_accuracy", fake)
        self.logger.record("airl/real_accuracy", real)
        self._rollout = []

    def _update(self) -> tuple[float, float]:
        """One gradient step; returns the accuracies on the policy's and on the demonstrated transitions."""
        batch = self._config.discriminator_batch
        states, actions, next_states = (
            torch.from_numpy(np.concatenate(pair)).to(self.model.device)
            for pair in zip(self._sample_policy(batch), self._sample_demonstrations(batch), strict=True)
        )
        assert isinstance(self.model, PPO)
        with torch.no_grad():
            _, log_probabilities, _ = self.model.policy.evaluate_actions(states.float(), actions)
        # D = exp(f) / (exp(f) + pi), so its logit is f - log pi.
        logits = self._network(states, next_states) - log_probabilities
        labels = torch.zeros_like(logits)
        labels[batch:] = 1
        loss = functional.binary_cross_entropy_with_logits(logits, labels)
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        with torch.no_grad():
            for mean, current in zip(self.averaged.parameters(), self._network.parameters(), strict=True):
                mean.lerp_(current, 1 - self._config.averaging)
            demonstrated = logits > 0
            fake, real = (~demonstrated[:batch]).float().mean(), demonstrated[batch:].float().mean()
        return float(fake), float(real)

    def _sample_policy(self, count: int) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8]]:
        steps = self._rng.integers(len(self._rollout), size=count)
        rows = self._rng.integers(self._venv.num_envs, size=count)
        picked = [(self._rollout[step], row) for step, row in zip(steps, rows, strict=True)]
        return (
            np.stack([transitions.observations[row] for transitions, row in picked]),
            np.array([transitions.actions[row] for transitions, row in picked]),
            np.stack([transitions.next_observations[row] for transitions, row in picked]),
        )

    def _sample_demonstrations(self, count: int) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8]]:
        demonstrations = self._demonstrations
        episodes = self._rng.integers(demonstrations.num_episodes, size=count)
        steps = self._rng.integers(demonstrations.actions.shape[1], size=count)
        return (
            demonstrations.states[episodes, steps],
            demonstrations.actions[episodes, steps].astype(np.int64),
            demonstrations.states[episodes, steps + 1],
        )
