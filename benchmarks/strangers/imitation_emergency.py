"""Emergency as `imitation`'s algorithms train on it: flat egocentric features and one number as the reward.

`imitation` knows scalar rewards alone. The one here is the lexicographic teacher's: a person saved counts 1
and a step at the extinguisher 1/128, which no 75 of them make up for; both are exact in binary, so that equal
fragments tie. AIRL never sees it; the preference comparisons' teacher does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain, pairwise
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn
from torch import nn

from benchmarks.strangers.egocentric import Egocentric, batch_crop, cropped_space
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
    "Its algorithms know scalar rewards alone: an SB3 VecEnv of this script turns the counters of the ground "
    "truth into one number.",
    "Its ways to normalise rewards divide by their own spread: SB3's VecNormalize is put above its reward "
    "wrapper, with the learner's set_env.",
    "It calls learn once a round, which is a whole training to SB3's schedules: step sizes are set in its "
    "callback.",
    "Its shaped reward drops the potential of the next state where an episode is cut off, as if it ended "
    "there: a subclass keeps it.",
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
        Environments side by side.
    starts, first_start
        Held-out starts on which the policies are measured, and the seed of the first of them.
    radius
        Cells that the egocentric crop shows in each direction.
    n_steps, batch_size, n_epochs, learning_rate, gamma, gae_lambda, ent_coef
        As in SB3's PPO; the step size falls linearly to a twentieth.
    hidden
        Layers that actor and critic share.
    """

    steps: int
    weights: tuple[float, float]
    num_envs: int = 256
    starts: int = 200
    first_start: int = 10_000
    radius: int = 5
    n_steps: int = 25
    batch_size: int = 1600
    n_epochs: int = 4
    learning_rate: float = 1e-3
    gamma: float = 0.97
    gae_lambda: float = 0.95
    ent_coef: float = 0.1
    hidden: tuple[int, ...] = (256, 256)


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


class EmergencyVecEnv(VecEnv):
    """Emergency's vector interface as SB3's ``VecEnv``, with crops and with the scalar that orders episodes.

    A horizon is a truncation here as there: ``infos`` say so in ``TimeLimit.truncated``, and what an episode
    showed last is its ``terminal_observation``, so that PPO bootstraps.

    Parameters
    ----------
    num_envs
        Environments side by side.
    radius
        Cells that the egocentric crop shows in each direction.
    progress
        Told what happens.
    """

    def __init__(self, num_envs: int, radius: int, progress: Progress) -> None:
        self._envs: Any = gymnasium.make_vec(
            "moral/Emergency-v0", num_envs=num_envs, autoreset_mode="SameStep"
        )
        self._radius = radius
        self._progress = progress
        self._before = np.zeros((num_envs, 2), dtype=np.int64)
        self._actions = np.zeros(num_envs, dtype=np.int64)
        planes = self._envs.single_observation_space
        size = cropped_space(planes, radius).shape
        super().__init__(num_envs, Box(0, 1, size, np.uint8), self._envs.single_action_space)

    def reset(self) -> NDArray[np.uint8]:
        """Begin new episodes everywhere; the first ones with the seeds that :meth:`seed` was given."""
        observations, _ = self._envs.reset(seed=self._seeds)
        self._reset_seeds()
        self._before[:] = 0
        return batch_crop(observations, self._radius)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take note of the actions."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take a step everywhere and pay for what the counters of the ground truth have gained."""
        observations, _, terminated, truncated, found = self._envs.step(self._actions)
        ended: NDArray[np.bool_] = terminated | truncated
        counters = found["objectives"]
        # Every step has infos of its own: `imitation` writes into them.
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        after = counters
        if ended.any():
            after = np.where(ended[:, None], found["final_info"]["objectives"], counters)
            for env in ended.nonzero()[0]:
                infos[env] = {
                    "terminal_observation": batch_crop(found["final_obs"][env][None], self._radius)[0],
                    "TimeLimit.truncated": bool(truncated[env] and not terminated[env]),
                }
                self._progress.final_objectives.append(after[env])
        gained = after - self._before
        self._before = np.where(ended[:, None], 0, counters)
        self._progress.env_steps += self.num_envs
        rewards = (gained[:, 1] + GOAL_STEP * gained[:, 0]).astype(np.float32)
        return batch_crop(observations, self._radius), rewards, ended, infos

    def close(self) -> None:
        """Release nothing: there is nothing to release."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Know no attribute of a single environment but that nothing is drawn."""
        if attr_name != "render_mode":
            raise AttributeError(attr_name)
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: there are no single environments."""
        raise AttributeError(attr_name)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: there are no single environments."""
        raise AttributeError(method_name)

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Tell that nothing is wrapped."""
        return [False] * self.num_envs


class SharedLayers(BaseFeaturesExtractor):
    """Layers that actor and critic share, each followed by a ReLU, as in this project's policy."""

    def __init__(self, observation_space: Box, hidden: tuple[int, ...]) -> None:
        super().__init__(observation_space, hidden[-1])
        sizes = (*observation_space.shape, *hidden)
        layers = [[nn.Linear(inputs, outputs), nn.ReLU()] for inputs, outputs in pairwise(sizes)]
        self.layers = nn.Sequential(*chain.from_iterable(layers))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (n, hidden[-1]) of crops (n, size)."""
        features: torch.Tensor = self.layers(observations)
        return features


def make_envs(config: LearnerConfig, progress: Progress, seed: int) -> EmergencyVecEnv:
    """Make all environments for training; seeds PyTorch, too."""
    torch.set_num_threads(1)
    torch.distributions.Distribution.set_default_validate_args(False)
    set_random_seed(seed)
    envs = EmergencyVecEnv(config.num_envs, config.radius, progress)
    envs.seed(seed)
    return envs


def make_ppo(envs: VecEnv, config: LearnerConfig, seed: int) -> PPO:
    """Make the learner of the policy."""
    return PPO(
        "MlpPolicy",
        envs,
        learning_rate=config.learning_rate,
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        ent_coef=config.ent_coef,
        policy_kwargs={
            "net_arch": [],
            "features_extractor_class": SharedLayers,
            "features_extractor_kwargs": {"hidden": config.hidden},
            "optimizer_kwargs": {"fused": True},
        },
        seed=seed,
        device="cpu",
    )


def anneal(
    learner: PPO, optimisers: Sequence[torch.optim.Optimizer], config: LearnerConfig, rate: float, done: float
) -> None:
    """Let step sizes fall linearly to a twentieth, those of the policy's learner and of the learned reward.

    SB3's own schedules cannot: `imitation` calls ``learn`` once a round, and each call is a whole training to
    them.

    Parameters
    ----------
    learner
        The policy's learner.
    optimisers
        Those of the learned reward.
    config
        The step size of the policy at the start.
    rate
        That of the reward.
    done
        Part of the training that is over.
    """
    remaining = max(1 - done, 0.05)
    learner.lr_schedule = lambda _: config.learning_rate * remaining
    for optimiser in optimisers:
        for group in optimiser.param_groups:
            group["lr"] = rate * remaining


def scale_by_returns(learner: PPO, envs: VecEnv) -> None:
    """Have rewards divided by the running spread of their discounted returns.

    Parameters
    ----------
    learner
        Whose environments they become.
    envs
        The environments with the learned reward.
    """
    learner.set_env(VecNormalize(envs, norm_obs=False, gamma=learner.gamma))


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
