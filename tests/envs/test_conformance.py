"""Each face against the checks and wrappers of the standard it follows."""

from __future__ import annotations

import copy
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import mo_gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import env_render_passive_checker
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
from pettingzoo.test import (
    api_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
    state_test,
)
from pettingzoo.utils import BaseWrapper
from pettingzoo.utils.conversions import parallel_to_aec

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.faces import GridAECEnv, GridEnv, GridParallelEnv, GridVectorEnv
from moral_envs.layouts import Layout
from moral_envs.world import MAX_HORIZON, World

MODULES = {
    "Emergency": emergency_v0,
    "Delivery": delivery_v0,
    "BurningWarehouse": burning_warehouse_v0,
    "WindyWall": windy_wall_v0,
}


@dataclass
class Variant:
    """A world with some of its arguments set."""

    name: str
    rules: dict[str, Any] = field(default_factory=dict)
    paid: Callable[[tuple[str, ...], int], list[Sequence[str]]] | None = None
    """What to pay each of some agents, given the names of the reward components."""

    @property
    def id(self) -> str:
        return f"moral/{self.name}-v0"

    @property
    def module(self) -> Any:
        return MODULES[self.name]

    def world(self) -> World:
        return self.module.world(**{name: rule for name, rule in self.rules.items() if name != "view_radius"})

    def single_env(self, **more: Any) -> GridEnv:
        return gymnasium.make(self.id, **{**self.rules, **more})

    def vector_env(self, **more: Any) -> GridVectorEnv:
        return gymnasium.make_vec(self.id, **{**self.rules, **more})

    def parallel_env(self, num_agents: int = 1, **more: Any) -> GridParallelEnv:
        return self.module.parallel_env(num_agents, **self.rules, **self._agent_rewards(num_agents), **more)

    def env(self, num_agents: int = 1, **more: Any) -> GridAECEnv:
        return self.module.env(num_agents, **self.rules, **self._agent_rewards(num_agents), **more)

    def _agent_rewards(self, num_agents: int) -> dict[str, Any]:
        return (
            {} if self.paid is None else {"agent_rewards": self.paid(self.world().reward_names, num_agents)}
        )


def one_each(names: tuple[str, ...], num_agents: int) -> list[Sequence[str]]:
    return [names[agent % len(names) :][:1] for agent in range(num_agents)]


def more_and_more(names: tuple[str, ...], num_agents: int) -> list[Sequence[str]]:
    return [names[: 1 + agent % len(names)] for agent in range(num_agents)]


WORLDS = {
    **{name: Variant(name) for name in MODULES if name != "WindyWall"},
    "WindyWall": Variant("WindyWall", {"max_cycles": 60}),
}
ALONE = {
    **WORLDS,
    "Emergency, what is near": Variant("Emergency", {"view_radius": 2}),
    "Delivery, random rooms": Variant("Delivery", {"layout": "random"}),
    "BurningWarehouse, a maze and what is near": Variant(
        "BurningWarehouse", {"layout": "maze", "view_radius": 1}
    ),
    "WindyWall, what is near": Variant("WindyWall", {"max_cycles": 60, "view_radius": 3}),
}
ALIKE = {**ALONE, "Delivery, one component each": Variant("Delivery", paid=one_each)}
TOGETHER = {
    **ALIKE,
    "Emergency, different components": Variant(
        "Emergency", {"layout": "random", "view_radius": 2}, more_and_more
    ),
}

each_world = pytest.mark.parametrize("variant", WORLDS.values(), ids=WORLDS)
each_single = pytest.mark.parametrize("variant", ALONE.values(), ids=ALONE)
each_alike = pytest.mark.parametrize("variant", ALIKE.values(), ids=ALIKE)
each_variant = pytest.mark.parametrize("variant", TOGETHER.values(), ids=TOGETHER)
each_team = pytest.mark.parametrize("num_agents", [1, 2, 5])


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Windows are drawn to memory; some suites leave them open."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    if "pygame" in sys.modules:
        sys.modules["pygame"].display.quit()


def random_joint(env: Any, rng: np.random.Generator) -> dict[str, int]:
    return {agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents}


def weights(env: Any) -> dict[str, np.ndarray[Any, Any]]:
    """Different scalarisation weights for every agent."""
    rng = np.random.default_rng(0)
    return {agent: rng.random(env.reward_space(agent).shape[0]) for agent in env.possible_agents}


# PettingZoo and MOMAland.


