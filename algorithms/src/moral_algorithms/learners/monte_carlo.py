"""On-policy Monte Carlo control with tables (thesis, algorithm 1): no networks, no model, whole episodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from moral_algorithms.seeding import spawn_seeds


@dataclass(frozen=True)
class MonteCarloConfig:
    """How the tables are learned."""

    episodes: int = 500
    """Episodes to learn from."""
    decay: float = 0.01
    """The thesis's beta: in episode i the chance of a random action is ``exploration * exp(-decay * i)``."""
    exploration: float = 1.0
    """That chance in the first episode."""
    discount: float = 0.8
    """What the return discounts a reward by for every step that it is away. An undiscounted return adds up
    all of an early episode's wandering, whose spread hides which action is better."""

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; it must be at least 1")
        if not 0 <= self.decay < math.inf:
            raise ValueError(f"decay is {self.decay}; it must be a finite number, 0 or more")
        for name in ("exploration", "discount"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be above 0 and at most 1")


class Control(NamedTuple):
    """What was learned."""

    values: NDArray[np.float64]
    """Mean discounted return after each action in each state, (states, actions); 0 where never tried."""
    greedy: NDArray[np.int64]
    """Action of the greatest value in each state, (states,); 0 where never visited."""
    visited: NDArray[np.bool_]
    """Whether a state was ever visited, (states,)."""
    returns: NDArray[np.float64]
    """Undiscounted return of each episode, exploration included, (episodes,)."""
    env_steps: int
    """Environment steps it took."""


def monte_carlo_control(
    env: gymnasium.Env[Any, int],
    state_of: Callable[[Any], int],
    num_states: int,
    config: MonteCarloConfig,
    seed: int,
) -> Control:
    """Learn action values from every visit of whole episodes, and act greedily in them ever more often.

    A state's policy changes when it is visited: until then its actions are uniformly random, and its
    exploration stays that of its latest visit. Values begin at 0, which is above every return where rewards
    are negative, so that an action untried in a visited state is tried first. An episode that truncates
    counts as if it had ended there.

    Parameters
    ----------
    env
        Discrete actions, and rewards that are numbers or vectors of one component.
    state_of
        Numbers the states: from an observation to 0 ... ``num_states`` - 1.
    num_states
        How many there are.
    config
        How it is learned.
    seed
        Entropy of the environment and of the actions.

    Raises
    ------
    ValueError
        If the actions are not discrete, or the seed is negative.
    """
    if not isinstance(env.action_space, Discrete):
        raise ValueError(f"env has the actions {env.action_space}; they must be Discrete")
    num_actions = int(env.action_space.n)
    env_seed, action_seed = spawn_seeds(seed, 2)
    rng = np.random.default_rng(action_seed)
    values = np.zeros((num_states, num_actions))
    counts = np.zeros((num_states, num_actions), dtype=np.int64)
    greedy = np.zeros(num_states, dtype=np.int64)
    epsilon = np.ones(num_states)
    returns = np.zeros(config.episodes)
    env_steps = 0
    for episode in range(config.episodes):
        trajectory: list[tuple[int, int, float]] = []
        observation, _ = env.reset(seed=env_seed if episode == 0 else None)
        ended = False
        while not ended:
            state = state_of(observation)
            explores = rng.random() < epsilon[state]
            action = int(rng.integers(num_actions) if explores else greedy[state])
            observation, reward, terminated, truncated, _ = env.step(action)
            trajectory.append((state, action, np.asarray(reward).item()))
            ended = terminated or truncated
        now = config.exploration * math.exp(-config.decay * episode)
        to_go = 0.0
        for state, action, pay in reversed(trajectory):
            to_go = config.discount * to_go + pay
            counts[state, action] += 1
            values[state, action] += (to_go - values[state, action]) / counts[state, action]
            greedy[state] = values[state].argmax()
            epsilon[state] = now
        returns[episode] = sum(pay for _, _, pay in trajectory)
        env_steps += len(trajectory)
    return Control(values, greedy, counts.sum(axis=1) > 0, returns, env_steps)
