"""A query (a pair of trajectories) and the preference that answers it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Preference(str, Enum):
    """A teacher's answer to a query.

    Members are strings, so ``json.dumps`` writes them as they are and ``Preference("first")`` reads them
    back. A query that the teacher skips has no preference: it never reaches the posterior.
    """

    FIRST = "first"
    SECOND = "second"
    EQUAL = "equal"

    @classmethod
    def _missing_(cls, value: object) -> Preference:
        raise ValueError(f"preference is {value!r}; it must be 'first', 'second' or 'equal'")


@dataclass(frozen=True, eq=False)
class Query:
    """A pair of trajectories, as inference and the teacher see it.

    The arrays are copied and made read-only.

    Parameters
    ----------
    returns : float64, shape (2, d)
        Normalised vector returns of the first and the second trajectory: what inference sees.
    objectives : int64, shape (2, m)
        Ground-truth counters at the end of the two episodes, in the environment's order of objectives: what a
        simulated teacher sees.

    Raises
    ------
    ValueError
        If an array does not have two rows, returns are not finite or objectives are not integers.
    """

    returns: NDArray[np.float64]
    objectives: NDArray[np.int64]

    def __post_init__(self) -> None:
        returns = return_pair(self.returns)
        objectives = np.asarray(self.objectives)
        if objectives.ndim != 2 or objectives.shape[0] != 2 or objectives.shape[1] == 0:
            raise ValueError(f"objectives has shape {objectives.shape}; it must be (2, number of objectives)")
        if not np.issubdtype(objectives.dtype, np.integer):
            raise ValueError(f"objectives has dtype {objectives.dtype}; counters must be integers")
        objectives = objectives.astype(np.int64)
        returns.flags.writeable = False
        objectives.flags.writeable = False
        object.__setattr__(self, "returns", returns)
        object.__setattr__(self, "objectives", objectives)


def return_pair(returns: NDArray[np.float64], dim: int | None = None) -> NDArray[np.float64]:
    """Copy a pair of vector returns as float64 of shape (2, d), after checking it.

    Raises
    ------
    ValueError
        If the shape is not (2, d), with d equal to `dim` where one is given, or a value is not finite.
    """
    pair = np.array(returns, dtype=np.float64)
    expected = f"(2, {'number of reward components' if dim is None else dim})"
    if pair.ndim != 2 or pair.shape[0] != 2 or pair.shape[1] == 0 or dim not in (None, pair.shape[1]):
        raise ValueError(f"returns has shape {pair.shape}; it must be {expected}")
    if not np.isfinite(pair).all():
        raise ValueError(f"returns is {pair.tolist()}; every value must be finite")
    return pair
