"""One engine: with the same seed and actions every face gives the same trace, final counters included."""

from __future__ import annotations

import inspect
import pickle
import re
from copy import deepcopy
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st
from mo_gymnasium.wrappers.vector import MOSyncVectorEnv
from momaland.utils.conversions import mo_aec_to_parallel, mo_parallel_to_aec
from numpy.typing import NDArray

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.engine import Engine
from moral_envs.faces import Faces, GridAECEnv, GridEnv, GridParallelEnv, GridVectorEnv
from moral_envs.layouts import Layout
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, Effect, World
from tests.envs.worlds import agent_rewards, small_worlds

Actions = NDArray[np.int64]
"""Of shape (episodes, horizon, n_agents); an episode that ends early leaves the rest of its actions aside."""

MODES = list(AutoresetMode)
NEIGHBOURS = 3
"""Environments of a batch; the trace is that of number 1."""


@dataclass
class Case:
    """What all faces are to play alike."""

    world: World
    num_agents: int
    seed: int
    actions: Actions
    team_reward: bool = False
    view_radius: int | None = None
    agent_rewards: list[list[str]] | None = None

    @property
    def arguments(self) -> dict[str, Any]:
        return {
            "num_agents": self.num_agents,
            "team_reward": self.team_reward,
            "view_radius": self.view_radius,
            "agent_rewards": self.agent_rewards,
        }

    def all_components(self, rewards: list[Any]) -> list[Any]:
        """PettingZoo's agents get only what they are paid; here with zeros for the rest."""
        if self.agent_rewards is None:
            return rewards
        names, rows = self.world.reward_names, []
        for reward, paid in zip(rewards, self.agent_rewards, strict=True):
            row = np.zeros(len(names), dtype=np.float32)
            row[[name in paid for name in names]] = reward
            rows.append(row)
        return rows


@dataclass
class Episode:
    """What an episode of t steps showed; the first observations and objectives are those of the reset."""

    observations: NDArray[np.uint8]
    """Shape (t + 1, n_agents, C, H, W)."""
    rewards: NDArray[np.float32]
    """Shape (t, n_agents, k)."""
    terminations: NDArray[np.bool_]
    """Shape (t,)."""
    truncations: NDArray[np.bool_]
    """Shape (t,)."""
    objectives: NDArray[np.int64]
    """Shape (t + 1, n_agents, m)."""


Trace = list[Episode]


class Recorder:
    """Gathers an episode step by step."""

    def __init__(self, observations: Any, objectives: Any) -> None:
        self.observations, self.objectives = [observations], [objectives]
        self.rewards: list[Any] = []
        self.terminations: list[Any] = []
        self.truncations: list[Any] = []

    def add(
        self, observations: Any, rewards: Any, termination: Any, truncation: Any, objectives: Any
    ) -> bool:
        """Record a step; returns whether it ends the episode."""
        self.observations.append(observations)
        self.rewards.append(rewards)
        self.terminations.append(termination)
        self.truncations.append(truncation)
        self.objectives.append(objectives)
        assert not (termination and truncation)
        return bool(termination or truncation)

    def episode(self) -> Episode:
        return Episode(*(np.array(getattr(self, field.name)) for field in fields(Episode)))


def assert_same(left: Trace, right: Trace, same_types: bool = True) -> None:
    assert len(left) == len(right)
    for one, other in zip(left, right, strict=True):
        for field in fields(Episode):
            values, others = getattr(one, field.name), getattr(other, field.name)
            assert values.shape == others.shape, field.name
            assert values.dtype == others.dtype or not same_types, field.name
            np.testing.assert_array_equal(values, others, err_msg=field.name)


def engine_trace(case: Case) -> Trace:
    engine = Engine(case.world, **case.arguments)
    engine.seed(spawn_streams(case.seed, 1))
    trace = []
    for episode in case.actions:
        engine.reset()
        recorder = Recorder(engine.observe()[0], engine.objectives[0])
        for joint in episode:
            step = engine.step(joint[None])
            ends = step.terminations[0], step.truncations[0]
            if recorder.add(engine.observe()[0], step.rewards[0], *ends, engine.objectives[0]):
                break
        trace.append(recorder.episode())
    return trace


