"""Adversarial inverse reinforcement learning: a reward network from demonstrations (thesis, algorithm 3).

Two networks play against each other. The discriminator D = exp(f) / (exp(f) + pi) (eq. 3.9) tells
demonstrated transitions from the policy's own; the policy is trained by PPO on the reward f. What the entropy
term of ``log D - log(1 - D) = f - log pi`` asks for is left to PPO's entropy bonus.

What it needs to work, beside a bootstrap at the horizon and rewards rescaled by the spread of returns: a
generous entropy bonus, without which the policy runs after every ripple of f and the discriminator after the
policy; and an average of the discriminator's weights over training, which is what is returned as the learned
reward.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import get_device
from torch.nn import functional

from moral_algorithms.bridge import EngineVecEnv, LearnedReward, RewardComponent, ScalarisedRewards
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.ppo import (
    ObjectiveMonitor,
    OnProgress,
    PPOConfig,
    learn,
    make_ppo,
    sampling_seed,
    standard_callbacks,
)
from moral_algorithms.networks.optimisers import EagerAdamW
from moral_algorithms.networks.rewards import REWARD_ARCHITECTURES, ShapedRewardNetwork
from moral_algorithms.networks.sparse import Rows, concatenate
from moral_algorithms.run_directory import append_line
from moral_algorithms.seeding import spawn_seeds


@dataclass(frozen=True)
class AIRLConfig:
    """How AIRL trains."""

    steps: int = 500_000
    """Environment steps."""
    architecture: str = "fast"
    """Reward network: fast (egocentric), counting (fast, with counts in unary, for Delivery), mlp (thesis
    figure 3.5) or conv (thesis B.1.2)."""
    discriminator_updates: int = 16
    """Gradient steps of the discriminator per rollout."""
    discriminator_batch: int = 512
    """Demonstrated transitions, and as many of the policy's, per gradient step."""
    discriminator_learning_rate: float = 1e-3
    """Adam's step size at the start; it falls linearly to a fiftieth."""
    discriminator_weight_decay: float = 0.0
    """Weight decay of Adam. It forgets judgements on what neither expert nor policy do any more; without it
    one expert's reward holds the other's errands against the agent for good."""
    averaging: float = 0.995
    """Memory, per gradient step, of the average of the discriminator's weights that becomes the reward."""
    normaliser_episodes: int = 200
    """Episodes of the imitation policy over which its return is averaged (eq. 5.2)."""
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(entropy_start=0.3, entropy_end=0.3))
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        if self.architecture not in REWARD_ARCHITECTURES:
            known = sorted(REWARD_ARCHITECTURES)
            raise ValueError(f"architecture is {self.architecture!r}; it must be one of {known}")
        for name in ("steps", "discriminator_updates", "discriminator_batch", "normaliser_episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        if not 0 < self.discriminator_learning_rate < math.inf:
            rate = self.discriminator_learning_rate
            raise ValueError(f"discriminator_learning_rate is {rate}; it must be positive and finite")
        if not 0 <= self.discriminator_weight_decay < math.inf:
            decay = self.discriminator_weight_decay
            raise ValueError(f"discriminator_weight_decay is {decay}; it must be finite and not negative")
        if not 0 <= self.averaging < 1:
            raise ValueError(f"averaging is {self.averaging}; it must be at least 0 and below 1")


class Imitation(NamedTuple):
    """What AIRL found."""

    network: ShapedRewardNetwork
    """The learned reward f."""
    normaliser: float
    """``|J|``, the absolute mean return of the imitation policy under f (eq. 5.2)."""
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
    metrics: Path | None = None,
    others: Sequence[RewardComponent] = (),
    weights: ArrayLike = (1.0,),
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
    metrics
        File to which a line is appended after every rollout: ``env_steps``, mean ``objectives`` and the
        discriminator's ``fake_accuracy`` and ``real_accuracy``.
    others
        Reward components that the policy pursues besides f.
    weights
        Scalarisation weights of these and, last, of f.

    Raises
    ------
    ValueError
        If the weights do not fit the components.
    """
    world = demonstrations.world.build()
    ppo_seed, network_seed, batch_seed, start_seed, action_seed = spawn_seeds(seed, 5)
    engine = EngineVecEnv(world, config.ppo.num_envs, seed=ppo_seed)
    channels, height, width = engine.engine.observation_shape
    with sampling_seed(network_seed):
        network = ShapedRewardNetwork((channels, height, width), config.architecture, config.ppo.gamma)
    component = LearnedReward("imitate", network.to(get_device(device)))
    venv = ScalarisedRewards(engine, [*others, component], weights)
    model = make_ppo(config.ppo, venv, ppo_seed, device, tensorboard)
    discriminator = Discriminator(engine, component, demonstrations, config, batch_seed)
    standard = standard_callbacks(config.ppo, config.steps, world.objective_names, on_progress)
    callbacks = [*standard, discriminator]
    if metrics is not None:
        monitor = next(callback for callback in standard if isinstance(callback, ObjectiveMonitor))
        callbacks.append(_Record(metrics, monitor, discriminator))
    learn(model, config.steps, callbacks)

    averaged = discriminator.averaged
    with sampling_seed(action_seed):
        episodes = play_episodes(model.policy, world, config.normaliser_episodes, start_seed)
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
    total = np.zeros(len(states))
    with torch.no_grad():
        for step in range(states.shape[1] - 1):
            now, after = (network.encode(states[:, step + i].copy()) for i in (0, 1))
            total += network.of_encoded(now, after).cpu().numpy()
    return total


class _Sample(NamedTuple):
    """Transitions."""

    states: Rows
    """Encoded."""
    next_states: Rows
    """As many, encoded."""
    log_probabilities: torch.Tensor
    """Of the actions, shape (n,)."""


class Discriminator(BaseCallback):
    """Trains the reward network after every rollout to tell demonstrations from the policy (eq. 3.10).

    Parameters
    ----------
    venv
        The environments that PPO acts in.
    component
        The reward f in those environments; its network's weights change in place.
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
    accuracies : dict of str to float
        ``fake_accuracy`` and ``real_accuracy`` in the last updates.
    """

    def __init__(
        self,
        venv: EngineVecEnv,
        component: LearnedReward,
        demonstrations: Demonstrations,
        config: AIRLConfig,
        seed: int,
    ) -> None:
        super().__init__()
        self._venv = venv
        self._encoded = component.encoded
        self._network = component.network
        self.averaged = copy.deepcopy(self._network)
        self.accuracies: dict[str, float] = {}
        self._config = config
        self._rng = np.random.default_rng(seed)
        self._optimiser = EagerAdamW(
            self._network.parameters(),
            lr=config.discriminator_learning_rate,
            weight_decay=config.discriminator_weight_decay,
            fused=True,
        )
        self._demonstrations = demonstrations
        self._rollout: list[tuple[Rows, Rows]] = []
        self._updates = 0

    def _on_step(self) -> bool:
        step = self._venv.transitions
        assert step is not None
        # The reward of this step has had them encoded.
        self._rollout.append((self._encoded(step.observations), self._encoded(step.next_observations)))
        return True

    def _on_rollout_end(self) -> None:
        assert isinstance(self.model, PPO)
        config = self._config
        remaining = max(1 - self.num_timesteps / config.steps, 0.02)
        for group in self._optimiser.param_groups:
            group["lr"] = config.discriminator_learning_rate * remaining
        updates, batch = config.discriminator_updates, config.discriminator_batch
        policy, demonstrations = (
            self._sample_policy(updates * batch),
            self._sample_demonstrations(updates * batch),
        )
        self._rollout = []
        accuracies = [
            self._update(
                concatenate([policy.states[part], demonstrations.states[part]]),
                concatenate([policy.next_states[part], demonstrations.next_states[part]]),
                torch.cat([policy.log_probabilities[part], demonstrations.log_probabilities[part]]),
            )
            for part in (slice(start, start + batch) for start in range(0, updates * batch, batch))
        ]
        fake, real = np.mean(accuracies, axis=0)
        self.accuracies = {"fake_accuracy": float(fake), "real_accuracy": float(real)}
        for name, accuracy in self.accuracies.items():
            self.logger.record(f"airl/{name}", accuracy)

    def _update(
        self, states: Rows, next_states: Rows, log_probabilities: torch.Tensor
    ) -> tuple[float, float]:
        """Take one gradient step on a batch: first half the policy's transitions, second half demonstrated.

        Returns the accuracies on the two halves.
        """
        # D = exp(f) / (exp(f) + pi), so its logit is f - log pi.
        logits = self._network.of_encoded(states, next_states) - log_probabilities
        half = len(logits) // 2
        labels = torch.zeros_like(logits)
        labels[half:] = 1
        loss = functional.binary_cross_entropy_with_logits(logits, labels)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        # The average is short at first, so that it forgets the random initialisation.
        self._updates += 1
        memory = min(self._config.averaging, self._updates / (self._updates + 10))
        with torch.no_grad():
            for mean, current in zip(self.averaged.parameters(), self._network.parameters(), strict=True):
                mean.lerp_(current, 1 - memory)
            correct = (logits > 0) == (labels > 0)
        return float(correct[:half].float().mean()), float(correct[half:].float().mean())

    def _sample_policy(self, count: int) -> _Sample:
        """Draw states, next states and log-probabilities of actions from the last rollout."""
        assert isinstance(self.model, PPO)
        states, next_states = (concatenate(part) for part in zip(*self._rollout, strict=True))
        # They are the current policy's: it has not been updated since.
        log_probabilities = self.model.rollout_buffer.log_probs.ravel()
        taken = self._rng.integers(len(log_probabilities), size=count)
        chosen = torch.from_numpy(log_probabilities[taken]).to(self.model.device)
        return _Sample(states[taken], next_states[taken], chosen)

    def _sample_demonstrations(self, count: int) -> _Sample:
        """Draw the same from the demonstrations; the log-probabilities are the current policy's."""
        assert isinstance(self.model, PPO)
        demonstrations, device = self._demonstrations, self.model.device
        episodes = self._rng.integers(demonstrations.num_episodes, size=count)
        steps = self._rng.integers(demonstrations.actions.shape[1], size=count)
        states = demonstrations.states[episodes, steps]
        actions = torch.from_numpy(demonstrations.actions[episodes, steps].astype(np.int64)).to(device)
        with torch.no_grad():
            _, log_probabilities, _ = self.model.policy.evaluate_actions(
                torch.from_numpy(states).to(device), actions
            )
        encode = self._encoded.encode
        return _Sample(encode(states), encode(demonstrations.states[episodes, steps + 1]), log_probabilities)


class _Record(BaseCallback):
    """Writes a line after every rollout, when monitor and discriminator have done theirs."""

    def __init__(self, path: Path, monitor: ObjectiveMonitor, discriminator: Discriminator) -> None:
        super().__init__()
        self._path = path
        self._monitor = monitor
        self._discriminator = discriminator

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        line = {"env_steps": self.num_timesteps, "objectives": self._monitor.means}
        append_line(self._path, {**line, **self._discriminator.accuracies})
