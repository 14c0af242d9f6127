"""Who stops a run, and how one that went on is compared with one that was never stopped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.learners.ppo import Progress
from moral_algorithms.preferences import LexicographicTeacher, NoisyTeacher, Preference, Query, Teacher
from tests.algorithms.tiny import EMERGENCY


class Recorder(Teacher):
    """Passes queries on to a noisy lexicographic teacher and remembers them."""

    def __init__(self, interrupt_at: int | None = None, skip: Sequence[int] = ()) -> None:
        lexicographic = LexicographicTeacher(("people_saved", "goal_time"), EMERGENCY.build().objective_names)
        # Noise, so that the teacher's own state has to be saved and continued, too.
        self._teacher = NoisyTeacher(lexicographic, 0.3, np.random.default_rng(0))
        self._interrupt_at = interrupt_at
        self._skip = skip
        self.asked: list[Query] = []

    def prefer(self, query: Query) -> Preference | None:
        if len(self.asked) == self._interrupt_at:
            raise KeyboardInterrupt
        self.asked.append(query)
        if len(self.asked) - 1 in self._skip:
            return None
        return self._teacher.prefer(query)

    def state_dict(self) -> dict[str, Any]:
        return self._teacher.state_dict()

    def load_state_dict(self, state: Any) -> None:
        self._teacher.load_state_dict(state)


def stop_at(steps: int) -> Callable[[Progress], None]:
    """Interrupt a run after a rollout."""

    def stop(progress: Progress) -> None:
        if progress.steps == steps:
            raise KeyboardInterrupt

    return stop


def require_same(one: dict[str, NDArray[Any]], other: dict[str, NDArray[Any]]) -> None:
    """The same arrays by name, bit by bit."""
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