def common_value(values: dict[str, bool]) -> bool:
    """All agents of an environment begin and end together."""
    (value,) = set(values.values())
    return value


def parallel_trace(case: Case, env: Any) -> Trace:
    trace = []
    for number, episode in enumerate(case.actions):
        observations, infos = env.reset(seed=case.seed if number == 0 else None)
        agents = list(env.agents)
        recorder = Recorder(
            [observations[agent] for agent in agents], [infos[agent]["objectives"] for agent in agents]
        )
        for joint in episode:
            assert env.agents == agents
            observations, rewards, terminations, truncations, infos = env.step(
                dict(zip(agents, joint, strict=True))
            )
            ended = recorder.add(
                [observations[agent] for agent in agents],
                case.all_components([rewards[agent] for agent in agents]),
                common_value(terminations),
                common_value(truncations),
                [infos[agent]["objectives"] for agent in agents],
            )
            if ended:
                break
        assert not env.agents
        trace.append(recorder.episode())
    return trace


def aec_trace(case: Case, env: Any) -> Trace:
    trace = []
    for number, episode in enumerate(case.actions):
        env.reset(seed=case.seed if number == 0 else None)
        agents = list(env.agents)
        turns: dict[str, list[Any]] = {agent: [] for agent in agents}
        for agent in env.agent_iter():
            observation, reward, terminated, truncated, info = env.last()
            turns[agent].append(
                (observation, reward.copy(), terminated, truncated, info["objectives"].copy())
            )
            time = len(turns[agent]) - 1
            env.step(None if terminated or truncated else episode[time, agents.index(agent)])
        first, *steps = zip(*turns.values(), strict=True)
        observations, rewards, _, _, objectives = zip(*first, strict=True)
        assert not any(reward.any() for reward in rewards)
        recorder = Recorder(observations, objectives)
        for step in steps:
            observations, rewards, terminations, truncations, objectives = zip(*step, strict=True)
            recorder.add(
                observations,
                case.all_components(list(rewards)),
                common_value(dict(enumerate(terminations))),
                common_value(dict(enumerate(truncations))),
                objectives,
            )
        trace.append(recorder.episode())
    return trace


def single_trace(case: Case, env: GridEnv) -> Trace:
    trace = []
    for number, episode in enumerate(case.actions):
        observation, info = env.reset(seed=case.seed if number == 0 else None)
        recorder = Recorder([observation], [info["objectives"]])
        for (action,) in episode:
            observation, reward, terminated, truncated, info = env.step(action)
            if recorder.add([observation], [reward], terminated, truncated, [info["objectives"]]):
                break
        trace.append(recorder.episode())
    return trace


def vector_trace(case: Case, env: Any, mode: AutoresetMode, head_start: int, agent_axis: bool) -> Trace:
    """The trace of environment 1, whose neighbours are some steps further in episodes of their own."""
    rng = np.random.default_rng(case.seed)
    own = np.arange(NEIGHBOURS) == 1
    ended = np.zeros(NEIGHBOURS, dtype=np.bool_)

    def shown(array: NDArray[Any]) -> NDArray[Any]:
        """What belongs to environment 1, with an axis for its agents."""
        return array[1] if agent_axis else array[1:2]

    def step(joint: NDArray[np.int64] | None) -> Any:
        """Take a step, at random where nothing else is given."""
        if mode == AutoresetMode.DISABLED and ended.any():
            env.reset(options={"reset_mask": ended})
        actions = rng.integers(case.world.num_actions, size=env.action_space.shape)
        if joint is not None:
            actions[1] = joint if agent_axis else joint[0]
        result = env.step(actions)
        ended[:] = result[2] | result[3]
        return result

    seeds = [case.seed + 1, case.seed, case.seed + 2]
    env.reset(seed=seeds)
    for _ in range(head_start):
        step(None)
    partial = {"options": {"reset_mask": own}} if head_start else {}
    observations, infos = env.reset(seed=[None, case.seed, None], **partial)
    ended[:] = ended & ~own & (head_start > 0)
    trace = []
    for number, episode in enumerate(case.actions):
        if number > 0 and mode == AutoresetMode.NEXT_STEP:
            observations, rewards, terminations, truncations, infos = step(None)
            assert not rewards[1].any()
            assert not terminations[1]
            assert not truncations[1]
        elif number > 0 and mode == AutoresetMode.DISABLED:
            observations, infos = env.reset(options={"reset_mask": ended})
            ended[:] = False
        recorder = Recorder(shown(observations), shown(infos["objectives"]))
        for joint in episode:
            observations, rewards, terminations, truncations, infos = step(joint)
            last, objectives = shown(observations), shown(infos["objectives"])
            if mode == AutoresetMode.SAME_STEP and ended.any():
                np.testing.assert_array_equal(infos["_final_obs"], ended)
                np.testing.assert_array_equal(infos["_final_info"], ended)
                np.testing.assert_array_equal(infos["final_info"]["_objectives"], ended)
                assert [final is not None for final in infos["final_obs"]] == ended.tolist()
                if ended[1]:
                    final = infos["final_obs"][1]
                    last, objectives = (
                        final if agent_axis else final[None],
                        shown(infos["final_info"]["objectives"]),
                    )
            if recorder.add(last, shown(rewards), terminations[1], truncations[1], objectives):
                break
        trace.append(recorder.episode())
    return trace


