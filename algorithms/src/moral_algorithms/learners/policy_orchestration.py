"""Policy orchestration: a bandit picks, at every step, whose policy acts (Noothigattu et al. 2019).

R. Noothigattu et al., "Teaching AI agents ethical values using reinforcement learning and policy
orchestration", IBM Journal of Research and Development 2019. One policy maximises the environment's reward,
another a reward learned from demonstrations by inverse reinforcement learning. An orchestrator that knows
neither of them from within chooses between them in each state by linear Thompson sampling (Agrawal and Goyal
2013), paid in both rewards: lambda of the environment's and 1 - lambda of the learned one. One sees at every
step which policy acts; but what neither of them would do is never done. With several experts there is one
arm, and one reward, for each.

A bandit does not look ahead, so each reward r is paid as r + gamma V(s') - V(s), where V values the policy
that pursues it: what its arm's choice gains or loses, then and later. V is linear in the context, by least
squares over that policy's transitions (LSTD, Bradtke and Barto 1996).

The authors' arms are tabular or linear in features of Pac-Man. Here they are trained by PPO, the learned
reward is AIRL's, and only the orchestrator is linear: in a bias and five features made by hand, or, to see
what it does without them, in all planes; see :mod:`moral_algorithms.learners.features`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import ActorCriticPolicy

from moral_algorithms.bridge import EngineVecEnv, RewardComponent, ScalarisedRewards, Transitions
from moral_algorithms.bridge.reward_vector import require_weights
from moral_algorithms.evaluation import Policy
from moral_algorithms.learners.features import CONTEXTS, require_emergency
from moral_algorithms.learners.ppo import PPOConfig, learn, make_ppo, sampling_seed, standard_callbacks
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.worlds import WorldSpec
from moral_envs.world import World


@dataclass(frozen=True)
class ArmConfig:
    """How a policy that pursues one reward alone is trained."""

    steps: int = 200_000
    """Environment steps."""
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(entropy_start=0.1, entropy_end=0.02))
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps is {self.steps}; it must be at least 1")


@dataclass(frozen=True)
class OrchestrationConfig:
    """How the orchestrator learns."""

    steps: int = 60_000
    """Environment steps, those for the values included."""
    value_episodes: int = 100
    """Episodes of each arm from which its value is estimated."""
    num_envs: int = 64
    """Environments that run side by side; between two updates all choose by the same sample."""
    context: str = "distances"
    """What the bandit sees: distances (a bias and five features) or planes (a bias and all planes)."""
    gamma: float = 0.97
    """Discount factor of the values."""
    ridge: float = 1.0
    """Precision of the prior over the bandit's parameters, and what keeps the values' equations regular."""
    exploration: float = 0.1
    """Scale v of the spread of the samples."""

    def __post_init__(self) -> None:
        for name in ("steps", "value_episodes", "num_envs"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        if self.context not in CONTEXTS:
            raise ValueError(f"context is {self.context!r}; it must be one of {sorted(CONTEXTS)}")
        if not 0 <= self.gamma < 1:
            raise ValueError(f"gamma is {self.gamma}; it must be at least 0 and below 1")
        if not 0 < self.ridge < math.inf:
            raise ValueError(f"ridge is {self.ridge}; it must be positive and finite")
        if not 0 <= self.exploration < math.inf:
            raise ValueError(f"exploration is {self.exploration}; it must be finite and not negative")


class Arm(NamedTuple):
    """A policy and the reward that it pursues."""

    policy: Policy
    """Acts when the arm is chosen."""
    reward: RewardComponent
    """On a scale that is comparable with that of the other arms' (eq. 5.2)."""


