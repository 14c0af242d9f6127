"""Who answers the queries of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from moral_algorithms.preferences import (
    LexicographicTeacher,
    NoisyTeacher,
    RatioTeacher,
    TargetTeacher,
    Teacher,
)


@dataclass(frozen=True)
class TeacherConfig:
    """Who answers the queries: a simulated teacher that looks at the objectives."""

    teacher: str = "lexicographic"
    """lexicographic (more of the first objective, on a tie of the next), ratio or target (closer to it)."""
    order: tuple[str, ...] = ("people_saved", "goal_time")
    """Objectives of the lexicographic teacher, the most important first."""
    ratio: dict[str, float] = field(default_factory=dict)
    """Share of each objective for the ratio teacher, such as people_saved 1 goal_time 9."""
    target: dict[str, float] = field(default_factory=dict)
    """Count of each objective for the target teacher, such as people_saved 6 goal_time 40."""
    noise: float = 0.0
    """Probability of a random answer."""

    def build(self, objective_names: tuple[str, ...], rng: np.random.Generator) -> Teacher:
        """Make the teacher.

        Raises
        ------
        ValueError
            If there is no such teacher, an objective is unknown, or a ratio or a target is given to another
            teacher.
        """
        teachers: dict[str, Callable[[], Teacher]] = {
            "lexicographic": lambda: LexicographicTeacher(self.order, objective_names),
            "ratio": lambda: RatioTeacher(self.ratio, objective_names),
            "target": lambda: TargetTeacher(self.target, objective_names),
        }
        if self.teacher not in teachers:
            raise ValueError(f"teacher is {self.teacher!r}; it must be one of {', '.join(teachers)}")
        for name, given in (("ratio", self.ratio), ("target", self.target)):
            if given and name != self.teacher:
                raise ValueError(f"{name} is {given}, but teacher is {self.teacher!r}; it must be {name!r}")
        return NoisyTeacher(teachers[self.teacher](), self.noise, rng)
