"""An ensemble of reward networks that is fitted to preferences (Christiano et al. 2017, section 2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from moral_algorithms.learners.checkpoints import load_optimiser_state, optimiser_state
from moral_algorithms.learners.clips import AnsweredClips, Pairs, Recording
from moral_algorithms.networks.optimisers import EagerAdamW
from moral_algorithms.networks.rewards import ACTION_REWARD_ARCHITECTURES, ActionRewardEnsemble
from moral_algorithms.storage import Arrays, arrays_under

_LOSS_MEMORY = 0.98
# States that go through the networks at once where no gradient is kept.
_CHUNK = 8192


@dataclass(frozen=True)
class RewardModelConfig:
    """How the reward is learned from preferences."""

    architecture: str = "fast"
    """Reward networks: fast (egocentric) or paper (thesis B.1.3)."""
    members: int = 3
    """Networks of the ensemble; with one there is no bootstrap and no disagreement."""
    lapse: float = 0.1
    """Probability with which the model takes an answer to be a coin toss."""
    updates: int = 20
    """Gradient steps after each rollout."""
    initial_updates: int = 500
    """Gradient steps after the answers about the untrained policy."""
    batch_size: int = 32
    """Answers per gradient step."""
    learning_rate: float = 1e-3
    """Adam's step size at the start; it falls linearly to a twentieth."""
    weight_decay: float = 0.1
    """Weight decay of Adam."""

    def __post_init__(self) -> None:
        if self.architecture not in ACTION_REWARD_ARCHITECTURES:
            known = sorted(ACTION_REWARD_ARCHITECTURES)
            raise ValueError(f"architecture is {self.architecture!r}; it must be one of {known}")
        for name, minimum in (("members", 1), ("updates", 1), ("initial_updates", 0), ("batch_size", 1)):
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least {minimum}")
        if not 0 <= self.lapse < 1:
            raise ValueError(f"lapse is {self.lapse}; it must be at least 0 and below 1")
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"learning_rate is {self.learning_rate}; it must be positive and finite")
        if not 0 <= self.weight_decay < math.inf:
            raise ValueError(f"weight_decay is {self.weight_decay}; it must be finite and not negative")


def preference_loss(differences: torch.Tensor, targets: torch.Tensor, lapse: float) -> torch.Tensor:
    """Cross-entropy of answers under the Bradley-Terry model with a lapse rate.

    The first clip is preferred with P = (1 - lapse) / (1 + exp(-difference)) + lapse / 2.

    Parameters
    ----------
    differences
        Predicted return of the first minus that of the second clip, shape (..., n).
    targets
        1 where the first was preferred, 0 where the second was, 0.5 for a tie; shape (n,).
    lapse
        Probability of a random answer, at least 0 and below 1.

    Returns
    -------
    Tensor of shape (..., n)
    """

    def log_probability(logits: torch.Tensor) -> torch.Tensor:
        if lapse == 0:
            return functional.logsigmoid(logits)
        return torch.log((1 - lapse) * torch.sigmoid(logits) + lapse / 2)

    return -targets * log_probability(differences) - (1 - targets) * log_probability(-differences)


