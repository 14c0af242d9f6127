"""The engine against the slow simulator, and what holds in every world."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.streams import draw_integers, spawn_streams
from moral_envs.world import NUM_ACTIONS, Effect, Fixture, ObjectKind, World
from tests.envs.reference import references
from tests.envs.worlds import engines, seeds

WORLDS = {"emergency": emergency_v0.world, "delivery": delivery_v0.world}


def random_actions(engine: Engine, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(NUM_ACTIONS, size=(engine.num_envs, engine.num_agents))


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
            np.testing.assert_array_equal(step.truncations, [simulator.ended for simulator in slow])
            assert step.any_truncation == step.truncations.any()
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
    engine = seeded(Engine(WORLDS[world](), 4, num_agents, team_reward), seed=num_agents)
    require_same_as_reference(engine, episodes=1, rng=np.random.default_rng(0))


def test_every_kind_of_event_happens_in_random_episodes() -> None:
    """What the slow simulator confirms in full episodes is not only walking about."""
    rng = np.random.default_rng(0)
    for make in WORLDS.values():
        engine = seeded(Engine(make(), 4, 5), seed=5)
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


@given(engine=engines(), seed=seeds)
@settings(max_examples=100)
def test_objects_disappear_only_by_the_rule_and_are_all_counted(engine: Engine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = engine.world.objects
    removable = np.array([bool(kind.on_interact or kind.on_enter) for kind in kinds], dtype=bool)
    before = engine.world_planes()[:, 2 : 2 + len(kinds)]
    start = before.sum(axis=(2, 3), dtype=int)
    np.testing.assert_array_equal(start, np.tile([kind.count for kind in kinds], (engine.num_envs, 1)))
    stood = np.zeros(engine.num_envs, dtype=int)
    for _ in range(engine.world.horizon):
        engine.step(random_actions(engine, rng))
        after = engine.world_planes()[:, 2 : 2 + len(kinds)]
        assert (after <= before).all()
        assert (after == before)[:, ~removable].all()
        gone = (before - after).sum(axis=(1, 2, 3))
        assert (gone <= engine.num_agents).all()
        before = after
        if engine.world.fixture is not None:
            corner = (engine.world.height - 2, engine.world.width - 2)
            stood += (engine.agent_cells == corner).all(axis=2).sum(axis=1)
    removed = (start - before.sum(axis=(2, 3), dtype=int)).sum(axis=1)
    counted = engine.objectives[:, 0] if engine.team_reward else engine.objectives.sum(axis=1)
    np.testing.assert_array_equal(counted.sum(axis=1), removed + stood)


@given(seed=seeds, num_agents=st.integers(1, 4), world=st.sampled_from(sorted(WORLDS)))
@settings(max_examples=20)
def test_counters_are_the_sums_of_unit_rewards(seed: int, num_agents: int, world: str) -> None:
    engine = seeded(Engine(WORLDS[world](), 3, num_agents), seed)
    rng = np.random.default_rng(seed)
    units = np.array({"emergency": [0.1, 1.0], "delivery": [1.0, 1.0, 1.0, -1.0]}[world])
    totals = np.zeros((3, num_agents, len(units)))
    for _ in range(engine.world.horizon):
        totals += engine.step(random_actions(engine, rng)).rewards
        np.testing.assert_array_equal(np.rint(totals / units), engine.objectives)
        np.testing.assert_allclose(totals / units, engine.objectives, atol=1e-4)


@given(engine=engines(max_agents=5), seed=seeds)
@settings(max_examples=100)
def test_agents_never_overlap_nor_enter_walls(engine: Engine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(engine.world.horizon):
        engine.step(random_actions(engine, rng))
        rows, columns = np.moveaxis(engine.agent_cells, -1, 0)
        assert ((rows >= 1) & (rows <= engine.world.height - 2)).all()
        assert ((columns >= 1) & (columns <= engine.world.width - 2)).all()
        for env in range(engine.num_envs):
            assert len(set(zip(rows[env], columns[env], strict=True))) == engine.num_agents


@given(engine=engines(), seed=seeds)
@settings(max_examples=50)
def test_resetting_some_environments_never_touches_the_others(engine: Engine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(rng.integers(engine.world.horizon + 1)):
        engine.step(random_actions(engine, rng))
    before = snapshot(engine)
    mask = rng.random(engine.num_envs) < 0.5
    engine.reset(mask)
    after = snapshot(engine)
    for name, array in after.items():
        if name in ("planes", "contents"):
            array, old = (a.reshape(engine.num_envs, -1) for a in (array, before[name]))
        else:
            old = before[name]
        np.testing.assert_array_equal(array[~mask], old[~mask], err_msg=name)
    assert (after["elapsed"][mask] == 0).all()
    assert (after["objectives"][mask] == 0).all()
    assert (after["streams"][mask] != before["streams"][mask]).all()


@given(engine=engines(), seed=seeds)
@settings(max_examples=50)
def test_returned_arrays_are_the_callers_own(engine: Engine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    actions = random_actions(engine, rng)
    given_actions = actions.copy()
    step = engine.step(actions)
    np.testing.assert_array_equal(actions, given_actions)
    before = snapshot(engine)
    handed_out = [step.rewards, step.truncations, engine.elapsed, engine.streams, *snapshot(engine).values()]
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
    other = Engine(engine.world, engine.num_envs, engine.num_agents, engine.team_reward)
    for _ in range(rng.integers(3)):
        other.step(random_actions(other, rng))
    state = engine.state_dict()
    stored = {name: array.copy() for name, array in state.items()}
    other.load_state_dict(state)
    for array in state.values():
        array[...] = 0
    assert_same(other.state_dict(), stored)
    for _ in range(2 * engine.world.horizon):
        actions = random_actions(engine, rng)
        left, right = engine.step(actions), other.step(actions)
        np.testing.assert_array_equal(left.rewards, right.rewards)
        np.testing.assert_array_equal(left.truncations, right.truncations)
        assert_same(snapshot(engine), snapshot(other))
        engine.reset(left.truncations)
        other.reset(right.truncations)


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
    assert not engine.step([WAIT]).any_truncation


def test_a_stream_does_not_depend_on_the_size_of_the_batch() -> None:
    assert spawn_streams(5, 1)[0] == spawn_streams(5, 100)[0]
    assert len(set(spawn_streams(5, 1000).tolist())) == 1000
    assert spawn_streams(5, 1)[0] != spawn_streams(6, 1)[0]
    assert spawn_streams(None, 1)[0] != spawn_streams(None, 1)[0]


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
