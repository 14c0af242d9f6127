"""Playing whole episodes with a policy."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import World


class Policy(Protocol):
    """What an episode is played with; every policy of Stable-Baselines3 is one."""

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Actions (n,) for observations (n, C, H, W)."""
        ...


class RandomPolicy:
    """Chooses every action with the same probability.

    Parameters
    ----------
    num_actions
        Number of actions.
    rng
        Source of randomness.
    """

    def __init__(self, num_actions: int, rng: np.random.Generator) -> None:
        self._num_actions = num_actions
        self._rng = rng

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Actions (n,) for observations (n, C, H, W)."""
        return self._rng.integers(self._num_actions, size=len(observation)), None


class CarelessPolicy:
    """Does at random, now and then, something else than another policy would.

    Parameters
    ----------
    policy
        What it does otherwise.
    share
        Probability of an action at random, all actions alike; 0 to 1.
    num_actions
        Number of actions.
    rng
        Source of randomness.

    Raises
    ------
    ValueError
        If ``share`` is no probability.
    """

    def __init__(self, policy: Policy, share: float, num_actions: int, rng: np.random.Generator) -> None:
        if not 0 <= share <= 1:
            raise ValueError(f"share is {share}; it must be 0 to 1")
        self._policy = policy
        self._share = share
        self._num_actions = num_actions
        self._rng = rng

    def predict(
        self, observation: NDArray[np.uint8], *, deterministic: bool = False
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Actions (n,) for observations (n, C, H, W)."""
        meant, _ = self._policy.predict(observation, deterministic=deterministic)
        careless = self._rng.random(len(observation)) < self._share
        return np.where(careless, self._rng.integers(self._num_actions, size=len(observation)), meant), None


class Episodes(NamedTuple):
    """Whole episodes, played side by side."""

    states: NDArray[np.uint8]
    """Shape (n, T + 1, C, H, W), the start and the state after each step."""
    actions: NDArray[np.uint8]
    """Shape (n, T)."""
    returns: NDArray[np.float64]
    """Undiscounted returns of the environment's reward vector, shape (n, k)."""
    objectives: NDArray[np.int64]
    """Ground-truth counters at the end, shape (n, m)."""


def play_episodes(
    policy: Policy, world: World, num_episodes: int, seed: int, deterministic: bool = False
) -> Episodes:
    """Play one episode from each of ``num_episodes`` seeded starts.

    Parameters
    ----------
    policy
        Chooses the actions.
    world
        The rules.
    num_episodes
        Number of episodes n.
    seed
        Entropy of the starts; the same seed gives the same starts to every policy.
    deterministic
        Take the likeliest action instead of sampling. What a policy samples does not depend on ``seed``.

    Raises
    ------
    ValueError
        If ``num_episodes`` is below 1, the policy chooses what is no action, or episodes of this world are
        not all equally long.
    """
    if world.ends_early:
        raise ValueError(f"world is {world.name}; its episodes must all take the same number of steps")
    if num_episodes < 1:
        raise ValueError(f"num_episodes is {num_episodes}; it must be at least 1")
    engine = Engine(world, num_episodes)
    engine.seed(spawn_streams(seed, num_episodes))
    engine.reset()
    states = np.empty((num_episodes, world.horizon + 1, *engine.observation_shape), dtype=np.uint8)
    actions = np.empty((num_episodes, world.horizon), dtype=np.uint8)
    returns = np.zeros((num_episodes, len(world.reward_names)))
    states[:, 0] = engine.observe()[:, 0]
    for step in range(world.horizon):
        chosen = np.asarray(policy.predict(states[:, step], deterministic=deterministic)[0])
        assert chosen.shape == (num_episodes,), f"actions {chosen.shape} are not ({num_episodes},)"
        returns += engine.step(chosen).rewards[:, 0]
        actions[:, step] = chosen
        states[:, step + 1] = engine.observe()[:, 0]
    return Episodes(states, actions, returns, engine.objectives[:, 0])