@each_team
@each_variant
def test_pettingzoo_accepts_the_parallel_face(variant: Variant, num_agents: int) -> None:
    parallel_api_test(variant.parallel_env(num_agents=num_agents), num_cycles=200)


@each_variant
def test_pettingzoo_finds_the_faces_reproducible(variant: Variant) -> None:
    parallel_seed_test(lambda: variant.parallel_env(num_agents=2), num_cycles=200)
    seed_test(lambda: variant.env(num_agents=2), num_cycles=200)


@each_variant
def test_the_parallel_face_stays_reproducible_over_many_episodes(variant: Variant) -> None:
    """PettingZoo's own check of the parallel interface compares one step only."""
    first, second, other = (variant.parallel_env(num_agents=3) for _ in range(3))
    rng = np.random.default_rng(0)
    differing = 0
    for number in range(10):
        seed = 42 if number == 0 else None
        starts = [env.reset(seed=seed)[0] for env in (first, second)]
        other.reset(seed=43 if number == 0 else None)
        for agent in first.agents:
            np.testing.assert_array_equal(starts[0][agent], starts[1][agent])
        while first.agents:
            actions = random_joint(first, rng)
            left, right, wrong = (env.step(actions) for env in (first, second, other))
            assert left[2:4] == right[2:4]
            for agent in left[0]:
                np.testing.assert_array_equal(left[0][agent], right[0][agent])
                np.testing.assert_array_equal(left[1][agent], right[1][agent])
                np.testing.assert_array_equal(left[4][agent]["objectives"], right[4][agent]["objectives"])
                differing += (left[0][agent] != wrong[0][agent]).any()
        assert first.agents == second.agents == []
    assert differing > 0


@pytest.mark.parametrize("num_agents", [1, 3])
@pytest.mark.parametrize("variant", WORLDS.values(), ids=WORLDS)
def test_pettingzoo_accepts_the_state(variant: Variant, num_agents: int) -> None:
    env, parallel = variant.env(num_agents=num_agents), variant.parallel_env(num_agents=num_agents)
    state_test(env, parallel)
    for face in (env, parallel):
        face.reset(seed=0)
        assert face.state_space.contains(face.state())


@each_team
@each_variant
def test_momaland_accepts_the_aec_face(variant: Variant, num_agents: int) -> None:
    mo_api_test(variant.env(num_agents=num_agents), num_cycles=100)


@each_variant
def test_momaland_accepts_its_own_conversion_of_the_parallel_face(variant: Variant) -> None:
    converted = mo_parallel_to_aec(variant.parallel_env(num_agents=2))
    assert converted.reward_space("agent_0") is converted.reward_space("agent_0")
    converted.reset(seed=0)
    for agent in converted.agent_iter(20):
        assert converted.reward_space(agent).contains(converted.last()[1])
        converted.step(0)
    back = mo_aec_to_parallel(variant.env(num_agents=2))
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
@each_variant
def test_pettingzoo_accepts_the_scalarised_aec_face(variant: Variant, num_agents: int) -> None:
    api_test(ScalarAEC(variant.env(num_agents=num_agents)), num_cycles=100)


@each_variant
def test_pettingzoo_accepts_the_aec_form_of_scalarised_rewards(variant: Variant) -> None:
    env = variant.parallel_env(num_agents=2)
    api_test(parallel_to_aec(parallel_wrappers.LinearizeReward(env, weights(env))), num_cycles=100)


@each_variant
def test_momaland_linearises_rewards(variant: Variant) -> None:
    plain, wrapped = (variant.parallel_env(num_agents=2) for _ in range(2))
    wrapped = parallel_wrappers.LinearizeReward(wrapped, weights(plain))
    plain.reset(seed=1)
    wrapped.reset(seed=1)
    rng = np.random.default_rng(1)
    while plain.agents:
        actions = random_joint(plain, rng)
        vectors, scalars = plain.step(actions)[1], wrapped.step(actions)[1]
        for agent, vector in vectors.items():
            assert scalars[agent] == pytest.approx(vector @ weights(plain)[agent])


@each_variant
def test_momaland_normalises_and_records_rewards(variant: Variant) -> None:
    env = variant.parallel_env(num_agents=2)
    plain = variant.parallel_env(num_agents=2)
    recorded = parallel_wrappers.RecordEpisodeStatistics(env)
    wrapped = recorded
    for agent in env.possible_agents:
        for component in range(len(env.agent_reward_names[agent])):
            wrapped = parallel_wrappers.NormalizeReward(wrapped, agent, component)
    wrapped.reset(seed=1)
    plain.reset(seed=1)
    rng = np.random.default_rng(1)
    totals = dict.fromkeys(plain.agents, 0.0)
    steps = 0
    while plain.agents:
        steps += 1
        actions = random_joint(plain, rng)
        infos = wrapped.step(actions)[4]
        for agent, reward in plain.step(actions)[1].items():
            totals[agent] = totals[agent] + reward
    for agent, total in totals.items():
        np.testing.assert_allclose(infos["episode"]["r"][agent], total, rtol=1e-5)
        assert infos["episode"]["l"][agent] == steps


