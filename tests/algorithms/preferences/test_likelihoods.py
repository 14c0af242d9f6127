"""Likelihoods against the formulas they implement."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moral_algorithms.preferences import BradleyTerry, ExponentialProxy

rationalities = st.floats(0.01, 100.0)
lapses = st.floats(0.0, 0.99)
differences = st.floats(-5.0, 5.0)


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(0.01, 10.0), lapses)
def test_bradley_terry_is_equation_4_1(first: float, second: float, rationality: float, lapse: float) -> None:
    numerator = math.exp(rationality * first)
    model = numerator / (numerator + math.exp(rationality * second))
    expected = (1 - lapse) * model + lapse / 2
    probability = np.exp(BradleyTerry(rationality, lapse).log_probability(np.array(first - second)))
    assert probability == pytest.approx(expected, rel=1e-9, abs=1e-300)


@given(differences, rationalities, lapses)
def test_bradley_terry_is_a_distribution_over_the_answers(
    difference: float, rationality: float, lapse: float
) -> None:
    log_probabilities = BradleyTerry(rationality, lapse).log_probability(np.array([difference, -difference]))
    assert (log_probabilities <= 0.0).all()
    assert np.exp(log_probabilities).sum() == pytest.approx(1.0)


@given(differences, rationalities)
def test_proxy_is_equation_4_12(difference: float, rationality: float) -> None:
    probability = np.exp(ExponentialProxy(rationality).log_probability(np.array(difference)))
    assert probability == pytest.approx(min(1.0, math.exp(min(rationality * difference, 0.0))))


def test_extreme_differences_stay_finite() -> None:
    extreme = np.array([-1e6, 1e6])
    np.testing.assert_allclose(BradleyTerry(20.0).log_probability(extreme), [-2e7, 0.0])
    np.testing.assert_allclose(ExponentialProxy(20.0).log_probability(extreme), [-2e7, 0.0])
    lapsing = BradleyTerry(20.0, lapse=0.1).log_probability(extreme)
    np.testing.assert_allclose(np.exp(lapsing), [0.05, 0.95])


@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
@pytest.mark.parametrize("likelihood", [BradleyTerry, ExponentialProxy])
def test_rationality_must_be_positive(
    likelihood: type[BradleyTerry] | type[ExponentialProxy], value: float
) -> None:
    with pytest.raises(ValueError, match=f"rationality is {value}; it must be positive and finite"):
        likelihood(rationality=value)


@pytest.mark.parametrize("value", [-0.1, 1.0, math.nan])
def test_lapse_must_be_a_probability_below_one(value: float) -> None:
    with pytest.raises(ValueError, match=f"lapse is {value}; it must be at least 0 and below 1"):
        BradleyTerry(lapse=value)