def require_one_trace(case: Case, head_start: int) -> Trace:
    """Play a case on every face; returns the one trace."""
    expected = engine_trace(case)
    world, arguments = case.world, case.arguments
    assert_same(parallel_trace(case, GridParallelEnv(world, **arguments)), expected)
    assert_same(aec_trace(case, GridAECEnv(world, **arguments)), expected)
    # MOMAland's conversions add rewards up in float64, and one takes all reward vectors to be of one length.
    converted = mo_parallel_to_aec(GridParallelEnv(world, **arguments))
    assert_same(aec_trace(case, converted), expected, same_types=False)
    if case.agent_rewards is None or len({len(names) for names in case.agent_rewards}) == 1:
        converted = mo_aec_to_parallel(GridAECEnv(world, **arguments))
        assert_same(parallel_trace(case, converted), expected, same_types=False)
    for mode in MODES:
        vector = GridVectorEnv(world, NEIGHBOURS, autoreset_mode=mode, **arguments)
        assert_same(vector_trace(case, vector, mode, head_start, agent_axis=True), expected)
    if case.num_agents == 1:
        for mode in MODES:
            vector = GridVectorEnv(
                world, NEIGHBOURS, autoreset_mode=mode, **{**arguments, "num_agents": None}
            )
            assert_same(vector_trace(case, vector, mode, head_start, agent_axis=False), expected)
    if case.num_agents == 1 and case.agent_rewards is None:
        assert_same(single_trace(case, GridEnv(world, view_radius=case.view_radius)), expected)
        peer = MOSyncVectorEnv([lambda: GridEnv(world, view_radius=case.view_radius)] * NEIGHBOURS)
        assert_same(vector_trace(case, peer, AutoresetMode.NEXT_STEP, 0, agent_axis=False), expected)
    return expected


def random_actions(seed: int, episodes: int, world: World, num_agents: int) -> Actions:
    rng = np.random.default_rng(seed)
    return rng.integers(world.num_actions, size=(episodes, world.horizon, num_agents))


@pytest.mark.parametrize("num_agents", [1, 2, 3])
@pytest.mark.parametrize(
    "world", [emergency_v0.world(), delivery_v0.world()], ids=lambda world: str(world.name)
)
def test_all_faces_give_one_trace_in_full_episodes(world: World, num_agents: int) -> None:
    """Six times 35 episodes, 210 in all, each over the whole horizon on every face."""
    actions = random_actions(num_agents, 35, world, num_agents)
    trace = require_one_trace(Case(world, num_agents, 8, actions), head_start=11)
    starts = {episode.observations[0].tobytes() for episode in trace}
    assert len(starts) == 35
    for episode in trace:
        np.testing.assert_array_equal(np.flatnonzero(episode.truncations), [world.horizon - 1])
        assert not episode.terminations.any()
        assert not episode.objectives[0].any()
    assert (sum(episode.objectives[-1].sum(axis=0) for episode in trace) > 0).all()


