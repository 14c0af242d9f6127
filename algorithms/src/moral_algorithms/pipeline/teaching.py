"""Who answers the queries of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from moral_algorithms.learners.query_queue import People
from moral_algorithms.preferences import (
    LexicographicTeacher,
    NoisyTeacher,
    RatioTeacher,
    TargetTeacher,
    Teacher,
)

PEOPLE = ("web", "terminal")
"""Teachers that are people, by where they answer."""

RECORDED = "recorded"
"""The teacher of a run that learns once more from recorded answers (`moral replay`)."""


@dataclass(frozen=True)
class TeacherConfig:
    """Who answers the queries: a simulated teacher, who looks at the objectives, or a person."""

    teacher: str = "lexicographic"
    """lexicographic (more of the first objective, on a tie of the next), ratio or target (closer to it); for
    moral train and moral live also a person: web (who answers on a page) or terminal."""
    order: tuple[str, ...] = ("people_saved", "goal_time")
    """Objectives of the lexicographic teacher, the most important first; the defaults are the world's."""
    ratio: dict[str, float] = field(default_factory=dict)
    """Share of each objective for the ratio teacher, such as people_saved 1 goal_time 9."""
    target: dict[str, float] = field(default_factory=dict)
    """Count of each objective for the target teacher, such as people_saved 6 goal_time 40."""
    noise: float = 0.0
    """Probability of a random answer of a simulated teacher."""
    repeat_every: int = 0
    """Every so many-th query to a person repeats an earlier one, sides swapped, to measure consistency."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {**asdict(self), "order": list(self.order)}

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> TeacherConfig:
        """Read what :meth:`to_json` wrote; KeyError, TypeError or ValueError if it is something else."""
        names: list[Any] = [value["teacher"], *value["order"]]
        numbers: list[Any] = [value["noise"], *dict(value["ratio"]).values(), *dict(value["target"]).values()]
        if not all(isinstance(name, str) for name in names):
            raise TypeError(f"a teacher's settings have {names} where there must be names")
        if not all(isinstance(number, (int, float)) for number in numbers):
            raise TypeError(f"a teacher's settings have {numbers} where there must be numbers")
        return cls(**{**value, "order": tuple(value["order"])})

    @property
    def asks_people(self) -> bool:
        """Whether the teacher is a person."""
        return self.teacher in PEOPLE

    def require_fitting(self, objective_names: tuple[str, ...]) -> None:
        """Raise a ValueError if there is no such teacher, or what is given does not suit it or the world."""
        if self.asks_people or self.teacher == RECORDED:
            if self.noise:
                raise ValueError(f"noise is {self.noise}; it must be 0 unless the teacher is simulated")
            self._refuse_others_options()
            People(self.repeat_every)
        else:
            self.build(objective_names, np.random.default_rng(0))

    def require_simulated(self, method: str) -> None:
        """Raise a ValueError if the teacher is not simulated, as a method needs."""
        if self.asks_people or self.teacher == RECORDED:
            raise ValueError(f"teacher is {self.teacher!r}; for {method} it must be a simulated one")

    def people(self) -> People:
        """Make the teacher, who is a person."""
        return People(self.repeat_every)

    def build(self, objective_names: tuple[str, ...], rng: np.random.Generator) -> Teacher:
        """Make the teacher, who must be a simulated one.

        Raises
        ------
        ValueError
            If there is no such teacher, an objective is unknown, or an option of another teacher is given.
        """
        teachers: dict[str, Callable[[], Teacher]] = {
            "lexicographic": lambda: LexicographicTeacher(self.order, objective_names),
            "ratio": lambda: RatioTeacher(self.ratio, objective_names),
            "target": lambda: TargetTeacher(self.target, objective_names),
        }
        if self.teacher not in teachers:
            known = ", ".join((*teachers, *PEOPLE))
            raise ValueError(f"teacher is {self.teacher!r}; it must be one of {known}")
        if self.repeat_every:
            raise ValueError(f"repeat_every is {self.repeat_every}; it must be 0 for a simulated teacher")
        if not 0 <= self.noise <= 1:
            raise ValueError(f"noise is {self.noise}; it must be 0 to 1")
        self._refuse_others_options()
        return NoisyTeacher(teachers[self.teacher](), self.noise, rng)

    def _refuse_others_options(self) -> None:
        for name, given in (("ratio", self.ratio), ("target", self.target)):
            if given and name != self.teacher:
                raise ValueError(f"{name} is {given}, but teacher is {self.teacher!r}; it must be {name!r}")
