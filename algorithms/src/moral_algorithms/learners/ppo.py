"""Stable-Baselines3's PPO as every learner here uses it: how it is made, watched, saved and continued."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from moral_algorithms.bridge import ScalarisedRewards
from moral_algorithms.learners.checkpoints import load_optimiser_state, optimiser_state
from moral_algorithms.networks.policies import POLICIES, EncodingPolicy, EncodingRolloutBuffer
from moral_algorithms.storage import Arrays, arrays_under
from moral_envs.world import World


@dataclass(frozen=True)
class PPOConfig:
    """How PPO trains; the defaults were chosen in Emergency and learn Delivery as well."""

    policy: str = "fast"
    """Networks of actor and critic: fast (egocentric) or paper (thesis B.1.1)."""
    num_envs: int = 256
    """Environments that run side by side."""
    rollout_steps: int = 25
    """Steps per environment between updates."""
    batch_size: int = 1600
    """Transitions per gradient step."""
    epochs: int = 4
    """Passes over each rollout."""
    learning_rate: float = 1e-3
    """Adam's step size at the start; it falls linearly to a twentieth."""
    gamma: float = 0.97
    """Discount factor."""
    gae_lambda: float = 0.95
    """Exponential weight of generalised advantage estimation."""
    clip_range: float = 0.2
    """Bound on the change of an action's probability ratio per update."""
    entropy_start: float = 0.1
    """Weight of the entropy bonus at the start."""
    entropy_end: float = 0.1
    """Weight of the entropy bonus at the end; it changes linearly."""

    def __post_init__(self) -> None:
        if self.policy not in POLICIES:
            raise ValueError(f"policy is {self.policy!r}; it must be one of {sorted(POLICIES)}")
        # PPO normalises the advantages of a batch, which takes two.
        for name, minimum in (("num_envs", 1), ("rollout_steps", 2), ("batch_size", 2), ("epochs", 1)):
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least {minimum}")
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be 0 to 1")
        for name in ("learning_rate", "clip_range"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be positive and finite")
        for name in ("entropy_start", "entropy_end"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be finite and not negative")


class Progress(NamedTuple):
    """How far a learner has come."""

    steps: int
    """Environment steps so far."""
    total_steps: int
    """Environment steps at the end, at most."""
    objectives: dict[str, float]
    """Mean ground-truth counters of the last finished episodes, by name."""
    queries: int = 0
    """Queries answered so far."""


OnProgress = Callable[[Progress], None]


def make_ppo(
    config: PPOConfig,
    venv: VecEnv,
    seed: int,
    device: str = "cpu",
    tensorboard: Path | None = None,
    policy: type[ActorCriticPolicy] | None = None,
    policy_arguments: Mapping[str, Any] | None = None,
) -> PPO:
    """PPO on scalarised rewards.

    Rewards are divided by the running spread of returns: otherwise the value loss of learned rewards, which
    are neither small nor centred, starves the policy through gradient clipping.

    Parameters
    ----------
    config
        Hyperparameters.
    venv
        The environments, whose rewards are scalars.
    seed
        Seeds the weights' initialisation and the actions.
    device
        Where networks live: cpu, cuda or auto.
    tensorboard
        Folder for TensorBoard's event files; None writes none.
    policy
        Networks of actor and critic; None takes those that the configuration names.
    policy_arguments
        Further arguments of the policy.
    """
    scaled = VecNormalize(venv, norm_obs=False, gamma=config.gamma)
    policy = policy or POLICIES[config.policy]
    model = PPO(
        policy,
        scaled,
        n_steps=config.rollout_steps,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        learning_rate=lambda remaining: config.learning_rate * max(remaining, 0.05),
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy_start,
        rollout_buffer_class=EncodingRolloutBuffer if issubclass(policy, EncodingPolicy) else RolloutBuffer,
        policy_kwargs={"optimizer_kwargs": {"fused": True}, **(policy_arguments or {})},
        seed=seed,
        device=device,
    )
    if isinstance(model.rollout_buffer, EncodingRolloutBuffer):
        assert isinstance(model.policy, EncodingPolicy)
        model.rollout_buffer.policy = model.policy
    # Without a folder, Stable-Baselines3's `configure` would leave an empty one among the temporary files.
    model.set_logger(
        Logger(None, []) if tensorboard is None else configure(str(tensorboard), ["tensorboard"])
    )
    return model


def least_steps(config: PPOConfig, world: World) -> int:
    """Count the steps of a training in which a rollout follows the first whole episodes.

    What is learned from a comparison of these changes nothing before that.
    """
    rollout = config.num_envs * config.rollout_steps
    return math.ceil(config.num_envs * world.horizon / rollout) * rollout + 1


def standard_callbacks(
    config: PPOConfig, total_steps: int, objective_names: Sequence[str], on_progress: OnProgress | None
) -> list[BaseCallback]:
    """Make what every learner needs: the bootstrap, the entropy schedule and a look at the objectives."""
    return [
        BatchedBootstrap(),
        EntropySchedule(config.entropy_start, config.entropy_end, total_steps),
        ObjectiveMonitor(objective_names, total_steps, on_progress),
    ]


class BatchedBootstrap(BaseCallback):
    """Adds the value of the last state of truncated episodes, for all of them in one forward pass.

    It does what PPO's own loop does one environment at a time, and tells that loop that it is done.
    """

    def _on_step(self) -> bool:
        infos: list[dict[str, Any]] = self.locals["infos"]
        ended = np.flatnonzero(self.locals["dones"])
        rows = np.array([row for row in ended if infos[row]["TimeLimit.truncated"]], dtype=np.int64)
        if rows.size:
            assert isinstance(self.model, PPO)
            last = np.stack([infos[row]["terminal_observation"] for row in rows])
            with torch.no_grad():
                values = self.model.policy.predict_values(obs_as_tensor(last, self.model.device))
            self.locals["rewards"][rows] += self.model.gamma * values.cpu().numpy()[:, 0]
            for row in rows:
                infos[row]["TimeLimit.truncated"] = False
        return True


class EntropySchedule(BaseCallback):
    """Moves the weight of the entropy bonus linearly from ``start`` to ``end`` in ``total_steps`` steps."""

    def __init__(self, start: float, end: float, total_steps: int) -> None:
        super().__init__()
        self._start, self._end, self._total_steps = start, end, total_steps

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        done = min(self.num_timesteps / self._total_steps, 1.0)
        self.model.ent_coef = self._start + done * (self._end - self._start)

    def _on_step(self) -> bool:
        return True


class ObjectiveMonitor(BaseCallback):
    """Logs the mean ground-truth counters of finished episodes; no learner sees them.

    Parameters
    ----------
    names
        The objectives, in the order of the counters.
    total_steps
        Environment steps at the end, for the progress.
    on_progress
        Called after every rollout.

    Attributes
    ----------
    means : dict of str to float
        Mean counters, by name, of the episodes that ended in the last rollout that had some.
    queries : int
        Queries answered so far; who asks them keeps it up to date.
    """

    def __init__(self, names: Sequence[str], total_steps: int, on_progress: OnProgress | None) -> None:
        super().__init__()
        self._names = tuple(names)
        self._total_steps = total_steps
        self._on_progress = on_progress
        self._finished: list[NDArray[np.int64]] = []
        self.means: dict[str, float] = {}
        self.queries = 0

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self._finished += [info["objectives"] for info in self.locals["infos"] if "objectives" in info]
        return True

    def _on_rollout_end(self) -> None:
        if self._finished:
            self.means = dict(zip(self._names, np.mean(self._finished, axis=0).tolist(), strict=True))
            self._finished = []
        for name, mean in self.means.items():
            self.logger.record(f"objectives/{name}", mean)
        if self._on_progress is not None:
            self._on_progress(Progress(self.num_timesteps, self._total_steps, dict(self.means), self.queries))


@contextmanager
def sampling_seed(seed: int) -> Iterator[None]:
    """Draw PyTorch's random numbers from ``seed`` inside, and go on as before afterwards."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


def ppo_state(model: PPO) -> tuple[Arrays, dict[str, Any]]:
    """Copy all that PPO needs to go on exactly, between two rollouts, as arrays and JSON-able values."""
    arrays: Arrays = {f"policy.{name}": _array(tensor) for name, tensor in model.policy.state_dict().items()}
    optimiser = optimiser_state(model.policy.optimizer)
    arrays |= {f"optimiser.{name}": value for name, value in optimiser.items()}
    scaled, scalarised = _environments(model)
    arrays |= {f"venv.{name}": value for name, value in scalarised.state_dict().items()}
    statistics = scaled.ret_rms
    arrays["scale.returns"] = scaled.returns.copy()
    arrays["scale.statistics"] = np.array([statistics.mean, statistics.var, statistics.count])
    assert model._last_episode_starts is not None
    arrays["episode_starts"] = np.asarray(model._last_episode_starts).copy()
    # SB3 samples actions from PyTorch's global generator and shuffles batches with NumPy's.
    arrays["random.torch"] = _array(torch.get_rng_state())
    if model.device.type == "cuda":
        arrays["random.cuda"] = _array(torch.cuda.get_rng_state(model.device))
    name, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002
    arrays["random.numpy"] = np.asarray(keys)
    metadata = {
        "num_timesteps": model.num_timesteps,
        "n_updates": model._n_updates,
        "numpy_random": [name, int(position), int(has_gauss), float(gauss)],
    }
    return arrays, metadata


def load_ppo_state(model: PPO, arrays: Arrays, metadata: dict[str, Any]) -> None:
    """Continue from what :func:`ppo_state` returned, in a model made with the same configuration.

    PyTorch's and NumPy's global generators continue, too: SB3 draws from them.

    Raises
    ------
    KeyError, IndexError, ValueError, RuntimeError
        If the state is of another model.
    """
    policy = {name: torch.from_numpy(value) for name, value in arrays_under(arrays, "policy.").items()}
    model.policy.load_state_dict(policy)
    load_optimiser_state(model.policy.optimizer, arrays_under(arrays, "optimiser."))
    scaled, scalarised = _environments(model)
    model._last_obs = scalarised.load_state_dict(arrays_under(arrays, "venv."))
    scaled.returns = arrays["scale.returns"].copy()
    mean, variance, count = arrays["scale.statistics"]
    scaled.ret_rms.mean, scaled.ret_rms.var, scaled.ret_rms.count = np.array(mean), np.array(variance), count
    model._last_episode_starts = arrays["episode_starts"].copy()
    model.num_timesteps = int(metadata["num_timesteps"])
    model._n_updates = int(metadata["n_updates"])
    torch.set_rng_state(torch.from_numpy(arrays["random.torch"]))
    if model.device.type == "cuda" and "random.cuda" in arrays:
        torch.cuda.set_rng_state(torch.from_numpy(arrays["random.cuda"]), model.device)
    name, position, has_gauss, gauss = metadata["numpy_random"]
    np.random.set_state((name, arrays["random.numpy"], position, has_gauss, gauss))  # noqa: NPY002


def learn(model: PPO, total_steps: int, callbacks: Sequence[BaseCallback]) -> None:
    """Train from where the model stands until ``total_steps`` environment steps are done."""
    if model._last_obs is None:
        model.learn(total_steps, callback=list(callbacks))
    elif model.num_timesteps < total_steps:
        model.learn(total_steps - model.num_timesteps, callback=list(callbacks), reset_num_timesteps=False)


def _environments(model: PPO) -> tuple[VecNormalize, ScalarisedRewards]:
    scaled = model.get_env()
    assert isinstance(scaled, VecNormalize)
    assert isinstance(scaled.venv, ScalarisedRewards)
    return scaled, scaled.venv


def _array(tensor: torch.Tensor) -> NDArray[Any]:
    array: NDArray[Any] = tensor.detach().cpu().numpy().copy()
    return array
