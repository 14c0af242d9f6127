"""The engine as a ``VecEnv``, against loops over single environments."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moral_algorithms.bridge import EngineVecEnv, Replay
from moral_envs import emergency_v0
from moral_envs.engine import Engine
from moral_envs.faces import GridEnv, GridParallelEnv
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, World
from tests.envs.worlds import seeds, small_worlds

WORLD = emergency_v0.world(5, 6, num_people=3, max_cycles=6)


def random_actions(seed: int, count: int, num_actions: int = NUM_ACTIONS) -> np.ndarray:
    return np.random.default_rng(seed).integers(num_actions, size=count)


@settings(max_examples=30)
@given(world=small_worlds(1), num_envs=st.integers(1, 3), seed=seeds)
def test_steps_as_a_loop_over_gymnasium_environments(world: World, num_envs: int, seed: int) -> None:
    venv = EngineVecEnv(world, num_envs, seed=seed)
    singles = [GridEnv(world) for _ in range(num_envs)]
    for single, stream in zip(singles, spawn_streams(seed, num_envs), strict=True):
        single.engine.seed(np.array([stream]))
    observations = np.stack([single.reset()[0] for single in singles])
    np.testing.assert_array_equal(venv.reset(), observations)

    for step in range(2 * world.horizon + 1):
        actions = random_actions(step, num_envs, world.num_actions)
        before = observations
        observations, rewards, dones, infos = venv.step(actions)
        assert venv.transitions is not None
        np.testing.assert_array_equal(venv.transitions.observations, before)
        np.testing.assert_array_equal(venv.transitions.actions, actions)
        for env, single in enumerate(singles):
            expected, vector_reward, terminated, truncated, info = single.step(int(actions[env]))
            np.testing.assert_array_equal(infos[env]["vector_reward"], vector_reward)
            np.testing.assert_array_equal(venv.transitions.vector_rewards[env], vector_reward)
            np.testing.assert_array_equal(venv.transitions.next_observations[env], expected)
            assert infos[env]["vector_reward"].dtype == np.float32
            assert rewards[env] == pytest.approx(vector_reward.sum())
            assert dones[env] == (terminated or truncated)
            if dones[env]:
                np.testing.assert_array_equal(infos[env]["terminal_observation"], expected)
                np.testing.assert_array_equal(infos[env]["objectives"], info["objectives"])
                assert infos[env]["TimeLimit.truncated"] is truncated
                expected, _ = single.reset()
            else:
                assert infos[env].keys() == {"vector_reward"}
            np.testing.assert_array_equal(observations[env], expected)


@settings(max_examples=30)
@given(
    world=small_worlds(3),
    num_envs=st.integers(1, 2),
    num_agents=st.integers(2, 3),
    team=st.booleans(),
    seed=seeds,
)
def test_several_agents_are_rows_of_their_environment(
    world: World, num_envs: int, num_agents: int, team: bool, seed: int
) -> None:
    venv = EngineVecEnv(world, num_envs, num_agents, team, seed)
    parallels = [GridParallelEnv(world, num_agents, team) for _ in range(num_envs)]
    for parallel, stream in zip(parallels, spawn_streams(seed, num_envs), strict=True):
        parallel.engine.seed(np.array([stream]))
    starts = [start for parallel in parallels for start in parallel.reset()[0].values()]
    np.testing.assert_array_equal(venv.reset(), starts)
    for step in range(world.horizon):
        actions = random_actions(step, num_envs * num_agents, world.num_actions)
        _, _, dones, infos = venv.step(actions)
        assert venv.transitions is not None
        for env, parallel in enumerate(parallels):
            rows = range(env * num_agents, (env + 1) * num_agents)
            chosen = {agent: int(actions[row]) for agent, row in zip(parallel.agents, rows, strict=True)}
            seen, rewards, terminations, truncations, parallel_infos = parallel.step(chosen)
            for agent, row in zip(chosen, rows, strict=True):
                np.testing.assert_array_equal(venv.transitions.next_observations[row], seen[agent])
                np.testing.assert_array_equal(infos[row]["vector_reward"], rewards[agent])
                assert dones[row] == (terminations[agent] or truncations[agent])
                if dones[row]:
                    final = parallel_infos[agent]["objectives"]
                    np.testing.assert_array_equal(infos[row]["objectives"], final)
            if not parallel.agents:
                parallel.reset()


@settings(max_examples=25)
@given(world=small_worlds(3), num_agents=st.integers(1, 3), seed=seeds)
def test_a_replay_leads_to_the_same_objectives(world: World, num_agents: int, seed: int) -> None:
    venv = EngineVecEnv(world, 2, num_agents, seed=seed)
    venv.reset()
    ended = 0
    for step in range(2 * world.horizon):
        _, _, dones, infos = venv.step(random_actions(seed + step, venv.num_envs, world.num_actions))
        for row in dones.nonzero()[0]:
            written = json.loads(json.dumps(infos[row]["replay"].to_json()))
            replay = Replay.from_json(written, num_agents)
            np.testing.assert_array_equal(replay.actions, infos[row]["replay"].actions)
            engine = Engine(world, 1, num_agents)
            engine.seed(np.array([replay.stream], dtype=np.uint64))
            engine.reset()
            for actions in replay.actions:
                engine.step(actions[None])
            agent = row % num_agents
            np.testing.assert_array_equal(engine.objectives[0, agent], infos[row]["objectives"])
            np.testing.assert_array_equal(engine.observe()[0, agent], infos[row]["terminal_observation"])
            ended += 1
    assert ended >= 2 * venv.num_envs
    assert world.ends_early or ended == 2 * venv.num_envs


def test_episodes_that_end_at_different_times_do_not_touch_each_other() -> None:
    venv = EngineVecEnv(WORLD, 3, seed=5)
    venv.reset()
    for step in range(2):
        venv.step(random_actions(step, 3))
    state = venv.state_dict()
    # The second environment is said to be two steps further.
    state["engine.elapsed"] = state["engine.elapsed"] + np.array([0, 2, 0])
    venv.load_state_dict(state)
    streams = venv.engine.streams.copy()
    all_dones = []
    for step in range(2 * WORLD.horizon):
        actions = random_actions(10 + step, 3)
        previous = venv.engine.streams.copy()
        _, _, dones, infos = venv.step(actions)
        all_dones.append(dones.tolist())
        np.testing.assert_array_equal(venv.engine.streams[~dones], previous[~dones])
        assert [("objectives" in info) for info in infos] == dones.tolist()
        for row in dones.nonzero()[0]:
            if sum(done[row] for done in all_dones) == 2:
                # The replay starts where the first of these episodes left the stream.
                assert infos[row]["replay"].stream == int(streams[row])
    assert [step for step, dones in enumerate(all_dones) if dones[1]] == [1, 7]
    assert [step for step, dones in enumerate(all_dones) if dones[0] and dones[2]] == [3, 9]


@pytest.mark.parametrize("num_agents", [1, 2])
def test_goes_on_exactly_from_a_saved_state(num_agents: int) -> None:
    venv = EngineVecEnv(WORLD, 2, num_agents, seed=3)
    venv.reset()
    for step in range(8):
        observations, *_ = venv.step(random_actions(step, venv.num_envs))
    state = venv.state_dict()
    twin = EngineVecEnv(WORLD, 2, num_agents, seed=99)
    np.testing.assert_array_equal(twin.load_state_dict(state), observations)
    ended = 0
    for step in range(8, 22):
        actions = random_actions(step, venv.num_envs)
        expected, got = venv.step(actions), twin.step(actions)
        for one, other in zip(expected[:3], got[:3], strict=True):
            np.testing.assert_array_equal(one, other)
        for one, other in zip(expected[3], got[3], strict=True):
            assert one.keys() == other.keys()
            if "replay" in one:
                assert one["replay"].to_json() == other["replay"].to_json()
                np.testing.assert_array_equal(one["objectives"], other["objectives"])
                ended += 1
    assert ended == 2 * venv.num_envs


def test_a_saved_state_does_not_change_and_must_fit() -> None:
    venv = EngineVecEnv(WORLD, 2, seed=3)
    venv.reset()
    state = venv.state_dict()
    copies = {name: value.copy() for name, value in state.items()}
    for step in range(7):
        venv.step(random_actions(step, 2))
    for name, value in copies.items():
        np.testing.assert_array_equal(state[name], value)
    with pytest.raises(ValueError, match="history"):
        EngineVecEnv(WORLD, 3).load_state_dict(state)
    longer = emergency_v0.world(5, 6, num_people=3, max_cycles=7)
    with pytest.raises(ValueError, match="history"):
        EngineVecEnv(longer, 2).load_state_dict(state)


def test_what_it_returns_is_not_its_own_state() -> None:
    venv, twin = EngineVecEnv(WORLD, 2, seed=3), EngineVecEnv(WORLD, 2, seed=3)
    twin.reset()
    venv.reset()[:] = 7
    for step in range(2 * WORLD.horizon):
        actions = random_actions(step, 2)
        expected, got = twin.step(actions), venv.step(actions)
        np.testing.assert_array_equal(got[0], expected[0])
        np.testing.assert_array_equal(got[1], expected[1])
        got[0][:] = 7
        got[1][:] = 7
        actions[:] = 0
        for info, twin_info in zip(got[3], expected[3], strict=True):
            np.testing.assert_array_equal(info["vector_reward"], twin_info["vector_reward"])
            info["vector_reward"][:] = 7
            if "replay" in info:
                np.testing.assert_array_equal(info["replay"].actions, twin_info["replay"].actions)
        assert venv.transitions is not None
        assert twin.transitions is not None
        for one, other in zip(venv.transitions, twin.transitions, strict=True):
            np.testing.assert_array_equal(one, other)


def test_seed_chooses_the_streams_of_the_next_reset_only() -> None:
    venv = EngineVecEnv(WORLD, 4, seed=0)
    venv.seed(11)
    seeded = venv.reset()
    np.testing.assert_array_equal(seeded, EngineVecEnv(WORLD, 4, seed=11).reset())
    engine = Engine(WORLD, 4)
    engine.seed(spawn_streams(11, 4))
    engine.reset()
    np.testing.assert_array_equal(seeded, engine.observe()[:, 0])
    engine.reset()
    np.testing.assert_array_equal(venv.reset(), engine.observe()[:, 0])


@pytest.mark.parametrize("actions", [np.zeros((2, 1), dtype=int), np.zeros(3, dtype=int), np.zeros(2)])
def test_actions_of_another_shape_or_type_are_refused(actions: np.ndarray) -> None:
    venv = EngineVecEnv(WORLD, 2, seed=0)
    venv.reset()
    with pytest.raises(AssertionError, match="actions"):
        venv.step(actions)


def test_rows_share_one_engine() -> None:
    venv = EngineVecEnv(WORLD, 3, seed=0)
    assert venv.get_attr("world", [0, 2]) == [WORLD, WORLD]
    assert not venv.has_attr("no_such_attribute")
    assert venv.env_is_wrapped(GridEnv) == [False] * 3  # type: ignore[arg-type]
    with pytest.raises(NotImplementedError, match="directly"):
        venv.set_attr("render_mode", "ansi")
    with pytest.raises(NotImplementedError, match="directly"):
        venv.env_method("reset")
