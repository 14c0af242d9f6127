"""The discounted coverage set of Emergency and its hypervolume against slow, obvious computations."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moral_envs import burning_warehouse_v0, delivery_v0, discounted, emergency_v0, optimal
from moral_envs.layouts import Layout
from moral_envs.world import Effect, World
from tests.envs.test_optimal import (
    FULL_HORIZON,
    Starts,
    State,
    initial_state,
    random_starts,
    simulate,
    tiny_starts,
)

Returns = npt.NDArray[np.float64]

WEIGHTS = np.stack([1 - np.linspace(0, 1, 41), np.linspace(0, 1, 41)], axis=1)
TOLERANCE = 1e-9


def rewards(before: State, after: State, start: Starts) -> Returns:
    """Reward vector of one step in the slow simulator."""
    return np.array([0.1 * start[3][after.agent], len(before.people) - len(after.people)])


def exhaustive_returns(start: Starts, horizon: int, gamma: float) -> Returns:
    """Discounted returns of all action sequences; those that differ in no event are followed once."""
    ends = {(initial_state(start), (0.0, 0.0))}
    for step in range(horizon):
        ends = {
            (after, tuple((total + gamma**step * rewards(state, after, start)).tolist()))
            for state, total in ends
            for after in {simulate(start, state, action) for action in range(9)}
        }
    return np.array([total for _, total in ends])


def best_value(start: Starts, horizon: int, gamma: float, weights: Returns) -> float:
    """Greatest scalarised return, by recursion over the slow simulator's states."""

    @cache
    def value(state: State, steps_left: int) -> float:
        if not steps_left:
            return 0.0
        return max(
            float(weights @ rewards(state, after, start))
            + gamma * value(after._replace(goal_time=0), steps_left - 1)
            for after in {simulate(start, state, action) for action in range(9)}
        )

    return value(initial_state(start), horizon)


def assert_convex(points: Returns) -> Returns:
    """Check that each row is a Pareto optimal vertex; return weights for which it alone is best."""
    lost, gained = -np.diff(points[:, 0]), np.diff(points[:, 1])
    assert (lost > 0).all()
    assert (gained > 0).all()
    switches = lost / (lost + gained)
    assert (np.diff(switches) > 0).all()
    bounds = np.concatenate([[0.0], switches, [1.0]])
    inside = (bounds[:-1] + bounds[1:]) / 2
    return np.stack([1 - inside, inside], axis=1)


@pytest.fixture(scope="module")
def starts() -> Starts:
    return random_starts(seed=0, n=20)


@settings(deadline=None, max_examples=60)
@given(
    start=tiny_starts(),
    horizon=st.integers(0, 5),
    gamma=st.sampled_from([0.0, 0.3, 0.5, 0.9, 0.98, 0.999, 1.0]),
)
def test_set_is_that_of_all_action_sequences(start: Starts, horizon: int, gamma: float) -> None:
    found = optimal.discounted_coverage_set(start[np.newaxis], horizon, gamma)
    every = exhaustive_returns(start, horizon, gamma)
    assert found.dtype == np.float64
    weights = np.concatenate([WEIGHTS, assert_convex(found)])
    np.testing.assert_allclose(
        (weights @ found.T).max(axis=1), (weights @ every.T).max(axis=1), atol=TOLERANCE
    )
    # Every vertex is the return of an action sequence.
    distances = np.abs(found[:, np.newaxis] - every).max(axis=2).min(axis=1)
    assert distances.max() < 1e-12


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), gamma=st.sampled_from([0.6, 0.95, 0.99]))
def test_average_is_that_of_each_starts_best(seed: int, gamma: float) -> None:
    few = random_starts(seed, n=3, height=5, width=6, people=2)
    found = optimal.discounted_coverage_set(few, 5, gamma)
    weights = np.concatenate([WEIGHTS, assert_convex(found)])
    best = [(weights @ exhaustive_returns(start, 5, gamma).T).max(axis=1) for start in few]
    np.testing.assert_allclose((weights @ found.T).max(axis=1), np.mean(best, axis=0), atol=TOLERANCE)


@pytest.mark.parametrize("gamma", [0.8, 0.97])
def test_long_horizons_agree_with_a_recursion(gamma: float) -> None:
    start = random_starts(seed=3, n=1, height=6, width=6, people=3)
    found = optimal.discounted_coverage_set(start, 14, gamma)
    assert len(found) > 2
    for weights in [*WEIGHTS[::20], *assert_convex(found)]:
        expected = best_value(start[0], 14, gamma, weights)
        assert (found @ weights).max() == pytest.approx(expected, abs=TOLERANCE)