@pytest.mark.parametrize("convert", [False, True])
@each_alike
def test_momaland_centralises_the_agents(variant: Variant, convert: bool) -> None:
    env = mo_aec_to_parallel(variant.env(num_agents=2)) if convert else variant.parallel_env(num_agents=2)
    plain = variant.parallel_env(num_agents=2)
    central = parallel_wrappers.CentraliseAgent(env)
    observation, _ = central.reset(seed=5)
    plain.reset(seed=5)
    rng = np.random.default_rng(5)
    done = False
    while not done:
        np.testing.assert_array_equal(observation, plain.state().ravel())
        assert central.observation_space.contains(observation)
        actions = rng.integers(variant.world().num_actions, size=2)
        observation, reward, terminated, truncated, _ = central.step(actions)
        done = terminated or truncated
        rewards = plain.step(dict(zip(("agent_0", "agent_1"), actions, strict=True)))[1]
        np.testing.assert_allclose(reward, sum(rewards.values()))
    assert plain.agents == []


@each_variant
def test_the_multi_agent_faces_have_the_promised_surface(variant: Variant) -> None:
    world = variant.world()
    for env in (variant.parallel_env(num_agents=2), variant.env(num_agents=2)):
        assert env.possible_agents == ["agent_0", "agent_1"]
        assert env.metadata["name"] == world.name == str(env)
        assert env.reward_names == world.reward_names
        assert env.objective_names == world.objective_names
        for agent in env.possible_agents:
            space = env.reward_space(agent)
            assert space is env.reward_space(agent) is env.reward_spaces[agent]
            assert space.shape == (len(env.agent_reward_names[agent]),)
            assert space.dtype == np.float32
            assert env.observation_space(agent).dtype == np.uint8
            assert env.action_space(agent).n == world.num_actions
    env = variant.parallel_env(num_agents=2)
    observations, infos = env.reset(seed=0)
    observations, rewards, _, _, infos = env.step({"agent_0": 3, "agent_1": 2})
    for agent in env.agents:
        assert env.observation_space(agent).contains(observations[agent])
        assert env.reward_space(agent).contains(rewards[agent])
        assert rewards[agent].dtype == np.float32
        assert infos[agent]["objectives"].dtype == np.int64
        assert infos[agent]["objectives"].shape == (len(env.objective_names),)
    assert not np.shares_memory(rewards["agent_0"], rewards["agent_1"])


# Every render mode.


def unhurried(env: Any) -> Any:
    """Hardly wait between frames; the suites want a rate above zero."""
    env.metadata["render_fps"] = 10_000
    return env


@each_team
@each_variant
def test_pettingzoo_accepts_what_the_aec_face_renders(variant: Variant, num_agents: int) -> None:
    render_test(lambda render_mode: unhurried(variant.env(num_agents, render_mode=render_mode)))


@pytest.mark.parametrize("mode", ["ansi", "rgb_array", "human"])
@each_team
@each_world
def test_the_suites_accept_the_multi_agent_faces_in_every_render_mode(
    variant: Variant, num_agents: int, mode: str
) -> None:
    env = unhurried(variant.parallel_env(num_agents, render_mode=mode))
    assert mode in env.metadata["render_modes"]
    parallel_api_test(env, num_cycles=10)
    mo_api_test(unhurried(variant.env(num_agents, render_mode=mode)), num_cycles=10)
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, 0))
    frame = env.render()
    assert {"ansi": isinstance(frame, str), "human": frame is None}.get(mode, isinstance(frame, np.ndarray))
    env.close()


@each_single
def test_gymnasium_accepts_the_single_face_in_every_render_mode(variant: Variant) -> None:
    for mode in variant.single_env().metadata["render_modes"]:
        env = unhurried(variant.single_env(render_mode=mode).unwrapped)
        with pytest.warns(UserWarning, match="different from the unwrapped version"):
            check_env(ScalarReward(env, lambda reward: float(reward.sum())), skip_render_check=True)
        env_render_passive_checker(env)
        env.close()


