"""Indicators, against hand-worked cases and slow, obvious computations."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.indicators import (
    convex_coverage,
    expected_utility,
    hypervolume,
    igd,
    igd_plus,
    pareto_optimal,
    preference_deviation,
    uniform_weights,
)
from moral_algorithms.preferences import Preference, Query, RatioTeacher

Points = NDArray[np.float64]

STAIRS = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0]])
MEASURES: dict[str, Callable[[Points], Any]] = {
    "hypervolume": lambda points: hypervolume(points, np.zeros(points.shape[-1])),
    "igd": lambda points: igd(points, np.full((1, points.shape[-1]), 4.0)),
    "igd_plus": lambda points: igd_plus(points, np.full((1, points.shape[-1]), 4.0)),
    "expected_utility": lambda points: expected_utility(points, np.eye(points.shape[-1])),
    "pareto_optimal": pareto_optimal,
    "convex_coverage": convex_coverage,
    "preference_deviation": lambda points: preference_deviation(points, np.ones(points.shape[-1])),
}
every_measure = pytest.mark.parametrize("measure", MEASURES.values(), ids=MEASURES.keys())


@st.composite
def grids(draw: st.DrawFn, dims: tuple[int, ...] = (2, 3, 4), most: int = 7, highest: int = 5) -> Points:
    """A set of points with small integer values: many ties, duplicates and common faces."""
    dim = draw(st.sampled_from(dims))
    rows = st.lists(st.integers(0, highest), min_size=dim, max_size=dim)
    return np.array(draw(st.lists(rows, min_size=1, max_size=most)), dtype=np.float64)


def dominates(better: Points, worse: Points) -> bool:
    return bool((better >= worse).all() and (better > worse).any())


# Hypervolume


@pytest.mark.parametrize(
    ("points", "reference", "volume"),
    [
        ([[2, 3]], [0, 0], 6),
        (STAIRS, [0, 0], 6),
        (STAIRS, [1, 1], 1),
        ([*STAIRS, [1, 1], [2, 2]], [0, 0], 6),
        (STAIRS - 5, [-5, -5], 6),
        ([[1, 1, 1]], [0, 0, 0], 1),
        ([[2, 1, 1], [1, 2, 1], [1, 1, 2]], [0, 0, 0], 4),
        ([[1, 2, 3, 4]], [0, 0, 0, 0], 24),
        ([[1, 2, 3, 4, 5]], [0, 1, 2, 3, 4], 1),
    ],
)
def test_hypervolume_by_hand(points: Any, reference: Any, volume: float) -> None:
    assert hypervolume(points, reference) == pytest.approx(volume)


@given(grids(dims=(2, 3, 4, 5)))
def test_hypervolume_counts_the_unit_cells_below_a_point(points: Points) -> None:
    corners = np.indices((5,) * points.shape[1]).reshape(points.shape[1], -1).T
    below = (corners[:, None] < points).all(axis=2).any(axis=1)
    assert hypervolume(points, np.zeros(points.shape[1])) == pytest.approx(below.sum())


@given(grids(), st.lists(st.floats(0.01, 100), min_size=4, max_size=4), st.integers(-9, 9))
def test_hypervolume_scales_and_shifts(points: Points, scales: list[float], shift: int) -> None:
    factors = np.array(scales[: points.shape[1]])
    reference = np.full(points.shape[1], -1.0)
    volume = hypervolume(points, reference)
    assert hypervolume(points * factors, reference * factors) == pytest.approx(volume * factors.prod())
    assert hypervolume(points + shift, reference + shift) == pytest.approx(volume)


def test_a_reference_above_a_point_is_refused() -> None:
    with pytest.raises(
        ValueError,
        match=r"^reference is \[0.0, 2.0\]; it must be at most \[1.0, 1.0\], the points' minimum$",
    ):
        hypervolume(STAIRS, [0, 2])


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ([0, 0, 0], r"reference has shape \(3,\); it must be \(2,\)"),
        (0.0, r"reference has shape \(\); it must be \(2,\)"),
        ([0, float("nan")], r"reference is \[0.0, nan\]; every value must be finite"),
        ([0, -float("inf")], r"reference is \[0.0, -inf\]; every value must be finite"),
    ],
)
def test_an_impossible_reference_is_refused(reference: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        hypervolume(STAIRS, reference)


# Distances from a front


@pytest.mark.parametrize(
    ("points", "plain", "plus"),
    [
        (STAIRS, 0, 0),
        ([*STAIRS, [0, 0]], 0, 0),
        ([[2, 2]], 2 * 2**0.5 / 3, 2 / 3),
        ([[4, 4]], (2 * 10**0.5 + 8**0.5) / 3, 0),
        ([[0, 0]], (2 * 10**0.5 + 8**0.5) / 3, (2 * 10**0.5 + 8**0.5) / 3),
    ],
)
def test_distances_by_hand(points: Any, plain: float, plus: float) -> None:
    assert igd(points, STAIRS) == pytest.approx(plain)
    assert igd_plus(points, STAIRS) == pytest.approx(plus)


@given(grids(), st.randoms(use_true_random=False))
def test_distances_agree_with_loops(points: Points, random: Any) -> None:
    front = np.array([[random.uniform(0, 5) for _ in range(points.shape[1])] for _ in range(4)])

    def mean_distance(distance: Callable[[Points, Points], float]) -> float:
        return float(np.mean([min(distance(point, wanted) for point in points) for wanted in front]))

    expected = mean_distance(lambda point, wanted: float(np.linalg.norm(wanted - point)))
    assert igd(points, front) == pytest.approx(expected)
    missing = mean_distance(lambda point, wanted: float(np.linalg.norm(np.maximum(wanted - point, 0.0))))
    assert igd_plus(points, front) == pytest.approx(missing)


def test_only_igd_plus_never_prefers_the_dominated_set() -> None:
    front = [[10, 0], [6, 1], [2, 2], [1, 6], [0, 10]]
    better, worse = -np.array([[4, 2], [3, 3], [2, 4]]), -np.array([[8, 2], [4, 4], [2, 8]])
    assert all(any((point >= other).all() for point in better) for other in worse)
    assert igd(better, -np.array(front)) > igd(worse, -np.array(front))
    assert igd_plus(better, -np.array(front)) < igd_plus(worse, -np.array(front))


# Expected utility


def test_expected_utility_by_hand() -> None:
    weights = [[1, 0], [0.5, 0.5], [0.25, 0.75]]
    assert expected_utility([[4, 0], [0, 2]], weights) == pytest.approx((4 + 2 + 1.5) / 3)


def test_expected_utility_of_two_extremes_is_the_mean_of_the_larger_weight() -> None:
    weights = uniform_weights(20_000, 2, np.random.default_rng(0))
    # The integral of max(w, 1 - w) over [0, 1].
    assert expected_utility(np.eye(2), weights) == pytest.approx(0.75, abs=0.005)


@pytest.mark.parametrize("dim", [2, 3, 5])
def test_weights_are_uniform_on_the_simplex(dim: int) -> None:
    weights = uniform_weights(20_000, dim, np.random.default_rng(1))
    assert weights.shape == (20_000, dim)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    for threshold in (0.1, 0.3, 0.6):
        # What is above a threshold is a simplex of edge 1 - threshold.
        share = (weights > threshold).mean(axis=0)
        np.testing.assert_allclose(share, (1 - threshold) ** (dim - 1), atol=0.015)


def test_weights_come_from_the_generator() -> None:
    first, second, other = (uniform_weights(5, 3, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert first.tolist() == second.tolist() != other.tolist()


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ([[0.5, 0.5, 0.0]], r"weights has shape \(1, 3\); it must be \(m, 2\) with m >= 1"),
        ([0.5, 0.5], r"weights has shape \(2,\); it must be \(m, 2\) with m >= 1"),
        (np.zeros((0, 2)), r"weights has shape \(0, 2\); it must be \(m, 2\) with m >= 1"),
        ([[1, 0], [1, 1]], r"weights\[1\] is \[1.0, 1.0\]; weights must be nonnegative and sum to 1"),
        ([[1.5, -0.5]], r"weights\[0\] is \[1.5, -0.5\]; weights must be nonnegative and sum to 1"),
        ([[float("nan"), 1]], r"weights\[0\] is \[nan, 1.0\]; every value must be finite"),
    ],
)
def test_impossible_weights_are_refused(weights: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        expected_utility(STAIRS, weights)


def test_weights_may_be_single_precision() -> None:
    weights = uniform_weights(100, 3, np.random.default_rng(0))
    assert expected_utility(np.eye(3), weights.astype(np.float32)) == pytest.approx(
        expected_utility(np.eye(3), weights)
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 2), "num_weights is 0; it must be at least 1"),
        ((5, 1), "num_objectives is 1; it must be at least 2"),
    ],
)
def test_no_weights_are_refused(arguments: tuple[int, int], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        uniform_weights(*arguments, np.random.default_rng(0))


# Pareto and convex optimality

HOLLOW = [[0, 4], [1, 1], [4, 0], [4, 0], [3, 0], [2, 2]]


@pytest.mark.parametrize(
    ("points", "pareto", "convex"),
    [
        ([[1, 1]], [True], [True]),
        ([[1, 1], [1, 1]], [True, True], [True, True]),
        # (1, 1) is dominated by (2, 2), (3, 0) by (4, 0); (2, 2) lies on the edge between the others.
        (HOLLOW, [1, 0, 1, 1, 0, 1], [1, 0, 1, 1, 0, 1]),
        # Below the edge from (0, 4) to (4, 0), on it, above it.
        ([[0, 4], [1.9, 2], [4, 0]], [1, 1, 1], [1, 0, 1]),
        ([[0, 4], [2, 2], [4, 0]], [1, 1, 1], [1, 1, 1]),
        ([[0, 4], [2.1, 2], [4, 0]], [1, 1, 1], [1, 1, 1]),
        # Within and beyond the tolerance, which dominance does not have.
        ([[0, 1], [0.5, 0.5 - 8e-9], [1, 0]], [1, 1, 1], [1, 1, 1]),
        ([[0, 1], [0.5, 0.5 - 12e-9], [1, 0]], [1, 1, 1], [1, 0, 1]),
        ([[0, 1], [0.5, 0.5 - 1e-9], [0.5, 0.5], [1, 0]], [1, 0, 1, 1], [1, 0, 1, 1]),
        # Ranges are those of the Pareto-optimal points.
        ([[0, 1], [0.5, 0.4], [1, 0], [-1e10, -1e10]], [1, 1, 1, 0], [1, 0, 1, 0]),
        ([[0, 1e-10], [0.5, 0.4e-10], [1, 0]], [1, 1, 1], [1, 0, 1]),
        # The mean of the corners dominates (0.3, 0.3, 0.3), though no pair of them does.
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.3, 0.3]], [1, 1, 1, 1], [1, 1, 1, 0]),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.34, 0.34, 0.34]], [1, 1, 1, 1], [1, 1, 1, 1]),
        # Weight on the third objective alone would make all of these optimal.
        ([[0, 4, 5], [1, 2, 5], [4, 0, 5]], [1, 1, 1], [1, 0, 1]),
    ],
)
def test_optimality_by_hand(points: Any, pareto: list[int], convex: list[int]) -> None:
    assert pareto_optimal(points).tolist() == [bool(mark) for mark in pareto]
    assert convex_coverage(points).tolist() == [bool(mark) for mark in convex]


@given(grids(most=12))
def test_pareto_optimal_agrees_with_comparing_all_pairs(points: Points) -> None:
    expected = [not any(dominates(other, point) for other in points) for point in points]
    assert pareto_optimal(points).tolist() == expected


@given(grids(dims=(2,), most=12))
def test_convex_coverage_is_what_a_grid_of_weights_finds(points: Points) -> None:
    # Exact: the weights under which points up to 5 apart tie are ratios of integers up to 5.
    found = np.zeros(len(points), dtype=bool)
    for weights in itertools.product(range(1, 6), repeat=2):
        scalarised = points @ weights
        found |= scalarised == scalarised.max()
    assert convex_coverage(points).tolist() == found.tolist()


def optimal_for_positive_weights(points: Points, point: Points) -> bool:
    """Whether a three-dimensional point is best under some weights w >= 1: tries the corners of their set."""
    normals = np.vstack([np.eye(3), point - points])
    bounds = np.append(np.ones(3), np.zeros(len(points)))
    for rows in itertools.combinations(range(len(normals)), 3):
        corner = normals[list(rows)]
        if abs(np.linalg.det(corner)) > 0.5:
            weights = np.linalg.solve(corner, bounds[list(rows)])
            if (normals @ weights >= bounds - 1e-9).all():
                return True
    return False


@given(grids(dims=(3,), most=6, highest=4))
def test_convex_coverage_is_what_some_positive_weights_choose(points: Points) -> None:
    expected = [optimal_for_positive_weights(points, point) for point in points]
    assert convex_coverage(points).tolist() == expected


@given(grids(), st.lists(st.floats(1e-12, 1e12), min_size=4, max_size=4))
def test_coverage_does_not_depend_on_scales(points: Points, scales: list[float]) -> None:
    assert convex_coverage(points * scales[: points.shape[1]]).tolist() == convex_coverage(points).tolist()


@given(grids())
def test_the_coverage_set_holds_every_best_scalarised_return(points: Points) -> None:
    weights = uniform_weights(50, points.shape[1], np.random.default_rng(0))
    pareto, convex = pareto_optimal(points), convex_coverage(points)
    assert convex.any()
    assert not (convex & ~pareto).any()
    assert expected_utility(points[convex], weights) == pytest.approx(expected_utility(points, weights))


def test_a_larger_front_is_covered() -> None:
    angles = np.linspace(0, np.pi / 2, 60)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.concatenate([circle, 0.99 * circle])
    assert convex_coverage(points).tolist() == [True] * 60 + [False] * 60
    assert convex_coverage(1 - circle).tolist() == [True, *[False] * 58, True]


# Preference deviation


def test_preference_deviation_by_hand() -> None:
    objectives = [[6, 2, 2], [5, 5, 0], [0, 9, 0], [0, 0, 0], [0.6, 0.2, 0.2]]
    deviations = preference_deviation(objectives, [3, 1, 1])
    half = 0.5 * np.log(0.5 / 0.6) + 0.5 * np.log(0.5 / 0.2)
    np.testing.assert_allclose(deviations, [0, half, np.log(5), np.inf, 0], atol=1e-15)


def test_policies_may_have_ratios_of_their_own() -> None:
    # The first is the example of section 5.2.2.
    deviations = preference_deviation([[3, 5, 7], [4, 4, 4]], [[1, 2, 3], [1, 1, 1]])
    example = 3 / 15 * np.log(18 / 15) + 7 / 15 * np.log(14 / 15)
    np.testing.assert_allclose(deviations, [example, 0], atol=1e-15)


@given(grids(dims=(3,)), st.lists(st.floats(0.1, 9), min_size=3, max_size=3), st.floats(0.1, 100))
def test_deviation_ignores_totals_and_is_no_less_than_zero(
    points: Points, ratio: list[float], factor: float
) -> None:
    deviations = preference_deviation(points, ratio)
    assert (deviations >= 0).all()
    np.testing.assert_allclose(preference_deviation(factor * points, ratio), deviations, atol=1e-12)
    np.testing.assert_allclose(preference_deviation(points, factor * np.array(ratio)), deviations, atol=1e-12)


@given(st.lists(st.integers(0, 6), min_size=6, max_size=6))
def test_a_ratio_teacher_prefers_the_smaller_deviation(counters: list[int]) -> None:
    pair = np.array(counters).reshape(2, 3)
    first, second = preference_deviation(pair, [2, 1, 3])
    answer = RatioTeacher({"a": 2, "b": 1, "c": 3}, ("a", "b", "c")).prefer(Query(np.zeros((2, 2)), pair))
    if first == second:
        assert answer is Preference.EQUAL
    else:
        assert answer is (Preference.FIRST if first < second else Preference.SECOND)


@pytest.mark.parametrize(
    ("objectives", "ratio", "message"),
    [
        ([[1, -2]], [1, 1], "objectives holds -2.0; counters must not be negative"),
        ([[1, 2]], [1, 1, 1], r"ratio has shape \(3,\); it must be \(2,\) or \(1, 2\)"),
        ([[1, 2]], [[1, 1], [1, 1]], r"ratio has shape \(2, 2\); it must be \(2,\) or \(1, 2\)"),
        ([[1, 2]], [1, 0], "ratio holds 0.0; every share must be positive and finite"),
        ([[1, 2]], [1, float("nan")], "ratio holds nan; every share must be positive and finite"),
        ([[1, 2]], [1, float("inf")], "ratio holds inf; every share must be positive and finite"),
    ],
)
def test_an_impossible_deviation_is_refused(objectives: Any, ratio: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        preference_deviation(objectives, ratio)


# What all measures share


@every_measure
@pytest.mark.parametrize("shape", [(2,), (0, 2), (3, 0), (3, 1), (2, 2, 2)])
def test_wrong_shapes_are_refused(measure: Callable[[Points], Any], shape: tuple[int, ...]) -> None:
    with pytest.raises(
        ValueError,
        match=r"^(points|objectives) has shape \(.*\); it must be \(n, k\) with n >= 1 and k >= 2$",
    ):
        measure(np.ones(shape))


@every_measure
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_values_that_are_not_finite_are_refused(measure: Callable[[Points], Any], value: float) -> None:
    with pytest.raises(
        ValueError, match=rf"^(points|objectives)\[1\] is \[2.0, {value}\]; every value must be finite$"
    ):
        measure(np.array([[1, 2], [2, value], [value, 3]]))


@pytest.mark.parametrize("distance", [igd, igd_plus])
def test_an_impossible_front_is_refused(distance: Callable[[Any, Any], float]) -> None:
    with pytest.raises(ValueError, match=r"^front has shape \(1, 3\); it must be \(m, 2\) with m >= 1$"):
        distance(STAIRS, [[1, 2, 3]])
    with pytest.raises(ValueError, match=r"^front has shape \(0, 2\); it must be \(m, 2\) with m >= 1$"):
        distance(STAIRS, np.zeros((0, 2)))
    with pytest.raises(ValueError, match=r"^front\[0\] is \[nan, 1.0\]; every value must be finite$"):
        distance(STAIRS, [[float("nan"), 1]])


@every_measure
@given(data=st.data())
@settings(max_examples=40)
def test_the_order_of_the_points_does_not_matter(
    measure: Callable[[Points], Any], data: st.DataObject
) -> None:
    points = data.draw(grids())
    order = data.draw(st.permutations(range(len(points))))
    result, permuted = measure(points), measure(points[order])
    if isinstance(result, float):
        assert permuted == pytest.approx(result)
    else:
        assert permuted.tolist() == result[order].tolist()


@given(grids(), st.lists(st.integers(0, 5), min_size=4, max_size=4))
def test_another_point_never_makes_a_set_worse(points: Points, values: list[int]) -> None:
    more = np.vstack([points, values[: points.shape[1]]])
    lowest, ideal = np.zeros(points.shape[1]), np.full((1, points.shape[1]), 4.0)
    weights = uniform_weights(20, points.shape[1], np.random.default_rng(0))
    assert hypervolume(more, lowest) >= hypervolume(points, lowest) - 1e-9
    assert igd(more, ideal) <= igd(points, ideal)
    assert igd_plus(more, ideal) <= igd_plus(points, ideal)
    assert expected_utility(more, weights) >= expected_utility(points, weights) - 1e-9


@given(grids(dims=(3,)), grids(dims=(3,)), st.integers(0, 2))
def test_a_set_that_dominates_another_measures_no_worse(
    points: Points, front: Points, objective: int
) -> None:
    better = points + np.eye(3)[objective]
    assert hypervolume(better, np.zeros(3)) >= hypervolume(points, np.zeros(3)) - 1e-9
    assert igd_plus(better, front) <= igd_plus(points, front)


@every_measure
def test_nothing_is_changed(measure: Callable[[Points], Any]) -> None:
    points = STAIRS.copy()
    points.flags.writeable = False
    first, again = measure(points), measure(points)
    assert np.array_equal(first, again)
    assert points.tolist() == STAIRS.tolist()


def test_integers_and_lists_will_do() -> None:
    assert hypervolume([[1, 3], [2, 2], [3, 1]], [0, 0]) == hypervolume(STAIRS, [0.0, 0.0])
    assert convex_coverage([[1, 3], [2, 2]]).tolist() == [True, True]


def test_preferences_need_neither_library() -> None:
    script = (
        "import sys; import moral_algorithms.preferences, moral_algorithms.cli; "
        "print([name for name in ('scipy', 'moocore') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