@pytest.mark.parametrize("num_agents", [1, 2])
@pytest.mark.parametrize(
    "world",
    [
        burning_warehouse_v0.world(),
        burning_warehouse_v0.world(
            layout=Layout(height=(5, 8), walls=1.0, counts={"people": (0, 6)}, max_cycles=(5, 40))
        ),
        delivery_v0.world(layout="spiral"),
        windy_wall_v0.world(max_cycles=300),
    ],
    ids=["people walk", "rooms and horizons differ", "a floor plan", "the goal ends it"],
)
def test_all_faces_give_one_trace_where_episodes_differ(world: World, num_agents: int) -> None:
    actions = random_actions(num_agents, 6, world, num_agents)
    trace = require_one_trace(Case(world, num_agents, 3, actions), head_start=4)
    lengths = {len(episode.rewards) for episode in trace}
    if world.layout is not None and world.layout.max_cycles is not None:
        assert len(lengths) > 1
    elif world.name == "windy_wall_v0":
        assert {bool(episode.terminations[-1]) for episode in trace} == {False, True}
        assert not any(episode.terminations[:-1].any() for episode in trace)
    else:
        assert lengths == {world.horizon}


@given(data=st.data(), seed=st.integers(0, 2**32 - 3), team_reward=st.booleans())
@settings(max_examples=80)
def test_all_faces_give_one_trace_in_any_world(data: st.DataObject, seed: int, team_reward: bool) -> None:
    num_agents = data.draw(st.integers(1, 4))
    world = data.draw(small_worlds(num_agents))
    case = Case(
        world,
        num_agents,
        seed,
        random_actions(seed, 3, world, num_agents),
        team_reward,
        data.draw(st.none() | st.integers(1, 3)),
        data.draw(st.none() | agent_rewards(world, num_agents)),
    )
    require_one_trace(case, data.draw(st.integers(0, world.horizon - 1)))


@pytest.mark.parametrize(
    ("module", "rules"),
    [
        (emergency_v0, {}),
        (delivery_v0, {"layout": "random"}),
        (burning_warehouse_v0, {}),
        (windy_wall_v0, {"max_cycles": 80}),
    ],
)
def test_a_list_of_seeds_is_as_many_single_environments(module: Any, rules: dict[str, Any]) -> None:
    seeds = [4, 7, 4, 0]
    vector = module.vector_env(4, autoreset_mode=AutoresetMode.SAME_STEP, **rules)
    observations, _ = vector.reset(seed=seeds)
    singles = [module.single_env(**rules) for _ in seeds]
    for row, env, seed in zip(observations, singles, seeds, strict=True):
        np.testing.assert_array_equal(row, env.reset(seed=seed)[0])
    np.testing.assert_array_equal(observations[0], observations[2])
    actions = random_actions(0, 3, module.world(**rules), 4).reshape(-1, 4)
    for joint in actions:
        observations, rewards, terminations, truncations, infos = vector.step(joint)
        for i, env in enumerate(singles):
            observation, reward, terminated, truncated, info = env.step(joint[i])
            np.testing.assert_array_equal(rewards[i], reward)
            assert terminations[i] == terminated
            assert truncations[i] == truncated
            if terminated or truncated:
                np.testing.assert_array_equal(infos["final_info"]["objectives"][i], info["objectives"])
                observation, info = env.reset()
            np.testing.assert_array_equal(observations[i], observation)
            np.testing.assert_array_equal(infos["objectives"][i], info["objectives"])


@pytest.mark.parametrize(
    ("module", "rules"),
    [
        (emergency_v0, {}),
        (emergency_v0, {"layout": "random"}),
        (delivery_v0, {}),
        (burning_warehouse_v0, {"layout": "ring"}),
    ],
)
def test_one_seed_gives_every_environment_its_own_episode(module: Any, rules: dict[str, Any]) -> None:
    observations, _ = module.vector_env(50, **rules).reset(seed=3)
    assert len({row.tobytes() for row in observations}) == 50
    np.testing.assert_array_equal(observations[0], module.single_env(**rules).reset(seed=3)[0])
    np.testing.assert_array_equal(observations[:10], module.vector_env(10, **rules).reset(seed=3)[0])
    again, _ = module.vector_env(50, **rules).reset(seed=3)
    np.testing.assert_array_equal(observations, again)


