"""Each face against the checks and wrappers of the standard it follows."""

from __future__ import annotations

import copy
import subprocess
import sys
from typing import Any

import gymnasium
import mo_gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import FlattenObservation, TimeLimit
from gymnasium.wrappers import TransformReward as ScalarReward
from gymnasium.wrappers.vector import FlattenObservation as VectorFlattenObservation
from gymnasium.wrappers.vector import RecordEpisodeStatistics, TransformReward
from mo_gymnasium.wrappers import (
    LinearReward,
    MOClipReward,
    MOMaxAndSkipObservation,
    MONormalizeReward,
    MORecordEpisodeStatistics,
)
from mo_gymnasium.wrappers.vector import MORecordEpisodeStatistics as MOVectorRecordEpisodeStatistics
from mo_gymnasium.wrappers.vector import MOSyncVectorEnv
from momaland.test.api_test import api_test as mo_api_test
from momaland.utils import parallel_wrappers
from momaland.utils.conversions import mo_aec_to_parallel, mo_parallel_to_aec
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.utils import BaseWrapper
from pettingzoo.utils.conversions import parallel_to_aec

from moral_envs import delivery_v0, emergency_v0
from moral_envs.faces import GridAECEnv, GridEnv, GridParallelEnv, GridVectorEnv
from moral_envs.world import NUM_ACTIONS

MODULES = {"Emergency": emergency_v0, "Delivery": delivery_v0}
IDS = [f"moral/{name}-v0" for name in MODULES]

each_world = pytest.mark.parametrize("module", MODULES.values(), ids=MODULES)
each_id = pytest.mark.parametrize("env_id", IDS)
each_team = pytest.mark.parametrize("num_agents", [1, 2, 5])


def weights(env: Any) -> dict[str, np.ndarray[Any, Any]]:
    """Different scalarisation weights for every agent."""
    rng = np.random.default_rng(0)
    return {agent: rng.random(env.reward_space(agent).shape[0]) for agent in env.possible_agents}


# PettingZoo and MOMAland.


@each_team
@each_world
def test_pettingzoo_accepts_the_parallel_face(module: Any, num_agents: int) -> None:
    parallel_api_test(module.parallel_env(num_agents=num_agents), num_cycles=200)


@each_world
def test_pettingzoo_finds_the_faces_reproducible(module: Any) -> None:
    parallel_seed_test(lambda: module.parallel_env(num_agents=2), num_cycles=200)
    seed_test(lambda: module.env(num_agents=2), num_cycles=200)


@each_world
def test_the_parallel_face_stays_reproducible_over_many_episodes(module: Any) -> None:
    """PettingZoo's own check of the parallel interface compares one step only."""
    first, second, other = (module.parallel_env(num_agents=3) for _ in range(3))
    rng = np.random.default_rng(0)
    differing = 0
    for number in range(10):
        seed = 42 if number == 0 else None
        starts = [env.reset(seed=seed)[0] for env in (first, second)]
        other.reset(seed=43 if number == 0 else None)
        for agent in first.agents:
            np.testing.assert_array_equal(starts[0][agent], starts[1][agent])
        while first.agents:
            actions = {agent: int(rng.integers(NUM_ACTIONS)) for agent in first.agents}
            left, right, wrong = (env.step(actions) for env in (first, second, other))
            assert left[2:4] == right[2:4]
            for agent in left[0]:
                np.testing.assert_array_equal(left[0][agent], right[0][agent])
                np.testing.assert_array_equal(left[1][agent], right[1][agent])
                np.testing.assert_array_equal(left[4][agent]["objectives"], right[4][agent]["objectives"])
                differing += (left[0][agent] != wrong[0][agent]).any()
        assert first.agents == second.agents == []
    assert differing > 0


@each_team
@each_world
def test_momaland_accepts_the_aec_face(module: Any, num_agents: int) -> None:
    mo_api_test(module.env(num_agents=num_agents), num_cycles=100)


@each_world
def test_momaland_accepts_its_own_conversion_of_the_parallel_face(module: Any) -> None:
    converted = mo_parallel_to_aec(module.parallel_env(num_agents=2))
    assert converted.reward_space("agent_0") is converted.reward_space("agent_0")
    converted.reset(seed=0)
    for agent in converted.agent_iter(20):
        assert converted.reward_space(agent).contains(converted.last()[1])
        converted.step(4)
    back = mo_aec_to_parallel(module.env(num_agents=2))
    parallel_api_test(back.aec_env.parallel, num_cycles=100)
    assert back.reward_spaces.keys() == {"agent_0", "agent_1"}


