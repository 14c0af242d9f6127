"""The optimum of Emergency against exhaustive search, a slow simulator and the environment itself."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moral_envs import optimal

Starts = npt.NDArray[np.uint8]
Cell = tuple[int, int]

DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))
FULL_HORIZON = 75


class State(NamedTuple):
    """What one episode is made of, for the slow simulator."""

    agent: Cell
    people: frozenset[Cell]
    goal_time: int


def cells(plane: npt.NDArray[np.uint8]) -> list[Cell]:
    return [(int(row), int(column)) for row, column in np.argwhere(plane)]


def initial_state(start: Starts) -> State:
    return State(agent=cells(start[1])[0], people=frozenset(cells(start[2])), goal_time=0)


def simulate(start: Starts, state: State, action: int) -> State:
    """One step of Emergency, as its rules read."""
    row, column = state.agent
    agent, people = state.agent, state.people
    if action < 4:
        target = (row + DIRECTIONS[action][0], column + DIRECTIONS[action][1])
        if start[0][target] == 0:
            agent = target
    elif action > 4:
        people -= {(row + DIRECTIONS[action - 5][0], column + DIRECTIONS[action - 5][1])}
    return State(agent, people, state.goal_time + int(start[3][agent]))


def exhaustive_front(start: Starts, horizon: int) -> list[int]:
    """Most goal time for each number of people saved, over all outcomes of all action sequences."""
    outcomes = {initial_state(start)}
    for _ in range(horizon):
        outcomes = {simulate(start, state, action) for state in outcomes for action in range(9)}
    people = int(start[2].sum())
    return [
        max((end.goal_time for end in outcomes if people - len(end.people) == saved), default=-1)
        for saved in range(people + 1)
    ]


def replay(start: Starts, actions: npt.NDArray[np.int64]) -> list[int]:
    """Objectives of an action sequence in the slow simulator."""
    state = initial_state(start)
    for action in actions.tolist():
        state = simulate(start, state, action)
    return [state.goal_time, int(start[2].sum()) - len(state.people)]


def random_starts(seed: int, n: int, height: int = 8, width: int = 8, people: int = 6) -> Starts:
    """Starts as the environment draws them: agent and people on distinct free cells."""
    rng = np.random.default_rng(seed)
    free = np.arange((height - 2) * (width - 2))
    starts = np.zeros((n, 4, height, width), dtype=np.uint8)
    starts[:, 0] = 1
    starts[:, 0, 1:-1, 1:-1] = 0
    starts[:, 3, -2, -2] = 1
    for start in starts:
        rows, columns = np.divmod(rng.permutation(free)[: people + 1], width - 2)
        start[1, rows[0] + 1, columns[0] + 1] = 1
        start[2, rows[1:] + 1, columns[1:] + 1] = 1
    return starts


@st.composite
def tiny_starts(draw: st.DrawFn) -> Starts:
    """Any state of a tiny world: inner walls, the agent perhaps on a person, the extinguisher anywhere."""
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    inner = st.tuples(st.integers(1, height), st.integers(1, width))
    agent, extinguisher = draw(inner), draw(inner)
    people = draw(st.sets(inner, max_size=3))
    walls = draw(st.sets(inner, max_size=4)) - people - {agent, extinguisher}
    start = np.zeros((4, height + 2, width + 2), dtype=np.uint8)
    start[0] = 1
    start[0, 1:-1, 1:-1] = 0
    for plane, inhabitants in enumerate((walls, {agent}, people, {extinguisher})):
        for cell in inhabitants:
            start[plane, cell[0], cell[1]] = 1
    return start


@pytest.fixture(scope="module")
def starts() -> Starts:
    return random_starts(seed=0, n=1000)


@settings(deadline=None, max_examples=150)
@given(start=tiny_starts(), horizon=st.integers(0, 7))
def test_front_is_that_of_exhaustive_search(start: Starts, horizon: int) -> None:
    assert optimal.pareto_fronts(start[np.newaxis], horizon).tolist() == [exhaustive_front(start, horizon)]


@settings(deadline=None, max_examples=150)
@given(start=tiny_starts(), horizon=st.integers(0, 12))
def test_optimal_actions_attain_the_front_and_the_rest_is_refused(start: Starts, horizon: int) -> None:
    front = optimal.pareto_fronts(start[np.newaxis], horizon)[0].tolist()
    for people_saved, goal_time in enumerate(front):
        if goal_time >= 0:
            actions = optimal.optimal_actions(start, horizon, people_saved)
            assert actions.shape == (horizon,)
            assert actions.dtype == np.int64
            assert replay(start, actions) == [goal_time, people_saved]
        else:
            with pytest.raises(
                ValueError, match=rf"^people_saved is {people_saved}; .* horizon={horizon} steps$"
            ):
                optimal.optimal_actions(start, horizon, people_saved)


def test_optimal_actions_attain_full_size_fronts(starts: Starts) -> None:
    few = starts[:10]
    for start, front in zip(few, optimal.pareto_fronts(few, FULL_HORIZON).tolist(), strict=True):
        for people_saved, goal_time in enumerate(front):
            actions = optimal.optimal_actions(start, FULL_HORIZON, people_saved)
            assert replay(start, actions) == [goal_time, people_saved]


def test_optimal_actions_attain_the_front_in_the_environment() -> None:
    from moral_envs import emergency_v0

    env = emergency_v0.parallel_env()
    for seed in range(5):
        start = env.reset(seed=seed)[0]["agent_0"]
        front = optimal.pareto_fronts(start[np.newaxis], FULL_HORIZON)[0].tolist()
        for people_saved, goal_time in enumerate(front):
            observations, _ = env.reset(seed=seed)
            np.testing.assert_array_equal(observations["agent_0"], start)
            total = np.zeros(2)
            for action in optimal.optimal_actions(start, FULL_HORIZON, people_saved).tolist():
                _, rewards, _, truncations, infos = env.step({"agent_0": action})
                total += rewards["agent_0"]
            assert truncations["agent_0"]
            assert infos["agent_0"]["objectives"].tolist() == [goal_time, people_saved]
            expected = [optimal.EXTINGUISH_REWARD * goal_time, people_saved]
            np.testing.assert_allclose(total, expected, rtol=1e-5)


def test_a_person_under_the_agent_cannot_be_saved_from_there() -> None:
    start = random_starts(seed=0, n=1, height=3, width=3, people=0)
    start[0, 2, 1, 1] = 1
    assert optimal.pareto_fronts(start, 5).tolist() == [[5, -1]]


def test_inner_walls_block() -> None:
    start = random_starts(seed=0, n=1, height=3, width=5, people=0)
    start[0, 1] = 0
    start[0, 1, 1, 1] = 1
    assert optimal.pareto_fronts(start, 5).tolist() == [[4]]
    start[0, 0, 1, 2] = 1
    assert optimal.pareto_fronts(start, 5).tolist() == [[0]]


@pytest.mark.parametrize("horizon", [126, 127, 128, 300])
def test_goal_time_does_not_overflow_on_long_horizons(horizon: int) -> None:
    starts = random_starts(seed=1, n=3, height=4, width=4, people=2)
    base = optimal.pareto_fronts(starts, 50)
    assert base.min() >= 0
    np.testing.assert_array_equal(optimal.pareto_fronts(starts, horizon), base + (horizon - 50))


def test_fronts_of_a_batch_are_those_of_its_starts(starts: Starts, monkeypatch: pytest.MonkeyPatch) -> None:
    few = starts[:40]
    batch = optimal.pareto_fronts(few, FULL_HORIZON)
    assert batch.shape == (40, 7)
    assert batch.dtype == np.int64
    singles = [optimal.pareto_fronts(start[np.newaxis], FULL_HORIZON)[0] for start in few]
    np.testing.assert_array_equal(batch, singles)
    order = np.random.default_rng(0).permutation(40)
    np.testing.assert_array_equal(optimal.pareto_fronts(few[order], FULL_HORIZON), batch[order])
    # Seven starts to a chunk leave a last chunk of five.
    monkeypatch.setattr(optimal, "_CHUNK_STATES", 7 * 2**6 * 64)
    np.testing.assert_array_equal(optimal.pareto_fronts(few, FULL_HORIZON), batch)


def test_fronts_follow_mirrored_worlds(starts: Starts) -> None:
    fronts = optimal.pareto_fronts(starts[:20], FULL_HORIZON)
    for mirrored in (starts[:20, :, ::-1], starts[:20, :, :, ::-1], starts[:20].swapaxes(2, 3)):
        np.testing.assert_array_equal(optimal.pareto_fronts(mirrored, FULL_HORIZON), fronts)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), horizon=st.integers(0, 40))
def test_fronts_fall_with_people_saved_and_rise_with_the_horizon(seed: int, horizon: int) -> None:
    starts = random_starts(seed, n=5, height=6, width=5, people=3)
    now, later = optimal.pareto_fronts(starts, horizon), optimal.pareto_fronts(starts, horizon + 1)
    assert (np.diff(now, axis=1) <= 0).all()
    assert (later >= now).all()
    assert (now >= -1).all()
    assert (now <= horizon).all()


def test_average_optimum_is_the_known_one(starts: Starts) -> None:
    goal_time, people_saved = optimal.lexicographic_optimum(starts, FULL_HORIZON).mean(axis=0)
    assert people_saved == 6.0
    assert goal_time == pytest.approx(59.1, abs=0.5)


@settings(deadline=None, max_examples=50)
@given(
    seed=st.integers(0, 2**32 - 1),
    horizon=st.integers(0, 25),
    weights=st.sampled_from([(0, 1), (1, 0), (2, 0.2), (1, 0.1), (3, 0.6), (1, 0.15), (1, 5), (0.5, 1e-3)]),
)
def test_best_returns_are_the_greatest_with_most_people_saved(
    seed: int, horizon: int, weights: tuple[float, float]
) -> None:
    starts = random_starts(seed, n=4, height=6, width=6, people=3)
    best = optimal.best_returns(starts, horizon, weights)
    assert best.shape == (4, 2)
    assert best.dtype == np.float64
    # In whole thousandths, so that ties are exact.
    per_goal_step, per_person = round(100 * weights[0]), round(1000 * weights[1])
    for found, front in zip(best.tolist(), optimal.pareto_fronts(starts, horizon).tolist(), strict=True):
        reachable = [(goal_time, saved) for saved, goal_time in enumerate(front) if goal_time >= 0]
        value = {point: per_goal_step * point[0] + per_person * point[1] for point in reachable}
        ties = [point for point in reachable if value[point] == max(value.values())]
        assert tuple(found) == max(ties, key=lambda point: point[1])


@pytest.mark.parametrize(("n", "horizon"), [(1, 75), (50, 75), (50, 12), (50, 1), (50, 0)])
def test_coverage_set_is_convex_and_its_intervals_join(starts: Starts, n: int, horizon: int) -> None:
    found = optimal.coverage_set(starts[:n], horizon)
    points, save_weights = found.points, found.save_weights
    assert points.dtype == save_weights.dtype == np.float64
    assert points.shape == save_weights.shape
    assert save_weights[0, 0] == 0.0
    assert save_weights[-1, 1] == 1.0
    np.testing.assert_array_equal(save_weights[1:, 0], save_weights[:-1, 1])
    assert (save_weights[:, 0] < save_weights[:, 1]).all()
    lost, gained = -np.diff(points[:, 0]), np.diff(points[:, 1])
    assert (lost > 0).all()
    assert (gained > 0).all()
    # Each person more costs more goal steps: strictly convex, no vertex on a line between others.
    prices = lost / gained
    assert (np.diff(prices) > 1e-6).all()
    # Neighbouring vertices are worth the same where one gives way to the other.
    switch = save_weights[1:, 0]
    np.testing.assert_allclose((1 - switch) * optimal.EXTINGUISH_REWARD * lost, switch * gained)


@pytest.mark.parametrize("horizon", [75, 12])
def test_coverage_set_dominates_and_attains_every_best_average(starts: Starts, horizon: int) -> None:
    few = starts[:50]
    found = optimal.coverage_set(few, horizon)
    rewards = found.points * [optimal.EXTINGUISH_REWARD, 1.0]
    inside = found.save_weights.mean(axis=1)
    seen = set()
    for save_weight in [0.0, 1.0, *inside, *np.random.default_rng(0).uniform(size=50)]:
        weights = np.array([1 - save_weight, save_weight])
        average = optimal.best_returns(few, horizon, weights).mean(axis=0)
        value = weights @ (average * [optimal.EXTINGUISH_REWARD, 1.0])
        assert (rewards @ weights).max() == pytest.approx(value, rel=1e-12)
        (vertex,) = np.flatnonzero((found.points == average).all(axis=1))
        low, high = found.save_weights[vertex]
        assert low <= save_weight <= high
        seen.add(int(vertex))
    assert seen == set(range(len(found.points)))


def test_coverage_set_of_one_start_is_the_hull_of_its_front(starts: Starts) -> None:
    for start in starts[:20]:
        front = optimal.pareto_fronts(start[np.newaxis], FULL_HORIZON)[0].tolist()
        vertices = [
            [float(goal_time), float(saved)]
            for saved, goal_time in enumerate(front)
            # It lies above every line from a point before to a point after it, and goal time falls next.
            if all(
                (goal_time - front[low]) * (high - saved) > (front[high] - goal_time) * (saved - low)
                for low in range(saved)
                for high in range(saved + 1, len(front))
            )
            and (saved == len(front) - 1 or front[saved + 1] < goal_time)
        ]
        assert optimal.coverage_set(start[np.newaxis], FULL_HORIZON).points.tolist() == vertices


def test_lexicographic_optimum_saves_all_it_can_first() -> None:
    starts = random_starts(seed=2, n=30, height=6, width=6, people=3)
    fronts = optimal.pareto_fronts(starts, 8)
    assert (fronts[:, -1] < 0).any()
    assert (fronts[:, -1] >= 0).any()
    expected = [max([saved, row[saved]] for saved in range(4) if row[saved] >= 0) for row in fronts.tolist()]
    np.testing.assert_array_equal(optimal.lexicographic_optimum(starts, 8), np.array(expected)[:, ::-1])


def test_starts_are_left_as_they_were(starts: Starts) -> None:
    given_starts = starts[:3].copy()
    given_starts.setflags(write=False)
    optimal.coverage_set(given_starts, FULL_HORIZON)
    optimal.optimal_actions(given_starts[0], FULL_HORIZON, 3)
    np.testing.assert_array_equal(given_starts, starts[:3])


def altered(plane: int, cell: Cell, value: int) -> Starts:
    """Two starts, the second with one cell changed; the agent, a person and the extinguisher lie in a row."""
    starts = np.zeros((2, 4, 3, 6), dtype=np.uint8)
    starts[:, 0] = 1
    starts[:, 0, 1, 1:-1] = 0
    starts[:, [1, 2, 3], 1, [1, 2, 4]] = 1
    assert optimal.pareto_fronts(starts, 4).tolist() == [[2, 1]] * 2
    starts[1, plane, cell[0], cell[1]] = value
    return starts


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        (np.zeros((4, 8, 8), np.uint8), "starts has shape (4, 8, 8)"),
        (np.zeros((0, 4, 8, 8), np.uint8), "starts has shape (0, 4, 8, 8)"),
        (np.zeros((1, 5, 8, 8), np.uint8), "starts has shape (1, 5, 8, 8)"),
        (np.zeros((1, 4, 2, 8), np.uint8), "starts has shape (1, 4, 2, 8)"),
        (altered(0, (1, 3), 2), "values from 0 to 2"),
        (altered(0, (2, 3), 0), "starts[1] has a gap in its border"),
        (altered(1, (1, 1), 0), "starts[1] has no or several agents"),
        (altered(1, (1, 2), 1), "starts[1] has no or several agents"),
        (altered(3, (1, 4), 0), "starts[1] has no or several extinguishers"),
        (altered(0, (1, 1), 1), "starts[1] has its agent in a wall"),
        (altered(0, (1, 2), 1), "starts[1] has its person in a wall"),
        (altered(0, (1, 4), 1), "starts[1] has its extinguisher in a wall"),
        (altered(2, (1, 3), 1), "starts[1] has not 1 people"),
        (random_starts(seed=0, n=1, people=13), "starts have 13 people; it must be at most 12"),
    ],
)
def test_what_is_no_start_is_refused_in_one_line(starts: Starts, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)) as refusal:
        optimal.pareto_fronts(starts, 5)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("horizon", [7.5, "a", None, np.array([3, 4]), [5], True])
def test_what_is_no_horizon_is_refused(starts: Starts, horizon: Any) -> None:
    for call in (optimal.pareto_fronts, optimal.coverage_set, optimal.discounted_coverage_set):
        with pytest.raises(ValueError, match=r"^horizon is [^\n]+; it must be an integer, at least 0$"):
            call(starts[:1], horizon)


@pytest.mark.parametrize("what", ["a", None, {"a": 1}, [[1], [1, 2]], np.full((1, 4, 8, 8), None)])
def test_what_is_no_array_of_planes_is_refused(what: Any) -> None:
    with pytest.raises(ValueError, match=r"^starts (is|has) [^\n]+; it must be [^\n]+$"):
        optimal.pareto_fronts(what, 5)
    with pytest.raises(ValueError, match=r"^starts? (is|has) [^\n]+; it must be [^\n]+$"):
        optimal.optimal_actions(what, 5, 0)


@pytest.mark.parametrize(
    "weights", [(1, -0.1), (0, 0), (np.nan, 1), (np.inf, 1), (1, 1, 1), 1, {"save": 1}, "ab", None]
)
def test_impossible_weights_are_refused(starts: Starts, weights: npt.ArrayLike) -> None:
    with pytest.raises(ValueError, match=r"^weights "):
        optimal.best_returns(starts[:1], 5, weights)  # type: ignore[arg-type]


def test_impossible_horizons_people_and_shapes_are_refused(starts: Starts) -> None:
    with pytest.raises(ValueError, match=r"^horizon is -1; "):
        optimal.pareto_fronts(starts[:1], -1)
    with pytest.raises(ValueError, match=r"^horizon is -1; "):
        optimal.optimal_actions(starts[0], -1, 0)
    for people_saved in (-1, 7, 2.0, 2.5, True, "a", None):
        with pytest.raises(ValueError, match=rf"^people_saved is {people_saved!r}; it must be 0 to 6"):
            optimal.optimal_actions(starts[0], FULL_HORIZON, people_saved)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^start has shape \(1, 4, 8, 8\); "):
        optimal.optimal_actions(starts[:1], FULL_HORIZON, 0)
