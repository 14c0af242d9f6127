"""The expert: PPO on the world's own rewards under given weights, until it stops improving."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.callbacks import BaseCallback

from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.bridge.reward_vector import require_weights
from moral_algorithms.learners.coverage import TrainedPolicy, train_weighted
from moral_algorithms.learners.ppo import OnProgress, PPOConfig
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class ExpertConfig:
    """How an expert is trained."""

    max_steps: int = 300_000
    """Environment steps after which training ends in any case."""
    window: int = 40_000
    """Environment steps over which returns are averaged to see whether they still grow."""
    patience: int = 2
    """Windows without a better mean return after which training ends."""
    tolerance: float = 0.005
    """What counts as better: this fraction of the best mean return."""
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(entropy_start=0.02, entropy_end=0.4))
    """Hyperparameters of PPO. The entropy bonus grows, so that what does not matter is left to chance."""

    def __post_init__(self) -> None:
        for name in ("max_steps", "window", "patience"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        if not self.tolerance >= 0:
            raise ValueError(f"tolerance is {self.tolerance}; it must not be negative")


def train_expert(
    world: WorldSpec,
    weights: ArrayLike,
    config: ExpertConfig,
    seed: int,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
) -> TrainedPolicy:
    """Train an expert; its policy keeps some randomness, as people do.

    Parameters
    ----------
    world
        Where it acts.
    weights
        Weights of the world's own reward vector, shape (k,), not negative.
    config
        How it is trained.
    seed
        Entropy of environments, networks and actions.
    device
        Where networks live.
    tensorboard
        Folder for TensorBoard's event files.
    on_progress
        Called after every rollout.

    Raises
    ------
    ValueError
        If the weights do not fit the world.
    """
    names = world.build().reward_names
    weights = require_weights(weights, names)
    return train_weighted(
        world,
        [PrimaryReward(names, name) for name in names],
        weights,
        config.ppo,
        config.max_steps,
        seed,
        device,
        tensorboard,
        on_progress,
        [StopWhenConverged(weights, config)],
    )


class StopWhenConverged(BaseCallback):
    """Ends training when the mean return has stopped growing.

    Parameters
    ----------
    weights
        Scalarisation weights of the returns, shape (d,).
    config
        Window, patience and tolerance.
    """

    def __init__(self, weights: NDArray[np.float32], config: ExpertConfig) -> None:
        super().__init__()
        self._weights = weights
        self._config = config
        self._returns: list[float] = []
        self._window_end = config.window
        self._best = -np.inf
        self._windows_without = 0

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            ended = [info["returns"] for info in self.locals["infos"] if "returns" in info]
            self._returns += (np.array(ended) @ self._weights).tolist()
        if self.num_timesteps < self._window_end or not self._returns:
            return True
        self._window_end = self.num_timesteps + self._config.window
        mean = float(np.mean(self._returns))
        self._returns = []
        if mean > self._best + self._config.tolerance * abs(self._best) or not np.isfinite(self._best):
            self._best = mean
            self._windows_without = 0
        else:
            self._windows_without += 1
        return self._windows_without < self._config.patience