@pytest.mark.parametrize("options", [{}, {"num_agents": 3}])
@pytest.mark.parametrize("mode", ["ansi", "rgb_array"])
@each_single
def test_a_vector_environment_renders_every_environment(
    variant: Variant, mode: str, options: dict[str, Any]
) -> None:
    envs = variant.vector_env(num_envs=2, render_mode=mode, **options)
    assert mode in envs.metadata["render_modes"]
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    frames = envs.render()
    assert len(frames) == 2
    for frame in frames:
        assert isinstance(frame, str) if mode == "ansi" else frame.dtype == np.uint8 and frame.shape[2] == 3


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


@each_single
def test_gymnasium_accepts_the_scalarised_single_face(variant: Variant) -> None:
    # Not by MO-Gymnasium's LinearReward: the same weights are in all its infos, which the checker forbids.
    scalarised = ScalarReward(variant.single_env(), lambda reward: float(reward.sum()))
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(scalarised)


@each_single
def test_an_environment_is_made_by_its_id(variant: Variant) -> None:
    env = variant.single_env(render_mode="ansi", max_cycles=3)
    assert isinstance(env.unwrapped, GridEnv)
    assert env.spec is not None
    assert env.spec.id == variant.id
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
    assert isinstance(mo_gymnasium.make(variant.id).unwrapped, GridEnv)


@each_world
def test_gymnasium_knows_the_render_modes_before_it_makes_one(variant: Variant) -> None:
    """It wraps what is asked for as a list, and it would say what it does not find."""
    env = gymnasium.make(variant.id, render_mode="rgb_array_list", max_cycles=3)
    env.reset(seed=0)
    env.step(0)
    frames = env.render()
    assert isinstance(frames, list)
    assert len(frames) == 2


def test_a_layout_survives_the_json_of_a_specification() -> None:
    layout = Layout(walls=(0.0, 0.4), height=(6, 9), counts={"people": (1, 3)}, max_cycles=(10, 20))
    env = gymnasium.make("moral/Emergency-v0", layout=layout)
    assert env.spec is not None
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert isinstance(env.unwrapped, GridEnv)
    assert isinstance(again.unwrapped, GridEnv)
    assert again.unwrapped.engine.world == env.unwrapped.engine.world


def test_the_longest_episodes_go_on_after_the_first() -> None:
    env = emergency_v0.single_env(max_cycles=MAX_HORIZON)
    for seed in range(3):
        env.reset(seed=seed)
        assert env.step(4)[2:4] == (False, False)


@pytest.mark.parametrize("options", [{}, {"num_agents": 2}])
@each_single
def test_a_vector_environment_is_made_by_its_id(variant: Variant, options: dict[str, Any]) -> None:
    envs = variant.vector_env(num_envs=16, autoreset_mode="SameStep", max_cycles=40, **options)
    assert isinstance(envs.unwrapped, GridVectorEnv)
    assert envs.num_envs == 16
    assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    assert variant.vector_env().metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    observations, infos = envs.reset(seed=0)
    assert envs.observation_space.contains(observations)
    agents = tuple(options.values())
    assert infos["objectives"].shape == (16, *agents, len(envs.unwrapped.objective_names))
    envs.action_space.seed(0)
    for _ in range(100):
        observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(observations)
        assert rewards.shape == (16, *agents, envs.unwrapped.reward_dim)
        assert rewards.dtype == np.float32
        assert all(envs.unwrapped.reward_space.contains(row) for row in rewards)
        assert terminations.dtype == truncations.dtype == np.bool_
        assert variant.name == "WindyWall" or not terminations.any()
    envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@each_single
def test_gymnasium_records_scalarised_vector_episodes(variant: Variant, mode: AutoresetMode) -> None:
    horizon = 4
    envs = variant.vector_env(num_envs=3, max_cycles=horizon, autoreset_mode=mode)
    plain = variant.vector_env(num_envs=3, max_cycles=horizon, autoreset_mode=mode)
    recorded = RecordEpisodeStatistics(TransformReward(envs, lambda rewards: rewards.sum(axis=1)))
    recorded.reset(seed=0)
    plain.reset(seed=0)
    rng = np.random.default_rng(0)
    returns = np.zeros(3)
    ends = 0
    for _ in range(40):
        actions = rng.integers(variant.world().num_actions, size=3)
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
        infos = recorded.step(rng.integers(9, size=3))[4]
    signs = [1, 1, 1, -1]
    np.testing.assert_array_equal(infos["episode"]["r"], infos["objectives"] * signs)
    assert infos["episode"]["l"].tolist() == [50, 50, 50]


