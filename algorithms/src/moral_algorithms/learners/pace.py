"""How far a training has come that goes on for as long as a person answers."""

from __future__ import annotations

import json
from typing import Any


class Pace:
    """Progress of a training from 0 to 1, which hurries no person.

    A first share of the progress, ``span``, belongs to the queries. It passes with the environment steps, but
    never gets more than one answer ahead of the answers given: while nobody answers, training goes on where
    it is, with the step size and entropy bonus of that moment. Once all answers are in, or somebody stops,
    the rest passes with the steps.

    Parameters
    ----------
    steps
        Environment steps of the whole if nobody is slow.
    queries
        Answers that are wanted.
    span
        Share of the progress over which they are spread, above 0 and at most 1.
    """

    def __init__(self, steps: int, queries: int, span: float) -> None:
        self.steps = steps
        self.queries = queries
        self.span = span
        self._closed: tuple[int, float] | None = None
        self._answers = 0

    @property
    def closing(self) -> bool:
        """Whether the last answer is in."""
        return self._closed is not None

    def update(self, env_steps: int, answers: int, stop: bool) -> None:
        """Take note of how many answers there are and whether somebody has stopped asking."""
        done = stop or answers >= self.queries
        if done and self._closed is None:
            self._closed = env_steps, self.progress(env_steps)
        elif not done:
            # An answer was taken back.
            self._closed = None
        self._answers = answers

    def due(self, env_steps: int) -> int:
        """How many queries may have been asked by now."""
        return min(self.queries, int(env_steps * self.queries / (self.span * self.steps)))

    def progress(self, env_steps: int) -> float:
        """Progress, 0 to 1."""
        if self._closed is None:
            asked = min(1.0, (self._answers + 1) / max(self.queries, 1))
            return min(self.span * asked, env_steps / self.steps)
        since, before = self._closed
        # Who stops early still gets an agent that was trained for so many steps.
        left = max((1 - self.span) * self.steps, self.steps - since)
        return min(1.0, before + (1 - before) * (env_steps - since) / left) if left > 0 else 1.0

    def state_dict(self) -> dict[str, Any]:
        """State that JSON can hold."""
        return {"closed": json.loads(json.dumps(self._closed)), "answers": self._answers}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken."""
        closed = state["closed"]
        self._closed = None if closed is None else (int(closed[0]), float(closed[1]))
        self._answers = int(state["answers"])
