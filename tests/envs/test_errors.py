"""Errors: one line that names the argument, its value and what would be right; nothing has changed then."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.engine import Engine
from moral_envs.faces import GridAECEnv, GridEnv, GridParallelEnv, GridVectorEnv
from moral_envs.layouts import Layout
from moral_envs.rendering import draw_rgb
from moral_envs.streams import spawn_streams
from moral_envs.world import Effect, Fixture, ObjectKind, World

EMERGENCY = emergency_v0.world()
ENDING_CORRIDOR = replace(
    windy_wall_v0.world(),
    height=3,
    width=5,
    interior_walls=(),
    fixture=Fixture("goal", "goal", "G", Effect("time", 0.0, "goals_reached"), terminates=True),
)
UNKNOWN_REWARD = ObjectKind("people", 1, "person", "P", on_interact=Effect("rescue", 1.0, "people_saved"))
UNKNOWN_OBJECTIVE = ObjectKind("people", 1, "person", "P", on_interact=Effect("save", 1.0, "rescued"))


def with_fixture(cell: tuple[int, int]) -> World:
    assert EMERGENCY.fixture is not None
    return replace(EMERGENCY, fixture=replace(EMERGENCY.fixture, cell=cell))


def require_one_line(call: Callable[[], Any], match: str) -> None:
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: emergency_v0.world(height=2), r"^height is 2; it must be at least 3"),
        (lambda: delivery_v0.world(width=-1), r"^width is -1; it must be at least 3"),
        (
            lambda: emergency_v0.world(max_cycles=2**31),
            r"^max_cycles is 2147483648; it must be at most",
        ),
        (
            lambda: delivery_v0.single_env(max_cycles=2**70),
            r"^max_cycles is \d+; it must be at most 2147483647$",
        ),
        (lambda: emergency_v0.world(walk=True), r"^walk is True; a chance is 0 to 1$"),
        (lambda: emergency_v0.world(num_people=-1), r"^num_people is -1; it must be a count, 0 or more"),
        (lambda: delivery_v0.world(num_vases=-2), r"^num_vases is -2; it must be a count, 0 or more"),
        (lambda: emergency_v0.world(num_people=2.5), r"^num_people is 2.5; it must be an integer, a count"),
        (lambda: emergency_v0.world(height=8.5), r"^height is 8.5; it must be an integer, at least 3"),
        (lambda: delivery_v0.world(width="16"), r"^width is '16'; it must be an integer, at least 3"),
        (lambda: delivery_v0.world(max_cycles=0), r"^max_cycles is 0; it must be at least 1, the steps"),
        (
            lambda: windy_wall_v0.world(max_cycles=7.5),
            r"^max_cycles is 7.5; it must be an integer, at least 1",
        ),
        (lambda: windy_wall_v0.world(wind=1.5), r"^wind is 1.5; a chance is 0 to 1$"),
        (lambda: windy_wall_v0.single_env(wind=-0.1), r"^wind is -0.1; a chance is 0 to 1$"),
        (lambda: windy_wall_v0.world(wind=float("nan")), r"^wind is nan; a chance is 0 to 1$"),
        (lambda: burning_warehouse_v0.world(walk=-0.5), r"^walks? is -0.5.*; a .* is 0 to 1$"),
        (lambda: emergency_v0.env(walk=2), r"^walks? is 2.*; a .* is 0 to 1$"),
        (lambda: emergency_v0.world(walk="often"), r"^walks? is 'often'.*; a .* is 0 to 1$"),
        (lambda: emergency_v0.world(pickup="kick"), r"^pickup is 'kick'; it must be 'interact' or 'enter'$"),
        (
            lambda: burning_warehouse_v0.vector_env(2, pickup=None),
            r"^pickup is None; .* 'interact' or 'enter'$",
        ),
        (lambda: replace(EMERGENCY, slip=1.01), r"^slip is 1.01; a chance is 0 to 1$"),
        (lambda: replace(EMERGENCY, slip="x"), r"^slip is 'x'; a chance is 0 to 1$"),
        (lambda: replace(EMERGENCY, num_actions=7), r"^num_actions is 7; it must be 4, 5 or 9$"),
        (lambda: replace(EMERGENCY, start="middle"), r"^start is 'middle'; it must be 'random' or 'corner'$"),
        (
            lambda: replace(EMERGENCY, interior_walls=((2, 2), (0, 3))),
            r"^interior_walls has \(0, 3\); it must be inside the border$",
        ),
        (
            lambda: replace(EMERGENCY, interior_walls=((3, 7),)),
            r"^interior_walls has \(3, 7\); it must be inside the border$",
        ),
        (lambda: with_fixture((0, 2)), r"^the extinguisher's cell is \(0, 2\); it must be a free cell$"),
        (
            lambda: replace(with_fixture((2, 2)), interior_walls=((2, 2),)),
            r"^the extinguisher's cell is \(2, 2\); it must be a free cell$",
        ),
        (
            lambda: replace(EMERGENCY, objects=(UNKNOWN_REWARD,)),
            r"^reward is 'rescue'; .*'extinguish', 'save'",
        ),
        (lambda: replace(EMERGENCY, objects=(UNKNOWN_OBJECTIVE,)), r"^objective is 'rescued'; .*'goal_time'"),
        (lambda: replace(EMERGENCY, objects=EMERGENCY.objects * 27), r"^objects has 27 kinds; .* at most 26"),
        (
            lambda: replace(EMERGENCY, reward_names=("extinguish", "save", "save")),
            r"^reward_names is \('extinguish', 'save', 'save'\); every name must be another one$",
        ),
        (
            lambda: replace(EMERGENCY, objects=EMERGENCY.objects * 2),
            r"^plane_names is .*'people', 'people', .*; every name must be another one$",
        ),
        (
            lambda: replace(EMERGENCY, layout=Layout(height=(6, 12))),
            r"^layout is Layout\(.*\); it must be given to in_layout, which fits the world to it$",
        ),
        (
            lambda: replace(EMERGENCY, layout=Layout(), interior_walls=((2, 2),)),
            r"^layout is Layout\(.*\); it must be None, for emergency_v0 has walls or places of its own$",
        ),
        (lambda: replace(EMERGENCY, layout="maze"), r"^layout is 'maze'; it must be a Layout, or "),
        (lambda: Engine(EMERGENCY, num_envs=2.0), r"^num_envs is 2.0; it must be an integer, at least 1$"),
        (lambda: Engine(EMERGENCY, num_envs=True), r"^num_envs is True; it must be an integer, at least 1$"),
        (
            lambda: Engine(EMERGENCY, num_agents=np.True_),
            r"^num_agents is (np\.)?True_?; it must be an integer",
        ),
        (lambda: Engine(EMERGENCY, num_envs=np.ones(2, int)), r"^num_envs is array.*; it must be an integer"),
        (
            lambda: Engine(EMERGENCY, team_reward="False"),
            r"^team_reward is 'False'; it must be True or False$",
        ),
        (lambda: delivery_v0.env(2, team_reward=1), r"^team_reward is 1; it must be True or False$"),
        (lambda: Engine(EMERGENCY, num_envs=0), r"^num_envs is 0; it must be at least 1"),
        (lambda: Engine(EMERGENCY, num_agents=0), r"^num_agents is 0; it must be 1 to 16"),
        (lambda: Engine(EMERGENCY, num_agents=17), r"^num_agents is 17; it must be 1 to 16"),
        (lambda: Engine(EMERGENCY, num_agents=1.5), r"^num_agents is 1.5; it must be an integer, 1 to 16"),
        (lambda: emergency_v0.vector_env("4"), r"^num_envs is '4'; it must be an integer, at least 1"),
        (lambda: emergency_v0.vector_env(4, num_agents=0), r"^num_agents is 0; it must be 1 to 16"),
        (lambda: emergency_v0.parallel_env(num_people=36), r"add up to 37; emergency_v0 has 36 free cells"),
        (lambda: delivery_v0.single_env(height=8, width=8), r"add up to 45; delivery_v0 has 36 free cells"),
        (
            lambda: emergency_v0.vector_env(2, num_agents=3, num_people=34),
            r"add up to 37; emergency_v0 has 36 free cells",
        ),
        # 31 people and an agent fit into the empty room, but four walls of two cells leave room for 28.
        (
            lambda: emergency_v0.parallel_env(num_people=31, layout="maze"),
            r"^num_agents .* add up to 32; emergency_v0 has at least 28 free cells to place them on$",
        ),
        (
            lambda: emergency_v0.single_env(num_people=0, layout=Layout(counts={"people": (0, 36)})),
            r"add up to 37; emergency_v0 has at least 36 free cells",
        ),
        # Nothing starts at the goal.
        (
            lambda: Engine(
                replace(windy_wall_v0.world(), height=3, width=5, interior_walls=()), num_agents=3
            ),
            r"the goal's cell is \(1, 10\); it must be a free cell",
        ),
        (
            lambda: Engine(ENDING_CORRIDOR, num_agents=3),
            r"^num_agents .* add up to 3; windy_wall_v0 has 2 free cells to place them on$",
        ),
        (lambda: emergency_v0.world(layout="castle"), r"^layout is 'castle'; it must be .*'random'.*'ring'"),
        (lambda: delivery_v0.single_env(layout=3), r"^layout is 3; it must be a Layout or one of .*'maze'"),
        (
            lambda: windy_wall_v0.world().in_layout("random"),
            r"^layout is Layout\(.*\); it must be None, for windy_wall_v0 has walls or places of its own$",
        ),
        (
            lambda: delivery_v0.vector_env(2, layout=Layout(counts={"dogs": 2})),
            r"^counts\['dogs'\] is 2; the kind must be one of \('deliveries', .*'vases'\)$",
        ),
        (
            lambda: emergency_v0.parallel_env(height=6, layout="ring"),
            r"^height is 6; the plan 'ring' needs at least 8$",
        ),
        (lambda: spawn_streams(-1, 1), r"^seed is -1; it must be 0 or more"),
        (lambda: emergency_v0.parallel_env().reset(seed=-5), r"^seed is -5; it must be 0 or more"),
        (lambda: emergency_v0.vector_env(2).reset(seed=[1, 2, 3]), r"^seed has 3 entries; .* integer or 2$"),
        (
            lambda: emergency_v0.vector_env(2, autoreset_mode="never"),
            r"^autoreset_mode is 'never'; it must be one of \['NextStep', 'SameStep', 'Disabled'\]",
        ),
        (
            lambda: emergency_v0.vector_env(2).reset(options={"reset_mask": np.ones(3, dtype=np.bool_)}),
            r"^options\['reset_mask'\] is bool \(3,\); it must be bool \(2,\)",
        ),
        (
            lambda: emergency_v0.vector_env(2).reset(options={"reset_mask": np.ones(2)}),
            r"^options\['reset_mask'\] is float64 \(2,\); it must be bool \(2,\)",
        ),
        (
            lambda: draw_rgb(EMERGENCY, np.zeros((4, 8, 8), np.uint8), np.ones((1, 2), np.int64), tile=7),
            r"^tile is 7; it must be at least 8 pixels",
        ),
    ],
)
def test_an_impossible_argument_is_refused(call: Callable[[], Any], match: str) -> None:
    require_one_line(call, match)


def test_the_largest_number_of_kinds_fits() -> None:
    engine = Engine(
        replace(
            EMERGENCY,
            objects=tuple(
                replace(EMERGENCY.objects[0], name=f"kind{i}", count=1, symbol=chr(ord("\u03b1") + i))
                for i in range(26)
            ),
        ),
        num_envs=50,
    )
    for _ in range(EMERGENCY.horizon):
        step = engine.step(np.full((50, 1), 5))
    saved = engine.objectives[:, 0, 1]
    assert set(saved.tolist()) == {0, 1}
    assert not step.rewards[:, :, 1].any()


EFFECT = Effect("save", 1.0, "people_saved")
PEOPLE = EMERGENCY.objects[0]


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (
            lambda: replace(windy_wall_v0.world(), reward_names="time"),
            r"^reward_names is 'time'; it must be a tuple of distinct names, as in \('time',\)$",
        ),
        (lambda: replace(EMERGENCY, reward_names=()), r"^reward_names is \(\); it must be a tuple of"),
        (
            lambda: replace(EMERGENCY, objective_names="ab"),
            r"^objective_names is 'ab'; it must be a tuple of",
        ),
        (lambda: replace(EMERGENCY, objective_names=(1, 2)), r"^objective_names is \(1, 2\); it must be a"),
        (
            lambda: replace(EMERGENCY, objective_names={"a"}),
            r"^objective_names is \{'a'\}; it must be a tuple",
        ),
        (lambda: replace(EMERGENCY, name=3), r"^name is 3; it must be a name$"),
        (
            lambda: replace(PEOPLE, pattern="dog"),
            r"^pattern is 'dog' for people; it must be one of \('person',",
        ),
        (lambda: replace(PEOPLE, pattern=[]), r"^pattern is \[\] for people; it must be one of"),
        (lambda: replace(PEOPLE, name=""), r"^name is ''; it must be a name$"),
        (lambda: replace(PEOPLE, symbol="PP"), r"^symbol is 'PP' for people; it must be one printable"),
        (lambda: replace(PEOPLE, symbol=""), r"^symbol is '' for people; it must be one printable"),
        (lambda: replace(PEOPLE, symbol="\n"), r"^symbol is '\\n' for people; it must be one printable"),
        (lambda: replace(PEOPLE, symbol=7), r"^symbol is 7 for people; it must be one printable"),
        *(
            (
                lambda symbol=symbol: replace(PEOPLE, symbol=symbol),
                rf"^symbol is '{re.escape(symbol)}' for people; it must be none of '#.: A0123456789abcdef'$",
            )
            for symbol in "#. A09f"
        ),
        (
            lambda: replace(PEOPLE, on_interact="save"),
            r"^on_interact is 'save'; it must be an Effect or None$",
        ),
        (lambda: replace(PEOPLE, on_enter=1.0), r"^on_enter is 1.0; it must be an Effect or None$"),
        (lambda: replace(PEOPLE, count=True), r"^num_people is True; it must be an integer"),
        (lambda: replace(EMERGENCY.fixture, on_stand=None), r"^on_stand is None; it must be an Effect$"),
        (
            lambda: replace(EMERGENCY.fixture, terminates="no"),
            r"^terminates is 'no'; it must be True or False$",
        ),
        (
            lambda: replace(EMERGENCY.fixture, symbol="."),
            r"^symbol is '\.' for extinguisher; it must be none",
        ),
        (
            lambda: replace(EMERGENCY.fixture, cell=(1.0, 2)),
            r"^the extinguisher's cell is \(1.0, 2\); a cell is two integers, row and column$",
        ),
        (
            lambda: replace(EMERGENCY.fixture, cell=3),
            r"^the extinguisher's cell is 3; a cell is two integers",
        ),
        (lambda: replace(EMERGENCY, interior_walls=(2, 2)), r"^interior_walls has 2; a cell is two integers"),
        (lambda: replace(EMERGENCY, interior_walls=3), r"^interior_walls is 3; it must be a tuple of cells$"),
        (
            lambda: replace(EMERGENCY, interior_walls=((2, 2, 2),)),
            r"^interior_walls has \(2, 2, 2\); a cell is two integers",
        ),
        (lambda: replace(EMERGENCY, on_step=-1.0), r"^on_step is -1.0; it must be an Effect or None$"),
        (lambda: replace(EMERGENCY, fixture="goal"), r"^fixture is 'goal'; it must be a Fixture or None$"),
        (
            lambda: replace(EMERGENCY, objects=PEOPLE),
            r"^objects is ObjectKind.*; it must be a tuple of ObjectK",
        ),
        (
            lambda: replace(EMERGENCY, objects=("p",)),
            r"^objects is \('p',\); it must be a tuple of ObjectKind$",
        ),
        (
            lambda: replace(EMERGENCY, num_actions=5),
            r"^num_actions is 5; it must be 9, for people have an on_interact$",
        ),
        (
            lambda: replace(EMERGENCY, objects=(PEOPLE, replace(PEOPLE, name="more"))),
            r"^symbol is 'P' for two things; each needs a symbol of its own$",
        ),
        (
            lambda: replace(EMERGENCY, objects=(replace(PEOPLE, symbol="E"),)),
            r"^symbol is 'E' for two things; each needs a symbol of its own$",
        ),
        (lambda: replace(EMERGENCY, num_actions="9"), r"^num_actions is '9'; it must be 4, 5 or 9$"),
        (lambda: replace(EMERGENCY, slip=np.ones(2)), r"^slip is array.*; a chance is 0 to 1$"),
        (lambda: replace(EFFECT, reward=1), r"^reward is 1; it must be a name$"),
        (lambda: replace(EFFECT, objective=None), r"^objective is None; it must be a name$"),
        *(
            (
                lambda amount=amount: replace(EFFECT, amount=amount),
                rf"^amount is {re.escape(repr(amount))}; it must be a finite number$",
            )
            for amount in (float("nan"), float("inf"), "1", None, True, 1j)
        ),
        *(
            (
                lambda name=name: replace(EMERGENCY, objects=(replace(PEOPLE, name=name),)),
                rf"^plane_names is .*'{name}', .*; every name must be another one$",
            )
            for name in ("walls", "agent", "extinguisher")
        ),
    ],
)
def test_a_mistake_in_a_world_is_found_when_it_is_made(call: Callable[[], Any], match: str) -> None:
    require_one_line(call, match)


def test_lists_and_numpys_numbers_make_the_same_world() -> None:
    other = replace(
        EMERGENCY,
        height=np.int8(8),
        horizon=np.uint8(75),
        num_actions=np.int64(9),
        reward_names=list(EMERGENCY.reward_names),
        objects=[replace(PEOPLE, count=np.int8(6), walks=np.float64(0))],
        interior_walls=[],
    )
    assert other == EMERGENCY
    assert hash(other) == hash(EMERGENCY)
    assert type(other.height) is type(other.objects[0].count) is int
    walled = replace(EMERGENCY, interior_walls=np.array([[2, 2], [2, 3]]))
    assert walled.interior_walls == ((2, 2), (2, 3))


def test_small_integers_do_not_overflow() -> None:
    env = emergency_v0.vector_env(
        np.int8(9), num_agents=np.int8(2), view_radius=np.int8(100), height=np.int8(20), width=np.int8(20)
    )
    twin = emergency_v0.vector_env(9, num_agents=2, view_radius=100, height=20, width=20)
    observations, _ = env.reset(seed=0)
    assert env.observation_space.contains(observations)
    np.testing.assert_array_equal(observations, twin.reset(seed=0)[0])


@pytest.mark.parametrize("seed", [1.5, "abc", [1, 2], True, -3, (None, 1), np.array([0.5])])
@pytest.mark.parametrize("make", ["parallel_env", "env", "single_env"])
def test_what_is_no_seed_is_refused(make: str, seed: Any) -> None:
    env = getattr(emergency_v0, make)()
    require_one_line(lambda: env.reset(seed=seed), r"^seed is .*; it must be (an integer, )?0 or more$")


@pytest.mark.parametrize("seed", [1.5, "abc", "ab", b"ab", {1, 2}, np.array(1.5), np.zeros((2, 2)), True])
def test_what_is_no_seed_of_a_batch_is_refused(seed: Any) -> None:
    env = emergency_v0.vector_env(2)
    require_one_line(
        lambda: env.reset(seed=seed), r"^seed is .*; it must be an integer, None or a sequence of 2$"
    )


@pytest.mark.parametrize("seed", [["a", 2], [2, 1.5], [2, -1], np.array([0.5, 1])])
def test_what_is_no_seed_of_one_environment_is_refused_and_nothing_changes(seed: Any) -> None:
    env = emergency_v0.vector_env(2)
    before = env.engine.streams
    require_one_line(lambda: env.reset(seed=seed), r"^seed is .*; it must be (an integer, )?0 or more$")
    np.testing.assert_array_equal(env.engine.streams, before)


def test_options_that_are_no_dict_are_refused() -> None:
    env = emergency_v0.vector_env(2)
    require_one_line(lambda: env.reset(options=3), r"^options is 3; it must be a dict or None$")


FACES = ["parallel_env", "env", "single_env", "vector_env"]
MODULES = [emergency_v0, delivery_v0, burning_warehouse_v0, windy_wall_v0]


@pytest.mark.parametrize("radius", [0, -1, 1.5, "2"])
@pytest.mark.parametrize("make", FACES)
@pytest.mark.parametrize("module", MODULES)
def test_a_view_that_shows_nothing_is_refused(module: Any, make: str, radius: Any) -> None:
    wanted = "at least 1" if isinstance(radius, int) else "an integer, at least 1"
    require_one_line(
        lambda: getattr(module, make)(view_radius=radius),
        rf"^view_radius is {radius!r}; it must be {wanted}, or None for the whole grid$",
    )


@pytest.mark.parametrize("make", FACES)
def test_a_world_of_fixed_walls_takes_no_layout(make: str) -> None:
    with pytest.raises(TypeError, match="'layout'"):
        getattr(windy_wall_v0, make)(layout="random")


@pytest.mark.parametrize("make", FACES)
def test_an_unknown_argument_is_refused(make: str) -> None:
    with pytest.raises(
        TypeError, match=rf"^{make}\(\) has no argument 'speed'; it must be one of .*, num_people"
    ):
        getattr(emergency_v0, make)(speed=3)


@pytest.mark.parametrize("argument", ["num_agents", "team_reward", "agent_rewards"])
def test_a_single_environment_names_those_for_several_agents(argument: str) -> None:
    match = rf"single_env\(\) has no argument '{argument}'; .* use parallel_env, env or vector_env"
    with pytest.raises(TypeError, match=match):
        emergency_v0.single_env(**{argument: 2})
    with pytest.raises(TypeError, match=match):
        gymnasium.make("moral/Emergency-v0", **{argument: 2})


@pytest.mark.parametrize("make", FACES)
def test_only_the_number_of_agents_or_environments_needs_no_name(make: str) -> None:
    with pytest.raises(TypeError, match=rf"^{make}\(\) has 2 arguments without a name; "):
        getattr(emergency_v0, make)(2, None)


@pytest.mark.parametrize("options", [{}, {"num_envs": 3}])
@pytest.mark.parametrize("make", ["parallel_env", "env", "vector_env"])
@pytest.mark.parametrize(
    ("agent_rewards", "match"),
    [
        ([["save"]], r"^agent_rewards has 1 entries; it must have one for each of 2 agents$"),
        ([["save"]] * 3, r"^agent_rewards has 3 entries; it must have one for each of 2 agents$"),
        ([], r"^agent_rewards has 0 entries; it must have one for each of 2 agents$"),
        (
            [["save"], ["vase"]],
            r"^agent_rewards has \['vase'\]; for each agent it must list some of \('extinguish', 'save'\)$",
        ),
        (
            [["save"], ["save", "vase"]],
            r"^agent_rewards has \['save', 'vase'\]; for each agent it must list ",
        ),
        ([["save"], []], r"^agent_rewards has \[\]; for each agent it must list "),
        (["save", "save"], r"^agent_rewards has 'save'; for each agent it must list "),
        (
            [["save"], ["save", "save"]],
            r"^agent_rewards has \['save', 'save'\]; it must name each component once$",
        ),
        ([["save"], 1], r"^agent_rewards has 1; for each agent it must list "),
        ([["save"], [1]], r"^agent_rewards has \[1\]; for each agent it must list "),
        ([["save"], [["save"]]], r"^agent_rewards has \[\['save'\]\]; for each agent it must list some of "),
        ([["save"], None], r"^agent_rewards has None; for each agent it must list "),
        ("save", r"^agent_rewards is 'save'; it must list names for each agent$"),
        (2, r"^agent_rewards is 2; it must list names for each agent$"),
    ],
)
def test_reward_components_that_are_not_there_are_refused(
    make: str, agent_rewards: Any, match: str, options: dict[str, Any]
) -> None:
    if options and make != "vector_env":
        options = {"team_reward": True}
    call = getattr(emergency_v0, make)
    require_one_line(lambda: call(num_agents=2, agent_rewards=agent_rewards, **options), match)


@pytest.mark.parametrize("agent", ["agent_9", "agent_2", "", 0, None])
@pytest.mark.parametrize("make", ["parallel_env", "env"])
@pytest.mark.parametrize("module", MODULES)
def test_an_unknown_agent_is_refused(module: Any, make: str, agent: Any) -> None:
    env = getattr(module, make)(num_agents=2)
    env.reset(seed=0)
    match = rf"^agent is {agent!r}; it must be one of \['agent_0', 'agent_1'\]$"
    require_one_line(lambda: env.observation_space(agent), match)
    require_one_line(lambda: env.action_space(agent), match)
    require_one_line(lambda: env.reward_space(agent), match)
    if make == "env":
        require_one_line(lambda: env.observe(agent), match)
    else:
        found = re.escape(repr(["agent_0", agent]))
        require_one_line(
            lambda: env.step({"agent_0": 0, agent: 0}),
            rf"^actions are for {found}; they must be for \['agent_0', 'agent_1'\]$",
        )


@pytest.mark.parametrize("make", FACES)
@pytest.mark.parametrize("module", MODULES)
def test_an_unknown_render_mode_is_refused(module: Any, make: str) -> None:
    require_one_line(
        lambda: getattr(module, make)(render_mode="movie"), r"^render_mode is 'movie'; it must be .*'ansi'"
    )


@pytest.mark.parametrize("num_agents", [1, 3])
@pytest.mark.parametrize("action", [*range(-18, 0), *range(9, 31), 2**31, 2**62, -(2**62)])
def test_an_action_out_of_range_is_refused_and_nothing_changes(action: int, num_agents: int) -> None:
    engine = Engine(EMERGENCY, num_envs=4, num_agents=num_agents)
    before = engine.state_dict()
    actions = np.zeros((4, num_agents), dtype=np.int64)
    actions[2, -1] = action
    require_one_line(lambda: engine.step(actions), rf"^actions contain {action}; an action is 0 to 8$")
    after = engine.state_dict()
    for name in before:
        np.testing.assert_array_equal(before[name], after[name])


@pytest.mark.parametrize(
    ("actions", "match"),
    [
        (np.zeros((3, 2)), r"^actions have dtype float64; they must be integers"),
        (np.zeros((3, 2), dtype=np.bool_), r"^actions have dtype bool; they must be integers"),
        ([["up", "up"]] * 3, r"^actions have dtype .*; they must be integers"),
        (None, r"^actions have dtype object; they must be integers"),
        (
            np.full((3, 2), 2**63 + 1, dtype=np.uint64),
            r"^actions contain 9223372036854775809; an action is 0 to 8$",
        ),
        (np.zeros((2, 3), dtype=np.int64), r"^actions have shape \(2, 3\); they must have shape \(3, 2\)"),
        (np.zeros(6, dtype=np.int64), r"^actions have shape \(6,\); they must have shape \(3, 2\)"),
        (np.zeros(3, dtype=np.int64), r"^actions have shape \(3,\); they must have shape \(3, 2\)"),
        (1, r"^actions have shape \(\); they must have shape \(3, 2\)"),
    ],
)
def test_what_is_no_action_is_refused(actions: Any, match: str) -> None:
    engine = Engine(EMERGENCY, num_envs=3, num_agents=2)
    require_one_line(lambda: engine.step(actions), match)


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.uint64])
def test_all_integers_are_actions(dtype: Any) -> None:
    engine = Engine(EMERGENCY, num_envs=3, num_agents=2)
    twin = Engine(EMERGENCY, num_envs=3, num_agents=2)
    twin.load_state_dict(engine.state_dict())
    actions = np.arange(6).reshape(3, 2)
    engine.step(actions)
    twin.step(actions.astype(dtype))
    np.testing.assert_array_equal(engine.observe(), twin.observe())


@pytest.mark.parametrize(
    "action", [-1, 9, 1.5, "up", None, True, np.True_, [3], np.array([3, 4]), np.uint64(2**63)]
)
def test_every_face_refuses_what_is_no_action(action: Any) -> None:
    parallel = emergency_v0.parallel_env(num_agents=2)
    parallel.reset(seed=0)
    require_one_line(lambda: parallel.step({"agent_0": 1, "agent_1": action}), r"^actions ")
    aec = emergency_v0.env(num_agents=2)
    aec.reset(seed=0)
    require_one_line(lambda: aec.step(action), r"^action is .*; it must be (an integer, )?0 to 8$")
    single = emergency_v0.single_env()
    single.reset(seed=0)
    if np.shape(action) != (1,):
        require_one_line(lambda: single.step(action), r"^actions ")
    vector = emergency_v0.vector_env(2)
    vector.reset(seed=0)
    # NumPy takes a truth value among integers for one of them.
    first = 1 if not isinstance(action, (bool, np.bool_)) else action
    require_one_line(lambda: vector.step([first, action]), r"^actions ")


def test_a_vector_environment_wants_one_action_for_each_environment() -> None:
    vector = emergency_v0.vector_env(3)
    vector.reset(seed=0)
    require_one_line(lambda: vector.step([1, 2]), r"^actions have shape \(2,\); they must have shape \(3,\)")


@pytest.mark.parametrize("action", [4, 8])
def test_a_world_of_moves_has_no_other_actions(action: int) -> None:
    parallel, aec = windy_wall_v0.parallel_env(num_agents=2), windy_wall_v0.env(num_agents=2)
    single, vector = windy_wall_v0.single_env(), windy_wall_v0.vector_env(2, num_agents=2)
    for env in (parallel, aec, single, vector):
        env.reset(seed=0)
    match = f"^actions contain {action}; an action is 0 to 3$"
    require_one_line(lambda: parallel.step({"agent_0": 0, "agent_1": action}), match)
    require_one_line(lambda: aec.step(action), f"^action is {action}; it must be 0 to 3$")
    require_one_line(lambda: single.step(action), match)
    require_one_line(lambda: vector.step([[0, 0], [0, action]]), match)


@pytest.mark.parametrize("actions", [[1, 2, 3], [[1], [2], [3]], [[1, 2]] * 2])
def test_a_vector_environment_wants_one_action_for_each_agent(actions: Any) -> None:
    vector = emergency_v0.vector_env(3, num_agents=2)
    vector.reset(seed=0)
    match = rf"^actions have shape {re.escape(str(np.shape(actions)))}; they must have shape \(3, 2\)$"
    require_one_line(lambda: vector.step(actions), match)


@pytest.mark.parametrize("actions", [[1, 1], None, 1, np.ones(2, dtype=np.int64)])
def test_a_joint_action_must_be_a_dict(actions: Any) -> None:
    env = emergency_v0.parallel_env(num_agents=2)
    env.reset(seed=0)
    require_one_line(
        lambda: env.step(actions), r"^actions are .*; they must be a dict with one for each agent$"
    )


@pytest.mark.parametrize(
    "actions", [{}, {"agent_0": 1}, {"agent_0": 1, "agent_1": 1, "agent_2": 1}, {0: 1, 1: 1}]
)
def test_a_joint_action_must_be_for_all_agents_and_no_others(actions: Any) -> None:
    env = emergency_v0.parallel_env(num_agents=2)
    env.reset(seed=0)
    require_one_line(
        lambda: env.step(actions), r"^actions are for \[.*\]; they must be for \['agent_0', 'agent_1'\]$"
    )


def test_a_step_outside_an_episode_is_refused() -> None:
    parallel = emergency_v0.parallel_env(max_cycles=1)
    require_one_line(lambda: parallel.step({"agent_0": 4}), "call reset first")
    parallel.reset()
    parallel.step({"agent_0": 4})
    require_one_line(lambda: parallel.step({"agent_0": 4}), "outside an episode; call reset first")
    require_one_line(lambda: parallel.step({}), "outside an episode; call reset first")

    single = emergency_v0.single_env(max_cycles=1)
    require_one_line(lambda: single.step(4), "outside an episode; call reset first")
    single.reset()
    single.step(4)
    require_one_line(lambda: single.step(4), "outside an episode; call reset first")

    aec = emergency_v0.env(max_cycles=1)
    require_one_line(lambda: aec.step(4), "call reset first")
    require_one_line(aec.last, "outside an episode; call reset first")
    require_one_line(lambda: aec.observe("agent_0"), "before the first episode; call reset first")
    aec.reset()
    aec.step(4)
    require_one_line(lambda: aec.step(4), "only valid action is None")
    aec.step(None)
    require_one_line(lambda: aec.step(4), "outside an episode; call reset first")
    require_one_line(aec.last, "outside an episode; call reset first")

    vector = emergency_v0.vector_env(3, max_cycles=2, autoreset_mode=AutoresetMode.DISABLED)
    require_one_line(lambda: vector.step([4, 4, 4]), "before the first episode; call reset first")
    for mask in ([False, False, False], [True, False, False], [False, False, True]):
        vector.reset(seed=0, options={"reset_mask": np.array(mask)})
        told = "the first episode" + (" of environment 1" if any(mask) else "")
        require_one_line(lambda: vector.step([4, 4, 4]), f"before {told}; call reset first")
    vector.reset(options={"reset_mask": np.array([False, True, False])})
    vector.step([4, 4, 4])
    vector.reset()
    vector.step([4, 4, 4])
    vector.reset(options={"reset_mask": np.array([True, False, False])})
    vector.step([4, 4, 4])
    require_one_line(lambda: vector.step([4, 4, 4]), "after the end of environment 1; call reset first")


def test_a_step_after_reaching_the_goal_is_refused() -> None:
    """Two agents in a corridor, the second one beside the goal."""
    corridor = replace(ENDING_CORRIDOR, slip=0.0)
    single, parallel, aec = GridEnv(corridor), GridParallelEnv(corridor, 2), GridAECEnv(corridor, 2)
    vector = GridVectorEnv(corridor, 2, autoreset_mode=AutoresetMode.DISABLED)
    for env in (single, parallel, aec, vector):
        env.reset(seed=0)

    single.step(3)
    assert single.step(3)[2:4] == (True, False)
    require_one_line(lambda: single.step(3), "outside an episode; call reset first")

    _, _, terminations, truncations, _ = parallel.step({"agent_0": 3, "agent_1": 3})
    assert terminations == {"agent_0": True, "agent_1": True}
    assert truncations == {"agent_0": False, "agent_1": False}
    require_one_line(lambda: parallel.step({"agent_0": 3, "agent_1": 3}), "outside an episode")

    aec.step(3)
    aec.step(3)
    assert aec.terminations == {"agent_0": True, "agent_1": True}
    require_one_line(lambda: aec.step(3), "only valid action is None")

    vector.step([2, 3])
    assert vector.step([2, 3])[2].tolist() == [False, True]
    require_one_line(lambda: vector.step([2, 3]), "after the end of environment 1; call reset first")