class LinearThompsonSampling:
    """Chooses the arm whose reward, linear in the context, is highest under a sample from the posterior.

    Parameters
    ----------
    num_arms
        Number of arms k.
    num_features
        Length d of a context.
    ridge
        Precision of the prior N(0, I / ridge) over an arm's parameters.
    exploration
        Scale v of the spread: a sample is drawn from N(mean, v^2 B^-1), with B the posterior's precision.
    rng
        Source of randomness.
    """

    def __init__(
        self,
        num_arms: int,
        num_features: int,
        ridge: float,
        exploration: float,
        rng: np.random.Generator,
    ) -> None:
        self._precisions = np.stack([ridge * np.eye(num_features)] * num_arms)
        self._moments = np.zeros((num_arms, num_features))
        self._exploration = exploration
        self._rng = rng

    @property
    def means(self) -> NDArray[np.float64]:
        """Posterior means B^-1 f of the arms' parameters, shape (k, d)."""
        return np.asarray(
            np.linalg.solve(self._precisions, self._moments[..., None])[..., 0], dtype=np.float64
        )

    def choose(self, contexts: NDArray[np.float64]) -> NDArray[np.int64]:
        """Arms (n,) for contexts (n, d), all by one sample."""
        # With B = L L^T, the solution of L^T x = z has the covariance B^-1.
        factors = np.linalg.cholesky(self._precisions).swapaxes(1, 2)
        noise = self._rng.standard_normal(self._moments.shape)[..., None]
        sample = self.means + self._exploration * np.linalg.solve(factors, noise)[..., 0]
        return _best(contexts, sample)

    def update(
        self, contexts: NDArray[np.float64], arms: NDArray[np.int64], rewards: NDArray[np.float64]
    ) -> None:
        """Learn from the rewards (n,) that the chosen arms (n,) brought in contexts (n, d)."""
        for arm in range(len(self._moments)):
            chosen = contexts[arms == arm]
            self._precisions[arm] += chosen.T @ chosen
            self._moments[arm] += chosen.T @ rewards[arms == arm]