class ScalarAEC(BaseWrapper[Any, Any, Any]):
    """The AEC face with the sums of its reward vectors: PettingZoo's own check compares only scalars."""

    @property
    def rewards(self) -> dict[str, float]:
        return {agent: float(reward.sum()) for agent, reward in self.env.rewards.items()}

    def last(self, observe: bool = True) -> Any:
        observation, reward, *rest = self.env.last(observe)
        return observation, float(reward.sum()), *rest


@each_team
@each_world
def test_pettingzoo_accepts_the_scalarised_aec_face(module: Any, num_agents: int) -> None:
    api_test(ScalarAEC(module.env(num_agents=num_agents)), num_cycles=100)


@each_world
def test_pettingzoo_accepts_the_aec_form_of_scalarised_rewards(module: Any) -> None:
    env = module.parallel_env(num_agents=2)
    api_test(parallel_to_aec(parallel_wrappers.LinearizeReward(env, weights(env))), num_cycles=100)


@each_world
def test_momaland_linearises_rewards(module: Any) -> None:
    plain, wrapped = (module.parallel_env(num_agents=2) for _ in range(2))
    wrapped = parallel_wrappers.LinearizeReward(wrapped, weights(plain))
    plain.reset(seed=1)
    wrapped.reset(seed=1)
    rng = np.random.default_rng(1)
    while plain.agents:
        actions = {agent: int(rng.integers(NUM_ACTIONS)) for agent in plain.agents}
        vectors, scalars = plain.step(actions)[1], wrapped.step(actions)[1]
        for agent, vector in vectors.items():
            assert scalars[agent] == pytest.approx(vector @ weights(plain)[agent])


@each_world
def test_momaland_normalises_and_records_rewards(module: Any) -> None:
    env = module.parallel_env(num_agents=2)
    plain = module.parallel_env(num_agents=2)
    recorded = parallel_wrappers.RecordEpisodeStatistics(env)
    wrapped = recorded
    for agent in env.possible_agents:
        for component in range(len(env.reward_names)):
            wrapped = parallel_wrappers.NormalizeReward(wrapped, agent, component)
    wrapped.reset(seed=1)
    plain.reset(seed=1)
    rng = np.random.default_rng(1)
    totals = dict.fromkeys(plain.agents, 0.0)
    while plain.agents:
        actions = {agent: int(rng.integers(NUM_ACTIONS)) for agent in plain.agents}
        infos = wrapped.step(actions)[4]
        for agent, reward in plain.step(actions)[1].items():
            totals[agent] = totals[agent] + reward
    for agent, total in totals.items():
        np.testing.assert_allclose(infos["episode"]["r"][agent], total, rtol=1e-5)
        assert infos["episode"]["l"][agent] == module.world().horizon


@pytest.mark.parametrize("convert", [False, True])
@each_world
def test_momaland_centralises_the_agents(module: Any, convert: bool) -> None:
    env = mo_aec_to_parallel(module.env(num_agents=2)) if convert else module.parallel_env(num_agents=2)
    plain = module.parallel_env(num_agents=2)
    central = parallel_wrappers.CentraliseAgent(env)
    observation, _ = central.reset(seed=5)
    plain.reset(seed=5)
    rng = np.random.default_rng(5)
    done = False
    while not done:
        np.testing.assert_array_equal(observation, plain.state().ravel())
        assert central.observation_space.contains(observation)
        actions = rng.integers(NUM_ACTIONS, size=2)
        observation, reward, _, done, _ = central.step(actions)
        rewards = plain.step(dict(zip(("agent_0", "agent_1"), actions, strict=True)))[1]
        np.testing.assert_allclose(reward, sum(rewards.values()))
    assert plain.agents == []


@each_world
def test_the_multi_agent_faces_have_the_promised_surface(module: Any) -> None:
    for env in (module.parallel_env(num_agents=2), module.env(num_agents=2)):
        assert env.possible_agents == ["agent_0", "agent_1"]
        assert env.metadata["name"] == module.world().name == str(env)
        assert env.reward_names == module.world().reward_names
        assert env.objective_names == module.world().objective_names
        for agent in env.possible_agents:
            space = env.reward_space(agent)
            assert space is env.reward_space(agent) is env.reward_spaces[agent]
            assert space.shape == (len(env.reward_names),)
            assert space.dtype == np.float32
            assert env.observation_space(agent).dtype == np.uint8
            assert env.action_space(agent).n == 9
    env = module.parallel_env(num_agents=2)
    observations, infos = env.reset(seed=0)
    observations, rewards, _, _, infos = env.step({"agent_0": 3, "agent_1": 8})
    for agent in env.agents:
        assert env.observation_space(agent).contains(observations[agent])
        assert env.reward_space(agent).contains(rewards[agent])
        assert rewards[agent].dtype == np.float32
        assert infos[agent]["objectives"].dtype == np.int64
        assert infos[agent]["objectives"].shape == (len(env.objective_names),)
    assert not np.shares_memory(rewards["agent_0"], rewards["agent_1"])


