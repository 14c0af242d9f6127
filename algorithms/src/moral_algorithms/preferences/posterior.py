"""The posterior over the parameter v of linear scalarisations, given preferences (thesis eq. 4.3)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .query import Preference, return_pair
from .samplers import Sampler, hit_and_run, resample

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from .likelihoods import Likelihood
    from .priors import FloatArray, Prior

# How often a preference counts as "first preferred" and as "second preferred".
_COUNTS = {Preference.FIRST: (1.0, 0.0), Preference.SECOND: (0.0, 1.0), Preference.EQUAL: (0.5, 0.5)}


class Posterior:
    """Samples of p(v | preferences), drawn anew after each answer.

    The samples of the last posterior are resampled by the new answer's likelihood, and the sampler starts
    from there (resample-move, Gilks and Berzuini 2001).

    The likelihood of an equal preference is the geometric mean of those of the two strict ones. It is largest
    where both trajectories score the same.

    Parameters
    ----------
    prior : Prior
        Prior over v; `RationalityPrior` infers the likelihood's scale, `BallPrior` is the thesis's.
    likelihood : Likelihood
        Likelihood of a preference.
    sampler : Sampler
        Draws the samples.
    num_samples : int
        Number M of samples.
    rng : numpy.random.Generator
        Source of randomness. The posterior owns it from here on and saves it with `state_dict`.

    Raises
    ------
    ValueError
        If `num_samples` is below 2.
    """

    def __init__(
        self,
        prior: Prior,
        likelihood: Likelihood,
        sampler: Sampler = hit_and_run,
        *,
        num_samples: int = 1000,
        rng: np.random.Generator,
    ) -> None:
        if num_samples < 2:
            raise ValueError(f"num_samples is {num_samples}; it must be at least 2")
        self.prior = prior
        self.likelihood = likelihood
        self.sampler = sampler
        self._rng = rng
        self._samples = prior.sample(num_samples, rng)
        self._set_preferences(np.empty((0, 2, prior.dim)), [])

    @property
    def samples(self) -> FloatArray:
        """Copy of the samples of v, shape (M, d); draws from the prior before the first preference."""
        return self._samples.copy()

    @property
    def num_queries(self) -> int:
        """Number of preferences received."""
        return len(self._preferences)

    def weights(self) -> FloatArray:
        """Mean scalarisation weights, shape (d,), nonnegative with sum 1.

        How v becomes weights is the prior's matter: see `RationalityPrior.weights` and `BallPrior.weights`.
        Before any answer they are the prior's exact mean.
        """
        return self.prior.weights(self._samples) if self._preferences else self.prior.mean_weights()

    def add(self, returns: NDArray[np.float64], preference: Preference) -> None:
        """Take in the answer to one query and draw the samples anew.

        Parameters
        ----------
        returns : float64, shape (2, d)
            Normalised vector returns of the query's two trajectories.
        preference : Preference
            The answer.

        Raises
        ------
        ValueError
            If `returns` has another shape or is not finite, or `preference` is no preference.
        """
        self.add_all([returns], [preference])

    def add_all(self, returns: ArrayLike, preferences: Sequence[Preference]) -> None:
        """Take in the answers to several queries at once, and draw the samples anew once.

        The samples of the posterior so far are where the sampler begins: of many answers that say much, take
        them in portions.

        Parameters
        ----------
        returns : float64, shape (n, 2, d)
            Normalised vector returns of the queries' pairs of trajectories.
        preferences : sequence of n Preference
            The answers.

        Raises
        ------
        ValueError
            If `returns` has another shape or is not finite, or a preference is none.
        """
        answers = [Preference(preference) for preference in preferences]
        pairs = [return_pair(pair, self.prior.dim) for pair in np.asarray(returns, dtype=np.float64)]
        if len(pairs) != len(answers):
            raise ValueError(f"returns has {len(pairs)} pairs; it must have {len(answers)}, as preferences")
        if not answers:
            return
        before = self.log_density(self._samples)
        self._set_preferences(
            np.concatenate([self._returns, np.stack(pairs)]), [*self._preferences, *answers]
        )
        log_weights = self.log_density(self._samples) - before
        start = resample(self._samples, log_weights, self._rng)
        self._samples = self.sampler(self.log_density, self.prior, start, self._rng)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log-density up to a constant at (m, d) points, shape (m,); -inf outside the prior's support."""
        log_probabilities = self.likelihood.log_probability(points @ self._differences.T)
        log_density: FloatArray = self.prior.log_density(points) + log_probabilities @ self._counts
        return log_density

    def state_dict(self) -> dict[str, Any]:
        """Everything that the posterior has learned, as arrays and plain values.

        Returns
        -------
        dict
            ``returns`` float64 (n, 2, d), ``preferences`` list of n strings, ``samples`` float64 (M, d), and
            ``rng``, the bit generator's state, which JSON can hold where the generator is
            `numpy.random.default_rng`'s.
        """
        return {
            "returns": self._returns.copy(),
            "preferences": [preference.value for preference in self._preferences],
            "samples": self._samples.copy(),
            "rng": self._rng.bit_generator.state,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on exactly where `state_dict` was taken.

        The posterior must have been made with the same prior, likelihood, sampler, number of samples and kind
        of generator.

        Raises
        ------
        ValueError
            If the arrays fit neither each other nor this posterior, or hold values that it cannot.
        """
        returns = np.array(state["returns"], dtype=np.float64)
        samples = np.array(state["samples"], dtype=np.float64)
        preferences = [Preference(preference) for preference in state["preferences"]]
        expected = (len(preferences), 2, self.prior.dim)
        if returns.shape != expected:
            raise ValueError(f"state['returns'] has shape {returns.shape}; it must be {expected}")
        if samples.shape != self._samples.shape:
            raise ValueError(f"state['samples'] has shape {samples.shape}; it must be {self._samples.shape}")
        if not np.isfinite(returns).all():
            raise ValueError("state['returns'] holds a value that is not finite; every return must be")
        outside = int((~np.isfinite(self.prior.log_density(samples))).sum())
        if outside:
            raise ValueError(f"state['samples'] has {outside} rows outside the prior's support; none may be")
        self._rng.bit_generator.state = state["rng"]
        self._samples = samples
        self._set_preferences(returns, preferences)

    def _set_preferences(self, returns: FloatArray, preferences: list[Preference]) -> None:
        self._returns = returns
        self._preferences = preferences
        differences = returns[:, 0] - returns[:, 1]
        counts = np.array([_COUNTS[preference] for preference in preferences]).reshape(-1, 2).T.ravel()
        counted = counts > 0.0
        self._differences = np.concatenate([differences, -differences])[counted]
        self._counts = counts[counted]
