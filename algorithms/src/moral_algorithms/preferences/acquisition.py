"""Acquisition functions: how much an answer to each candidate query is expected to teach.

Each maps samples of v (M, d), normalised vector returns of P candidate pairs (P, 2, d), the likelihood and a
generator (which only `random` draws from) to scores (P,); the learner asks the query of the highest score.
All are unchanged when a pair is swapped. They hold a few (M, P) arrays of float64 at a time, and raise
ValueError where the candidates have another shape.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .likelihoods import Likelihood
from .priors import FloatArray, normalise_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

Acquisition = Callable[[FloatArray, FloatArray, Likelihood, np.random.Generator], FloatArray]


def volume_removal(
    samples: FloatArray, candidates: FloatArray, likelihood: Likelihood, rng: np.random.Generator
) -> FloatArray:
    """Volume that either answer is sure to remove: min over answers of E[1 - p(answer | v)] (thesis eq. 4.5).

    Sadigh et al. 2017. It is at its maximum, 1/2 under `BradleyTerry`, for two trajectories of equal returns,
    about which no answer teaches anything (Biyik et al. 2019): leave such pairs out of the candidates. For
    the same reason it likes pairs that a noisy teacher answers at random; `expected_regret` does not.
    """
    differences = _differences(samples, candidates)
    first = np.exp(likelihood.log_probability(samples @ differences.T)).mean(axis=0)
    second = np.exp(likelihood.log_probability(-samples @ differences.T)).mean(axis=0)
    scores: FloatArray = 1.0 - np.maximum(first, second)
    return scores


def expected_regret(
    samples: FloatArray, candidates: FloatArray, likelihood: Likelihood, rng: np.random.Generator
) -> FloatArray:
    """Return expected to be lost by choosing between the two trajectories without asking.

    With ``w = v / |v|_1``, the score of the pair (i, j) is

        E[max(w·r_i, w·r_j)] - max(E[w]·r_i, E[w]·r_j)
            = min(E[max(0, w·(r_j - r_i))], E[max(0, w·(r_i - r_j))]),

    the expected value of perfect information about the pair (Howard 1966), in units of normalised return;
    Wilde et al. 2020 take a maximum over weights where this takes the mean. As -log min(1, exp(x)) = max(0,
    -x), it is also the least expected negative log-likelihood of an answer under `ExponentialProxy`. Equal
    returns score 0. It depends on no likelihood.
    """
    advantages = normalise_rows(samples) @ _differences(samples, candidates).T
    gain_of_first = np.maximum(advantages, 0.0).mean(axis=0)
    gain_of_second = np.maximum(-advantages, 0.0).mean(axis=0)
    scores: FloatArray = np.minimum(gain_of_first, gain_of_second)
    return scores


def mutual_information(
    samples: FloatArray, candidates: FloatArray, likelihood: Likelihood, rng: np.random.Generator
) -> FloatArray:
    """Mutual information of answer and v, in nats: H(E[p(answer | v)]) - E[H(p(answer | v))], at most log 2.

    Biyik et al. 2019. A likelihood that is no distribution over the two answers is first divided by its sum.
    """
    differences = _differences(samples, candidates)
    first = likelihood.log_probability(samples @ differences.T)
    second = likelihood.log_probability(-samples @ differences.T)
    probability = 1.0 / (1.0 + np.exp(np.clip(second - first, -_MAX_LOG_ODDS, _MAX_LOG_ODDS)))
    information = _binary_entropy(probability.mean(axis=0)) - _binary_entropy(probability).mean(axis=0)
    scores: FloatArray = np.maximum(information, 0.0)
    return scores


def random(
    samples: FloatArray, candidates: FloatArray, likelihood: Likelihood, rng: np.random.Generator
) -> FloatArray:
    """Independent uniform scores: every candidate is as likely to be asked (the thesis's random queries)."""
    return rng.random(len(_differences(samples, candidates)))


ACQUISITIONS: dict[str, Acquisition] = {
    "volume_removal": volume_removal,
    "expected_regret": expected_regret,
    "mutual_information": mutual_information,
    "random": random,
}

# exp(700) is finite in float64, and a probability of exp(-700) is as good as 0.
_MAX_LOG_ODDS = 700.0


def _differences(samples: FloatArray, candidates: NDArray[np.float64]) -> FloatArray:
    if candidates.ndim != 3 or candidates.shape[1:] != (2, samples.shape[1]):
        raise ValueError(f"candidates has shape {candidates.shape}; it must be (P, 2, {samples.shape[1]})")
    differences: FloatArray = candidates[:, 0] - candidates[:, 1]
    return differences


def _binary_entropy(probability: FloatArray) -> FloatArray:
    # 0 log 0 = 0: a floor under the logarithm's argument alone leaves the product at 0.
    outcomes = np.stack([probability, 1.0 - probability])
    entropy: FloatArray = -(outcomes * np.log(np.maximum(outcomes, np.finfo(np.float64).tiny))).sum(axis=0)
    return entropy