def test_the_names_and_spaces_are_those_of_the_contract() -> None:
    emergency, delivery = emergency_v0.parallel_env(), delivery_v0.parallel_env(num_agents=2)
    assert emergency.reward_names == ("extinguish", "save")
    assert emergency.objective_names == ("goal_time", "people_saved")
    assert emergency.observation_space("agent_0").shape == (4, 8, 8)
    assert delivery.reward_names == ("deliver", "help", "clean", "vase")
    assert delivery.objective_names == ("delivered", "helped", "cleaned", "vases_broken")
    assert delivery.observation_space("agent_0").shape == (7, 16, 16)
    np.testing.assert_array_equal(emergency.reward_space("agent_0").low, [0, 0])
    np.testing.assert_array_equal(emergency.reward_space("agent_0").high, np.float32([0.1, 1]))
    np.testing.assert_array_equal(delivery.reward_space("agent_0").low, [0, 0, 0, -1])
    np.testing.assert_array_equal(delivery.reward_space("agent_0").high, [1, 1, 1, 0])


# Gymnasium and MO-Gymnasium.


@each_id
def test_gymnasium_accepts_the_scalarised_single_face(env_id: str) -> None:
    # Not by MO-Gymnasium's LinearReward: the same weights are in all its infos, which the checker forbids.
    scalarised = ScalarReward(gymnasium.make(env_id), lambda reward: float(reward.sum()))
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(scalarised)


@each_id
def test_an_environment_is_made_by_its_id(env_id: str) -> None:
    env = gymnasium.make(env_id, render_mode="ansi", max_cycles=3)
    assert isinstance(env.unwrapped, GridEnv)
    assert env.spec is not None
    assert env.spec.id == env_id
    assert env.unwrapped.render_mode == "ansi"
    assert env.unwrapped.reward_dim == env.unwrapped.reward_space.shape[0] == len(env.unwrapped.reward_names)
    assert env.observation_space.contains(env.reset(seed=0)[0])
    truncations = []
    for _ in range(3):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert env.unwrapped.reward_space.contains(reward)
        assert not terminated
        assert info["objectives"].dtype == np.int64
        truncations.append(truncated)
    assert truncations == [False, False, True]
    assert isinstance(mo_gymnasium.make(env_id).unwrapped, GridEnv)


@each_id
def test_a_vector_environment_is_made_by_its_id(env_id: str) -> None:
    envs = gymnasium.make_vec(env_id, num_envs=16, autoreset_mode="SameStep", height=12)
    assert isinstance(envs.unwrapped, GridVectorEnv)
    assert envs.num_envs == 16
    assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    assert gymnasium.make_vec(env_id).metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    observations, infos = envs.reset(seed=0)
    assert envs.observation_space.contains(observations)
    assert infos["objectives"].shape == (16, len(envs.unwrapped.objective_names))
    envs.action_space.seed(0)
    for _ in range(200):
        observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(observations)
        assert rewards.shape == (16, envs.unwrapped.reward_dim)
        assert rewards.dtype == np.float32
        assert all(envs.unwrapped.reward_space.contains(row) for row in rewards)
        assert terminations.dtype == truncations.dtype == np.bool_
        assert not terminations.any()
    envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@each_id
def test_gymnasium_records_scalarised_vector_episodes(env_id: str, mode: AutoresetMode) -> None:
    horizon = 4
    envs = gymnasium.make_vec(env_id, num_envs=3, max_cycles=horizon, autoreset_mode=mode)
    plain = gymnasium.make_vec(env_id, num_envs=3, max_cycles=horizon, autoreset_mode=mode)
    recorded = RecordEpisodeStatistics(TransformReward(envs, lambda rewards: rewards.sum(axis=1)))
    recorded.reset(seed=0)
    plain.reset(seed=0)
    rng = np.random.default_rng(0)
    returns = np.zeros(3)
    ends = 0
    for _ in range(40):
        actions = rng.integers(NUM_ACTIONS, size=3)
        truncations, infos = recorded.step(actions)[3:]
        returns += plain.step(actions)[1].sum(axis=1)
        assert truncations.all() == ("episode" in infos)
        if truncations.all():
            ends += 1
            np.testing.assert_allclose(infos["episode"]["r"], returns, rtol=1e-6)
            assert infos["episode"]["l"].tolist() == [horizon] * 3
            returns[:] = 0
    assert ends == (10 if mode == AutoresetMode.SAME_STEP else 8)


