"""Priors over the parameter v of linear scalarisations, in the nonnegative orthant.

A prior says how its parameter becomes scalarisation weights, and gives the samplers its support as chords.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Prior(Protocol):
    """What inference asks of a prior over v in R^d."""

    @property
    def dim(self) -> int:
        """Number d of reward components."""
        ...

    def log_density(self, points: FloatArray) -> FloatArray:
        """Normalised log-density at (m, d) points, shape (m,); -inf outside the support."""
        ...

    def chord(self, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the ends (low, high), each (m,), of {t: point + t * direction lies in the support}.

        `points` (m, d) lie in the support, so low <= 0 <= high; an end may be infinite.
        """
        ...

    def sample(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """Independent draws, shape (num_samples, d)."""
        ...

    def mean_weights(self) -> FloatArray:
        """Exact mean of the scalarisation weights under the prior, shape (d,)."""
        ...

    def weights(self, samples: FloatArray) -> FloatArray:
        """Mean scalarisation weights of samples (m, d) of v: shape (d,), nonnegative, summing to 1."""
        ...


@dataclass(frozen=True)
class BallPrior:
    """Uniform on the nonnegative part of the unit ball (thesis eq. 4.4).

    The norm of v is at once a weight's confidence and bounded by 1, so the likelihood must bring a scale
    (`rationality`) that suits the returns.

    Parameters
    ----------
    dim : int
        Number of reward components.
    """

    dim: int

    def __post_init__(self) -> None:
        _check_dim(self.dim)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Minus the logarithm of the support's volume inside it; -inf outside."""
        log_ball_volume = self.dim / 2 * math.log(math.pi) - math.lgamma(self.dim / 2 + 1)
        inside = (points >= 0.0).all(axis=1) & ((points**2).sum(axis=1) <= 1.0)
        return np.where(inside, self.dim * math.log(2.0) - log_ball_volume, -np.inf)

    def chord(self, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cut the chord through the ball off where it leaves the orthant."""
        # |point + t * direction|^2 = 1 is a t^2 + 2 b t + c = 0, with c <= 0 inside the ball.
        a = (directions**2).sum(axis=1)
        b = (points * directions).sum(axis=1)
        c = np.minimum((points**2).sum(axis=1) - 1.0, 0.0)
        root = np.sqrt(b**2 - a * c)
        low, high = _orthant_chord(points, directions)
        return np.maximum(low, (-b - root) / a), np.minimum(high, (-b + root) / a)

    def sample(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw a uniform direction in the orthant and a radius of density dim * radius**(dim - 1)."""
        directions = np.abs(rng.standard_normal((num_samples, self.dim)))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return directions * rng.random((num_samples, 1)) ** (1.0 / self.dim)

    def mean_weights(self) -> FloatArray:
        """1 / dim each, by symmetry."""
        return np.full(self.dim, 1.0 / self.dim)

    def weights(self, samples: FloatArray) -> FloatArray:
        """Mean of the samples, divided by its sum: to optimise it is to optimise E[v] (thesis eq. 4.14)."""
        mean: FloatArray = samples.mean(axis=0)
        weights: FloatArray = mean / mean.sum()
        return weights


@dataclass(frozen=True)
class RationalityPrior:
    """Prior on v = beta * w: scalarisation weights w and the teacher's rationality beta, inferred together.

    w is Dirichlet distributed, Dir(c, ..., c), and, independently of it, ``beta = |v|_1`` is Gamma
    distributed with shape `dim` * c and mean `mean_rationality`. With that shape the Jacobian beta**(dim - 1)
    of (w, beta) -> v cancels, and v has independent Gamma components of shape c:
    log p(v) = sum((c - 1) log v_i - v_i / scale) up to a constant, scale = mean_rationality / (dim * c). This
    is concave on the orthant for c >= 1, so the posterior under `BradleyTerry()` is log-concave. With c = 1
    weights are uniform on the simplex, and components exponential.

    Parameters
    ----------
    dim : int
        Number of reward components.
    mean_rationality : float
        Prior mean of beta, per unit of return.
    concentration : float
        c, at least 1. The larger, the surer it is beforehand that no component is to be left out.
    """

    dim: int
    mean_rationality: float = 40.0
    concentration: float = 1.0

    def __post_init__(self) -> None:
        _check_dim(self.dim)
        if not (math.isfinite(self.mean_rationality) and self.mean_rationality > 0.0):
            raise ValueError(f"mean_rationality is {self.mean_rationality}; it must be positive and finite")
        if not (math.isfinite(self.concentration) and self.concentration >= 1.0):
            raise ValueError(f"concentration is {self.concentration}; it must be at least 1 and finite")

    @property
    def scale(self) -> float:
        """Scale of each component of v, whose mean is `concentration` times that."""
        return self.mean_rationality / (self.dim * self.concentration)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log-density of independent Gamma components; -inf outside the orthant."""
        inside = (points >= 0.0).all(axis=1)
        power = self.concentration - 1.0
        constant = self.dim * (math.lgamma(self.concentration) + self.concentration * math.log(self.scale))
        log_density = -points.sum(axis=1) / self.scale - constant
        if power > 0.0:
            with np.errstate(divide="ignore"):
                log_density += power * np.log(np.maximum(points, 0.0)).sum(axis=1)
        return np.where(inside, log_density, -np.inf)

    def chord(self, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cut the line off where it leaves the orthant; it is infinite on a side where no component falls."""
        return _orthant_chord(points, directions)

    def sample(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """Independent Gamma components."""
        return rng.gamma(self.concentration, self.scale, (num_samples, self.dim))

    def mean_weights(self) -> FloatArray:
        """1 / dim each, by symmetry."""
        return np.full(self.dim, 1.0 / self.dim)

    def weights(self, samples: FloatArray) -> FloatArray:
        """Mean of ``v / |v|_1``, so that samples of a high rationality do not count for more."""
        weights: FloatArray = normalise_rows(samples).mean(axis=0)
        return weights


def normalise_rows(samples: FloatArray) -> FloatArray:
    """Divide nonnegative samples (m, d) of v by their sums: each row becomes scalarisation weights.

    A row of zeros, which points nowhere, becomes equal weights.
    """
    sums = samples.sum(axis=1, keepdims=True)
    dim = samples.shape[1]
    rows: FloatArray = np.divide(samples, sums, out=np.full_like(samples, 1.0 / dim), where=sums > 0.0)
    return rows


def _orthant_chord(points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = -points / directions
    low = np.where(directions > 0.0, crossings, -np.inf).max(axis=1)
    high = np.where(directions < 0.0, crossings, np.inf).min(axis=1)
    return low, high


def _check_dim(dim: int) -> None:
    if dim < 1:
        raise ValueError(f"dim is {dim}; it must be at least 1, the number of reward components")
