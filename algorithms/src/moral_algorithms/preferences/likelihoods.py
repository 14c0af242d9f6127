"""Likelihoods of a preference, given how much better one trajectory scores than the other.

Each likelihood maps utility differences x = v·(r(preferred) - r(other)), of any shape, to log-probabilities
of that preference. v is the prior's parameter and r the normalised vector return.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Likelihood(Protocol):
    """What inference asks of a likelihood."""

    def log_probability(self, differences: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log-probability, elementwise and at most 0, of preferring what scores `differences` more."""
        ...


@dataclass(frozen=True)
class BradleyTerry:
    """Bradley-Terry model (thesis eq. 4.1 and 4.11) with a lapse rate.

    p(x) = (1 - lapse) / (1 + exp(-rationality * x)) + lapse / 2.

    Parameters
    ----------
    rationality : float
        Scale of the utility differences. Take about 20 with `BallPrior` on returns of order 1; leave it at 1
        with `RationalityPrior`, whose parameter already holds the scale.
    lapse : float in [0, 1)
        Probability that the teacher answers at random (thesis section 4.2.1). Above 0 no single answer can
        rule a weight out; the log-likelihood is then no longer concave.
    """

    rationality: float = 1.0
    lapse: float = 0.0

    def __post_init__(self) -> None:
        _check_rationality(self.rationality)
        if not 0.0 <= self.lapse < 1.0:
            raise ValueError(f"lapse is {self.lapse}; it must be at least 0 and below 1")

    def log_probability(self, differences: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log-probability of the preference, elementwise."""
        logits = self.rationality * differences
        # log(sigmoid(z)) = min(z, 0) - log(1 + exp(-|z|)) overflows for no z.
        log_sigmoid: NDArray[np.float64] = np.minimum(logits, 0.0) - np.log1p(np.exp(-np.abs(logits)))
        if self.lapse == 0.0:
            return log_sigmoid
        return np.log((1.0 - self.lapse) * np.exp(log_sigmoid) + self.lapse / 2.0)


@dataclass(frozen=True)
class ExponentialProxy:
    """The thesis's stand-in for Bradley-Terry (eq. 4.12): p(x) = min(1, exp(rationality * x)).

    Log-concave with its mode at v = 0, where `metropolis` starts. It is not a distribution over the two
    answers: they sum to between 1 and 2, and no answer speaks for a longer v. So it cannot infer rationality;
    use it with `BallPrior`.

    Parameters
    ----------
    rationality : float
        Scale of the utility differences; 1 in the thesis.
    """

    rationality: float = 1.0

    def __post_init__(self) -> None:
        _check_rationality(self.rationality)

    def log_probability(self, differences: NDArray[np.float64]) -> NDArray[np.float64]:
        """Logarithm of the proxy, elementwise."""
        return np.minimum(0.0, self.rationality * differences)


def _check_rationality(rationality: float) -> None:
    if not (math.isfinite(rationality) and rationality > 0.0):
        raise ValueError(f"rationality is {rationality}; it must be positive and finite")
