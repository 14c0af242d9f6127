"""Averages and intervals by hand, and against SciPy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.harness.statistics import (
    exceeds,
    interquartile_mean,
    mean_with_interval,
    spread,
    stratified_interval,
    write_mean,
)

FINITE = st.floats(-1e6, 1e6)


@pytest.mark.parametrize(
    ("values", "mean"),
    [
        ([3.0], 3.0),
        ([0.0, 1.0, 5.0], 2.0),
        ([0.0, 1.0, 3.0, 100.0], 2.0),
        ([100.0, 2.0, 3.0, 4.0, -50.0], 3.0),
        ([9.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 99.0], 3.5),
    ],
)
def test_interquartile_mean_by_hand(values: list[float], mean: float) -> None:
    assert interquartile_mean(values) == pytest.approx(mean)


@given(st.lists(FINITE, min_size=1, max_size=30))
def test_interquartile_mean_is_scipys_trimmed_mean(values: list[float]) -> None:
    assert interquartile_mean(values) == pytest.approx(scipy.stats.trim_mean(values, 0.25), abs=1e-6)


def test_one_seed_has_no_spread() -> None:
    assert stratified_interval([[1.0], [2.0]]) == (1.5, 1.5)
    assert spread([2.0]) == "2.00, 1 run"


def test_spread_by_hand() -> None:
    assert spread([1.0, 2.0, 3.0], digits=1) == "2.0 (1.0), 1.0 to 3.0, 3 runs"


def test_seeds_are_resampled_within_their_group() -> None:
    # Two groups far apart, each without any spread: resampled together, the mean would move.
    assert stratified_interval([[0.0] * 5, [100.0] * 5], statistic=np.mean) == (50.0, 50.0)


@pytest.mark.parametrize("statistic", [np.mean, np.median, interquartile_mean])
def test_an_interval_agrees_with_scipy(statistic: object) -> None:
    values = np.random.default_rng(3).gamma(2.0, size=20)
    low, high = stratified_interval([list(values)], level=0.9, statistic=statistic)  # type: ignore[arg-type]
    reference = scipy.stats.bootstrap(
        (values,),
        statistic,
        n_resamples=3000,
        confidence_level=0.9,
        method="percentile",
        vectorized=False,
        rng=np.random.default_rng(4),
    ).confidence_interval
    width = reference.high - reference.low
    assert low == pytest.approx(reference.low, abs=0.08 * width)
    assert high == pytest.approx(reference.high, abs=0.08 * width)


@settings(max_examples=20)
@given(st.lists(st.lists(FINITE, min_size=1, max_size=4), min_size=1, max_size=3))
def test_an_interval_lies_within_the_values_and_is_always_the_same(groups: list[list[float]]) -> None:
    low, high = stratified_interval(groups, statistic=lambda values: float(values.mean()))
    values = [value for group in groups for value in group]
    slack = 1e-9 * max(1.0, *map(abs, values))
    assert min(values) - slack <= low <= high <= max(values) + slack
    assert stratified_interval(groups, statistic=lambda values: float(values.mean())) == (low, high)


def test_seeds_are_resampled_whole() -> None:
    # However many values a seed has, there are two of them: each alone, or both.
    mean, low, high = mean_with_interval([[0.0] * 100, [1.0] * 100])
    assert (mean, low, high) == (0.5, 0.0, 1.0)
    # The same values in no clusters are far surer.
    low, high = stratified_interval([[0.0] * 100 + [1.0] * 100], statistic=lambda row: float(row.mean()))
    assert high - low < 0.2
    assert mean_with_interval([[0.1, 0.3], [0.2, 0.2, 0.7]])[0] == pytest.approx(0.3)


def test_what_exceeds_by_more_than_two_standard_errors() -> None:
    # Variances of 1 and two values each: a standard error of 1.
    those = [-np.sqrt(0.5), np.sqrt(0.5)]
    assert exceeds([2.1 + value for value in those], those)
    assert not exceeds([1.9 + value for value in those], those)
    assert not exceeds([5.0], those)


def test_a_mean_is_written_with_those_of_the_seeds() -> None:
    assert write_mean([[0.1, 0.3], [0.2, 0.2, 0.8]]) == "0.3200 (seeds: 0.2000, 0.4000)"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: interquartile_mean([]), "values is"),
        (lambda: interquartile_mean([1.0, math.nan]), "values is"),
        (lambda: stratified_interval([]), "groups is"),
        (lambda: stratified_interval([[1.0], []]), "groups is"),
        (lambda: stratified_interval([[1.0, math.inf]]), "groups is"),
        (lambda: stratified_interval([[1.0]], level=1.0), "level is 1.0"),
    ],
)
def test_what_has_no_answer_is_refused(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()  # type: ignore[operator]