@pytest.mark.parametrize("horizon", [75, 12, 1, 0])
def test_without_discount_it_is_the_coverage_set(starts: Starts, horizon: int) -> None:
    expected = optimal.coverage_set(starts, horizon).points * [optimal.EXTINGUISH_REWARD, 1.0]
    np.testing.assert_array_equal(optimal.discounted_coverage_set(starts, horizon), expected)
    # Just below 1 the search over weights finds the same set.
    searched = optimal.discounted_coverage_set(starts, horizon, np.nextafter(1.0, 0.0))
    weights = np.concatenate([WEIGHTS, assert_convex(expected)])
    np.testing.assert_allclose(
        (weights @ searched.T).max(axis=1), (weights @ expected.T).max(axis=1), atol=TOLERANCE
    )


def test_the_set_moves_continuously_as_the_discount_goes_to_one(starts: Starts) -> None:
    few = starts[:5]
    limit = (WEIGHTS @ optimal.discounted_coverage_set(few, FULL_HORIZON).T).max(axis=1)
    for shortfall in (1e-3, 1e-5, 1e-7):
        near = optimal.discounted_coverage_set(few, FULL_HORIZON, 1 - shortfall)
        lost = limit - (WEIGHTS @ near.T).max(axis=1)
        # No reward is discounted by more than that of the last step, and no return exceeds 7.5 and 6.
        most = (1 - (1 - shortfall) ** (FULL_HORIZON - 1)) * (WEIGHTS @ [7.5, 6.0])
        assert (lost >= -TOLERANCE).all()
        assert (lost <= most + TOLERANCE).all()


def test_least_weight_on_saving_walks_straight_to_the_extinguisher(starts: Starts) -> None:
    gamma = 0.98
    # The bottom right of the free cells; there are no walls inside.
    distances = np.abs(np.argwhere(starts[:, 1])[:, 1:] - 6).sum(axis=1)
    returns = [0.1 * (gamma ** np.arange(max(d - 1, 0), FULL_HORIZON)).sum() for d in distances]
    found = optimal.discounted_coverage_set(starts, FULL_HORIZON, gamma)
    assert found[0, 0] == pytest.approx(np.mean(returns), abs=TOLERANCE)


def test_vertices_dominate_the_best_policies_without_discount(starts: Starts) -> None:
    gamma = 0.98
    discounts = gamma ** np.arange(FULL_HORIZON)
    for start in starts[:5]:
        found = optimal.discounted_coverage_set(start[np.newaxis], FULL_HORIZON, gamma)
        for people_saved in range(7):
            state, total = initial_state(start), np.zeros(2)
            for discount, action in zip(
                discounts, optimal.optimal_actions(start, FULL_HORIZON, people_saved).tolist(), strict=True
            ):
                after = simulate(start, state, action)
                total += discount * rewards(state, after, start)
                state = after
            assert ((WEIGHTS @ found.T).max(axis=1) >= WEIGHTS @ total - TOLERANCE).all()


def test_a_batch_is_worked_off_in_chunks(starts: Starts, monkeypatch: pytest.MonkeyPatch) -> None:
    few = starts[:7]
    whole = optimal.discounted_coverage_set(few, 30, 0.95)
    singles = [optimal.discounted_coverage_set(start[np.newaxis], 30, 0.95) for start in few]
    for weights in WEIGHTS:
        mean = np.mean([(single @ weights).max() for single in singles])
        assert (whole @ weights).max() == pytest.approx(mean, abs=TOLERANCE)
    # Three starts to a chunk leave a last chunk of one.
    monkeypatch.setattr(discounted, "_CHUNK_STATES", 3 * 2**6 * 64)
    np.testing.assert_array_equal(optimal.discounted_coverage_set(few, 30, 0.95), whole)


def test_mirrored_worlds_have_the_same_set(starts: Starts) -> None:
    few = starts[:4]
    found = optimal.discounted_coverage_set(few, 40, 0.97)
    for mirrored in (few[:, :, ::-1], few[:, :, :, ::-1], few.swapaxes(2, 3)):
        other = optimal.discounted_coverage_set(mirrored, 40, 0.97)
        np.testing.assert_allclose(
            (WEIGHTS @ other.T).max(axis=1), (WEIGHTS @ found.T).max(axis=1), atol=TOLERANCE
        )