def test_mo_gymnasium_records_vector_episodes() -> None:
    envs = gymnasium.make_vec("moral/Delivery-v0", num_envs=3)
    recorded = MOVectorRecordEpisodeStatistics(envs)
    recorded.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(50):
        infos = recorded.step(rng.integers(NUM_ACTIONS, size=3))[4]
    signs = [1, 1, 1, -1]
    np.testing.assert_array_equal(infos["episode"]["r"], infos["objectives"] * signs)
    assert infos["episode"]["l"].tolist() == [50, 50, 50]


@each_id
def test_gymnasium_flattens_vector_observations(env_id: str) -> None:
    plain, flat = (gymnasium.make_vec(env_id, num_envs=2, max_cycles=2) for _ in range(2))
    flat = VectorFlattenObservation(flat)
    np.testing.assert_array_equal(flat.reset(seed=0)[0], plain.reset(seed=0)[0].reshape(2, -1))
    for _ in range(4):
        observations, flat_observations = plain.step([1, 3])[0], flat.step([1, 3])[0]
        np.testing.assert_array_equal(flat_observations, observations.reshape(2, -1))
        assert flat.observation_space.contains(flat_observations)


@each_id
def test_mo_gymnasium_wraps_the_single_face(env_id: str) -> None:
    plain = gymnasium.make(env_id)
    env = MORecordEpisodeStatistics(gymnasium.make(env_id), gamma=0.9)
    for component in range(plain.unwrapped.reward_dim):
        env = MOClipReward(MONormalizeReward(env, component), component, -0.5, 0.5)
    weight = np.arange(1.0, 1 + plain.unwrapped.reward_dim)
    env = LinearReward(env, weight)
    env.reset(seed=0)
    plain.reset(seed=0)
    rng = np.random.default_rng(0)
    total: Any = 0
    truncated = False
    while not truncated:
        action = int(rng.integers(NUM_ACTIONS))
        _, scalar, _, truncated, info = env.step(action)
        assert np.abs(info["vector_reward"]).max() <= 0.5
        assert scalar == pytest.approx(info["vector_reward"] @ weight)
        total = total + plain.step(action)[1]
    np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-5)


@each_id
def test_mo_gymnasium_skips_steps_and_gymnasium_flattens_and_limits(env_id: str) -> None:
    env = MOMaxAndSkipObservation(gymnasium.make(env_id), skip=3)
    env.reset(seed=0)
    assert env.step(4)[1].shape == (env.unwrapped.reward_dim,)
    limited = TimeLimit(FlattenObservation(gymnasium.make(env_id)), 5)
    observation, _ = limited.reset(seed=0)
    assert limited.observation_space.contains(observation)
    assert [limited.step(4)[3] for _ in range(5)] == [False] * 4 + [True]
    assert gymnasium.make(env_id, max_episode_steps=7).spec.max_episode_steps == 7


@each_id
def test_mo_gymnasium_batches_the_single_face(env_id: str) -> None:
    envs = MOSyncVectorEnv([lambda: gymnasium.make(env_id, max_cycles=3)] * 2)
    envs.reset(seed=0)
    truncations = []
    for _ in range(4):
        _, rewards, _, truncation, infos = envs.step([4, 4])
        assert rewards.shape == (2, envs.reward_space.shape[0])
        truncations.append(truncation.tolist())
    assert truncations == [[False, False]] * 2 + [[True, True], [False, False]]
    assert infos["objectives"].shape[0] == 2


@pytest.mark.parametrize("make", [emergency_v0.parallel_env, emergency_v0.env, emergency_v0.single_env])
def test_a_copy_goes_its_own_way(make: Any) -> None:
    env = make()
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    step: Any = {"agent_0": 4} if isinstance(env, GridParallelEnv) else 4
    env.step(step)
    engines = [e.parallel.engine if isinstance(e, GridAECEnv) else e.engine for e in (env, twin)]
    assert [engine.elapsed[0] for engine in engines] == [1, 0]


def test_importing_the_package_loads_no_heavy_library() -> None:
    code = "import sys, moral_envs; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "moral_envs.engine" in loaded
    assert not loaded & {"torch", "pygame", "scipy", "matplotlib", "stable_baselines3", "momaland", "PIL"}
