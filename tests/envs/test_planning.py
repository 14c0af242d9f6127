"""Plans for Delivery against exhaustive search, a slow simulator and the environment itself."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from moral_envs import delivery_v0, layouts, planning
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams

Starts = npt.NDArray[np.uint8]
Cell = tuple[int, int]

DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))
PLANES = "#ADP~V"
EQUAL = np.ones(4)


def parsed(drawing: list[str]) -> Starts:
    """Planes of a start that is drawn with the characters of `ansi` frames."""
    grid = np.array([list(row) for row in drawing])
    return np.stack([grid == symbol for symbol in PLANES]).astype(np.uint8)


CORRIDOR = parsed(["##########", "#D...AV.P#", "##########"])


class State(NamedTuple):
    """What an episode is made of, for the slow simulator."""

    agent: Cell
    objects: frozenset[tuple[int, Cell]]


def initial_state(start: Starts) -> State:
    objects = {(int(kind), (int(row), int(column))) for kind, row, column in np.argwhere(start[2:])}
    row, column = np.argwhere(start[1])[0].tolist()
    return State((row, column), frozenset(objects))


def simulate(start: Starts, state: State, action: int) -> State:
    """One step of Delivery, as its rules read."""
    if action == 4:
        return state
    step = DIRECTIONS[action % 5]
    target = (state.agent[0] + step[0], state.agent[1] + step[1])
    if action > 4:
        return State(state.agent, state.objects - {(kind, target) for kind in range(3)})
    if start[0][target]:
        return state
    return State(target, state.objects - {(3, target)})


def gone(start: Starts, state: State) -> npt.NDArray[np.float64]:
    """The return of each component, told from what has disappeared."""
    taken = initial_state(start).objects - state.objects
    counts = np.bincount([kind for kind, _ in taken], minlength=4)
    return counts * np.array([1.0, 1.0, 1.0, -1.0])


def optimum(start: Starts, horizon: int, weights: npt.NDArray[np.float64]) -> float:
    """The best scalarised return, over all states that any actions lead to."""
    reached = {initial_state(start)}
    frontier = reached
    for _ in range(horizon):
        frontier = {simulate(start, state, action) for state in frontier for action in range(9)} - reached
        reached = reached | frontier
    return max(float(gone(start, state) @ weights) for state in reached)


def simulated_returns(start: Starts, actions: npt.NDArray[np.int64]) -> list[float]:
    state = initial_state(start)
    for action in actions.tolist():
        state = simulate(start, state, action)
    returns: list[float] = gone(start, state).tolist()
    return returns


@st.composite
def tiny_starts(draw: st.DrawFn) -> Starts:
    """Any state of a tiny world: inner walls, the agent perhaps on an object or even on a whole vase."""
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    cells = draw(st.permutations([(row, column) for row in range(height) for column in range(width)]))
    start = np.zeros((6, height + 2, width + 2), dtype=np.uint8)
    start[0] = 1
    start[0, 1:-1, 1:-1] = 0
    for kind, most in ((2, 2), (3, 2), (4, 1), (5, 3), (0, 3)):
        for _ in range(draw(st.integers(0, most))):
            if len(cells) > 1:
                row, column = cells.pop()
                start[kind, row + 1, column + 1] = 1
    free = np.argwhere(start[0] == 0)
    start[1][tuple(draw(st.sampled_from(free.tolist())))] = 1
    return start


# Some are sums of others; some have sums so close together that rounding a bound down hardly helps.
some_weights = st.one_of(
    st.sampled_from(
        [(1, 1, 1, 1), (1, 0, 0, 0), (0, 1, 0, 5), (1, 1, 1, 0), (0.3, 0.5, 0.2, 0.1), (0, 0, 0, 1)]
    ),
    st.tuples(*[st.floats(0, 2)] * 4).filter(lambda weights: max(weights) > 0.1),
).map(np.array)


@settings(deadline=None, max_examples=150)
@given(
    start=tiny_starts(),
    horizon=st.integers(0, 12),
    weights=some_weights,
    beam_width=st.integers(1, 4),
    iterations=st.sampled_from([0, 3, 25]),
)
def test_the_optimum_lies_between_return_and_bound(
    start: Starts, horizon: int, weights: npt.NDArray[np.float64], beam_width: int, iterations: int
) -> None:
    plans = planning.plan(start[None], horizon, weights, beam_width=beam_width, iterations=iterations)
    best = optimum(start, horizon, weights)
    assert plans.returns[0] @ weights <= best + 1e-8
    assert plans.upper_bounds[0] >= best - 1e-8
    assert plans.actions.shape == (1, horizon)
    assert plans.returns[0].tolist() == simulated_returns(start, plans.actions[0])


@settings(deadline=None, max_examples=150)
@given(start=tiny_starts(), horizon=st.integers(0, 12), weights=some_weights)
def test_a_wide_beam_finds_and_proves_the_optimum(
    start: Starts, horizon: int, weights: npt.NDArray[np.float64]
) -> None:
    # At most 20 cells with 256 sets of what is left: nothing is ever cut.
    plans = planning.plan(start[None], horizon, weights, beam_width=20 * 256, iterations=0)
    best = optimum(start, horizon, weights)
    np.testing.assert_allclose(plans.returns[0] @ weights, best, atol=1e-8)
    np.testing.assert_allclose(plans.upper_bounds[0], best, atol=1e-8)


@settings(deadline=None, max_examples=150)
@given(start=tiny_starts(), horizon=st.integers(0, 12), weights=some_weights, sweeps=st.integers(1, 4))
def test_prices_alone_give_a_bound(
    start: Starts, horizon: int, weights: npt.NDArray[np.float64], sweeps: int
) -> None:
    task = planning._Task(start, horizon, weights)
    memory, dual = task.nearby(), planning._Dual(task)
    for _ in range(sweeps if task.num_objects else 0):
        relaxation = planning._Relaxation(task, memory)
        for _ in range(5):
            dual.descend(relaxation, target=0.0)
        dual.grow(memory, limit=6)
    assert dual.bound >= optimum(start, horizon, weights) - 1e-8


@settings(deadline=None, max_examples=150)
@given(start=tiny_starts(), horizon=st.integers(0, 12), weights=some_weights)
@example(CORRIDOR, 9, np.array([1.0, 1.0, 1.0, 0.4]))
def test_relaxed_plans_that_remember_everything_err_by_the_later_vases_alone(
    start: Starts, horizon: int, weights: npt.NDArray[np.float64]
) -> None:
    task = planning._Task(start, horizon, weights)
    memory = np.ones_like(task.nearby())
    memory[:, task.num_objects :] = False
    relaxation = planning._Relaxation(task, memory)
    relaxed = relaxation.values(np.zeros(task.nothing + 1))[-1, relaxation.start]
    best = optimum(start, horizon, weights)
    assert relaxed >= best - 1e-8
    if start[5].sum() <= 1:
        assert relaxed <= best + 1e-8


def test_of_ways_to_the_same_cell_the_one_that_spares_the_vase_is_kept() -> None:
    drawn = parsed(["#####", "#AV.#", "#..D#", "#####", "#####"])
    turned = [
        np.rot90(start, turns, axes=(1, 2)) for start in (drawn, drawn[..., ::-1]) for turns in range(4)
    ]
    plans = planning.plan(turned, 3, [1.0, 1.0, 1.0, 0.1])
    assert plans.returns.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 8
    assert plans.upper_bounds.tolist() == [1.0] * 8


def test_a_vase_is_paid_for_once_however_often_it_is_crossed() -> None:
    start = CORRIDOR[None]
    weights = np.array([1.0, 1.0, 1.0, 0.4])
    # To the person and back to the delivery takes 9 steps, the other way round 10.
    plans = planning.plan(start, 9, weights)
    assert plans.returns.tolist() == [[1.0, 1.0, 0.0, -1.0]]
    np.testing.assert_allclose(plans.upper_bounds, [1.6])
    spared = planning.plan(start, 9, np.array([1.0, 1.0, 1.0, 1.1]))
    assert spared.returns.tolist() == [[1.0, 0.0, 0.0, 0.0]]
    assert spared.upper_bounds.tolist() == [1.0]


def test_components_without_weight_are_ignored() -> None:
    start = parsed(["########", "#DAVP~V#", "########"])[None]
    for kind, horizon in ((0, 1), (1, 2), (2, 3)):
        weights = np.eye(4)[kind]
        plans = planning.plan(start, horizon, weights)
        assert plans.returns[0] @ weights == plans.upper_bounds[0] == 1
        assert planning.plan(start, horizon - 1, weights).upper_bounds[0] == 0


def test_prices_tighten_the_bound() -> None:
    _, starts = seeded(4)
    loose, tight = (
        planning.plan(starts, 50, EQUAL, beam_width=20, iterations=iterations).upper_bounds
        for iterations in (0, 40)
    )
    assert (tight < loose - 3).all()


def seeded(n: int, **rules: Any) -> tuple[Engine, Starts]:
    engine = Engine(delivery_v0.world(**rules), n)
    engine.seed(spawn_streams(0, n))
    engine.reset()
    return engine, engine.observe()[:, 0]


@pytest.mark.parametrize(
    "rules",
    [{}, {"height": 9, "width": 7, "num_vases": 3}, *({"layout": name} for name in layouts.HELD_OUT)],
    ids=str,
)
def test_returns_are_what_the_environment_pays(rules: dict[str, Any]) -> None:
    rules = {"num_deliveries": 4, "num_people": 5, "num_pollution": 6, **rules}
    engine, starts = seeded(3, **rules)
    plans = planning.plan(starts, 30, EQUAL, beam_width=100, iterations=10)
    paid = np.zeros((3, 4))
    for actions in plans.actions.T:
        paid += engine.step(actions).rewards[:, 0]
    np.testing.assert_array_equal(paid, plans.returns)
    assert (plans.returns @ EQUAL <= plans.upper_bounds).all()
    assert (plans.returns @ EQUAL >= 3).all()


def test_random_actions_replay_as_in_the_environment_also_from_mid_episode() -> None:
    rng = np.random.default_rng(0)
    engine, starts = seeded(50)
    for _ in range(2):
        actions = rng.integers(9, size=(50, 40))
        paid = np.zeros((50, 4))
        for step_actions in actions.T:
            paid += engine.step(step_actions).rewards[:, 0]
        np.testing.assert_array_equal(planning.replay(starts, actions), paid)
        assert (paid != 0).any(axis=0).all()
        starts = engine.observe()[:, 0]


def test_full_size_plans_are_optimal_and_each_start_is_planned_for_alone() -> None:
    _, starts = seeded(3)
    plans = planning.plan(starts, 50, EQUAL)
    assert plans.returns[:, :3].sum(axis=1).mean() >= 19.5
    np.testing.assert_array_equal(plans.returns @ EQUAL, plans.upper_bounds)
    again = planning.plan(starts[1:2], 50, EQUAL)
    for alone, together in zip(again, plans, strict=True):
        np.testing.assert_array_equal(alone[0], together[1])


def test_more_items_than_a_word_has_bits() -> None:
    _, starts = seeded(1, height=10, width=11, num_deliveries=30, num_people=20, num_pollution=9, num_vases=9)
    plans = planning.plan(starts, 6, EQUAL)
    assert plans.returns[0] @ EQUAL == plans.upper_bounds[0] == optimum(starts[0], 6, EQUAL)


def test_bounds_are_not_rounded_where_there_are_too_many_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "_MAX_SUMS", 3)
    _, starts = seeded(2, height=8, width=8, num_deliveries=3, num_people=3, num_pollution=3, num_vases=2)
    for beam_width in (3, 20_000):
        plans = planning.plan(starts, 7, EQUAL, beam_width=beam_width)
        best = [optimum(start, 7, EQUAL) for start in starts]
        assert (plans.upper_bounds >= best).all()
    np.testing.assert_allclose(plans.returns @ EQUAL, best)
    np.testing.assert_allclose(plans.upper_bounds, best)


def altered(*changes: tuple[int, Cell, int]) -> Starts:
    start = parsed(["#####", "#AD.#", "#.V.#", "#####"])
    for plane, cell, value in changes:
        start[plane][cell] = value
    return np.stack([parsed(["#####", "#AD.#", "#.V.#", "#####"]), start])


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        (altered()[0], "starts has shape (6, 4, 5); it must be (n, 6, height, width)"),
        (altered()[:, :5], "starts has shape (2, 5, 4, 5); "),
        (altered()[:0], "starts has shape (0, 6, 4, 5); "),
        (altered()[..., :2], "starts has shape (2, 6, 4, 2); "),
        (altered((2, (1, 3), 2)), "starts has values from 0 to 2; "),
        (altered((0, (0, 1), 0)), "starts[1] has a gap in its border; "),
        (altered((1, (1, 1), 0)), "starts[1] has no or several agents; "),
        (altered((1, (1, 3), 1)), "starts[1] has no or several agents; "),
        (altered((0, (1, 1), 1)), "starts[1] has its agent in a wall; "),
        (altered((0, (2, 2), 1)), "starts[1] has several things in a cell; "),
        (altered((3, (1, 2), 1)), "starts[1] has several things in a cell; "),
    ],
)
def test_what_is_no_start_is_refused_in_one_line(starts: Starts, message: str) -> None:
    calls: list[Callable[[], object]] = [
        lambda: planning.plan(starts, 5, EQUAL),
        lambda: planning.replay(starts, np.zeros((len(starts), 1), dtype=np.int64)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=re.escape(message)) as refusal:
            call()
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": "a"}, "horizon is 'a'; it must be an integer, at least 0"),
        ({"horizon": 2.5}, "horizon is 2.5; it must be an integer, at least 0"),
        ({"horizon": None}, "horizon is None; it must be an integer, at least 0"),
        ({"beam_width": 1.5}, "beam_width is 1.5; it must be an integer, at least 1"),
        ({"iterations": "x"}, "iterations is 'x'; it must be an integer, at least 0"),
        ({"weights": {"vase": 1}}, "weights is {'vase': 1}; it must be an array of numbers"),
        ({"horizon": -1}, "horizon is -1; it must be at least 0"),
        ({"beam_width": 0}, "beam_width is 0; it must be at least 1"),
        ({"iterations": -1}, "iterations is -1; it must be at least 0"),
        ({"weights": np.ones(3)}, "weights has shape (3,); it must have one for each of ('deliver', "),
        ({"weights": [1, 1, 1, -1]}, "weights is [1.0, 1.0, 1.0, -1.0]; it must be finite, nonnegative and "),
        ({"weights": [1, 1, np.nan, 1]}, "weights is [1.0, 1.0, nan, 1.0]; "),
        ({"weights": [1, 1, np.inf, 1]}, "weights is [1.0, 1.0, inf, 1.0]; "),
        ({"weights": np.zeros(4)}, "weights is [0.0, 0.0, 0.0, 0.0]; "),
    ],
)
def test_impossible_arguments_are_refused_in_one_line(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(message)) as refusal:
        planning.plan(**{"starts": altered(), "horizon": 5, "weights": EQUAL, **arguments})
    assert "\n" not in str(refusal.value)


def test_impossible_actions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^actions has shape \(1, 5\); it must be \(2, steps\)$"):
        planning.replay(altered(), np.zeros((1, 5), dtype=np.int64))
    with pytest.raises(ValueError, match=r"^actions contain 9; an action is 0 to 8$"):
        planning.replay(altered(), np.full((2, 5), 9))
