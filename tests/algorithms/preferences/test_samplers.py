"""Samplers against distributions whose moments are known."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.preferences import (
    SAMPLERS,
    BallPrior,
    BradleyTerry,
    Posterior,
    Preference,
    Prior,
    RationalityPrior,
    Sampler,
    hit_and_run,
    metropolis,
)
from moral_algorithms.preferences.samplers import resample

FloatArray = NDArray[np.float64]
samplers = pytest.mark.parametrize("sampler", SAMPLERS.values(), ids=SAMPLERS)


@samplers
@pytest.mark.parametrize("prior", [BallPrior(3), RationalityPrior(3, 6.0)], ids=str)
def test_a_sampler_leaves_the_prior_as_it_is(sampler: Sampler, prior: Prior) -> None:
    rng = np.random.default_rng(0)
    exact = prior.sample(100_000, rng)
    samples = sampler(prior.log_density, prior, prior.sample(4000, rng), rng)
    assert samples.shape == (4000, 3)
    spread = exact.std(axis=0)
    np.testing.assert_allclose((samples.mean(axis=0) - exact.mean(axis=0)) / spread, 0.0, atol=0.08)
    np.testing.assert_allclose(samples.std(axis=0) / spread, 1.0, atol=0.08)


@samplers
def test_a_correlated_gaussian_inside_the_support(sampler: Sampler) -> None:
    prior = RationalityPrior(2, 1.0)
    mean = np.array([50.0, 30.0])
    covariance = np.array([[1.0, 0.7], [0.7, 1.0]])
    precision = np.linalg.inv(covariance)

    def log_density(points: FloatArray) -> FloatArray:
        centred = points - mean
        log_density: FloatArray = -0.5 * np.einsum("mi,ij,mj->m", centred, precision, centred)
        return log_density

    rng = np.random.default_rng(2)
    start = mean + rng.uniform(-3.0, 3.0, (4000, 2))
    samples = sampler(log_density, prior, sampler(log_density, prior, start, rng), rng)
    np.testing.assert_allclose(samples.mean(axis=0), mean, atol=0.1)
    np.testing.assert_allclose(np.cov(samples.T), covariance, atol=0.12)


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e4])
def test_hit_and_run_forgets_a_start_of_another_scale(scale: float) -> None:
    prior = RationalityPrior(2, scale)
    rng = np.random.default_rng(3)
    start = np.array([3.0, 0.2]) + 0.1 * rng.random((2000, 2))
    samples = hit_and_run(prior.log_density, prior, start, rng, num_sweeps=40)
    np.testing.assert_allclose(samples.mean(axis=0), scale / 2, rtol=0.1)
    np.testing.assert_allclose(samples.std(axis=0), scale / 2, rtol=0.1)


def test_hit_and_run_recovers_from_chains_that_all_start_at_one_point() -> None:
    prior = BallPrior(2)
    rng = np.random.default_rng(4)
    samples = hit_and_run(prior.log_density, prior, np.full((2000, 2), 0.7), rng, num_sweeps=30)
    np.testing.assert_allclose(samples.mean(axis=0), 4 / (3 * np.pi), atol=0.03)


def test_a_thousand_samples_of_hit_and_run_are_worth_a_thousand() -> None:
    rng = np.random.default_rng(5)
    posterior = Posterior(RationalityPrior(3), BradleyTerry(), rng=rng)
    for _ in range(25):
        returns = rng.random((2, 3))
        first = returns[0] @ [0.5, 0.3, 0.2] > returns[1] @ [0.5, 0.3, 0.2]
        posterior.add(returns, Preference.FIRST if first else Preference.SECOND)
    means = []
    for _ in range(30):
        samples = hit_and_run(posterior.log_density, posterior.prior, posterior.samples, rng)
        means.append(samples.mean(axis=0))
    effective = samples.var(axis=0) / np.var(means, axis=0)
    assert effective.mean() > 600.0


@given(st.integers(0, 10_000))
def test_resampling_repeats_each_row_in_proportion_to_its_weight(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = np.arange(50.0)[:, None]
    log_weights = rng.normal(0.0, 2.0, 50) - 1e4
    counts = np.bincount(resample(rows, log_weights, rng)[:, 0].astype(np.int64), minlength=50)
    expected = np.exp(log_weights - log_weights.max())
    expected *= 50 / expected.sum()
    assert counts.sum() == 50
    assert (np.abs(counts - expected) < 1.0 + 1e-9).all()


@samplers
def test_samplers_are_reproducible_and_leave_their_input_alone(sampler: Sampler) -> None:
    prior = BallPrior(2)
    start = prior.sample(150, np.random.default_rng(6))
    before = start.copy()
    first = sampler(prior.log_density, prior, start, np.random.default_rng(7))
    second = sampler(prior.log_density, prior, start, np.random.default_rng(7))
    assert first.shape == (150, 2)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(start, before)
    assert not np.shares_memory(first, start)


@pytest.mark.parametrize(
    ("sampler", "message"),
    [
        (partial(hit_and_run, num_sweeps=0), "num_sweeps is 0; it must be at least 1"),
        (partial(metropolis, num_chains=0), "num_chains is 0; it must be at least 1"),
        (partial(metropolis, num_warm_up=-1), "num_warm_up is -1; it must be at least 0"),
        (partial(metropolis, num_thinning=0), "num_thinning is 0; it must be at least 1"),
    ],
)
def test_lengths_must_be_positive(sampler: Sampler, message: str) -> None:
    prior = BallPrior(2)
    rng = np.random.default_rng(8)
    with pytest.raises(ValueError, match=message):
        sampler(prior.log_density, prior, prior.sample(10, rng), rng)
