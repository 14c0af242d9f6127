"""Clips of episodes: what a query shows when it does not show two whole ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.bridge import Replay
from moral_algorithms.evaluation import Policy
from moral_algorithms.preferences import Preference
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import World

Value = TypeVar("Value", bound=np.generic)


class Recording(NamedTuple):
    """Episodes of one agent, all of the same length T, with everything that clips of them are cut from."""

    replays: tuple[Replay, ...]
    """The n episodes themselves."""
    states: NDArray[np.uint8]
    """States in which the agent acted, shape (n, T, C, H, W)."""
    actions: NDArray[np.int64]
    """Shape (n, T)."""
    counters: NDArray[np.int64]
    """Objectives before the first and after each step, shape (n, T + 1, m)."""


def play_again(world: World, replays: Sequence[Replay]) -> Recording:
    """Play episodes once more, side by side.

    Parameters
    ----------
    world
        Where they took place.
    replays
        Episodes of one agent and of the same length; at least one.
    """
    actions = np.stack([replay.actions[:, 0] for replay in replays]).astype(np.int64)
    engine = Engine(world, len(replays))
    engine.seed(np.array([replay.stream for replay in replays], dtype=np.uint64))
    engine.reset()
    count, length = actions.shape
    states = np.empty((count, length, *engine.observation_shape), dtype=np.uint8)
    counters = np.empty((count, length + 1, len(world.objective_names)), dtype=np.int64)
    counters[:, 0] = engine.objectives[:, 0]
    for step in range(length):
        states[:, step] = engine.observe()[:, 0]
        engine.step(actions[:, step, None])
        counters[:, step + 1] = engine.objectives[:, 0]
    return Recording(tuple(replays), states, actions, counters)


def play_untrained(policy: Policy, world: World, count: int, seed: int) -> list[Replay]:
    """Play ``count`` episodes with a policy, from starts drawn from ``seed``."""
    engine = Engine(world, count)
    streams = spawn_streams(seed, count)
    engine.seed(streams)
    engine.reset()
    actions = np.empty((world.horizon, count), dtype=np.uint8)
    for step in range(world.horizon):
        actions[step], _ = policy.predict(engine.observe()[:, 0], deterministic=False)
        engine.step(actions[step].astype(np.int64)[:, None])
    return [Replay(int(stream), actions[:, row, None].copy()) for row, stream in enumerate(streams)]


class Pairs(NamedTuple):
    """Pairs of equally long clips of recorded episodes."""

    episodes: NDArray[np.int64]
    """Which episodes, shape (n, 2)."""
    starts: NDArray[np.int64]
    """Their first steps, shape (n, 2)."""
    length: int
    """Steps of a clip."""

    def sums(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum values of every step over the clips.

        Parameters
        ----------
        values
            Shape (..., episodes, T).

        Returns
        -------
        float64 array of shape (..., n, 2)
        """
        totals = np.concatenate([np.zeros_like(values[..., :1]), values.cumsum(axis=-1)], axis=-1)
        sums: NDArray[np.float64] = (
            totals[..., self.episodes, self.starts + self.length] - totals[..., self.episodes, self.starts]
        )
        return sums

    def cut(self, index: int, values: NDArray[Value]) -> NDArray[Value]:
        """Cut the two clips of one pair out of (episodes, T, ...) values: shape (2, length, ...)."""
        first, second = (
            values[episode, start : start + self.length]
            for episode, start in zip(self.episodes[index], self.starts[index], strict=True)
        )
        return np.stack([first, second])

    def objectives(self, index: int, counters: NDArray[np.int64]) -> NDArray[np.int64]:
        """Count the objectives within the two clips of one pair, shape (2, m)."""
        episodes, starts = self.episodes[index], self.starts[index]
        counted: NDArray[np.int64] = counters[episodes, starts + self.length] - counters[episodes, starts]
        return counted


def draw_pairs(
    rng: np.random.Generator, recording: Recording, length: int, count: int, recent: int | None = None
) -> Pairs:
    """Draw pairs of clips of two different episodes, no pair twice, whichever comes first, in random order.

    Parameters
    ----------
    rng
        Source of randomness.
    recording
        The episodes, at least two.
    length
        Steps of a clip; at most those of an episode.
    count
        How many pairs, at most.
    recent
        One clip of each pair is of the first so many episodes; None stands for all.
    """
    num_episodes, horizon = recording.actions.shape
    first = rng.integers(recent or num_episodes, size=count)
    second = (first + rng.integers(1, num_episodes, size=count)) % num_episodes
    starts = rng.integers(horizon - length + 1, size=(count, 2))
    episodes = rng.permuted(np.stack([first, second], axis=1), axis=1)
    # The same two clips are the same pair with their sides swapped.
    ascending = np.argsort(episodes, axis=1)
    sides = [np.take_along_axis(values, ascending, axis=1) for values in (episodes, starts)]
    _, kept = np.unique(np.concatenate(sides, axis=1), axis=0, return_index=True)
    kept.sort()
    return Pairs(episodes[kept], starts[kept], length)


_TARGETS = {Preference.FIRST: 1.0, Preference.SECOND: 0.0, Preference.EQUAL: 0.5}


class AnsweredClips:
    """All pairs of clips that a teacher has compared, eight cells in a byte.

    They take ``capacity * 2 * length * ceil(C * H * W / 8)`` bytes for the states: 1.6 MB for 1,000 pairs of
    25 steps in Emergency, 48 MB for 5,000 of them in Delivery.

    Parameters
    ----------
    shape
        Shape (C, H, W) of a state.
    length
        Steps of a clip.
    capacity
        Most pairs that it ever holds.
    """

    def __init__(self, shape: tuple[int, int, int], length: int, capacity: int) -> None:
        self._shape = shape
        self._cells = int(np.prod(shape))
        self._planes = np.zeros((capacity, 2, length, -(-self._cells // 8)), dtype=np.uint8)
        self._actions = np.zeros((capacity, 2, length), dtype=np.uint8)
        self._targets = np.zeros(capacity, dtype=np.float32)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, states: NDArray[np.uint8], actions: NDArray[np.int64], preference: Preference) -> None:
        """Keep an answer.

        Parameters
        ----------
        states
            0/1 planes of the two clips, shape (2, length, C, H, W).
        actions
            Shape (2, length).
        preference
            The answer; a skipped query is none.
        """
        assert states.shape == (*self._actions.shape[1:], *self._shape), f"{states.shape} are no two clips"
        assert actions.shape == self._actions.shape[1:], f"{actions.shape} are no two clips' actions"
        self._planes[self._count] = np.packbits(states.reshape(*actions.shape, -1), axis=-1)
        self._actions[self._count] = actions
        self._targets[self._count] = _TARGETS[preference]
        self._count += 1

    def batch(
        self, indices: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.float32]]:
        """Take some of the pairs.

        Returns
        -------
        states : uint8 array of shape (n, 2, length, C, H, W)
        actions : int64 array of shape (n, 2, length)
        targets : float32 array of shape (n,)
            1 where the first was preferred, 0 where the second was, 0.5 for a tie.
        """
        assert (indices < self._count).all()
        planes = np.unpackbits(self._planes[indices], axis=-1, count=self._cells)
        states = planes.reshape(*planes.shape[:-1], *self._shape)
        return states, self._actions[indices].astype(np.int64), self._targets[indices]
