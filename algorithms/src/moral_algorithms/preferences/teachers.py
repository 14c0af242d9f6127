"""Teachers answer queries. Simulated ones look at the ground-truth counters of the two episodes."""

from __future__ import annotations

import json
import math
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


def ask(teacher: Teacher, query: Query) -> Preference | None:
    """Ask a teacher, who may answer by a string, too.

    Raises
    ------
    ValueError
        If the answer is neither a preference nor None, which skips the query.
    """
    answer = teacher.prefer(query)
    return None if answer is None else Preference(answer)


def require_teacher(teacher: Teacher) -> None:
    """Raise a ValueError if there is no way to ask a teacher, or JSON cannot hold its state."""
    for name in ("prefer", "state_dict", "load_state_dict"):
        if not callable(getattr(teacher, name, None)):
            kind = type(teacher).__name__
            raise ValueError(f"teacher is a {kind} without {name}(); it must be a subclass of Teacher")
    try:
        json.dumps(teacher.state_dict())
    except (TypeError, ValueError) as error:
        raise ValueError(f"teacher has a state that JSON cannot hold: {error}") from error


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

    Close in the KL divergence of ``j / |j|_1`` from the ratio m, both over the objectives that m names; see
    :func:`ratio_divergence`. A trajectory that achieved none of them has no ratio and is the worst.

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
        self._ratio = shares
        self._num_objectives = len(objective_names)

    def prefer(self, query: Query) -> Preference:
        """Compare the two divergences."""
        achieved = _objectives(query, self._num_objectives)[:, self._columns]
        first, second = ratio_divergence(achieved, self._ratio).tolist()
        return _nearer(first, second)


class TargetTeacher(Teacher):
    """Prefers the trajectory whose objectives lie closer to a target (thesis eq. 5.13).

    Close in the sum of squared differences over the objectives that the target names. With what a trained
    policy achieves on average as the target, the answers ask for a policy that behaves like it.

    Parameters
    ----------
    target : mapping of str to float
        Wanted count of each objective that matters, not negative; 0 asks for none.
    objective_names : sequence of str
        Names of the counters in a query's `objectives`, in the environment's order.

    Raises
    ------
    ValueError
        If `target` is empty, holds a negative or infinite count or a name that is not in `objective_names`.
    """

    def __init__(self, target: Mapping[str, float], objective_names: Sequence[str]) -> None:
        counts = np.array(list(target.values()), dtype=np.float64)
        if counts.size == 0 or not (np.isfinite(counts).all() and (counts >= 0.0).all()):
            raise ValueError(f"target is {dict(target)}; it must name counts, none negative or infinite")
        self._columns = _columns("target", tuple(target), objective_names)
        self._target = counts
        self._num_objectives = len(objective_names)

    def prefer(self, query: Query) -> Preference:
        """Compare the two squared distances."""
        achieved = _objectives(query, self._num_objectives)[:, self._columns]
        # Rounded once, so that the same differences in another order are a tie.
        first, second = (math.fsum(row) for row in ((achieved - self._target) ** 2).tolist())
        return _nearer(first, second)


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


def ratio_divergence(
    objectives: NDArray[np.float64 | np.int64], ratio: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Kullback-Leibler divergence of achieved shares from a wanted ratio (thesis eq. 5.12).

    Where nothing was achieved there is no ratio. Equation 5.12 read to the letter finds it perfect
    (divergence 0); here it is the worst.

    Parameters
    ----------
    objectives : float64 or int64, shape (..., k)
        What was achieved of each objective that the ratio is about, not negative.
    ratio : float64, shape (k,) or (..., k)
        Wanted shares, positive; they need not sum to 1.

    Returns
    -------
    float64, shape (...)
        The divergences in nats, 0 or more; infinite where nothing was achieved.
    """
    total = objectives.sum(axis=-1, keepdims=True)
    shares = objectives / np.where(total > 0, total, 1)
    # An objective of which nothing was achieved adds 0 log 0 = 0.
    quotients = np.where(shares > 0.0, shares / (ratio / ratio.sum(axis=-1, keepdims=True)), 1.0)
    # Sorted, so that the same terms in another order have the same sum: a tie.
    divergences = np.sort(shares * np.log(quotients), axis=-1).sum(axis=-1)
    # Rounding takes it below zero.
    return np.where(total[..., 0] > 0, np.maximum(divergences, 0.0), np.inf)


def _nearer(first: float, second: float) -> Preference:
    if first == second:
        return Preference.EQUAL
    return Preference.FIRST if first < second else Preference.SECOND


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
