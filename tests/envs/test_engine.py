"""The engine against the slow simulator, and what holds in every world."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.engine import Engine
from moral_envs.layouts import Layout
from moral_envs.streams import draw_integers, spawn_streams
from moral_envs.world import NUM_ACTIONS, Effect, Fixture, ObjectKind, World
from tests.envs.reference import references
from tests.envs.worlds import engines, seeds

WORLDS = {
    "emergency": emergency_v0.world(),
    "delivery": delivery_v0.world(),
    "burning warehouse": burning_warehouse_v0.world(),
    "windy wall": windy_wall_v0.world(max_cycles=100),
    "delivery in random rooms": delivery_v0.world(layout="random"),
    "burning warehouse in a maze": burning_warehouse_v0.world(layout="maze"),
}


def random_actions(engine: Engine, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(engine.world.num_actions, size=(engine.num_envs, engine.num_agents))


def seeded(engine: Engine, seed: int) -> Engine:
    engine.seed(spawn_streams(seed, engine.num_envs))
    engine.reset()
    return engine


def snapshot(engine: Engine) -> dict[str, NDArray[Any]]:
    return {
        **engine.state_dict(),
        "observations": engine.observe(),
        "world": engine.world_planes(),
        "objectives": engine.objectives,
        "agent_cells": engine.agent_cells,
    }


def assert_same(left: dict[str, NDArray[Any]], right: dict[str, NDArray[Any]]) -> None:
    assert left.keys() == right.keys()
    for name in left:
        np.testing.assert_array_equal(left[name], right[name], err_msg=name)


def require_same_as_reference(engine: Engine, episodes: int, rng: np.random.Generator) -> None:
    """Drive engine and slow simulators together; every number must agree."""
    for _ in range(episodes):
        slow = references(engine)
        for _ in range(engine.world.horizon):
            actions = random_actions(engine, rng)
            step = engine.step(actions)
            expected = [simulator.step(row.tolist()) for simulator, row in zip(slow, actions, strict=True)]
            np.testing.assert_allclose(step.rewards, np.array(expected), rtol=1e-6)
            np.testing.assert_array_equal(step.terminations, [simulator.terminated for simulator in slow])
            np.testing.assert_array_equal(step.truncations, [simulator.truncated for simulator in slow])
            assert step.any_end == (step.terminations | step.truncations).any()
            np.testing.assert_array_equal(engine.objectives, [simulator.objectives for simulator in slow])
            np.testing.assert_array_equal(engine.elapsed, [simulator.time for simulator in slow])
            np.testing.assert_array_equal(engine.agent_cells, [simulator.agents for simulator in slow])
            seen = [[simulator.observe(i) for i in range(engine.num_agents)] for simulator in slow]
            np.testing.assert_array_equal(engine.observe(), seen)
        engine.reset()


@given(engine=engines(), seed=seeds)
@settings(max_examples=150)
def test_the_engine_follows_the_rules_in_any_world(engine: Engine, seed: int) -> None:
    require_same_as_reference(engine, episodes=2, rng=np.random.default_rng(seed))


@pytest.mark.parametrize("team_reward", [False, True])
@pytest.mark.parametrize("num_agents", [1, 2, 5])
@pytest.mark.parametrize("world", WORLDS)
def test_the_engine_follows_the_rules_in_full_episodes(
    world: str, num_agents: int, team_reward: bool
) -> None:
    engine = seeded(Engine(WORLDS[world], 2, num_agents, team_reward), seed=num_agents)
    require_same_as_reference(engine, episodes=1, rng=np.random.default_rng(0))


def test_every_kind_of_event_happens_in_random_episodes() -> None:
    """What the slow simulator confirms in full episodes is not only walking about."""
    rng = np.random.default_rng(0)
    for world in WORLDS.values():
        engine = seeded(Engine(world, 16, 5), seed=5)
        for _ in range(engine.world.horizon):
            engine.step(random_actions(engine, rng))
        assert (engine.objectives.sum(axis=(0, 1)) > 0).all()


# What the rules say of single cells: a corridor of three free cells with the fixture at its right end.
CORRIDOR = World(
    name="corridor",
    height=3,
    width=5,
    horizon=10,
    reward_names=("stand", "take", "break"),
    objective_names=("stood", "taken", "broken"),
    objects=(
        ObjectKind("people", 1, "person", "P", on_interact=Effect("take", 1.0, "taken")),
        ObjectKind("vases", 0, "vase", "V", on_enter=Effect("break", -1.0, "broken")),
    ),
    fixture=Fixture("extinguisher", "extinguisher", "E", Effect("stand", 0.1, "stood")),
)

UP, DOWN, LEFT, RIGHT, WAIT = range(5)
TAKE_LEFT, TAKE_RIGHT = 7, 8


def corridor(agents: list[int], person: int | None = None, first: int = 0) -> Engine:
    """The corridor with agents and a person in the given columns, 1 to 3."""
    engine = Engine(CORRIDOR, num_agents=len(agents))
    state = engine.state_dict()
    planes = state["planes"].reshape(len(CORRIDOR.plane_names), CORRIDOR.height, CORRIDOR.width)
    planes[2] = 0
    contents = state["contents"].reshape(CORRIDOR.height, CORRIDOR.width)
    contents[1, 1:-1] = 0
    if person is not None:
        planes[2, 1, person] = 1
        contents[1, person] = 2 * NUM_ACTIONS
    state["cells"] = np.array([[CORRIDOR.width + column for column in agents]])
    state["turn_offsets"] = np.array([first])
    engine.load_state_dict(state)
    return engine


def columns(engine: Engine) -> list[int]:
    return list(engine.agent_cells[0, :, 1])


@pytest.mark.parametrize(
    ("action", "column", "rewards"),
    [
        (LEFT, 1, [0, 0, 0]),
        (UP, 2, [0, 0, 0]),
        (DOWN, 2, [0, 0, 0]),
        (WAIT, 2, [0, 0, 0]),
        (TAKE_LEFT, 2, [0, 0, 0]),
        (RIGHT, 3, [0.1, 0, 0]),
        (TAKE_RIGHT, 2, [0, 1, 0]),
    ],
)
def test_an_agent_beside_a_person_on_the_extinguisher(action: int, column: int, rewards: list[float]) -> None:
    engine = corridor([2], person=3)
    step = engine.step([[action]])
    assert columns(engine) == [column]
    np.testing.assert_array_equal(step.rewards[0, 0], np.float32(rewards))
    assert engine.observe()[0, 0, 2].sum() == (action != TAKE_RIGHT)


@pytest.mark.parametrize("action", [UP, DOWN, RIGHT, WAIT, TAKE_LEFT, TAKE_RIGHT])
def test_the_extinguisher_pays_whatever_the_agent_does_there(action: int) -> None:
    engine = corridor([3], person=2)
    step = engine.step([[action]])
    np.testing.assert_array_equal(step.rewards[0, 0], np.float32([0.1, action == TAKE_LEFT, 0]))


@pytest.mark.parametrize("first", [0, 1])
def test_the_first_agent_gets_the_contested_cell(first: int) -> None:
    engine = corridor([1, 3], first=first)
    engine.step([[RIGHT, LEFT]])
    assert columns(engine) == ([2, 3] if first == 0 else [1, 2])


@pytest.mark.parametrize("first", [0, 1])
def test_agents_cannot_swap_and_follow_only_in_turn(first: int) -> None:
    engine = corridor([1, 2], first=first)
    engine.step([[RIGHT, LEFT]])
    assert columns(engine) == [1, 2]
    engine = corridor([1, 2], first=first)
    engine.step([[RIGHT, RIGHT]])
    assert columns(engine) == ([1, 3] if first == 0 else [2, 3])


@pytest.mark.parametrize("first", [0, 1])
def test_the_first_agent_gets_the_contested_person(first: int) -> None:
    engine = corridor([1, 3], person=2, first=first)
    step = engine.step([[TAKE_RIGHT, TAKE_LEFT]])
    np.testing.assert_array_equal(step.rewards[0, :, 1], [first == 0, first == 1])
    np.testing.assert_array_equal(engine.objectives[0, :, 1], [first == 0, first == 1])


def require_the_same_future(engine: Engine, other: Engine, rng: np.random.Generator) -> None:
    """Take random steps and resets in two engines; every number must agree."""
    for _ in range(min(2 * engine.world.horizon, 25)):
        actions = random_actions(engine, rng)
        left, right = engine.step(actions), other.step(actions)
        for one, another in zip(left, right, strict=True):
            np.testing.assert_array_equal(one, another)
        assert_same(snapshot(engine), snapshot(other))
        ended = left.terminations | left.truncations
        engine.reset(ended)
        other.reset(ended)


@given(engine=engines(), seed=seeds)
@settings(max_examples=50)
def test_returned_arrays_are_the_callers_own(engine: Engine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    actions = random_actions(engine, rng)
    given_actions = actions.copy()
    step = engine.step(actions)
    np.testing.assert_array_equal(actions, given_actions)
    before = snapshot(engine)
    handed_out = [*step[:3], engine.elapsed, engine.horizons, engine.streams, *snapshot(engine).values()]
    for array in handed_out:
        array[...] = True if array.dtype == np.bool_ else 77
    actions[...] = 0
    assert_same(snapshot(engine), before)


@given(engine=engines(), seed=seeds)
@settings(max_examples=50)
def test_a_stored_state_continues_exactly(engine: Engine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(rng.integers(engine.world.horizon + 1)):
        engine.step(random_actions(engine, rng))
    other = copy.deepcopy(engine)
    other.reset()
    for _ in range(rng.integers(3)):
        other.step(random_actions(other, rng))
    state = engine.state_dict()
    stored = {name: array.copy() for name, array in state.items()}
    other.load_state_dict(state)
    for array in state.values():
        array[...] = 0
    assert_same(other.state_dict(), stored)
    require_the_same_future(engine, other, rng)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy])
@given(engine=engines(), seed=seeds)
@settings(max_examples=20)
def test_a_copy_continues_on_its_own(
    duplicate: Callable[[Engine], Engine], engine: Engine, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(rng.integers(engine.world.horizon + 1)):
        engine.step(random_actions(engine, rng))
    other, left_alone = duplicate(engine), duplicate(engine)
    assert_same(snapshot(engine), snapshot(other))
    before = snapshot(left_alone)
    require_the_same_future(engine, other, rng)
    assert_same(snapshot(left_alone), before)


def corrupt(state: dict[str, NDArray[Any]], name: str, how: Callable[[NDArray[Any]], Any]) -> dict[str, Any]:
    return {**state, name: how(state[name])}


@pytest.mark.parametrize(
    ("name", "how", "found"),
    [
        ("cells", lambda array: None, "missing"),
        ("planes", lambda array: array[1:], r"uint8 \(1535,\)"),
        ("counters", lambda array: array.astype(np.float64), "float64"),
    ],
)
def test_an_unfit_state_is_refused(name: str, how: Callable[[NDArray[Any]], Any], found: str) -> None:
    engine = Engine(delivery_v0.world())
    before = snapshot(engine)
    with pytest.raises(ValueError, match=rf"state\['{name}'\] is {found}.*; it must be "):
        engine.load_state_dict(corrupt(engine.state_dict(), name, how))
    assert_same(snapshot(engine), before)


def test_placing_is_uniform_over_distinct_cells() -> None:
    """Chi-square of every agent's and object kind's cells; the margin is far beyond chance."""
    engine = seeded(Engine(emergency_v0.world(), 4096, num_agents=2), seed=3)
    planes = engine.world_planes().astype(int)
    cells = engine.agent_cells
    agents, people = planes[:, 1], planes[:, 2]
    assert (agents.sum(axis=(1, 2)) == 2).all()
    assert (people.sum(axis=(1, 2)) == 6).all()
    assert not (agents & people).any()
    assert (planes[:, 3, 6, 6] == 1).all()

    def chi_square(counts: NDArray[np.int64]) -> float:
        free = counts[1:-1, 1:-1].astype(float)
        assert counts.sum() == free.sum()
        return float(((free - free.mean()) ** 2 / free.mean()).sum())

    for agent in range(2):
        counts = np.zeros((8, 8), dtype=np.int64)
        np.add.at(counts, tuple(cells[:, agent].T), 1)
        assert chi_square(counts) < 90  # 35 degrees of freedom: exceeded with a probability of 1e-6
    assert chi_square(people.sum(axis=0)) < 90
    # Where the agent and a person may both be: on the extinguisher, about once in 36.
    assert 0 < agents[:, 6, 6].sum() < 4096 * 2 / 18
    assert 0 < people[:, 6, 6].sum() < 4096 * 6 / 18


@pytest.mark.parametrize("wind", [0.0, 0.25, 1.0])
def test_the_wind_blows_as_often_as_it_says(wind: float) -> None:
    """Where nothing blocks, the intended move has a chance of 1 - 3/4 wind, each other one of 1/4 wind."""
    world = windy_wall_v0.world(wind)
    engine = seeded(Engine(world, 20_000), seed=1)
    state = engine.state_dict()
    engine.load_state_dict({**state, "cells": np.full((20_000, 1), 3 * world.width + 2)})
    engine.step(np.full((20_000, 1), RIGHT))
    ways = engine.agent_cells[:, 0] - [3, 2]
    for way in [(0, 1), (1, 0), (-1, 0), (0, -1)]:
        expected = 1 - 3 / 4 * wind if way == (0, 1) else wind / 4
        assert (ways == way).all(axis=1).mean() == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("walk", [0.0, 0.3, 1.0])
def test_people_walk_as_often_as_they_should(walk: float) -> None:
    engine = seeded(Engine(burning_warehouse_v0.world(5, 5, num_people=1, walk=walk), 20_000), seed=2)
    before = engine.world_planes()[:, 2]
    away = before[:, 2, 2] > 0
    engine.step(np.full((20_000, 1), WAIT))
    after = engine.world_planes()[:, 2]
    # From the middle of the room; in half of the cases the agent is beside the person and blocks a way.
    assert away.sum() > 1000
    assert (after != before)[away].any(axis=(1, 2)).mean() == pytest.approx(walk * 7 / 8, abs=0.03)
    ways = [after[away, row, column].mean() for row, column in [(1, 2), (3, 2), (2, 1), (2, 3)]]
    np.testing.assert_allclose(ways, walk * 7 / 32, atol=0.03)


def test_rooms_are_those_that_the_layout_draws() -> None:
    layout = Layout(height=(5, 8), width=8, walls=(0.0, 1.0), counts={"people": (0, 6)}, max_cycles=(5, 40))
    world = burning_warehouse_v0.world(layout=layout)
    engine = seeded(Engine(world, 500, num_agents=2), seed=6)
    streams = spawn_streams(6, 500)
    rooms = layout.draw(streams, world.height, world.width, {"people": 6}, world.horizon)
    planes = engine.world_planes()
    np.testing.assert_array_equal(planes[:, 0], rooms.walls)
    np.testing.assert_array_equal(planes[:, 2].sum(axis=(1, 2)), rooms.counts[:, 0])
    np.testing.assert_array_equal(engine.horizons, rooms.horizons)
    assert set(rooms.counts[:, 0].tolist()) == set(range(7))
    assert set(rooms.horizons.tolist()) == set(range(5, 41))
    for step in range(1, 41):
        ended = engine.step(np.full((500, 2), WAIT)).truncations
        np.testing.assert_array_equal(ended, rooms.horizons <= step)


@pytest.mark.parametrize("num_agents", [1, 2, 5])
def test_agents_start_side_by_side_in_the_corner(num_agents: int) -> None:
    engine = Engine(windy_wall_v0.world(), 3, num_agents)
    # The wall is in column 5.
    expected = [(1, column) for column in (1, 2, 3, 4, 6)][:num_agents]
    np.testing.assert_array_equal(engine.agent_cells, [expected] * 3)


def test_a_terminating_fixture_ends_the_episode_of_all_agents() -> None:
    world = replace(CORRIDOR, fixture=replace(CORRIDOR.fixture, terminates=True), horizon=2)
    world = replace(world, on_step=Effect("break", -1.0, "broken"), objects=())
    engine = seeded(Engine(world, 64, num_agents=2), seed=0)
    for terminations_before in (False, True):
        step = engine.step(np.full((64, 2), RIGHT if not terminations_before else WAIT))
        reached = (engine.agent_cells == [1, 3]).all(axis=2)
        np.testing.assert_array_equal(step.terminations, reached.any(axis=1))
        np.testing.assert_array_equal(step.truncations, terminations_before & ~reached.any(axis=1))
        # Who stands at the end is paid for that, the other for its step.
        np.testing.assert_array_equal(step.rewards[:, :, 0], np.float32(0.1) * reached)
        np.testing.assert_array_equal(step.rewards[:, :, 2], -1.0 * ~reached)
    assert step.terminations.any()


@pytest.mark.parametrize("column", [1, 2, 3])
def test_a_step_costs_on_a_lasting_fixture_too(column: int) -> None:
    world = replace(CORRIDOR, on_step=Effect("break", -1.0, "broken"), objects=())
    engine = Engine(world)
    engine.load_state_dict({**engine.state_dict(), "cells": np.array([[world.width + column]])})
    step = engine.step([[WAIT]])
    np.testing.assert_array_equal(step.rewards[0, 0], np.float32([0.1 * (column == 3), 0, -1]))
    np.testing.assert_array_equal(engine.objectives[0, 0], [column == 3, 0, 1])
    assert not step.any_end


def test_agents_may_be_paid_different_components() -> None:
    paid = [["deliver"], ["vase", "help"], ["clean", "help", "deliver", "vase"]]
    for team_reward in (False, True):
        plain = seeded(Engine(delivery_v0.world(), 8, 3, team_reward), seed=4)
        other = seeded(Engine(delivery_v0.world(), 8, 3, team_reward, agent_rewards=paid), seed=4)
        rng = np.random.default_rng(4)
        seen = np.zeros((3, 4))
        for _ in range(50):
            actions = random_actions(plain, rng)
            everything, rewards = plain.step(actions).rewards, other.step(actions).rewards
            mask = np.array([[True, False, False, False], [False, True, False, True], [True] * 4])
            np.testing.assert_array_equal(rewards, everything * mask)
            np.testing.assert_array_equal(plain.objectives, other.objectives)
            seen += np.abs(rewards).sum(axis=0)
        np.testing.assert_array_equal(seen > 0, mask)


@pytest.mark.parametrize("first", range(4))
def test_two_agents_win_a_contested_cell_equally_often(first: int) -> None:
    """A contest every third step meets, after four of them, each of the four places in the rounds once."""
    engine = corridor([1, 3], first=first)
    winners = []
    for _ in range(4):
        engine.step([[RIGHT, LEFT]])
        winners.append(columns(engine).index(2))
        engine.step([[LEFT if winners[-1] == 0 else WAIT, RIGHT if winners[-1] == 1 else WAIT]])
        engine.step([[WAIT, WAIT]])
    assert winners.count(0) == winners.count(1)


@pytest.mark.parametrize("num_agents", [2, 3, 5, 8])
def test_each_of_two_agents_precedes_the_other_equally_often(num_agents: int) -> None:
    """Every pair contests a cell, at each of 2 n places in the rounds, while all others wait."""
    world = replace(CORRIDOR, height=4, width=num_agents + 2, horizon=2 * num_agents)
    engine = Engine(world, num_agents=num_agents)
    state = engine.state_dict()
    for left, right in itertools.combinations(range(num_agents), 2):
        wins = 0
        for offset in range(2 * num_agents):
            # The two stand above and beside the contested cell, the others in the row above, out of the way.
            others = [agent for agent in range(num_agents) if agent not in (left, right)]
            cells = np.empty((1, num_agents), dtype=np.int64)
            cells[0, left], cells[0, right] = world.width + 1, 2 * world.width + 2
            cells[0, others] = world.width + 2 + np.arange(len(others))
            engine.load_state_dict({**state, "cells": cells, "turn_offsets": np.array([offset])})
            actions = np.full((1, num_agents), WAIT)
            actions[0, left], actions[0, right] = DOWN, LEFT
            engine.step(actions)
            moved = (engine.agent_cells[0, [left, right]] == [2, 1]).all(axis=1)
            assert moved.sum() == 1
            wins += int(moved[0])
        assert wins == num_agents


@pytest.mark.parametrize("num_agents", [1, 2, 3])
def test_the_start_of_the_turns_is_drawn_uniformly(num_agents: int) -> None:
    engine = seeded(Engine(emergency_v0.world(), 3000, num_agents), seed=0)
    counts = np.bincount(engine.state_dict()["turn_offsets"].astype(np.int64), minlength=2 * num_agents)
    np.testing.assert_allclose(counts / 3000, 1 / (2 * num_agents), atol=0.05)


def test_the_turns_move_on_by_one_every_step() -> None:
    for offset in range(6):
        engine, later = (seeded(Engine(emergency_v0.world(), 1, 3), seed=1) for _ in range(2))
        state = {**engine.state_dict(), "turn_offsets": np.array([offset])}
        engine.load_state_dict(state)
        engine.step([[WAIT] * 3])
        later.load_state_dict({**state, "turn_offsets": np.array([(offset + 1) % 6])})
        actions = random_actions(engine, np.random.default_rng(offset))
        np.testing.assert_array_equal(engine.step(actions).rewards, later.step(actions).rewards)
        np.testing.assert_array_equal(engine.agent_cells, later.agent_cells)


def test_past_the_horizon_every_step_truncates_until_a_reset() -> None:
    engine = corridor([1])
    truncations = [bool(engine.step([WAIT]).truncations[0]) for _ in range(CORRIDOR.horizon + 3)]
    assert truncations == [False] * (CORRIDOR.horizon - 1) + [True] * 4
    engine.reset()
    assert not engine.step([WAIT]).any_end


def test_a_stream_does_not_depend_on_the_size_of_the_batch() -> None:
    assert spawn_streams(5, 1)[0] == spawn_streams(5, 100)[0]
    assert len(set(spawn_streams(5, 1000).tolist())) == 1000
    assert spawn_streams(5, 1)[0] != spawn_streams(6, 1)[0]
    assert spawn_streams(None, 1)[0] != spawn_streams(None, 1)[0]


def test_what_ends_an_episode_is_paid_instead_of_what_every_step_pays() -> None:
    every, goal = Effect("score", 1.0, "steps"), Effect("score", 5.0, "goals")
    for terminates, most in ((True, 5.0), (False, 6.0)):
        fixture = Fixture("goal", "goal", "G", on_stand=goal, terminates=terminates)
        world = World("w", 4, 4, 5, ("score",), ("steps", "goals"), (), fixture, on_step=every)
        # A step that only resets pays nothing.
        assert world.reward_bounds == ([0.0], [most])


@given(seed=seeds, bounds=st.lists(st.integers(1, 1000), min_size=1, max_size=20))
def test_draws_stay_in_bounds_and_depend_on_their_own_stream(seed: int, bounds: list[int]) -> None:
    limits = np.array(bounds, dtype=np.uint64)
    states = spawn_streams(seed, 5)
    alone = states[2:3].copy()
    drawn, drawn_alone = draw_integers(states, limits), draw_integers(alone, limits)
    assert drawn.shape == (len(bounds), 5)
    assert (drawn >= 0).all()
    assert (drawn < np.array(bounds)[:, None]).all()
    np.testing.assert_array_equal(drawn[:, 2], drawn_alone[:, 0])
    assert states[2] == alone[0]


def test_a_stream_draws_the_published_numbers() -> None:
    """SplitMix64 from state 0, whose first outputs are widely published; a draw uses their upper halves."""
    words = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]
    states = np.zeros(1, dtype=np.uint64)
    drawn = draw_integers(states, np.full(3, 1 << 16, dtype=np.uint64))
    assert drawn[:, 0].tolist() == [word >> 48 for word in words]