@pytest.mark.parametrize("gamma", [-0.1, 1.01, np.nan])
def test_impossible_discounts_are_refused(starts: Starts, gamma: float) -> None:
    with pytest.raises(ValueError, match=rf"^gamma is {gamma}; [^\n]+$"):
        optimal.discounted_coverage_set(starts, 5, gamma)


def test_impossible_starts_and_horizons_are_refused(starts: Starts) -> None:
    with pytest.raises(ValueError, match=r"^horizon is -1; "):
        optimal.discounted_coverage_set(starts, -1, 0.9)
    with pytest.raises(ValueError, match=r"^starts has shape \(4, 8, 8\); "):
        optimal.discounted_coverage_set(starts[0], 5, 0.9)


def test_seeded_starts_are_those_of_the_vector_environment() -> None:
    arguments: tuple[dict[str, Any], ...] = ({}, {"height": 5, "width": 9, "num_people": 2, "max_cycles": 20})
    for rules in arguments:
        found = optimal.seeded_starts(emergency_v0.world(**rules), num_starts=30, seed=5)
        expected, _ = emergency_v0.vector_env(num_envs=30, **rules).reset(seed=5)
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == np.uint8
    assert optimal.seeded_starts(emergency_v0.world()).shape == (100, 4, 8, 8)


@pytest.mark.parametrize("layout", ["maze", "spiral", Layout(height=(5, 8), counts={"people": 3})])
def test_seeded_starts_may_have_walls_and_sizes_of_their_own(layout: Layout | str) -> None:
    found = optimal.seeded_starts(emergency_v0.world().in_layout(layout), num_starts=6)
    assert found[:, 0, 1:-1, 1:-1].any()
    # The rules accept them, and walls only ever cost.
    people = int(found[0, 2].sum())
    walled = optimal.discounted_coverage_set(found, 25, 0.95)
    assert (found[:, 2].sum(axis=(1, 2)) == people).all()
    opened = found.copy()
    opened[:, 0, 1:-1, 1:-1] = 0
    free = optimal.discounted_coverage_set(opened, 25, 0.95)
    assert ((WEIGHTS @ walled.T).max(axis=1) <= (WEIGHTS @ free.T).max(axis=1) + TOLERANCE).all()


def dearer_people() -> World:
    """Emergency with another reward."""
    world = emergency_v0.world()
    return replace(
        world, objects=(replace(world.objects[0], on_interact=Effect("save", 2.0, "people_saved")),)
    )


@pytest.mark.parametrize(
    ("world", "message"),
    [
        (delivery_v0.world(), "objects is ('deliveries', 'people', 'pollution', 'vases') in delivery_v0; "),
        (burning_warehouse_v0.world(), "pickup is 'enter' in burning_warehouse_v0; it must be 'interact', "),
        (emergency_v0.world(pickup="enter"), "pickup is 'enter' in emergency_v0; it must be 'interact', "),
        (emergency_v0.world(walk=0.25), "walk is 0.25 in emergency_v0; it must be 0.0, "),
        (
            dearer_people(),
            "on_interact is Effect(reward='save', amount=2.0, objective='people_saved') in emergency_v0; ",
        ),
        (replace(emergency_v0.world(), fixture=None), "on_stand is None in emergency_v0; "),
        (replace(emergency_v0.world(), slip=0.1), "slip is 0.1 in emergency_v0; "),
        (emergency_v0.world(num_people=13), "num_people is 13; it must be at most 12, "),
        (
            emergency_v0.world().in_layout(Layout(counts={"people": (2, 4)})),
            "layout draws people from (2, 4); ",
        ),
        (
            emergency_v0.world().in_layout(Layout(max_cycles=(50, 75))),
            "layout draws max_cycles from (50, 75); ",
        ),
    ],
)
def test_worlds_whose_optimum_is_unknown_are_refused(world: World, message: str) -> None:
    with pytest.raises(ValueError, match=rf"^{re.escape(message)}[^\n]+$"):
        optimal.seeded_starts(world)


