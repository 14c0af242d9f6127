"""Learning once more from answers that were recorded: nobody is asked."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.answers import Answer
from moral_algorithms.bridge import EngineVecEnv, RewardComponent, ScalarisedRewards
from moral_algorithms.learners.asking import Episode
from moral_algorithms.preferences import Posterior
from moral_algorithms.replay import Replay
from moral_envs.world import World


@dataclass(frozen=True, eq=False)
class RecordedAnswers:
    """A teacher whose answers are all given already."""

    answers: tuple[Answer, ...]
    """Answers that say something, in the order in which they are used."""


class RecordedAsker:
    """Adds recorded answers to the posterior at even intervals.

    Parameters
    ----------
    recorded
        The answers.
    returns
        Vector returns of their pairs under the reward vector of this run, shape (n, 2, d).
    posterior
        Takes them.
    span
        Environment steps over which they are spread.
    """

    def __init__(
        self,
        recorded: RecordedAnswers,
        returns: NDArray[np.float64],
        posterior: Posterior,
        span: float,
    ) -> None:
        self._answers = recorded.answers
        self._returns = returns
        self._posterior = posterior
        self._span = span

    def read(self) -> None:
        """Nothing was left by an earlier process."""

    def act(self, env_steps: int, episodes: deque[Episode]) -> bool:
        """Use the answers that are due."""
        before = self._posterior.num_queries
        count = len(self._answers)
        while (used := self._posterior.num_queries) < count and env_steps >= self._span * (used + 1) / count:
            preference = self._answers[used].preference
            assert preference is not None
            self._posterior.add(self._returns[used], preference)
        return self._posterior.num_queries > before

    def state_dict(self) -> dict[str, Any]:
        """Nothing: how many were used is the posterior's to know."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on."""


def vector_returns(
    world: World, components: Sequence[RewardComponent], replays: Sequence[Replay]
) -> NDArray[np.float64]:
    """Play whole episodes of one agent again and add up their reward vectors.

    Parameters
    ----------
    world
        Where they took place.
    components
        The reward vector, of d components.
    replays
        The n episodes.

    Returns
    -------
    float64 array of shape (n, d)

    Raises
    ------
    ValueError
        If an episode is not of this world: of another length, or with actions that it does not have.
    """
    if not replays:
        return np.empty((0, len(components)))
    for replay in replays:
        if replay.actions.shape != (world.horizon, 1):
            raise ValueError(
                f"an episode has {len(replay.actions)} steps; in {world.name} it must have {world.horizon}"
            )
    engine = EngineVecEnv(world, len(replays), seed=0)
    engine.engine.seed(np.array([replay.stream for replay in replays], dtype=np.uint64))
    venv = ScalarisedRewards(engine, components, np.ones(len(components)))
    venv.reset()
    actions = np.stack([replay.actions[:, 0] for replay in replays])
    for step in range(world.horizon):
        _, _, _, infos = venv.step(actions[:, step])
    return np.array([info["returns"] for info in infos], dtype=np.float64)
