"""Acquisition functions against slow loops and cases worked by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.preferences import (
    ACQUISITIONS,
    BradleyTerry,
    ExponentialProxy,
    Likelihood,
    expected_regret,
    mutual_information,
    random,
    volume_removal,
)

FloatArray = NDArray[np.float64]
LIKELIHOODS: list[Likelihood] = [BradleyTerry(3.0), BradleyTerry(3.0, lapse=0.2), ExponentialProxy(3.0)]
INFORMATIVE = {name: score for name, score in ACQUISITIONS.items() if name != "random"}


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def problem(seed: int) -> tuple[FloatArray, FloatArray]:
    generator = np.random.default_rng(seed)
    return generator.exponential(1.0, (30, 3)), generator.normal(0.0, 1.0, (12, 2, 3))


def probability(likelihood: Likelihood, difference: float) -> float:
    return float(np.exp(likelihood.log_probability(np.array(difference))))


def entropy(p: float) -> float:
    return -sum(q * math.log(q) for q in (p, 1 - p) if q > 0)


def slow_volume_removal(samples: FloatArray, pair: FloatArray, likelihood: Likelihood) -> float:
    first = [1 - probability(likelihood, v @ pair[0] - v @ pair[1]) for v in samples]
    second = [1 - probability(likelihood, v @ pair[1] - v @ pair[0]) for v in samples]
    return min(sum(first) / len(first), sum(second) / len(second))


def slow_expected_regret(samples: FloatArray, pair: FloatArray, likelihood: Likelihood) -> float:
    weights = [v / v.sum() for v in samples]
    mean = sum(weights) / len(weights)
    informed = sum(max(w @ pair[0], w @ pair[1]) for w in weights) / len(weights)
    return float(informed - max(mean @ pair[0], mean @ pair[1]))


def slow_mutual_information(samples: FloatArray, pair: FloatArray, likelihood: Likelihood) -> float:
    answers = []
    for v in samples:
        first = probability(likelihood, v @ pair[0] - v @ pair[1])
        second = probability(likelihood, v @ pair[1] - v @ pair[0])
        answers.append(first / (first + second))
    return entropy(sum(answers) / len(answers)) - sum(entropy(p) for p in answers) / len(answers)


SLOW = {
    "volume_removal": slow_volume_removal,
    "expected_regret": slow_expected_regret,
    "mutual_information": slow_mutual_information,
}


@pytest.mark.parametrize("name", SLOW)
@pytest.mark.parametrize("likelihood", LIKELIHOODS, ids=str)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_scores_agree_with_a_slow_loop(name: str, likelihood: Likelihood, seed: int) -> None:
    samples, candidates = problem(seed)
    scores = ACQUISITIONS[name](samples, candidates, likelihood, rng())
    expected = [SLOW[name](samples, pair, likelihood) for pair in candidates]
    np.testing.assert_allclose(scores, expected, atol=1e-12)


@pytest.mark.parametrize("score", INFORMATIVE.values(), ids=INFORMATIVE)
@pytest.mark.parametrize("likelihood", LIKELIHOODS, ids=str)
@given(seed=st.integers(0, 10_000))
def test_swapping_and_permuting_change_nothing(score, likelihood: Likelihood, seed: int) -> None:  # type: ignore[no-untyped-def]
    samples, candidates = problem(seed)
    scores = score(samples, candidates, likelihood, rng())
    assert scores.shape == (12,)
    assert np.isfinite(scores).all()
    assert (scores >= -1e-12).all()
    np.testing.assert_allclose(score(samples, candidates[:, ::-1], likelihood, rng()), scores, atol=1e-12)
    components, pairs = np.array([2, 0, 1]), np.arange(12)[::-1]
    permuted = score(samples[:, components], candidates[pairs][..., components], likelihood, rng())
    np.testing.assert_allclose(permuted, scores[pairs], atol=1e-12)


TWO_WEIGHTS = np.array([[1.0, 0.0], [0.0, 1.0]])
# One trajectory suits each weight; the second pair divides nobody; the third is one trajectory twice.
HAND_WORKED = np.array([[[1.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [0.0, 0.0]], [[0.3, 0.4], [0.3, 0.4]]])


def test_volume_removal_by_hand() -> None:
    # Sigmoid(ln 3) is 3/4. Divided weights: the mean is 1/2. Agreed ones: the likely answer removes 1/4.
    scores = volume_removal(TWO_WEIGHTS, HAND_WORKED, BradleyTerry(math.log(3.0)), rng())
    np.testing.assert_allclose(scores, [0.5, 0.25, 0.5])


def test_expected_regret_by_hand() -> None:
    # Half the weights lose 1 whichever trajectory is chosen unasked; where all agree nobody loses.
    scores = expected_regret(TWO_WEIGHTS, HAND_WORKED, BradleyTerry(), rng())
    np.testing.assert_allclose(scores, [0.5, 0.0, 0.0])


def test_mutual_information_by_hand() -> None:
    # A rational teacher's answer tells two divided weights apart: one bit. Anything else tells nothing.
    scores = mutual_information(TWO_WEIGHTS, HAND_WORKED, BradleyTerry(1e6), rng())
    np.testing.assert_allclose(scores, [math.log(2.0), 0.0, 0.0], atol=1e-12)


def test_expected_regret_is_the_proxys_least_expected_negative_log_likelihood() -> None:
    generator = np.random.default_rng(1)
    weights, candidates = generator.dirichlet(np.ones(3), 50), generator.normal(size=(8, 2, 3))
    differences = weights @ (candidates[:, 0] - candidates[:, 1]).T
    losses = [-ExponentialProxy().log_probability(sign * differences).mean(axis=0) for sign in (1.0, -1.0)]
    scores = expected_regret(weights, candidates, BradleyTerry(), rng())
    np.testing.assert_allclose(scores, np.minimum(*losses), atol=1e-12)


def test_expected_regret_ignores_the_scale_of_samples() -> None:
    samples, candidates = problem(3)
    scales = np.random.default_rng(4).lognormal(size=(30, 1))
    np.testing.assert_allclose(
        expected_regret(samples * scales, candidates, BradleyTerry(), rng()),
        expected_regret(samples, candidates, BradleyTerry(), rng()),
    )


def test_extreme_returns_stay_finite() -> None:
    samples, candidates = problem(5)
    for likelihood in LIKELIHOODS:
        for score in INFORMATIVE.values():
            assert np.isfinite(score(samples, 1e8 * candidates, likelihood, rng())).all()


def test_random_scores_come_from_the_generator_alone() -> None:
    samples, candidates = problem(6)
    generator = np.random.default_rng(7)
    picks = [int(np.argmax(random(samples, candidates, BradleyTerry(), generator))) for _ in range(3000)]
    counts = np.bincount(picks, minlength=12)
    np.testing.assert_allclose(counts, 250, atol=75)
    first = random(samples, candidates, BradleyTerry(), np.random.default_rng(8))
    second = random(samples[:5], candidates * 2, ExponentialProxy(), np.random.default_rng(8))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("score", ACQUISITIONS.values(), ids=ACQUISITIONS)
def test_candidates_must_be_pairs_of_vector_returns(score) -> None:  # type: ignore[no-untyped-def]
    samples, candidates = problem(9)
    with pytest.raises(ValueError, match=r"candidates has shape \(12, 2, 2\); it must be \(P, 2, 3\)"):
        score(samples, candidates[..., :2], BradleyTerry(), rng())
    with pytest.raises(ValueError, match=r"candidates has shape \(2, 3\)"):
        score(samples, candidates[0], BradleyTerry(), rng())
