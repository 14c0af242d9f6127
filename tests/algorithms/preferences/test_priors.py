"""Priors: densities, chords, draws and weights."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moral_algorithms.preferences import BallPrior, Prior, RationalityPrior

PRIORS: list[Prior] = [
    BallPrior(1),
    BallPrior(2),
    BallPrior(4),
    RationalityPrior(1, 5.0),
    RationalityPrior(2, 5.0),
    RationalityPrior(4, 5.0),
    RationalityPrior(3, 5.0, concentration=3.0),
]
priors = pytest.mark.parametrize("prior", PRIORS, ids=str)


def test_ball_density_is_the_constant_of_equation_4_4() -> None:
    d = 3
    expected = 2**d / (math.pi ** (d / 2) / math.gamma(d / 2 + 1))
    points = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.6, 0.6, 0.6], [-0.1, 0.5, 0.5]])
    np.testing.assert_allclose(np.exp(BallPrior(d).log_density(points)), [expected, expected, 0.0, 0.0])


def test_rationality_density_is_uniform_weights_and_gamma_rationality() -> None:
    mean, d = 6.0, 3
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(d), 5)
    rationality = rng.uniform(0.1, 30.0, 5)
    # Uniform on the simplex: (d - 1)!. The map (w, beta) -> v has the Jacobian beta**(d - 1).
    scale = mean / d
    gamma = rationality ** (d - 1) * np.exp(-rationality / scale) / (math.gamma(d) * scale**d)
    expected = gamma * math.factorial(d - 1) / rationality ** (d - 1)
    density = np.exp(RationalityPrior(d, mean).log_density(weights * rationality[:, None]))
    np.testing.assert_allclose(density, expected)


def test_concentrated_rationality_density_is_dirichlet_weights_and_gamma_rationality() -> None:
    mean, d, concentration = 6.0, 3, 2.5
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(d), 5)
    rationality = rng.uniform(0.1, 30.0, 5)
    shape = d * concentration
    scale = mean / shape
    gamma = rationality ** (shape - 1) * np.exp(-rationality / scale) / (math.gamma(shape) * scale**shape)
    normaliser = math.gamma(shape) / math.gamma(concentration) ** d
    expected = gamma * normaliser * (weights ** (concentration - 1)).prod(axis=1) / rationality ** (d - 1)
    prior = RationalityPrior(d, mean, concentration)
    np.testing.assert_allclose(np.exp(prior.log_density(weights * rationality[:, None])), expected)
    assert prior.log_density(np.array([[0.0, 1.0, 1.0]])) == -np.inf


@pytest.mark.parametrize(
    ("prior", "bound"),
    [(BallPrior(2), 1.0), (RationalityPrior(2, 3.0), 60.0), (RationalityPrior(2, 3.0, 2.0), 60.0)],
)
def test_densities_integrate_to_one(prior: Prior, bound: float) -> None:
    n = 1000
    axis = (np.arange(n) + 0.5) * bound / n
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert np.exp(prior.log_density(grid)).sum() * (bound / n) ** 2 == pytest.approx(1.0, abs=2e-3)


@priors
def test_draws_follow_the_prior(prior: Prior) -> None:
    samples = prior.sample(20_000, np.random.default_rng(1))
    assert samples.shape == (20_000, prior.dim)
    assert np.isfinite(prior.log_density(samples)).all()
    if isinstance(prior, BallPrior):
        radii = np.linalg.norm(samples, axis=1)
        for quantile in (0.1, 0.5, 0.9):
            assert (radii < quantile ** (1 / prior.dim)).mean() == pytest.approx(quantile, abs=0.015)
    else:
        assert isinstance(prior, RationalityPrior)
        rationality = samples.sum(axis=1)
        assert rationality.mean() == pytest.approx(5.0, rel=0.04)
        shape = prior.dim * prior.concentration
        assert rationality.var() == pytest.approx(25.0 / shape, rel=0.1)
        np.testing.assert_allclose((samples / rationality[:, None]).mean(axis=0), 1 / prior.dim, atol=0.01)
    np.testing.assert_allclose(prior.weights(samples), prior.mean_weights(), atol=0.01)


@priors
@given(seed=st.integers(0, 10_000))
def test_chords_end_where_the_support_ends(prior: Prior, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = prior.sample(20, rng)
    directions = rng.standard_normal((20, prior.dim)) * rng.lognormal(0.0, 2.0, (20, 1))
    low, high = prior.chord(points, directions)
    assert (low <= 0.0).all()
    assert (high >= 0.0).all()
    for end in (low, high):
        finite = np.isfinite(end)
        inside = points[finite] + 0.999 * end[finite, None] * directions[finite]
        outside = points[finite] + 1.001 * end[finite, None] * directions[finite]
        assert np.isfinite(prior.log_density(inside)).all()
        assert np.isneginf(prior.log_density(outside)).all()
        far = points[~finite] + np.sign(end[~finite])[:, None] * 1e6 * directions[~finite]
        assert np.isfinite(prior.log_density(far)).all()
    if isinstance(prior, BallPrior):
        assert np.isfinite(low).all()
        assert np.isfinite(high).all()


def test_rationality_does_not_leak_into_the_weights() -> None:
    samples = np.array([[100.0, 0.0], [0.0, 1.0]])
    np.testing.assert_allclose(RationalityPrior(2).weights(samples), [0.5, 0.5])


def test_ball_weights_are_the_direction_of_the_mean() -> None:
    samples = np.array([[0.9, 0.0], [0.0, 0.1]])
    np.testing.assert_allclose(BallPrior(2).weights(samples), [0.9, 0.1])


def test_a_zero_sample_counts_as_equal_weights() -> None:
    np.testing.assert_allclose(RationalityPrior(2).weights(np.array([[0.0, 0.0], [1.0, 0.0]])), [0.75, 0.25])


@pytest.mark.parametrize("prior", [BallPrior, RationalityPrior])
def test_dim_must_be_positive(prior: type[BallPrior] | type[RationalityPrior]) -> None:
    with pytest.raises(ValueError, match="dim is 0; it must be at least 1"):
        prior(0)


@pytest.mark.parametrize("value", [0.99, -3.0, math.inf, math.nan])
def test_concentration_must_be_at_least_one(value: float) -> None:
    with pytest.raises(ValueError, match=f"concentration is {value}; it must be at least 1 and finite"):
        RationalityPrior(2, concentration=value)


@pytest.mark.parametrize("value", [0.0, -3.0, math.inf, math.nan])
def test_mean_rationality_must_be_positive(value: float) -> None:
    with pytest.raises(ValueError, match=f"mean_rationality is {value}; it must be positive and finite"):
        RationalityPrior(2, value)