def test_impossible_numbers_of_starts_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^num_starts is 0; "):
        optimal.seeded_starts(emergency_v0.world(), num_starts=0)
    with pytest.raises(ValueError, match=r"^num_starts is 2.5; it must be an integer, at least 1$"):
        optimal.seeded_starts(emergency_v0.world(), 2.5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^seed is -1; "):
        optimal.seeded_starts(emergency_v0.world(), seed=-1)


def test_a_module_is_no_world() -> None:
    message = r"^world is <module .*>; it must be a World, as emergency_v0.world\(\) returns it$"
    with pytest.raises(ValueError, match=message):
        optimal.seeded_starts(emergency_v0)  # type: ignore[arg-type]


@pytest.mark.parametrize("gamma", ["x", "0.5", None, np.ones(2), np.nan, -0.1, 1.01])
def test_what_is_no_discount_is_refused(gamma: Any, starts: Starts) -> None:
    with pytest.raises(ValueError, match=r"^gamma is [^\n]+; it must be a discount from 0 to 1$"):
        optimal.discounted_coverage_set(starts[:1], 5, gamma)


def test_a_discount_may_be_of_any_kind_of_number(starts: Starts) -> None:
    for gamma in (np.float64(0.5), np.float32(0.5)):
        found = optimal.discounted_coverage_set(starts[:1], 5, gamma)
        np.testing.assert_array_equal(found, optimal.discounted_coverage_set(starts[:1], 5, 0.5))
    whole = optimal.discounted_coverage_set(starts[:1], 5)
    np.testing.assert_array_equal(optimal.discounted_coverage_set(starts[:1], 5, 1), whole)


def test_hypervolume_of_stairs() -> None:
    stairs = [(2.0, 2.0), (1.0, 3.0), (3.0, 1.0)]
    assert optimal.hypervolume(stairs) == 6.0
    assert optimal.hypervolume([np.array(point) for point in stairs]) == 6.0
    # Dominated points, doubles and points beside the reference point add nothing.
    assert optimal.hypervolume([*stairs, *stairs, (1.0, 1.0), (9.0, 0.0), (-1.0, 9.0)]) == 6.0
    # From (1, 1) only the middle stair is seen, from (-1, 0) one more column.
    assert optimal.hypervolume(stairs, (1, 1)) == 1.0
    assert optimal.hypervolume(stairs, (-1, 0)) == 9.0
    assert optimal.hypervolume(stairs, (3, 3)) == 0.0
    assert optimal.hypervolume([]) == 0.0
    assert optimal.REFERENCE_POINT == (0.0, 0.0)


@settings(deadline=None)
@given(
    points=st.lists(st.tuples(st.integers(-3, 8), st.integers(-3, 8)), max_size=12),
    reference=st.tuples(st.integers(-3, 8), st.integers(-3, 8)),
)
def test_hypervolume_counts_the_dominated_unit_squares(
    points: list[tuple[int, int]], reference: tuple[int, int]
) -> None:
    squares = sum(
        any(x > column and y > row for x, y in points)
        for column in range(reference[0], 8)
        for row in range(reference[1], 8)
    )
    assert optimal.hypervolume(points, reference) == squares
    scaled = np.array(points, dtype=np.float64).reshape(-1, 2) * [0.1, 0.5]
    found = optimal.hypervolume(scaled, np.array(reference) * [0.1, 0.5])
    assert found == pytest.approx(0.05 * squares, abs=1e-12)


def test_the_hypervolume_of_the_set_grows_with_the_discount(starts: Starts) -> None:
    few = starts[:5]
    volumes = [
        optimal.hypervolume(optimal.discounted_coverage_set(few, FULL_HORIZON, gamma))
        for gamma in (0.9, 0.98, 1.0)
    ]
    assert 0 < volumes[0] < volumes[1] < volumes[2] < 7.5 * 6


@pytest.mark.parametrize(
    ("points", "reference", "message"),
    [
        ([[1.0, 2.0, 3.0]], (0, 0), "points has shape (1, 3); it must be (m, 2)"),
        ([1.0, 2.0], (0, 0), "points has shape (2,); it must be (m, 2)"),
        ([[1.0, 2.0], [np.nan, 1.0]], (0, 0), "points[1] is [nan, 1.0]; "),
        ("a", (0, 0), "points is 'a'; it must be an array of "),
        ([[1.0, 2.0], [3.0]], (0, 0), "points is [[1.0, 2.0], [3.0]]; it must be "),
        ([[1.0, 2.0]], None, "reference is nan; it must be two finite "),
        ([[1.0, np.inf]], (0, 0), "points[0] is [1.0, inf]; "),
        ([[1.0, 2.0]], (0, 0, 0), "reference is [0.0, 0.0, 0.0]; "),
        ([[1.0, 2.0]], (0, np.nan), "reference is [0.0, nan]; "),
    ],
)
def test_what_has_no_area_is_refused(points: npt.ArrayLike, reference: npt.ArrayLike, message: str) -> None:
    with pytest.raises(ValueError, match=rf"^{re.escape(message)}[^\n]+$"):
        optimal.hypervolume(points, reference)
