"""Errors: one line that names the argument, its value and what would be right; nothing has changed then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.rendering import draw_rgb
from moral_envs.streams import spawn_streams
from moral_envs.world import Effect, ObjectKind

EMERGENCY = emergency_v0.world()
UNKNOWN_REWARD = ObjectKind("people", 1, "person", "P", on_interact=Effect("rescue", 1.0, "people_saved"))
UNKNOWN_OBJECTIVE = ObjectKind("people", 1, "person", "P", on_interact=Effect("save", 1.0, "rescued"))


def require_one_line(call: Callable[[], Any], match: str) -> None:
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: emergency_v0.world(height=2), r"^height is 2; it must be at least 3"),
        (lambda: delivery_v0.world(width=-1), r"^width is -1; it must be at least 3"),
        (lambda: emergency_v0.world(num_people=-1), r"^num_people is -1; a count cannot be negative"),
        (lambda: delivery_v0.world(num_vases=-2), r"^num_vases is -2; a count cannot be negative"),
        (lambda: delivery_v0.world(max_cycles=0), r"^max_cycles is 0; an episode needs at least 1 step"),
        (
            lambda: replace(EMERGENCY, objects=(UNKNOWN_REWARD,)),
            r"^reward is 'rescue'; .*'extinguish', 'save'",
        ),
        (lambda: replace(EMERGENCY, objects=(UNKNOWN_OBJECTIVE,)), r"^objective is 'rescued'; .*'goal_time'"),
        (lambda: replace(EMERGENCY, objects=EMERGENCY.objects * 27), r"^objects has 27 kinds; .* at most 26"),
        (lambda: Engine(EMERGENCY, num_envs=0), r"^num_envs is 0; it must be at least 1"),
        (lambda: Engine(EMERGENCY, num_agents=0), r"^num_agents is 0; it must be 1 to 16"),
        (lambda: Engine(EMERGENCY, num_agents=17), r"^num_agents is 17; it must be 1 to 16"),
        (lambda: emergency_v0.parallel_env(num_people=36), r"add up to 37; emergency_v0 has 36 free cells"),
        (lambda: delivery_v0.single_env(height=8, width=8), r"add up to 45; delivery_v0 has 36 free cells"),
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
    engine = Engine(replace(EMERGENCY, objects=(replace(EMERGENCY.objects[0], count=1),) * 26), num_envs=50)
    for _ in range(EMERGENCY.horizon):
        step = engine.step(np.full((50, 1), 5))
    saved = engine.objectives[:, 0, 1]
    assert set(saved.tolist()) == {0, 1}
    assert not step.rewards[:, :, 1].any()


@pytest.mark.parametrize("make", ["parallel_env", "env", "single_env", "vector_env"])
@pytest.mark.parametrize("module", [emergency_v0, delivery_v0])
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
        (np.full((3, 2), 2**63 + 1, dtype=np.uint64), r"^actions contain -"),
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


@pytest.mark.parametrize("action", [-1, 9, 1.5, "up", None])
def test_every_face_refuses_what_is_no_action(action: Any) -> None:
    parallel = emergency_v0.parallel_env(num_agents=2)
    parallel.reset(seed=0)
    require_one_line(lambda: parallel.step({"agent_0": 1, "agent_1": action}), r"^actions ")
    aec = emergency_v0.env(num_agents=2)
    aec.reset(seed=0)
    require_one_line(lambda: aec.step(action), r"^action is .*; it must be 0 to 8$")
    single = emergency_v0.single_env()
    single.reset(seed=0)
    require_one_line(lambda: single.step(action), r"^actions ")
    vector = emergency_v0.vector_env(2)
    vector.reset(seed=0)
    require_one_line(lambda: vector.step([1, action]), r"^actions ")


def test_a_vector_environment_wants_one_action_for_each_environment() -> None:
    vector = emergency_v0.vector_env(3)
    vector.reset(seed=0)
    require_one_line(
        lambda: vector.step([1, 2]), r"^actions have shape \(2,\); they must have shape \(3, 1\)"
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
    require_one_line(lambda: parallel.step({"agent_0": 4}), "after the end of the episode; call reset first")
    require_one_line(lambda: parallel.step({}), "after the end of the episode; call reset first")

    single = emergency_v0.single_env(max_cycles=1)
    require_one_line(lambda: single.step(4), "outside an episode; call reset first")
    single.reset()
    single.step(4)
    require_one_line(lambda: single.step(4), "outside an episode; call reset first")

    aec = emergency_v0.env(max_cycles=1)
    require_one_line(lambda: aec.step(4), "call reset first")
    aec.reset()
    aec.step(4)
    require_one_line(lambda: aec.step(4), "only valid action is None")
    aec.step(None)
    require_one_line(lambda: aec.step(4), "after the end of the episode; call reset first")

    vector = emergency_v0.vector_env(3, max_cycles=2, autoreset_mode=AutoresetMode.DISABLED)
    vector.reset()
    vector.step([4, 4, 4])
    vector.reset(options={"reset_mask": np.array([True, False, False])})
    vector.step([4, 4, 4])
    require_one_line(lambda: vector.step([4, 4, 4]), "after the end of environment 1; call reset first")