def test_the_agents_of_a_batch_have_an_axis_of_their_own() -> None:
    paid = [["clean"], ["vase", "help"]]
    env = delivery_v0.vector_env(5, num_agents=2, view_radius=3, agent_rewards=paid)
    assert env.single_observation_space.shape == (2, 7, 7, 7)
    assert env.observation_space.shape == (5, 2, 7, 7, 7)
    assert env.single_action_space.nvec.tolist() == [9, 9]
    assert env.action_space.shape == (5, 2)
    assert env.reward_space.shape == (2, 4)
    np.testing.assert_array_equal(env.reward_space.low, [[0, 0, 0, 0], [0, 0, 0, -1]])
    np.testing.assert_array_equal(env.reward_space.high, [[0, 0, 1, 0], [0, 1, 0, 0]])
    observations, infos = env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(20):
        assert env.observation_space.contains(observations)
        assert infos["objectives"].shape == (5, 2, 4)
        observations, rewards, terminations, truncations, infos = env.step(env.action_space.sample())
        assert rewards.dtype == np.float32
        assert all(env.reward_space.contains(row) for row in rewards)
        assert terminations.shape == truncations.shape == (5,)


def test_a_seed_may_be_any_integer() -> None:
    expected, _ = emergency_v0.vector_env(2).reset(seed=3)
    np.testing.assert_array_equal(emergency_v0.vector_env(2).reset(seed=np.int64(3))[0], expected)
    observation, _ = emergency_v0.parallel_env().reset(seed=np.int64(3))
    np.testing.assert_array_equal(observation["agent_0"], expected[0])


def test_a_partial_reset_seeds_nothing_else() -> None:
    touched, untouched = (emergency_v0.vector_env(2, max_cycles=2) for _ in range(2))
    first = np.array([True, False])
    for env, seeds in ((touched, [8, 9]), (untouched, [8, None])):
        env.reset(seed=0)
        env.reset(seed=seeds, options={"reset_mask": first})
    for _ in range(9):
        for left, right in zip(touched.step([1, 3])[:4], untouched.step([1, 3])[:4], strict=True):
            np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_a_partial_reset_leaves_other_ends_to_be_handled(mode: AutoresetMode) -> None:
    env = emergency_v0.vector_env(2, max_cycles=2, autoreset_mode=mode)
    env.reset(seed=0)
    env.step([4, 4])
    assert env.step([4, 4])[3].all()
    env.reset(options={"reset_mask": np.array([True, False])})
    if mode == AutoresetMode.DISABLED:
        with pytest.raises(ValueError, match="after the end of environment 1"):
            env.step([4, 4])
        env.reset(options={"reset_mask": np.array([False, True])})
        assert not env.step([4, 4])[3].any()
    else:
        assert not env.step([4, 4])[3].any()
        np.testing.assert_array_equal(env.engine.elapsed, [1, 0])
        assert env.step([4, 4])[3].tolist() == [True, False]


def test_a_reset_without_a_seed_goes_on_with_the_stream() -> None:
    env = emergency_v0.single_env()
    first, _ = env.reset(seed=1)
    second, _ = env.reset()
    assert (first != second).any()
    np.testing.assert_array_equal(first, env.reset(seed=1)[0])
    np.testing.assert_array_equal(second, env.reset()[0])


def test_unseeded_environments_differ() -> None:
    starts = {emergency_v0.single_env().reset()[0].tobytes() for _ in range(5)}
    assert len(starts) == 5


