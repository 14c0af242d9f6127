"""Emergency as `imitation`'s algorithms train on it: flat egocentric features and one number as the reward.

`imitation` knows scalar rewards alone. The one here is the lexicographic teacher's: a person saved counts 1
and a step at the extinguisher 1/128, which no 75 of them make up for; both are exact in binary, so that equal
fragments tie. AIRL never sees it; the preference comparisons' teacher does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from tempfile import TemporaryDirectory
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from benchmarks.strangers.egocentric import Egocentric
from benchmarks.strangers.training import HORIZON, emergency_outcome

GOAL_STEP = 1 / 128
"""What a step at the extinguisher counts, where a person saved counts 1: ``HORIZON`` of them count less."""

assert HORIZON * GOAL_STEP < 1

EPISODES_OF_A_POINT = 50

PACKAGES = ("imitation", "stable-baselines3", "torch")

WORKAROUNDS = [
    "imitation 1.0.1 declares gymnasium~=0.29 and stable-baselines3~=2.2.1, and moral-envs needs gymnasium "
    "1.1 or newer: imitation is installed without its dependencies, beside current versions of both, with "
    "which AIRL and the preference comparisons run unchanged.",
    "Importing AIRL imports tensorboard, rich and tqdm, of which nothing is needed here: they have to be "
    "installed.",
    "Its algorithms know scalar rewards alone, and SB3's Monitor fails on vectors: a wrapper of this script "
    "turns the counters of the ground truth into one number.",
    "Discriminator and generator begin from PyTorch's global random state: stable_baselines3's "
    "set_random_seed is needed besides the seed argument of PPO.",
]


@dataclass(frozen=True)
class LearnerConfig:
    """What both algorithms have in common: the policy's learner, Stable-Baselines3's PPO.

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
    n_steps, batch_size, n_epochs, learning_rate, gamma, ent_coef, vf_coef
        As in SB3's PPO.
    net_arch
        Hidden layers of the policy and, apart from it, of the value function.
    """

    steps: int
    weights: tuple[float, float]
    num_envs: int = 64
    starts: int = 200
    first_start: int = 10_000
    radius: int = 5
    n_steps: int = 75
    batch_size: int = 1200
    n_epochs: int = 4
    learning_rate: float = 1e-3
    gamma: float = 0.97
    ent_coef: float = 0.05
    vf_coef: float = 0.5
    net_arch: tuple[int, ...] = (256, 256)


@dataclass
class Progress:
    """What training has done so far, and the curve of it."""

    env_steps: int = 0
    """Environment steps, those of every environment."""
    final_objectives: list[NDArray[np.int64]] = field(default_factory=list)
    """Counters at the end of each finished episode."""
    started: float = 0.0
    """When training began, in processor seconds."""
    curve: dict[str, list[float]] = field(default_factory=dict)
    """Environment steps, processor seconds and the mean counters of the latest episodes."""

    def begin(self) -> None:
        """Training begins: forget what checking and wrapping the environments has done."""
        self.env_steps = 0
        self.final_objectives.clear()
        self.started = time.process_time()

    def seconds(self) -> float:
        """Processor seconds since training began."""
        return round(time.process_time() - self.started, 2)

    def note(self, *_: Any) -> None:
        """Add a point to the curve; the arguments are those of `imitation`'s callbacks."""
        if not self.final_objectives:
            return
        goal_time, people_saved = np.mean(self.final_objectives[-EPISODES_OF_A_POINT:], axis=0).tolist()
        point = {
            "env_steps": self.env_steps,
            "processor_seconds": self.seconds(),
            "goal_time": round(goal_time, 3),
            "people_saved": round(people_saved, 3),
        }
        for name, value in point.items():
            self.curve.setdefault(name, []).append(value)


class LexicographicReward(gymnasium.Wrapper[Any, int, Any, int]):
    """The scalar that orders episodes and fragments as the teacher does, and a record of what happened."""

    def __init__(self, env: gymnasium.Env[Any, int], progress: Progress) -> None:
        super().__init__(env)
        self.progress = progress
        self.before = np.zeros(2, dtype=np.int64)

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self.before = np.zeros(2, dtype=np.int64)
        return super().reset(**settings)

    def step(self, action: int) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Pay for what the counters of the ground truth have gained."""
        observation, _, terminated, truncated, info = self.env.step(action)
        goal_time, people_saved = info["objectives"] - self.before
        self.before = info["objectives"]
        self.progress.env_steps += 1
        if terminated or truncated:
            self.progress.final_objectives.append(self.before)
        # The trajectories that `imitation` keeps would hold a copy for every step.
        del info["objectives"]
        return observation, float(people_saved + GOAL_STEP * goal_time), terminated, truncated, info


def make_env(radius: int, progress: Progress) -> gymnasium.Env[Any, int]:
    """Make one environment for training."""
    return Egocentric(LexicographicReward(gymnasium.make("moral/Emergency-v0"), progress), radius)


def make_envs(config: LearnerConfig, progress: Progress, seed: int) -> Any:
    """Make all environments for training, as SB3's ``DummyVecEnv``; seeds PyTorch, too."""
    import torch
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.utils import set_random_seed

    torch.set_num_threads(1)
    set_random_seed(seed)
    return make_vec_env(lambda: make_env(config.radius, progress), n_envs=config.num_envs, seed=seed)


def make_ppo(envs: Any, config: LearnerConfig, seed: int) -> Any:
    """Make the learner of the policy."""
    import torch
    from stable_baselines3 import PPO

    return PPO(
        "MlpPolicy",
        envs,
        learning_rate=config.learning_rate,
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.gamma,
        ent_coef=config.ent_coef,
        vf_coef=config.vf_coef,
        policy_kwargs={"net_arch": list(config.net_arch), "activation_fn": torch.nn.ReLU},
        seed=seed,
        device="cpu",
    )


@contextmanager
def silent_logger() -> Iterator[Any]:
    """Open a logger of `imitation` that writes nothing that stays."""
    from imitation.util.logger import configure

    with TemporaryDirectory() as folder:
        yield configure(folder, format_strs=[])


def measure(model: Any, progress: Progress, config: LearnerConfig) -> dict[str, Any]:
    """Tell what training took, its curve, and how its policy, sampled from, does on the held-out starts."""
    trained = {"env_steps": progress.env_steps, "processor_seconds": progress.seconds()}
    env = Egocentric(gymnasium.make("moral/Emergency-v0"), config.radius)
    found = emergency_outcome(
        env, lambda observation: int(model.predict(observation, deterministic=False)[0]), config
    )
    return {**found, **trained, "curve": progress.curve}
