"""Stable-Baselines3's PPO on Emergency through the plain Gymnasium face and MO-Gymnasium's ``LinearReward``.

    python -m benchmarks.strangers.sb3_linear_reward

What an ordinary user writes: ``gymnasium.make``, ``LinearReward``, an observation wrapper,
``make_vec_env``, ``PPO("MlpPolicy")``. The trained policy is measured on held-out seeded starts beside
random actions and the exact optimum for the same weights. The settings were chosen on seeds from 100 on;
seeds 0 to 2 were run once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from benchmarks.strangers.egocentric import Egocentric
from benchmarks.strangers.training import Stranger, emergency_baselines, emergency_outcome, train_and_report

WORKAROUNDS = [
    "make_vec_env(env_id, wrapper_class=...) puts SB3's Monitor below the wrapper, where rewards are "
    "still vectors, and fails in float(reward): the environment is handed over as a callable that applies "
    "LinearReward itself.",
    "The planes are uint8 but end at 1: taken for images they would be divided by 255, so they are "
    "flattened.",
]
PACKAGES = ("stable-baselines3", "mo-gymnasium", "torch")


@dataclass(frozen=True)
class Config:
    """What is run.

    Parameters
    ----------
    steps
        Environment steps of a run.
    weights
        Scalarisation weights of (extinguish, save).
    num_envs
        Environments in the ``DummyVecEnv``.
    starts, first_start
        Held-out starts on which the policies are measured, and the seed of the first of them.
    radius
        Cells that the egocentric crop shows in each direction.
    n_steps, batch_size, n_epochs, learning_rate, gamma, ent_coef
        As in SB3's PPO.
    """

    steps: int = 300_000
    weights: tuple[float, float] = (0.5, 0.5)
    num_envs: int = 32
    starts: int = 200
    first_start: int = 10_000
    radius: int = 5
    n_steps: int = 50
    batch_size: int = 800
    n_epochs: int = 4
    learning_rate: float = 1e-3
    gamma: float = 0.97
    ent_coef: float = 0.05


def make_env(config: Config) -> gymnasium.Env[Any, int]:
    """Emergency with a scalar reward and flat egocentric observations."""
    from mo_gymnasium.wrappers import LinearReward

    env = LinearReward(gymnasium.make("moral/Emergency-v0"), weight=np.array(config.weights))
    return Egocentric(env, config.radius)


def train(seed: int, config: Config) -> Any:
    """Train one policy."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    torch.set_num_threads(1)
    envs = make_vec_env(lambda: make_env(config), n_envs=config.num_envs, seed=seed)
    model = PPO(
        "MlpPolicy",
        envs,
        learning_rate=config.learning_rate,
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.gamma,
        ent_coef=config.ent_coef,
        seed=seed,
        device="cpu",
    )
    return model.learn(config.steps)


def run(seed: int, config: Config) -> dict[str, Any]:
    """Train and measure one policy."""
    model = train(seed, config)
    return emergency_outcome(
        make_env(config), lambda observation: int(model.predict(observation, deterministic=False)[0]), config
    )


def main(options: Sequence[str] | None = None) -> None:
    """Run all seeds, print the figures and store them."""
    stranger = Stranger("sb3_linear_reward", __doc__, run, emergency_baselines, WORKAROUNDS, PACKAGES)
    train_and_report(stranger, Config(), options)


if __name__ == "__main__":
    main()