@pytest.mark.parametrize("options", [{}, {"num_agents": 3}, {"num_agents": 3, "view_radius": 1}])
@pytest.mark.parametrize("mode", MODES)
def test_what_a_vector_environment_returns_is_the_callers_own(
    mode: AutoresetMode, options: dict[str, Any]
) -> None:
    """Two environments, one whose results are overwritten at once, stay the same through auto-resets."""
    careful, careless = (
        burning_warehouse_v0.vector_env(4, autoreset_mode=mode, max_cycles=3, **options) for _ in range(2)
    )
    careful.reset(seed=0)
    observations, infos = careless.reset(seed=0)
    observations[:], infos["objectives"][:] = 9, 9
    rng = np.random.default_rng(0)
    for time in range(1, 13):
        actions = rng.integers(NUM_ACTIONS, size=careful.action_space.shape)
        left, right = careful.step(actions), careless.step(actions)
        for one, other in zip(left[:4], right[:4], strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(left[4]["objectives"], right[4]["objectives"])
        for array in (*right[:4], *(value for value in right[4].values() if isinstance(value, np.ndarray))):
            array[...] = 1
        if mode == AutoresetMode.DISABLED and time % 3 == 0:
            np.testing.assert_array_equal(careful.reset()[0], careless.reset()[0])


def test_what_multi_agent_environments_return_is_the_callers_own() -> None:
    careful, careless = (delivery_v0.parallel_env(num_agents=3) for _ in range(2))
    careful.reset(seed=0)
    careless.reset(seed=0)
    rng = np.random.default_rng(0)
    while careful.agents:
        actions = {agent: int(rng.integers(NUM_ACTIONS)) for agent in careful.agents}
        left, right = careful.step(actions), careless.step(actions)
        for agent in left[0]:
            np.testing.assert_array_equal(left[0][agent], right[0][agent])
            np.testing.assert_array_equal(left[1][agent], right[1][agent])
            np.testing.assert_array_equal(left[4][agent]["objectives"], right[4][agent]["objectives"])
        for agent in left[0]:
            for array in (right[0][agent], right[1][agent], right[4][agent]["objectives"]):
                array[...] = 1
        careless.state()[...] = 1
        np.testing.assert_array_equal(careful.state(), careless.state())


def test_all_that_aec_last_returns_is_the_callers_own() -> None:
    env = emergency_v0.env(num_agents=2)
    env.reset(seed=0)
    for _ in range(10):
        observation, reward, _, _, info = env.last()
        kept_observation, kept_reward = observation.copy(), reward.copy()
        kept_objectives = info["objectives"].copy()
        observation[...], reward[...], info["objectives"][...] = 7, 7, 7
        info["more"] = 7
        np.testing.assert_array_equal(env.last()[0], kept_observation)
        np.testing.assert_array_equal(env.last()[1], kept_reward)
        assert list(env.last()[4]) == ["objectives"]
        np.testing.assert_array_equal(env.last()[4]["objectives"], kept_objectives)
        env.step(4)


def test_the_state_has_a_plane_for_every_agent() -> None:
    env = delivery_v0.parallel_env(num_agents=3)
    observations, _ = env.reset(seed=0)
    state = env.state()
    assert state.dtype == np.uint8
    assert state.shape == (8, 16, 16)
    assert env.get_central_observation_space().contains(state.ravel())
    for number, agent in enumerate(env.agents):
        np.testing.assert_array_equal(state[0], observations[agent][0])
        np.testing.assert_array_equal(state[1 + number], observations[agent][1])
        np.testing.assert_array_equal(state[4:], observations[agent][2:-1])
        others = state[1:4].sum(axis=0) - state[1 + number]
        np.testing.assert_array_equal(others, observations[agent][-1])
    single = delivery_v0.parallel_env()
    observations, _ = single.reset(seed=0)
    np.testing.assert_array_equal(single.state(), observations["agent_0"])


def test_a_team_shares_what_its_agents_earn() -> None:
    alone, team = (delivery_v0.parallel_env(num_agents=3, team_reward=shared) for shared in (False, True))
    alone.reset(seed=2)
    team.reset(seed=2)
    rng = np.random.default_rng(2)
    while alone.agents:
        actions = {agent: int(rng.integers(NUM_ACTIONS)) for agent in alone.agents}
        _, own, _, _, own_infos = alone.step(actions)
        _, shared, _, _, shared_infos = team.step(actions)
        counted = sum(info["objectives"] for info in own_infos.values())
        for agent in own:
            np.testing.assert_array_equal(shared[agent], sum(own.values()))
            np.testing.assert_array_equal(shared_infos[agent]["objectives"], counted)
            assert team.reward_space(agent).contains(shared[agent])
    assert counted.sum() > 0


def test_a_horizon_of_one_step_resets_at_every_step() -> None:
    env = emergency_v0.vector_env(2, max_cycles=1, autoreset_mode=AutoresetMode.SAME_STEP)
    env.reset(seed=0)
    for _ in range(5):
        assert env.step([4, 4])[3].all()
    waiting = emergency_v0.vector_env(2, max_cycles=1)
    waiting.reset(seed=0)
    truncations = [waiting.step([4, 4])[3].tolist() for _ in range(4)]
    assert truncations == [[True, True], [False, False]] * 2


@pytest.mark.parametrize("mode", MODES)
def test_a_partial_reset_in_mid_episode_touches_no_other_environment(mode: AutoresetMode) -> None:
    """Once episodes have ended and been reset, their ends are forgotten."""
    env = emergency_v0.vector_env(2, max_cycles=3, autoreset_mode=mode)
    env.reset(seed=0)
    for _ in range(3):
        env.step([4, 4])
    if mode == AutoresetMode.NEXT_STEP:
        env.step([4, 4])
    elif mode == AutoresetMode.DISABLED:
        env.reset()
    env.step([4, 4])
    env.reset(options={"reset_mask": np.array([True, False])})
    env.step([4, 4])
    np.testing.assert_array_equal(env.engine.elapsed, [1, 2])


def test_the_rewards_of_an_only_agent_lie_in_their_space() -> None:
    env = delivery_v0.vector_env(3, agent_rewards=[["vase", "help"]])
    env.reset(seed=0)
    rewards = env.step([0, 1, 2])[1]
    assert env.reward_space.shape == (4,)
    assert all(env.reward_space.contains(row) for row in rewards)


@pytest.mark.parametrize("num_agents", [1, 7, 16])
def test_the_sum_of_a_teams_rewards_lies_in_their_space(num_agents: int) -> None:
    """Neither 0.1 nor its multiples are exact in float32."""
    world = World("w", 6, 6, 3, ("time",), ("steps",), (), on_step=Effect("time", -0.1, "steps"))
    env = GridParallelEnv(world, num_agents, team_reward=True)
    env.reset(seed=0)
    rewards = env.step(dict.fromkeys(env.agents, 4))[1]
    assert env.reward_space("agent_0").contains(rewards["agent_0"])
    assert rewards["agent_0"] == pytest.approx([-0.1 * num_agents])


MODULES = [emergency_v0, delivery_v0, burning_warehouse_v0, windy_wall_v0]
FACES = {
    "parallel_env": GridParallelEnv,
    "env": GridAECEnv,
    "single_env": GridEnv,
    "vector_env": GridVectorEnv,
}


@pytest.mark.parametrize("make", FACES)
@pytest.mark.parametrize("module", MODULES)
def test_help_shows_all_that_a_function_takes(module: Any, make: str) -> None:
    function = getattr(module, make)
    assert (function.__module__, function.__qualname__) == (module.__name__, make)
    assert pickle.loads(pickle.dumps(function)) is function  # noqa: S301
    shown = inspect.signature(function)
    rules = inspect.signature(module.world).parameters
    assert list(shown.parameters)[-len(rules) :] == list(rules)
    for name, rule in rules.items():
        assert shown.parameters[name].default == rule.default
        assert shown.parameters[name].kind is inspect.Parameter.KEYWORD_ONLY
    assert not any(given.kind is inspect.Parameter.VAR_KEYWORD for given in shown.parameters.values())
    assert issubclass(shown.return_annotation, FACES[make])
    parameters, returns = inspect.getdoc(function).split("\n\nReturns\n-------\n")
    described = re.findall(r"^(\w[\w, ]*)$", parameters.split("Parameters\n----------\n")[1], re.MULTILINE)
    assert ", ".join(described).split(", ") == list(shown.parameters)
    assert "float32" in returns
    env = function(**{name: given.default for name, given in shown.parameters.items()})
    assert isinstance(env, shown.return_annotation)


def test_the_rules_of_a_new_world_are_shown_as_they_are() -> None:
    def world(num_people: int, **more: Any) -> World:
        return emergency_v0.world(num_people=num_people, **more)

    own = Faces(world)
    assert list(inspect.signature(own.single_env).parameters) == [
        "render_mode",
        "view_radius",
        "num_people",
        "more",
    ]
    assert own.single_env(num_people=2, max_cycles=3).engine.world.horizon == 3
    part = Faces(partial(emergency_v0.world, 5))
    assert part.vector_env(2).engine.world.height == 5


def test_a_worlds_own_class_comes_from_its_own_function() -> None:
    assert inspect.signature(emergency_v0.single_env).return_annotation is emergency_v0.EmergencyEnv
    assert isinstance(emergency_v0.single_env(), emergency_v0.EmergencyEnv)


def test_every_face_shows_its_engine_and_what_its_agents_are_paid() -> None:
    arguments: dict[str, Any] = {"num_agents": 2, "agent_rewards": [["vase", "deliver"], ["help"]]}
    aec, vector = delivery_v0.env(**arguments), delivery_v0.vector_env(3, **arguments)
    assert aec.engine is aec.parallel.engine
    # In the world's order, whatever the order of the names.
    assert vector.agent_reward_names == (("deliver", "vase"), ("help",))
    assert tuple(aec.agent_reward_names.values()) == vector.agent_reward_names
    assert emergency_v0.vector_env(3).agent_reward_names == (("extinguish", "save"),)


def _start(env: Any) -> bytes:
    result = env.reset()
    if result is None:
        return bytes(env.observe("agent_0"))
    observations = result[0]
    return bytes(observations["agent_0"] if isinstance(observations, dict) else observations)


@pytest.mark.parametrize("make", FACES)
def test_copies_of_an_environment_that_nobody_has_seeded_differ(make: str) -> None:
    """As do those in processes that a fork has made."""
    env = getattr(delivery_v0, make)()
    copies = [deepcopy(env), pickle.loads(pickle.dumps(env)), env]  # noqa: S301
    assert len({_start(copied) for copied in copies}) == 3


@pytest.mark.parametrize("make", FACES)
def test_copies_of_an_environment_that_has_started_go_on_alike(make: str) -> None:
    env = getattr(delivery_v0, make)()
    _start(env)
    assert len({_start(copied) for copied in (deepcopy(env), env)}) == 1


def test_a_copy_pays_what_its_original_pays() -> None:
    """Whatever has become of the list that the original was made with."""
    names = [["extinguish"], ["save"]]
    env = emergency_v0.parallel_env(2, agent_rewards=names)
    names.reverse()
    for copied in (deepcopy(env), pickle.loads(pickle.dumps(env))):  # noqa: S301
        np.testing.assert_array_equal(copied.engine.agent_rewards, [[1, 0], [0, 1]])
    by_agent = {"agent_0": ["extinguish"], "agent_1": ["save"]}
    pickle.dumps(emergency_v0.parallel_env(2, agent_rewards=by_agent.values()))


def test_partial_resets_give_each_environment_entropy_once() -> None:
    env = delivery_v0.vector_env(2)
    env.reset(options={"reset_mask": np.array([True, False])})
    streams = env.engine.streams
    env.reset(options={"reset_mask": np.array([False, True])})
    assert env.engine.streams[0] == streams[0]
    copied = deepcopy(env)
    np.testing.assert_array_equal(copied.reset()[0], env.reset()[0])


def test_pettingzoo_takes_all_that_is_an_index() -> None:
    parallel, aec = delivery_v0.parallel_env(2), delivery_v0.env(2)
    parallel.reset(seed=1)
    aec.reset(seed=1)
    observations = parallel.step({"agent_0": np.uint8(1), "agent_1": np.array(3)})[0]
    aec.step(np.uint8(1))
    aec.step(np.array(3))
    np.testing.assert_array_equal(aec.observe("agent_1"), observations["agent_1"])
