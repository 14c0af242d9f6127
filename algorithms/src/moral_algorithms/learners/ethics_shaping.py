"""Ethics shaping: a tabular learner whose reward is shaped by what people do (Wu and Lin 2018).

Y.-H. Wu and S.-D. Lin, "A low-cost ethics shaping approach for designing reinforcement learning agents", AAAI
2018. The assumption is that most of what people do is ethical, whatever their goals. A human policy P_H is
counted from demonstrations, state by state. A temporal difference learner with the Boltzmann policy P_Q is
paid, beside its primary reward,

    H(s, a) = -c_n KL(P_Q || P_H)   where people hardly do what it does:  P_H(a) < tau_n and P_H(a) < P_Q(a),
              +c_p KL(P_Q || P_H)   where they mostly do:                 P_H(a) > tau_p and P_H(a) > P_Q(a),
              0                     otherwise, and in states in which nobody was seen.

There is no reward to learn, and no query: demonstrations are used as they are. There is also one human
policy, so several experts can only be pooled, and one table, so states must come back: see
:mod:`moral_algorithms.learners.features` for what stands in for Emergency's.

Two choices differ from the authors' program. It takes P_H in proportion to c^n(s,a) (1 - c)^(n(s) - n(s,a));
after thousands of demonstrated steps that is all on one action, also where people are indifferent. Relative
frequencies are the default here, and the likelihood is an option. And it learns by Sarsa, which meets one
successor; the expectation over P_Q is the same target without that noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.bridge import EngineVecEnv, PrimaryReward
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.learners.features import KEYS, StateTable
from moral_algorithms.seeding import spawn_seeds


@dataclass(frozen=True)
class EthicsShapingConfig:
    """How ethics shaping learns."""

    steps: int = 400_000
    """Environment steps."""
    num_envs: int = 64
    """Environments that run side by side."""
    features: str = "nearest"
    """What the table tells apart: nearest (cells of agent and nearest person) or planes (every state)."""
    primary: tuple[str, ...] = ("extinguish",)
    """Components of the world's reward vector that the agent is given; there may be none."""
    penalty: float = 3.0
    """c_n, for doing what people hardly do."""
    bonus: float = 3.0
    """c_p, for doing what people mostly do."""
    rare: float = 0.04
    """tau_n, the probability below which people hardly do something."""
    common: float = 0.25
    """tau_p, the probability above which they mostly do it."""
    consistency: float = 0.0
    """c of the human policy's likelihood, above 0.5 and below 1; 0 takes relative frequencies."""
    pseudo_counts: float = 0.1
    """What is added to the count of every action before it is divided."""
    gamma: float = 0.97
    """Discount factor."""
    learning_rate: float = 0.1
    """Part of a temporal difference by which a value moves."""
    temperature_start: float = 0.3
    """Temperature of the Boltzmann policy at the start."""
    temperature_end: float = 0.02
    """Temperature at the end; it changes geometrically."""

    def __post_init__(self) -> None:
        if self.features not in KEYS:
            raise ValueError(f"features is {self.features!r}; it must be one of {sorted(KEYS)}")
        for name in ("steps", "num_envs"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        for name in ("penalty", "bonus"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be finite and not negative")
        for name in ("rare", "common"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be 0 to 1")
        if self.consistency != 0 and not 0.5 < self.consistency < 1:
            raise ValueError(f"consistency is {self.consistency}; it must be above 0.5 and below 1, or 0")
        if not 0 <= self.gamma < 1:
            raise ValueError(f"gamma is {self.gamma}; it must be at least 0 and below 1")
        if not 0 < self.learning_rate <= 1:
            raise ValueError(f"learning_rate is {self.learning_rate}; it must be above 0 and at most 1")
        for name in ("pseudo_counts", "temperature_start", "temperature_end"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be positive and finite")


class TabularPolicy:
    """Draws actions from a table of probabilities, and any action in a state that is not in it.

    Parameters
    ----------
    table
        Numbers the states.
    probabilities
        Float64 of shape (states, actions), rows that sum to 1.
    rng
        Source of randomness.
    """

    def __init__(
        self, table: StateTable, probabilities: NDArray[np.float64], rng: np.random.Generator
    ) -> None:
        assert len(probabilities) == len(table), f"{len(probabilities)} rows are not {len(table)} states"
        uniform = np.full((1, probabilities.shape[1]), 1 / probabilities.shape[1])
        self._table = table
        # A state that was never met has row -1.
        self._probabilities = np.concatenate([probabilities, uniform])
        self._rng = rng

    def probabilities(self, observation: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Probabilities (n, actions) for observations (n, C, H, W)."""
        return self._probabilities[self._table.find(observation)]

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Actions (n,) for observations (n, C, H, W)."""
        probabilities = self.probabilities(observation)
        if deterministic:
            return probabilities.argmax(axis=1), None
        return _draw(probabilities, self._rng), None


class ShapedAgent(NamedTuple):
    """What ethics shaping found."""

    policy: TabularPolicy
    """The trained policy, at its last temperature."""
    states: int
    """States in its table."""
    env_steps: int
    """Environment steps it took."""


def human_policy(counts: NDArray[np.float64], config: EthicsShapingConfig) -> NDArray[np.float64]:
    """Estimate what people do from how often they did it.

    Parameters
    ----------
    counts
        n(s, a), shape (states, actions).
    config
        ``consistency`` and ``pseudo_counts``.

    Returns
    -------
    float64 array of shape (states, actions)
        P_H, rows that sum to 1, every entry positive.
    """
    if config.consistency:
        # c^n (1 - c)^(N - n), up to a factor that is the same for all actions.
        odds = config.consistency / (1 - config.consistency)
        likelihood = odds ** (counts - counts.max(axis=1, keepdims=True))
        weights = likelihood + config.pseudo_counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    else:
        weights = counts + config.pseudo_counts
    policy: NDArray[np.float64] = weights / weights.sum(axis=1, keepdims=True)
    return policy


def shaping(
    policy: NDArray[np.float64],
    human: NDArray[np.float64],
    actions: NDArray[np.int64],
    config: EthicsShapingConfig,
) -> NDArray[np.float64]:
    """Compute H(s, a) for a batch of states.

    Parameters
    ----------
    policy
        P_Q, the agent's policy, shape (n, actions).
    human
        P_H, shape (n, actions), positive; that of the agent where nobody was seen, which gives 0.
    actions
        Actions taken, shape (n,).
    config
        Scales and thresholds.

    Returns
    -------
    float64 array of shape (n,)
    """
    chosen = np.arange(len(actions)), actions
    by_agent, by_people = policy[chosen], human[chosen]
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = policy * np.log(policy / human)
    # An action of probability 0 adds 0 log 0 = 0.
    divergence = np.where(policy > 0, terms, 0).sum(axis=1)
    unethical = (by_people < config.rare) & (by_people < by_agent)
    ethical = (by_people > config.common) & (by_people > by_agent)
    return np.select([unethical, ethical], [-config.penalty * divergence, config.bonus * divergence], 0.0)


def train_ethics_shaping(
    demonstrations: Demonstrations, config: EthicsShapingConfig, seed: int
) -> ShapedAgent:
    """Train a tabular agent on its primary reward, shaped by demonstrations.

    Parameters
    ----------
    demonstrations
        What people did, all of it one policy; the counters are not looked at.
    config
        How it learns.
    seed
        Entropy of environments and actions.

    Raises
    ------
    ValueError
        If the demonstrations' world is not Emergency, or has no such primary reward.
    """
    world = demonstrations.world.build()
    env_seed, action_seed, policy_seed = spawn_seeds(seed, 3)
    primary = [PrimaryReward(world.reward_names, name) for name in config.primary]
    table = StateTable(world, config.features)
    rng = np.random.default_rng(action_seed)

    # The people's states are met first, so they have the first rows.
    rows = np.concatenate([table.add(states[:-1]) for states in demonstrations.states])
    counts = np.zeros((len(table), world.num_actions))
    np.add.at(counts, (rows, demonstrations.actions.ravel()), 1)
    human = human_policy(counts, config)

    values = np.zeros((len(table), world.num_actions))
    venv = EngineVecEnv(world, config.num_envs, seed=env_seed)
    states = table.add(venv.reset())
    updates = -(-config.steps // config.num_envs)
    cooling = (config.temperature_end / config.temperature_start) ** (1 / updates)
    temperature = config.temperature_start
    for _ in range(updates):
        values = _grown(values, len(table))
        policy = _boltzmann(values[states], temperature)
        actions = _draw(policy, rng)
        observations = np.asarray(venv.step(actions)[0])
        transitions = venv.transitions
        assert transitions is not None
        # Where an episode ended the successor is its last state, whose value counts: the horizon truncates.
        after = table.add(transitions.next_observations)
        values = _grown(values, len(table))
        seen = states < len(human)
        expected = policy.copy()
        expected[seen] = human[states[seen]]
        rewards = shaping(policy, expected, actions, config)
        for component in primary:
            rewards += component(transitions)
        successors = _boltzmann(values[after], temperature)
        targets = rewards + config.gamma * (successors * values[after]).sum(axis=1)
        _move(values, states, actions, targets, config.learning_rate)
        states = table.add(observations)
        temperature *= cooling
    values = _grown(values, len(table))
    final = _boltzmann(values[: len(table)], config.temperature_end)
    return ShapedAgent(
        TabularPolicy(table, final, np.random.default_rng(policy_seed)),
        len(table),
        updates * config.num_envs,
    )


def _boltzmann(values: NDArray[np.float64], temperature: float) -> NDArray[np.float64]:
    """Probabilities (n, actions) in proportion to exp(values / temperature)."""
    weights = np.exp((values - values.max(axis=1, keepdims=True)) / temperature)
    probabilities: NDArray[np.float64] = weights / weights.sum(axis=1, keepdims=True)
    return probabilities


def _draw(probabilities: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """One action (n,) from each row of probabilities (n, actions)."""
    cumulative = probabilities.cumsum(axis=1)
    # Compared with the sum as it was rounded, so that no draw falls beyond the last action.
    beyond = rng.random((len(cumulative), 1)) * cumulative[:, -1:] >= cumulative
    return np.asarray(beyond.sum(axis=1), dtype=np.int64)


def _grown(values: NDArray[np.float64], states: int) -> NDArray[np.float64]:
    """Room for new states, whose values are 0; twice what is needed, so that it is seldom copied."""
    if len(values) >= states:
        return values
    grown = np.zeros((2 * states, values.shape[1]))
    grown[: len(values)] = values
    return grown


def _move(
    values: NDArray[np.float64],
    states: NDArray[np.int64],
    actions: NDArray[np.int64],
    targets: NDArray[np.float64],
    learning_rate: float,
) -> None:
    """Move values in place towards the mean of their targets, as far as one step for each would go."""
    pairs, inverse, counts = np.unique(
        states * values.shape[1] + actions, return_inverse=True, return_counts=True
    )
    means = np.bincount(inverse, targets) / counts
    flat = values.reshape(-1)
    flat[pairs] += (1 - (1 - learning_rate) ** counts) * (means - flat[pairs])