@each_single
def test_gymnasium_flattens_vector_observations(variant: Variant) -> None:
    plain, flat = (variant.vector_env(num_envs=2, max_cycles=2) for _ in range(2))
    flat = VectorFlattenObservation(flat)
    np.testing.assert_array_equal(flat.reset(seed=0)[0], plain.reset(seed=0)[0].reshape(2, -1))
    for _ in range(4):
        observations, flat_observations = plain.step([1, 3])[0], flat.step([1, 3])[0]
        np.testing.assert_array_equal(flat_observations, observations.reshape(2, -1))
        assert flat.observation_space.contains(flat_observations)


@each_single
def test_mo_gymnasium_wraps_the_single_face(variant: Variant) -> None:
    plain = variant.single_env()
    env = MORecordEpisodeStatistics(variant.single_env(), gamma=0.9)
    for component in range(plain.unwrapped.reward_dim):
        env = MOClipReward(MONormalizeReward(env, component), component, -0.5, 0.5)
    weight = np.arange(1.0, 1 + plain.unwrapped.reward_dim)
    env = LinearReward(env, weight)
    env.reset(seed=0)
    plain.reset(seed=0)
    rng = np.random.default_rng(0)
    total: Any = 0
    ended = False
    while not ended:
        action = int(rng.integers(env.action_space.n))
        _, scalar, terminated, truncated, info = env.step(action)
        ended = terminated or truncated
        assert np.abs(info["vector_reward"]).max() <= 0.5
        assert scalar == pytest.approx(info["vector_reward"] @ weight)
        total = total + plain.step(action)[1]
    np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-5)


@each_single
def test_mo_gymnasium_skips_steps_and_gymnasium_flattens_and_limits(variant: Variant) -> None:
    env = MOMaxAndSkipObservation(variant.single_env(), skip=3)
    env.reset(seed=0)
    assert env.step(0)[1].shape == (env.unwrapped.reward_dim,)
    limited = TimeLimit(FlattenObservation(variant.single_env()), 5)
    observation, _ = limited.reset(seed=0)
    assert limited.observation_space.contains(observation)
    assert [limited.step(0)[3] for _ in range(5)] == [False] * 4 + [True]
    assert variant.single_env(max_episode_steps=7).spec.max_episode_steps == 7


@each_single
def test_mo_gymnasium_batches_the_single_face(variant: Variant) -> None:
    envs = MOSyncVectorEnv([lambda: variant.single_env(max_cycles=3)] * 2)
    envs.reset(seed=0)
    truncations = []
    for _ in range(4):
        _, rewards, _, truncation, infos = envs.step([0, 0])
        assert rewards.shape == (2, envs.reward_space.shape[0])
        truncations.append(truncation.tolist())
    assert truncations == [[False, False]] * 2 + [[True, True], [False, False]]
    assert infos["objectives"].shape[0] == 2


@each_variant
def test_a_copy_goes_its_own_way(variant: Variant) -> None:
    """An environment and its copy go through the same, one after the other."""

    def play(env: Any) -> list[Any]:
        rng = np.random.default_rng(0)
        steps = [env.step(random_joint(env, rng)) for _ in range(8)]
        return [results[agent] for step in steps for results in step[:4] for agent in env.possible_agents]

    env = variant.parallel_env(num_agents=2)
    env.reset(seed=0)
    env.step({"agent_0": 1, "agent_1": 3})
    twin = copy.deepcopy(env)
    before = twin.state()
    played = play(env)
    assert [env.engine.elapsed[0], twin.engine.elapsed[0]] == [9, 1]
    np.testing.assert_array_equal(twin.state(), before)
    for one, other in zip(played, play(twin), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(twin.state(), env.state())

    aec = variant.env(num_agents=2)
    aec.reset(seed=0)
    aec_twin = copy.deepcopy(aec)
    for _ in range(4):
        aec.step(0)
    assert [env.parallel.engine.elapsed[0] for env in (aec, aec_twin)] == [2, 0]
    assert aec_twin.agent_selection == "agent_0"

    vector = copy.deepcopy(variant.vector_env(num_envs=3))
    vector.reset(seed=0)
    with pytest.raises(ValueError, match=r"must have shape \(3,\)$"):
        vector.step([1])


def test_importing_the_package_loads_no_heavy_library() -> None:
    code = "import sys, moral_envs; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "moral_envs.engine" in loaded
    assert not loaded & {"torch", "pygame", "scipy", "matplotlib", "stable_baselines3", "momaland", "PIL"}
