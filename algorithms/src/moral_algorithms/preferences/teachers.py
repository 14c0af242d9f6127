"""Teachers answer queries. Simulated ones look at the ground-truth counters of the two episodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .query import Preference, Query

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


class Teacher(Protocol):
    """Who answers a query. A subclass without state of its own need only define `prefer`."""

    def prefer(self, query: Query) -> Preference | None:
        """Answer a query; None skips it, and it then never reaches the posterior."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """State that `load_state_dict` takes to go on exactly, in values that JSON can hold."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on where `state_dict` was taken."""
        if state:
            raise ValueError(f"state has the keys {sorted(state)}; it must be empty for a stateless teacher")


class LexicographicTeacher(Teacher):
    """Prefers the trajectory with more of the first objective; where they tie, with more of the next.

    The thesis's teacher in Emergency (section 4.2) orders by ``("people_saved", "goal_time")``; its malicious
    one (section 5.2) by ``("vases_broken",)``. Trajectories that tie in all named objectives are equal.

    Parameters
    ----------
    order : sequence of str
        Objectives, the most important first; more is better.
    objective_names : sequence of str
        Names of the counters in a query's `objectives`, in the environment's order.

    Raises
    ------
    ValueError
        If `order` is empty, repeats a name or holds one that is not in `objective_names`.
    """

    def __init__(self, order: Sequence[str], objective_names: Sequence[str]) -> None:
        if len(order) == 0 or len(set(order)) != len(order):
            raise ValueError(f"order is {tuple(order)}; it must name at least one objective, and none twice")
        self._columns = _columns("order", order, objective_names)
        self._num_objectives = len(objective_names)

    def prefer(self, query: Query) -> Preference:
        """Compare the named objectives one after the other."""
        first, second = _objectives(query, self._num_objectives)[:, self._columns].tolist()
        if first == second:
            return Preference.EQUAL
        return Preference.FIRST if first > second else Preference.SECOND


class RatioTeacher(Teacher):
    """Prefers the trajectory whose objectives stand closer to a wanted ratio (thesis eq. 5.12).

    Close in the KL divergence of j / |j|_1 from the ratio m, both over the objectives that m names. A
    trajectory that achieved none of them has no ratio. Equation 5.12 read to the letter finds it perfect
    (divergence 0); here it is the worst.

    Parameters
    ----------
    ratio : mapping of str to float
        Wanted share of each objective that counts, positive; (3, 1, 1) and (0.6, 0.2, 0.2) are the same
        ratio.
    objective_names : sequence of str
        Names of the counters in a query's `objectives`, in the environment's order.

    Raises
    ------
    ValueError
        If `ratio` is empty, holds a share that is not positive or a name that is not in `objective_names`.
    """

    def __init__(self, ratio: Mapping[str, float], objective_names: Sequence[str]) -> None:
        shares = np.array(list(ratio.values()), dtype=np.float64)
        if shares.size == 0 or not (np.isfinite(shares).all() and (shares > 0.0).all()):
            raise ValueError(f"ratio is {dict(ratio)}; every share must be positive and finite")
        self._columns = _columns("ratio", tuple(ratio), objective_names)
        self._ratio = shares / shares.sum()
        self._num_objectives = len(objective_names)

    def prefer(self, query: Query) -> Preference:
        """Compare the two divergences."""
        first, second = (
            self._divergence(j) for j in _objectives(query, self._num_objectives)[:, self._columns]
        )
        if first == second:
            return Preference.EQUAL
        return Preference.FIRST if first < second else Preference.SECOND

    def _divergence(self, objectives: NDArray[np.int64]) -> float:
        achieved = objectives > 0
        if not achieved.any():
            return float("inf")
        shares = objectives[achieved] / objectives.sum()
        return float((shares * np.log(shares / self._ratio[achieved])).sum())


class NoisyTeacher(Teacher):
    """Answers at random with some probability, else as another teacher does (thesis section 4.2.1).

    Parameters
    ----------
    teacher : Teacher
        Who answers otherwise.
    probability : float in [0, 1]
        Probability of a random answer, first or second alike; half of those go against the teacher.
    rng : numpy.random.Generator
        Source of randomness. The teacher owns it from here on and saves it with `state_dict`.

    Raises
    ------
    ValueError
        If `probability` is not between 0 and 1.
    """

    def __init__(self, teacher: Teacher, probability: float, rng: np.random.Generator) -> None:
        if not 0.0 <= probability <= 1.0:
            raise ValueError(f"probability is {probability}; it must be between 0 and 1")
        self.teacher = teacher
        self.probability = probability
        self._rng = rng

    def prefer(self, query: Query) -> Preference | None:
        """Answer at random or pass the query on."""
        if self._rng.random() >= self.probability:
            return self.teacher.prefer(query)
        return Preference.FIRST if self._rng.random() < 0.5 else Preference.SECOND

    def state_dict(self) -> dict[str, Any]:
        """State of the generator and of the other teacher."""
        return {"rng": self._rng.bit_generator.state, "teacher": self.teacher.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on where `state_dict` was taken."""
        self._rng.bit_generator.state = state["rng"]
        self.teacher.load_state_dict(state["teacher"])


def _columns(argument: str, wanted: Sequence[str], objective_names: Sequence[str]) -> list[int]:
    unknown = [name for name in wanted if name not in objective_names]
    if unknown:
        raise ValueError(f"{argument} names {unknown}; the objectives are {list(objective_names)}")
    return [list(objective_names).index(name) for name in wanted]


def _objectives(query: Query, num_objectives: int) -> NDArray[np.int64]:
    if query.objectives.shape[1] != num_objectives:
        raise ValueError(
            f"query.objectives has shape {query.objectives.shape}; it must be (2, {num_objectives})"
        )
    return query.objectives