class OrchestratedPolicy:
    """Lets the arm act whose mean reward is highest.

    Parameters
    ----------
    world
        Emergency, of any size.
    policies
        The arms' policies.
    means
        Parameters of the arms' rewards, shape (k, d).
    context
        What they are linear in: a name in :data:`~moral_algorithms.learners.features.CONTEXTS`.
    """

    def __init__(
        self, world: World, policies: Sequence[Policy], means: NDArray[np.float64], context: str
    ) -> None:
        self._world = world
        self._policies = tuple(policies)
        self._means = means
        self._context = context

    def arms(self, observation: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Which arm (n,) acts for observations (n, C, H, W)."""
        contexts = CONTEXTS[self._context](self._world, observation)
        return _best(contexts, self._means)

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Actions (n,) for observations (n, C, H, W)."""
        return _act(self._policies, self.arms(observation), observation, deterministic), None


class Orchestration(NamedTuple):
    """What policy orchestration found."""

    policy: OrchestratedPolicy
    """The orchestrated policy, without exploration."""
    env_steps: int
    """Environment steps it took, without those of the arms' own training."""


def train_arm(
    world: WorldSpec, reward: RewardComponent, config: ArmConfig, seed: int, device: str = "cpu"
) -> ActorCriticPolicy:
    """Train the policy of an arm, which pursues one reward alone, learned or primary.

    Parameters
    ----------
    world
        Where it acts.
    reward
        What it pursues.
    config
        How it is trained.
    seed
        Entropy of environments, networks and actions.
    device
        Where networks live.
    """
    built = world.build()
    venv = ScalarisedRewards(EngineVecEnv(built, config.ppo.num_envs, seed=seed), [reward], [1.0])
    model = make_ppo(config.ppo, venv, seed, device)
    learn(model, config.steps, standard_callbacks(config.ppo, config.steps, built.objective_names, None))
    return model.policy


def train_orchestrator(
    world: WorldSpec, arms: Sequence[Arm], weights: ArrayLike, config: OrchestrationConfig, seed: int
) -> Orchestration:
    """Learn which arm should act when.

    Parameters
    ----------
    world
        Emergency, of any size.
    arms
        At least two, whose rewards have different names.
    weights
        What the arms' rewards count for, shape (k,), not negative and not all zero: (lambda, 1 - lambda)
        where the environment's comes first.
    config
        How the orchestrator learns.
    seed
        Entropy of environments, choices and actions.

    Raises
    ------
    ValueError
        If the world is not Emergency, there are fewer than two arms, two share a name, or the weights do not
        fit them.
    """
    built = world.build()
    require_emergency(built)
    names = tuple(arm.reward.name for arm in arms)
    if len(names) < 2 or len(set(names)) < len(names):
        raise ValueError(f"arms pursue {names}; there must be at least two, of different names")
    shares = require_weights(weights, names).astype(np.float64)
    value_seed, env_seed, choice_seed, action_seed = spawn_seeds(seed, 4)
    features = CONTEXTS[config.context]
    with sampling_seed(action_seed):
        values = np.stack(
            [
                _value(built, arm, config, arm_seed)
                for arm, arm_seed in zip(arms, spawn_seeds(value_seed, len(arms)), strict=True)
            ]
        )
        venv = EngineVecEnv(built, config.num_envs, seed=env_seed)
        states = venv.reset()
        contexts = features(built, states)
        rng = np.random.default_rng(choice_seed)
        bandit = LinearThompsonSampling(len(arms), contexts.shape[1], config.ridge, config.exploration, rng)
        spent = len(arms) * config.value_episodes * built.horizon
        updates = max(-(-(config.steps - spent) // config.num_envs), 1)
        for _ in range(updates):
            chosen = bandit.choose(contexts)
            actions = _act([arm.policy for arm in arms], chosen, states, deterministic=False)
            states = np.asarray(venv.step(actions)[0])
            transitions = venv.transitions
            assert transitions is not None
            after = features(built, transitions.next_observations)
            gains = _rewards(arms, transitions) + (config.gamma * after - contexts) @ values.T
            bandit.update(contexts, chosen, gains @ shares)
            contexts = features(built, states)
    policy = OrchestratedPolicy(built, [arm.policy for arm in arms], bandit.means, config.context)
    return Orchestration(policy, spent + updates * config.num_envs)


def _value(world: World, arm: Arm, config: OrchestrationConfig, seed: int) -> NDArray[np.float64]:
    """Parameters (d,) of the value of an arm's policy under its own reward, by least squares (LSTD).

    The horizon only truncates: the last state has a value like any other.
    """
    features = CONTEXTS[config.context]
    venv = EngineVecEnv(world, config.value_episodes, seed=seed)
    states = venv.reset()
    size = features(world, states).shape[1]
    system, moments = config.ridge * np.eye(size), np.zeros(size)
    for _ in range(world.horizon):
        now = features(world, states)
        states = np.asarray(venv.step(arm.policy.predict(states)[0])[0])
        transitions = venv.transitions
        assert transitions is not None
        after = features(world, transitions.next_observations)
        system += now.T @ (now - config.gamma * after)
        moments += now.T @ _rewards([arm], transitions)[:, 0]
    return np.asarray(np.linalg.solve(system, moments), dtype=np.float64)


def _best(contexts: NDArray[np.float64], parameters: NDArray[np.float64]) -> NDArray[np.int64]:
    """Arms (n,) with the highest of the linear rewards of contexts (n, d) under parameters (k, d)."""
    return np.asarray((contexts @ parameters.T).argmax(axis=1), dtype=np.int64)


def _rewards(arms: Sequence[Arm], transitions: Transitions) -> NDArray[np.float64]:
    """Rewards (n, k) of all arms for a batch of transitions."""
    return np.stack([arm.reward(transitions) for arm in arms], axis=1).astype(np.float64)


def _act(
    policies: Sequence[Policy],
    arms: NDArray[np.int64],
    states: NDArray[np.uint8],
    deterministic: bool,
) -> NDArray[np.int64]:
    """Actions (n,), each from the policy of the arm that was chosen for its state."""
    actions = np.empty(len(states), dtype=np.int64)
    for arm, policy in enumerate(policies):
        rows = arms == arm
        if rows.any():
            actions[rows] = policy.predict(states[rows], deterministic=deterministic)[0]
    return actions
