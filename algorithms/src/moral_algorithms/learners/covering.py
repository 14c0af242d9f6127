"""One policy for all scalarisation weights, trained once (Abels et al. 2019).

Every episode is played under weights of its own, which the network is shown, as a universal value function is
shown its goal (Schaul et al. 2015). What it learns approximates the whole convex coverage set: weights that
change later, as those that MORAL infers from preferences do, choose another of its policies at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from moral_algorithms.bridge import EngineVecEnv, PrimaryReward, RewardComponent, ScalarisedRewards
from moral_algorithms.learners.ppo import OnProgress, PPOConfig, learn, make_ppo, standard_callbacks
from moral_algorithms.networks.conditioned import ConditionedPolicy, conditioned_space
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class CoveringConfig:
    """How a policy for all weights is trained."""

    steps: int = 5_000_000
    """Environment steps."""
    span: float = 30.0
    """Each weight is log-uniform over a range of this ratio: which weights balance components depends on
    their scales, and normalised returns fix those only roughly."""
    primary_weight: float = 1.5
    """How much larger primary components' weights are drawn than learned ones'. A learned reward charges for
    all that its expert did not do; what is given pays only under weights that outweigh that."""
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(learning_rate=2e-3, entropy_start=0.03, entropy_end=0.005)
    )
    """Hyperparameters of PPO; the network must be fast."""

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps is {self.steps}; it must be at least 1")
        if not (math.isfinite(self.span) and self.span > 1):
            raise ValueError(f"span is {self.span}; it must be above 1 and finite")
        if not (math.isfinite(self.primary_weight) and self.primary_weight > 0):
            raise ValueError(f"primary_weight is {self.primary_weight}; it must be positive and finite")
        if self.ppo.policy != "fast":
            raise ValueError(f"ppo.policy is {self.ppo.policy!r}; it must be 'fast' to be given weights")


class CoveringPolicy(NamedTuple):
    """What :func:`train_covering` found."""

    policy: ConditionedPolicy
    """The policy; ``policy_at`` makes that for fixed weights."""
    env_steps: int
    """Environment steps it took."""


def draw_weights(
    count: int, scales: NDArray[np.float64], span: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw scalarisation weights, each log-uniform over a range of its own, and make them sum to 1.

    Parameters
    ----------
    count
        How many vectors.
    scales
        The ends of the ranges, shape (d,), positive.
    span
        Ratio of the ends to the beginnings of the ranges.
    rng
        Source of randomness.

    Returns
    -------
    float32 array of shape (count, d)
        Positive, with sums of 1.
    """
    drawn = scales * span ** -rng.random((count, len(scales)))
    weights: NDArray[np.float32] = (drawn / drawn.sum(axis=1, keepdims=True)).astype(np.float32)
    return weights


class ConditionedRewards(VecEnvWrapper):
    """Scalarises every environment with weights of its own and shows them to the policy.

    Observations are float32 vectors: the planes, then the weights. An environment's weights
    stay for an episode; its terminal observation holds those it was played under.

    Parameters
    ----------
    venv
        The environments with their reward vector; its own weights have no effect.
    draw
        Draws weights (k, d) for k new episodes, not negative, with sums of 1.

    Attributes
    ----------
    weights : float32 array of shape (n, d)
        Those of the current episodes; do not change them.
    """

    venv: ScalarisedRewards

    def __init__(self, venv: ScalarisedRewards, draw: Callable[[int], NDArray[np.float32]]) -> None:
        shape = venv.venv.engine.observation_shape
        components = len(venv.components)
        super().__init__(venv, observation_space=conditioned_space(shape, components))
        self._draw = draw
        self.weights = np.full((self.num_envs, components), 1 / components, dtype=np.float32)

    def reset(self) -> NDArray[np.float32]:
        """Start new episodes everywhere, under new weights."""
        self.weights = self._draw(self.num_envs)
        return self._observe(self.venv.reset(), self.weights)

    def step_wait(self) -> VecEnvStepReturn:
        """Take the step; rewards are those of each environment's own weights."""
        observations, _, dones, infos = self.venv.step_wait()
        assert isinstance(observations, np.ndarray)
        rewards = np.einsum("nd,nd->n", self.venv.rewards, self.weights)
        ended = dones.nonzero()[0]
        if ended.size:
            last = np.stack([infos[row]["terminal_observation"] for row in ended])
            for row, observation in zip(ended, self._observe(last, self.weights[ended]), strict=True):
                infos[row]["terminal_observation"] = observation
            # A new array: what somebody has kept of the old weights stays as it is.
            self.weights = self.weights.copy()
            self.weights[ended] = self._draw(ended.size)
        return self._observe(observations, self.weights), rewards, dones, infos

    @staticmethod
    def _observe(planes: NDArray[np.uint8], weights: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.concatenate([planes.reshape(len(planes), -1), weights], axis=1, dtype=np.float32)


def train_covering(
    world: WorldSpec,
    components: Sequence[RewardComponent],
    config: CoveringConfig,
    seed: int,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
) -> CoveringPolicy:
    """Train a policy for all weights of a reward vector by PPO.

    Parameters
    ----------
    world
        Where it acts.
    components
        The reward vector, normalised (eq. 5.2): the return of a policy that pursues one component alone is
        about one for a primary component, and about minus one for a learned one.
    config
        How it is trained.
    seed
        Entropy of environments, weights, networks and actions.
    device
        Where networks live.
    tensorboard
        Folder for TensorBoard's event files.
    on_progress
        Called after every rollout.

    Raises
    ------
    ValueError
        If two components share a name.
    """
    built = world.build()
    ppo_seed, weights_seed = spawn_seeds(seed, 2)
    rng = np.random.default_rng(weights_seed)
    is_primary = [isinstance(component, PrimaryReward) for component in components]
    scales = np.where(is_primary, config.primary_weight, 1.0)
    engine = EngineVecEnv(built, config.ppo.num_envs, seed=ppo_seed)
    vector = ScalarisedRewards(engine, components, np.ones(len(components)))
    venv = ConditionedRewards(vector, lambda count: draw_weights(count, scales, config.span, rng))
    shape = engine.engine.observation_shape
    widest = config.span * float(scales.max() / scales.min())
    network = {"shape": shape, "components": len(components), "span": widest}
    model = make_ppo(config.ppo, venv, ppo_seed, device, tensorboard, ConditionedPolicy, network)
    names = built.objective_names
    learn(model, config.steps, standard_callbacks(config.ppo, config.steps, names, on_progress))
    assert isinstance(model.policy, ConditionedPolicy)
    model.policy.set_training_mode(False)
    return CoveringPolicy(model.policy, model.num_timesteps)