class RewardModel:
    """The ensemble, the answers it is fitted to and how.

    Each member sees every answer as often as a Poisson variable of mean 1 says, drawn once: a bootstrap
    resample that grows with the data. The answers that it never sees, one in e, tell how well it predicts.

    Parameters
    ----------
    network
        The ensemble; its parameters change in place.
    answers
        Pairs of clips and what the teacher said of them; may grow.
    config
        How it is fitted.
    seed
        Entropy of resamples and batches.

    Attributes
    ----------
    losses : dict of str to float
        Running means: ``training``, and for several members ``held_out``; empty before the first step.
    """

    def __init__(
        self, network: ActionRewardEnsemble, answers: AnsweredClips, config: RewardModelConfig, seed: int
    ) -> None:
        self.network = network
        self.answers = answers
        self._config = config
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self._optimiser = EagerAdamW(
            network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self._multiplicities = np.empty((0, config.members), dtype=np.float32)
        self.losses: dict[str, float] = {}

    def train(self, updates: int, remaining: float = 1.0) -> None:
        """Take gradient steps on the answers there are; without any, do nothing.

        Parameters
        ----------
        updates
            How many.
        remaining
            Part of the training that is left, for the step size.
        """
        if len(self.answers) == 0:
            return
        self._resample()
        for group in self._optimiser.param_groups:
            group["lr"] = self._config.learning_rate * max(remaining, 0.05)
        for _ in range(updates):
            self._update()

    def _resample(self) -> None:
        """Draw how often each member sees the answers that are new."""
        known, members = self._multiplicities.shape
        new = [
            # From seed and number alone, so that a checkpoint need not hold it.
            np.random.default_rng([self._seed, number]).poisson(1.0, members)
            for number in range(known, len(self.answers))
        ]
        if new:
            drawn = np.array(new, dtype=np.float32) if members > 1 else np.ones((len(new), 1), np.float32)
            self._multiplicities = np.concatenate([self._multiplicities, drawn])

    def _update(self) -> None:
        device = self.network.means.device
        # With replacement, so that a step costs the same from the first answer on.
        indices = self._rng.integers(len(self.answers), size=self._config.batch_size)
        states, actions, targets = (torch.from_numpy(part).to(device) for part in self.answers.batch(indices))
        seen = torch.from_numpy(self._multiplicities[indices].T.copy()).to(device)
        rewards = self.network(states.flatten(0, 2), actions.flatten())
        returns = rewards.reshape(len(rewards), *actions.shape).sum(dim=-1)
        differences = returns[..., 0] - returns[..., 1]
        losses = preference_loss(differences, targets, self._config.lapse)
        self._optimiser.zero_grad()
        # The members have no parameter in common: the sum trains each on its own.
        (seen * losses).mean(dim=1).sum().backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        with torch.no_grad():
            self._remember("training", losses, seen)
            self._remember("held_out", losses, (seen == 0).float())

    def _remember(self, name: str, losses: torch.Tensor, weights: torch.Tensor) -> None:
        total = float(weights.sum())
        if total > 0:
            mean = float((losses * weights).sum()) / total
            before = self.losses.get(name, mean)
            self.losses[name] = _LOSS_MEMORY * before + (1 - _LOSS_MEMORY) * mean

    def predict(self, recording: Recording) -> NDArray[np.float64]:
        """Rewards that each member predicts for every step of some episodes, shape (members, episodes, T)."""
        device = self.network.means.device
        states = recording.states.reshape(-1, *recording.states.shape[2:])
        actions = recording.actions.reshape(-1)
        with torch.no_grad():
            parts = [
                self.network(
                    torch.from_numpy(states[start : start + _CHUNK]).to(device),
                    torch.from_numpy(actions[start : start + _CHUNK]).to(device),
                )
                for start in range(0, len(actions), _CHUNK)
            ]
        rewards: NDArray[np.float64] = torch.cat(parts, dim=1).double().cpu().numpy()
        return rewards.reshape(-1, *recording.actions.shape)

    def state_dict(self) -> tuple[Arrays, dict[str, Any]]:
        """Copy all but the answers into arrays and JSON-able values, for an exact continuation."""
        arrays: Arrays = {
            f"network.{name}": tensor.detach().cpu().numpy().copy()
            for name, tensor in self.network.state_dict().items()
        }
        arrays |= {f"optimiser.{name}": value for name, value in optimiser_state(self._optimiser).items()}
        metadata = {
            "losses": dict(self.losses),
            "batches": self._rng.bit_generator.state,
        }
        return arrays, metadata

    def load_state_dict(self, arrays: Arrays, metadata: dict[str, Any]) -> None:
        """Continue from what :meth:`state_dict` returned, with the same answers.

        Raises
        ------
        KeyError, ValueError, RuntimeError
            If the state is of another ensemble.
        """
        network = {
            name: torch.from_numpy(value.copy()) for name, value in arrays_under(arrays, "network.").items()
        }
        self.network.load_state_dict(network)
        load_optimiser_state(self._optimiser, arrays_under(arrays, "optimiser."))
        self.losses = {str(name): float(loss) for name, loss in metadata["losses"].items()}
        self._rng.bit_generator.state = metadata["batches"]


def disagreement(rewards: NDArray[np.float64], pairs: Pairs) -> NDArray[np.float64]:
    """Variance over members of the probability that the first of two clips is preferred.

    Parameters
    ----------
    rewards
        What each member predicts for every step, shape (members, episodes, T).
    pairs
        The n pairs of clips.

    Returns
    -------
    float64 array of shape (n,)
    """
    returns = pairs.sums(rewards)
    # tanh does not overflow.
    probabilities = (1 + np.tanh((returns[..., 0] - returns[..., 1]) / 2)) / 2
    variance: NDArray[np.float64] = probabilities.var(axis=0)
    return variance
