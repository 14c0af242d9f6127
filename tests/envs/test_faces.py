"""One engine: with the same seed and actions every face gives the same trace, final counters included."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st
from mo_gymnasium.wrappers.vector import MOSyncVectorEnv
from momaland.utils.conversions import mo_aec_to_parallel, mo_parallel_to_aec
from numpy.typing import NDArray

from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.faces import GridAECEnv, GridEnv, GridParallelEnv, GridVectorEnv
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, World
from tests.envs.worlds import small_worlds

Actions = NDArray[np.int64]
"""Of shape (episodes, horizon, n_agents)."""

MODES = list(AutoresetMode)
DEFAULT_WORLDS = [emergency_v0.world(), delivery_v0.world()]


@dataclass
class Episode:
    """What an episode showed; the first observations and objectives are those of the reset."""

    observations: NDArray[np.uint8]
    """Shape (horizon + 1, n_agents, C, H, W)."""
    rewards: NDArray[np.float32]
    """Shape (horizon, n_agents, k)."""
    truncations: NDArray[np.bool_]
    """Shape (horizon,)."""
    objectives: NDArray[np.int64]
    """Shape (horizon + 1, n_agents, m)."""


Trace = list[Episode]


class Recorder:
    """Gathers an episode step by step."""

    def __init__(self, observations: Any, objectives: Any) -> None:
        self.observations, self.objectives = [observations], [objectives]
        self.rewards: list[Any] = []
        self.truncations: list[Any] = []

    def add(self, observations: Any, rewards: Any, truncation: Any, objectives: Any) -> None:
        self.observations.append(observations)
        self.rewards.append(rewards)
        self.truncations.append(truncation)
        self.objectives.append(objectives)

    def episode(self) -> Episode:
        recorded = (self.observations, self.rewards, self.truncations, self.objectives)
        return Episode(*(np.array(values) for values in recorded))


def assert_same(left: Trace, right: Trace) -> None:
    assert len(left) == len(right)
    for one, other in zip(left, right, strict=True):
        for name in ("observations", "rewards", "truncations", "objectives"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def engine_trace(engine: Engine, seed: int, actions: Actions) -> Trace:
    engine.seed(spawn_streams(seed, 1))
    trace = []
    for episode in actions:
        engine.reset()
        recorder = Recorder(engine.observe()[0], engine.objectives[0])
        for joint in episode:
            step = engine.step(joint[None])
            recorder.add(engine.observe()[0], step.rewards[0], step.truncations[0], engine.objectives[0])
        trace.append(recorder.episode())
    return trace


def parallel_trace(env: Any, seed: int, actions: Actions) -> Trace:
    trace = []
    for number, episode in enumerate(actions):
        observations, infos = env.reset(seed=seed if number == 0 else None)
        agents = list(env.agents)
        recorder = Recorder(
            [observations[agent] for agent in agents], [infos[agent]["objectives"] for agent in agents]
        )
        for joint in episode:
            assert env.agents == agents
            observations, rewards, terminations, truncations, infos = env.step(
                dict(zip(agents, joint, strict=True))
            )
            assert not any(terminations.values())
            assert len(set(truncations.values())) == 1
            recorder.add(
                [observations[agent] for agent in agents],
                [rewards[agent] for agent in agents],
                truncations[agents[0]],
                [infos[agent]["objectives"] for agent in agents],
            )
        assert not env.agents
        trace.append(recorder.episode())
    return trace


def aec_trace(env: Any, seed: int, actions: Actions) -> Trace:
    trace = []
    for number, episode in enumerate(actions):
        env.reset(seed=seed if number == 0 else None)
        agents = list(env.agents)
        turns: dict[str, list[Any]] = {agent: [] for agent in agents}
        for agent in env.agent_iter():
            observation, reward, terminated, truncated, info = env.last()
            assert not terminated
            turns[agent].append((observation, reward.copy(), truncated, info["objectives"].copy()))
            time = len(turns[agent]) - 1
            env.step(None if truncated else episode[time, agents.index(agent)])
        steps = zip(*turns.values(), strict=True)
        joint = [[list(values) for values in zip(*step, strict=True)] for step in steps]
        recorder = Recorder(joint[0][0], joint[0][3])
        assert not np.any(joint[0][1])
        for observations, rewards, truncations, objectives in joint[1:]:
            assert len(set(truncations)) == 1
            recorder.add(observations, rewards, truncations[0], objectives)
        trace.append(recorder.episode())
    return trace


def single_trace(env: GridEnv, seed: int, actions: Actions) -> Trace:
    trace = []
    for number, episode in enumerate(actions):
        observation, info = env.reset(seed=seed if number == 0 else None)
        recorder = Recorder([observation], [info["objectives"]])
        for (action,) in episode:
            observation, reward, terminated, truncated, info = env.step(action)
            assert not terminated
            recorder.add([observation], [reward], truncated, [info["objectives"]])
        trace.append(recorder.episode())
    return trace


def vector_trace(env: Any, seed: int, actions: Actions, mode: AutoresetMode, head_start: int) -> Trace:
    """The trace of environment 1 of three, whose neighbours are some steps further in their episodes."""
    rng = np.random.default_rng(seed)
    batch = rng.integers(NUM_ACTIONS, size=(*actions.shape[:2], 3))
    batch[:, :, 1] = actions[:, :, 0]
    alone = np.array([False, True, False])
    env.reset(seed=[seed + 1, seed, seed + 2])
    for _ in range(head_start):
        env.step(rng.integers(NUM_ACTIONS, size=3))
    if head_start:
        observations, infos = env.reset(seed=[None, seed, None], options={"reset_mask": alone})
    else:
        observations, infos = env.reset(seed=[None, seed, None])
    ended = np.zeros(3, dtype=np.bool_)
    trace = []
    for number, episode in enumerate(batch):
        if number > 0 and mode == AutoresetMode.NEXT_STEP:
            observations, rewards, _, truncations, infos = env.step(rng.integers(NUM_ACTIONS, size=3))
            assert not rewards[1].any()
            assert not truncations[1]
        recorder = Recorder(observations[1:2], infos["objectives"][1:2])
        for joint in episode:
            if mode == AutoresetMode.DISABLED and ended.any():
                env.reset(options={"reset_mask": ended})
            observations, rewards, terminations, truncations, infos = env.step(joint)
            assert not terminations.any()
            ended = truncations.copy()
            last, objectives = observations[1], infos["objectives"][1]
            if mode == AutoresetMode.SAME_STEP and truncations.any():
                np.testing.assert_array_equal(infos["_final_obs"], truncations)
                np.testing.assert_array_equal(infos["_final_info"], truncations)
                np.testing.assert_array_equal(infos["final_info"]["_objectives"], truncations)
                for env_number in range(3):
                    assert (infos["final_obs"][env_number] is not None) == truncations[env_number]
                if truncations[1]:
                    last, objectives = infos["final_obs"][1], infos["final_info"]["objectives"][1]
            recorder.add([last], rewards[1:2], truncations[1], [objectives])
        if mode == AutoresetMode.DISABLED:
            observations, infos = env.reset(options={"reset_mask": ended})
            ended[:] = False
        trace.append(recorder.episode())
    return trace


def require_one_trace(
    world: World, num_agents: int, team_reward: bool, seed: int, actions: Actions, head_start: int
) -> Trace:
    expected = engine_trace(Engine(world, 1, num_agents, team_reward), seed, actions)
    arguments = (world, num_agents, team_reward)
    assert_same(parallel_trace(GridParallelEnv(*arguments), seed, actions), expected)
    assert_same(aec_trace(GridAECEnv(*arguments), seed, actions), expected)
    assert_same(aec_trace(mo_parallel_to_aec(GridParallelEnv(*arguments)), seed, actions), expected)
    assert_same(parallel_trace(mo_aec_to_parallel(GridAECEnv(*arguments)), seed, actions), expected)
    if num_agents == 1:
        assert_same(single_trace(GridEnv(world), seed, actions), expected)
        for mode in MODES:
            vector = GridVectorEnv(world, 3, autoreset_mode=mode)
            assert_same(vector_trace(vector, seed, actions, mode, head_start), expected)
        peer = MOSyncVectorEnv([lambda: GridEnv(world)] * 3)
        assert_same(vector_trace(peer, seed, actions, AutoresetMode.NEXT_STEP, 0), expected)
    return expected


def random_actions(seed: int, episodes: int, world: World, num_agents: int) -> Actions:
    rng = np.random.default_rng(seed)
    return rng.integers(NUM_ACTIONS, size=(episodes, world.horizon, num_agents))


@pytest.mark.parametrize("num_agents", [1, 2, 3])
@pytest.mark.parametrize("world", DEFAULT_WORLDS, ids=lambda world: str(world.name))
def test_all_faces_give_one_trace_in_full_episodes(world: World, num_agents: int) -> None:
    """Six times 35 episodes, 210 in all, each over the whole horizon on every face."""
    actions = random_actions(num_agents, 35, world, num_agents)
    trace = require_one_trace(world, num_agents, False, seed=8, actions=actions, head_start=11)
    starts = {episode.observations[0].tobytes() for episode in trace}
    assert len(starts) == 35
    for episode in trace:
        np.testing.assert_array_equal(np.flatnonzero(episode.truncations), [world.horizon - 1])
        assert not episode.objectives[0].any()
    assert (sum(episode.objectives[-1].sum(axis=0) for episode in trace) > 0).all()


@given(data=st.data(), seed=st.integers(0, 2**32 - 3), team_reward=st.booleans())
@settings(max_examples=100)
def test_all_faces_give_one_trace_in_any_world(data: st.DataObject, seed: int, team_reward: bool) -> None:
    num_agents = data.draw(st.integers(1, 4))
    world = data.draw(small_worlds(num_agents))
    head_start = data.draw(st.integers(0, world.horizon - 1))
    actions = random_actions(seed, 3, world, num_agents)
    require_one_trace(world, num_agents, team_reward and num_agents > 1, seed, actions, head_start)


@pytest.mark.parametrize("module", [emergency_v0, delivery_v0])
def test_a_list_of_seeds_is_as_many_single_environments(module: Any) -> None:
    seeds = [4, 7, 4, 0]
    vector = module.vector_env(4, autoreset_mode=AutoresetMode.SAME_STEP)
    observations, _ = vector.reset(seed=seeds)
    singles = [module.single_env() for _ in seeds]
    for row, env, seed in zip(observations, singles, seeds, strict=True):
        np.testing.assert_array_equal(row, env.reset(seed=seed)[0])
    np.testing.assert_array_equal(observations[0], observations[2])
    actions = random_actions(0, 3, module.world(), 4).reshape(-1, 4)
    for joint in actions:
        observations, rewards, _, truncations, infos = vector.step(joint)
        for i, env in enumerate(singles):
            observation, reward, _, truncated, info = env.step(joint[i])
            np.testing.assert_array_equal(rewards[i], reward)
            assert truncations[i] == truncated
            if truncated:
                np.testing.assert_array_equal(infos["final_info"]["objectives"][i], info["objectives"])
                observation, info = env.reset()
            np.testing.assert_array_equal(observations[i], observation)
            np.testing.assert_array_equal(infos["objectives"][i], info["objectives"])


@pytest.mark.parametrize("module", [emergency_v0, delivery_v0])
def test_one_seed_gives_every_environment_its_own_episode(module: Any) -> None:
    observations, _ = module.vector_env(50).reset(seed=3)
    assert len({row.tobytes() for row in observations}) == 50
    np.testing.assert_array_equal(observations[0], module.single_env().reset(seed=3)[0])
    np.testing.assert_array_equal(observations[:10], module.vector_env(10).reset(seed=3)[0])
    again, _ = module.vector_env(50).reset(seed=3)
    np.testing.assert_array_equal(observations, again)


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


@pytest.mark.parametrize("mode", MODES)
def test_what_a_vector_environment_returns_is_the_callers_own(mode: AutoresetMode) -> None:
    """Two environments, one whose results are overwritten at once, stay the same through auto-resets."""
    careful, careless = (emergency_v0.vector_env(4, autoreset_mode=mode, max_cycles=3) for _ in range(2))
    careful.reset(seed=0)
    observations, infos = careless.reset(seed=0)
    observations[:], infos["objectives"][:] = 9, 9
    rng = np.random.default_rng(0)
    for time in range(1, 13):
        actions = rng.integers(NUM_ACTIONS, size=4)
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
