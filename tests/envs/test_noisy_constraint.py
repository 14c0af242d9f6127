"""The two-state CMDP: its payoffs, its noise, the thesis's closed form, and the standards' own checks."""

from __future__ import annotations

import copy
import inspect
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TransformReward as ScalarReward
from gymnasium.wrappers.vector import RecordEpisodeStatistics, TransformReward
from hypothesis import given
from hypothesis import strategies as st
from mo_gymnasium.wrappers import LinearReward, MONormalizeReward, MORecordEpisodeStatistics
from mo_gymnasium.wrappers.vector import MORecordEpisodeStatistics as MOVectorRecordEpisodeStatistics
from mo_gymnasium.wrappers.vector import MOSyncVectorEnv
from momaland.test.api_test import api_test as mo_api_test
from momaland.utils import parallel_wrappers
from momaland.utils.conversions import mo_aec_to_parallel, mo_parallel_to_aec
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.utils.conversions import parallel_to_aec

from moral_envs import noisy_constraint_v0
from moral_envs.noisy_constraint_v0 import NoisyConstraintVectorEnv, success_probability

FACES: dict[str, Callable[..., Any]] = {
    name: getattr(noisy_constraint_v0, name) for name in ("single_env", "vector_env", "parallel_env", "env")
}
START, SAFE, UNSAFE = np.eye(3, dtype=np.uint8)

each_face = pytest.mark.parametrize("make", FACES.values(), ids=FACES)
each_noise = pytest.mark.parametrize("noise", [0.0, 0.7])
each_mode = pytest.mark.parametrize("mode", list(AutoresetMode))


def decide(
    num: int, action: int, seed: int = 0, episodes: int = 1, **payoffs: Any
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Reward vectors of as many decisions in each of ``num`` environments, float32 (episodes * num, 2)."""
    envs = noisy_constraint_v0.vector_env(num, autoreset_mode=AutoresetMode.SAME_STEP, **payoffs)
    envs.reset(seed=seed)
    return np.concatenate([envs.step(np.full(num, action))[1] for _ in range(episodes)])


def started(num: int) -> NoisyConstraintVectorEnv:
    """A batch whose first episodes have begun."""
    envs = noisy_constraint_v0.vector_env(num)
    envs.reset(seed=0)
    return envs


# The rules.


@pytest.mark.parametrize(
    ("action", "state", "reward", "counters"),
    [(0, SAFE, (0.5, 0.0), (1, 0)), (1, UNSAFE, (1.0, -1.0), (0, 1))],
)
def test_a_decision_pays_costs_and_ends(
    action: int, state: Any, reward: tuple[float, float], counters: tuple[int, int]
) -> None:
    env = noisy_constraint_v0.single_env()
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(observation, START)
    np.testing.assert_array_equal(info["objectives"], [0, 0])
    observation, vector, terminated, truncated, info = env.step(action)
    np.testing.assert_array_equal(observation, state)
    np.testing.assert_array_equal(vector, np.float32(reward))
    assert not np.signbit(vector[0])
    assert (terminated, truncated) == (True, False)
    np.testing.assert_array_equal(info["objectives"], counters)
    assert vector.dtype == np.float32
    assert info["objectives"].dtype == np.int64
    assert observation.dtype == np.uint8


def test_payoffs_are_arguments() -> None:
    payoffs = {"rewards": (3, -2.0), "costs": [0.25, 7]}
    assert decide(1, 0, **payoffs).tolist() == [[3.0, -0.25]]
    assert decide(1, 1, **payoffs).tolist() == [[-2.0, -7.0]]
    space = noisy_constraint_v0.single_env(**payoffs).reward_space
    assert (space.low.tolist(), space.high.tolist()) == ([-2.0, -7.0], [3.0, 0.0])
    noisy = noisy_constraint_v0.single_env(noise=0.1, **payoffs).reward_space
    assert (noisy.low.tolist(), noisy.high.tolist()) == ([-2.0, -math.inf], [3.0, math.inf])


@pytest.mark.parametrize(("action", "cost"), [(0, 0.0), (1, 1.0)])
def test_an_observed_cost_is_normal_around_the_true_one(action: int, cost: float) -> None:
    """Moments, tails and independence, each within five standard errors of the sample."""
    num, noise = 40_000, 0.6
    rewards = decide(num // 200, action, episodes=200, noise=noise)
    assert set(rewards[:, 0].tolist()) == {(0.5, 1.0)[action]}
    errors = (-rewards[:, 1] - cost) / noise
    margin = 5 / math.sqrt(num)
    assert abs(errors.mean()) < margin
    assert abs((errors**2).mean() - 1) < margin * math.sqrt(2)
    assert abs((errors**3).mean()) < margin * math.sqrt(15)
    assert abs((errors**4).mean() - 3) < margin * math.sqrt(96)
    assert abs(np.corrcoef(errors[:-1], errors[1:])[0, 1]) < margin
    for bound in (-2.0, -0.5, 0.0, 1.0, 2.5):
        share = 0.5 * (1 + math.erf(bound / math.sqrt(2)))
        assert abs((errors <= bound).mean() - share) < 5 * math.sqrt(share * (1 - share) / num)


def test_the_counters_are_free_of_noise() -> None:
    envs = noisy_constraint_v0.vector_env(3, noise=50.0)
    envs.reset(seed=0)
    objectives = envs.step([0, 1, 1])[4]["objectives"]
    assert objectives.tolist() == [[1, 0], [0, 1], [0, 1]]


# Equation 3.6.


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.5, 1.5])
@pytest.mark.parametrize("threshold", [-0.4, 0.3, 0.5, 1.1])
def test_the_success_probability_is_what_the_environment_shows(threshold: float, noise: float) -> None:
    """Equation 3.5 on observed costs: S1 is chosen where S2 looks too costly and S1 does not."""
    num = 20_000
    safe, unsafe = (-decide(100, action, action, num // 100, noise=noise)[:, 1] for action in (0, 1))
    successes = ((unsafe > threshold) & (safe <= threshold)).mean()
    probability = success_probability(threshold, noise)
    margin = 5 * math.sqrt(probability * (1 - probability) / num)
    assert abs(successes - probability) <= margin


@given(st.floats(0.05, 5), st.floats(-3, 3))
def test_the_best_threshold_lies_half_way_between_the_costs(noise: float, offset: float) -> None:
    best = success_probability(0.5, noise)
    assert success_probability(0.5 + offset, noise) <= best + 1e-12
    assert success_probability(0.5 - offset, noise) == pytest.approx(success_probability(0.5 + offset, noise))
    assert success_probability(0.5, 1.1 * noise) <= best
    assert success_probability(2.5 + 2 * offset, 2 * noise, (1.5, 3.5)) == pytest.approx(
        success_probability(0.5 + offset, noise)
    )


def test_known_success_probabilities() -> None:
    assert success_probability(0.5, 0.5) == pytest.approx(0.8413447460685429**2)
    assert success_probability(0.0, 1.0) == pytest.approx(0.5 * 0.8413447460685429)
    assert [success_probability(d, 0.0) for d in (-0.1, 0.0, 0.5, 1.0)] == [0.0, 1.0, 1.0, 0.0]


# Faces.


@each_noise
def test_all_faces_give_the_same_trace(noise: float) -> None:
    single, parallel, aec = (FACES[name](noise=noise) for name in ("single_env", "parallel_env", "env"))
    vectors = noisy_constraint_v0.vector_env(2, noise=noise, autoreset_mode=AutoresetMode.SAME_STEP)
    rng = np.random.default_rng(0)
    seen = set()
    for episode in range(20):
        seed = 5 if episode == 0 else None
        if episode == 0:
            vectors.reset(seed=[seed, 6])
        observation, info = single.reset(seed=seed)
        observations, infos = parallel.reset(seed=seed)
        aec.reset(seed=seed)
        np.testing.assert_array_equal(observations["agent_0"], observation)
        np.testing.assert_array_equal(aec.last()[0], observation)
        np.testing.assert_array_equal(infos["agent_0"]["objectives"], info["objectives"])
        action = int(rng.integers(2))
        expected = single.step(action)
        together = [part["agent_0"] for part in parallel.step({"agent_0": action})]
        aec.step(action)
        batch = vectors.step([action, 0])
        alone = (batch[4]["final_obs"], *batch[1:4], batch[4]["final_info"])
        for trace in (together, aec.last(), [part[0] for part in alone[:4]]):
            for part, wanted in zip(trace[:4], expected[:4], strict=False):
                np.testing.assert_array_equal(part, wanted)
        for counters in (together[4], aec.last()[4]):
            np.testing.assert_array_equal(counters["objectives"], expected[4]["objectives"])
        np.testing.assert_array_equal(alone[4]["objectives"][0], expected[4]["objectives"])
        seen.add(float(expected[1][1]))
    assert len(seen) == (2 if noise == 0 else 20)


def test_a_batch_in_next_step_mode_decides_and_returns_in_turns() -> None:
    envs = noisy_constraint_v0.vector_env(2)
    envs.reset(seed=0)
    for _ in range(3):
        observations, rewards, terminations, truncations, infos = envs.step([0, 1])
        np.testing.assert_array_equal(observations, [SAFE, UNSAFE])
        assert rewards.tolist() == [[0.5, 0.0], [1.0, -1.0]]
        assert terminations.tolist() == [True, True]
        assert infos["objectives"].tolist() == [[1, 0], [0, 1]]
        observations, rewards, terminations, truncations, infos = envs.step([1, 1])
        np.testing.assert_array_equal(observations, [START, START])
        assert not rewards.any()
        assert not terminations.any()
        assert not truncations.any()
        assert not infos["objectives"].any()


def test_a_batch_in_same_step_mode_decides_at_every_step() -> None:
    envs = noisy_constraint_v0.vector_env(2, autoreset_mode="SameStep")
    envs.reset(seed=0)
    for _ in range(3):
        observations, rewards, terminations, _, infos = envs.step([1, 0])
        np.testing.assert_array_equal(observations, [START, START])
        assert rewards.tolist() == [[1.0, -1.0], [0.5, 0.0]]
        assert terminations.tolist() == [True, True]
        np.testing.assert_array_equal(list(infos["final_obs"]), [UNSAFE, SAFE])
        assert infos["final_info"]["objectives"].tolist() == [[0, 1], [1, 0]]
        assert infos["_final_obs"].tolist() == infos["_final_info"].tolist() == [True, True]
        assert not infos["objectives"].any()


def test_a_batch_without_resets_wants_them_from_the_caller() -> None:
    envs = noisy_constraint_v0.vector_env(3, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=0)
    envs.step([1, 0, 1])
    mask = np.array([True, False, True])
    observations, infos = envs.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(observations, [START, SAFE, START])
    assert infos["objectives"].tolist() == [[0, 0], [1, 0], [0, 0]]
    with pytest.raises(ValueError, match=r"after the end of environment 1; call reset first"):
        envs.step([0, 0, 0])


def test_resetting_one_environment_leaves_the_others_streams_alone() -> None:
    batch, twin = (noisy_constraint_v0.vector_env(2, noise=1.0) for _ in range(2))
    for envs in (batch, twin):
        envs.reset(seed=3)
        envs.step([0, 0])
    batch.reset(seed=9, options={"reset_mask": np.array([True, False])})
    batch.step([1, 1])
    twin.step([1, 1])
    batch.reset(options={"reset_mask": np.array([True, False])})
    mine, other = batch.step([1, 1])[1], twin.step([1, 1])[1]
    assert mine[0, 1] != other[0, 1]
    assert mine[1, 1] == other[1, 1]


def test_a_seeded_environment_does_not_depend_on_the_size_of_its_batch() -> None:
    first = decide(7, 1, noise=1.0)
    np.testing.assert_array_equal(first[:3], decide(3, 1, noise=1.0))
    assert len(np.unique(first[:, 1])) == 7
    assert (first != decide(7, 1, seed=1, noise=1.0)).any()


@pytest.mark.parametrize("make", [FACES["single_env"], FACES["parallel_env"], FACES["env"]])
def test_a_copy_goes_its_own_way(make: Any) -> None:
    env = make(noise=1.0)
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    env.step({"agent_0": 1} if make is FACES["parallel_env"] else 1)
    np.testing.assert_array_equal(twin.state(), START)
    np.testing.assert_array_equal(env.state(), UNSAFE)


def test_nothing_that_is_handed_out_is_shared() -> None:
    env = noisy_constraint_v0.single_env(render_mode="rgb_array")
    observation, info = env.reset(seed=0)
    observation[:] = 9
    info["objectives"][:] = 9
    frame = env.render()
    frame[:] = 0
    assert env.render().any()
    observation, _, _, _, info = env.step(0)
    np.testing.assert_array_equal(observation, SAFE)
    assert info["objectives"].tolist() == [1, 0]
    aec = noisy_constraint_v0.env()
    aec.reset()
    aec.step(1)
    aec.last()[1][:] = 9
    aec.last()[4]["objectives"][:] = 9
    assert aec.last()[1].tolist() == [1.0, -1.0]


# The standards' own checks and wrappers.


def entry(name: str, **arguments: Any) -> str:
    """Id of an environment that is registered for the tests."""
    if name not in gymnasium.registry:
        gymnasium.register(
            id=name,
            entry_point="moral_envs.noisy_constraint_v0:single_env",
            vector_entry_point="moral_envs.noisy_constraint_v0:vector_env",
            disable_env_checker=True,
            kwargs=arguments,
        )
    return name


QUIET, NOISY = entry("test/NoisyConstraint-v0"), entry("test/NoisierConstraint-v0", noise=0.5)
each_id = pytest.mark.parametrize("env_id", [QUIET, NOISY])


@each_noise
def test_pettingzoo_and_momaland_accept_the_faces(noise: float) -> None:
    parallel, aec = (partial(FACES[name], noise=noise) for name in ("parallel_env", "env"))
    parallel_api_test(parallel(), num_cycles=100)
    parallel_seed_test(parallel, num_cycles=100)
    seed_test(aec, num_cycles=100)
    mo_api_test(aec(), num_cycles=100)
    parallel_api_test(mo_aec_to_parallel(aec()), num_cycles=100)
    weights = {"agent_0": np.array([0.3, 0.7])}
    api_test(parallel_to_aec(parallel_wrappers.LinearizeReward(parallel(), weights)), num_cycles=100)


def test_momaland_converts_and_wraps_the_parallel_face() -> None:
    converted = mo_parallel_to_aec(noisy_constraint_v0.parallel_env())
    converted.reset(seed=0)
    converted.step(1)
    assert converted.reward_space("agent_0").contains(converted.last()[1])
    wrapped = parallel_wrappers.RecordEpisodeStatistics(noisy_constraint_v0.parallel_env())
    wrapped.reset(seed=0)
    infos = wrapped.step({"agent_0": 1})[4]
    np.testing.assert_array_equal(infos["episode"]["r"]["agent_0"], [1.0, -1.0])
    central = parallel_wrappers.CentraliseAgent(noisy_constraint_v0.parallel_env())
    observation, _ = central.reset(seed=0)
    assert central.observation_space.contains(observation)
    np.testing.assert_array_equal(observation, START)


@each_id
def test_gymnasium_accepts_the_scalarised_single_face(env_id: str) -> None:
    scalarised = ScalarReward(gymnasium.make(env_id), lambda reward: float(reward.sum()))
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(scalarised)


@each_id
def test_mo_gymnasium_wraps_the_single_face(env_id: str) -> None:
    env = LinearReward(MORecordEpisodeStatistics(gymnasium.make(env_id)), np.array([1.0, 2.0]))
    env.reset(seed=0)
    _, scalar, terminated, _, info = env.step(1)
    assert terminated
    assert scalar == pytest.approx(info["vector_reward"] @ [1.0, 2.0])
    np.testing.assert_allclose(info["episode"]["r"], info["vector_reward"], rtol=1e-6)
    normalised = MONormalizeReward(gymnasium.make(env_id), 1)
    normalised.reset(seed=0)
    assert normalised.step(1)[1].shape == (2,)
    envs = MOSyncVectorEnv([lambda: gymnasium.make(env_id)] * 2)
    envs.reset(seed=0)
    assert envs.step([0, 1])[2].tolist() == [True, True]


@each_id
def test_a_vector_environment_is_made_by_its_id(env_id: str) -> None:
    same_step = gymnasium.make_vec(env_id, num_envs=5, autoreset_mode="SameStep")
    assert same_step.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    # The only mode that MO-Gymnasium's recorder knows is the default.
    envs = gymnasium.make_vec(env_id, num_envs=5)
    assert isinstance(envs.unwrapped, NoisyConstraintVectorEnv)
    recorded = MOVectorRecordEpisodeStatistics(envs)
    observations, _ = recorded.reset(seed=0)
    assert recorded.observation_space.contains(observations)
    envs.action_space.seed(0)
    for step in range(6):
        observations, rewards, terminations, _, infos = recorded.step(envs.action_space.sample())
        assert recorded.observation_space.contains(observations)
        assert all(envs.unwrapped.reward_space.contains(row) for row in rewards)
        assert terminations.tolist() == [step % 2 == 0] * 5
        assert ("episode" in infos) == (step % 2 == 0)
        if step % 2 == 0:
            np.testing.assert_allclose(infos["episode"]["r"], rewards, rtol=1e-6)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_gymnasium_records_scalarised_vector_episodes(mode: AutoresetMode) -> None:
    envs = gymnasium.make_vec(QUIET, num_envs=3, autoreset_mode=mode)
    recorded = RecordEpisodeStatistics(TransformReward(envs, lambda rewards: rewards.sum(axis=1)))
    recorded.reset(seed=0)
    for step in range(6):
        infos = recorded.step([0, 1, 0])[4]
        ended = mode == AutoresetMode.SAME_STEP or step % 2 == 0
        assert ("episode" in infos) == ended
        if ended:
            assert infos["episode"]["r"].tolist() == [0.5, 0.0, 0.5]
            assert infos["episode"]["l"].tolist() == [1, 1, 1]


# Pictures.


def test_the_ansi_frame_is_that_of_the_documentation() -> None:
    env = noisy_constraint_v0.single_env(render_mode="ansi")
    env.reset()
    frame = env.render()
    assert isinstance(frame, str)
    documented = noisy_constraint_v0.__doc__ or ""
    assert "\n".join(f"    {line}" for line in frame.splitlines()) in documented
    env.step(1)
    assert env.render() == " S  -0-> S1   reward 0.5, cost 0\n    -1->[S2]  reward 1, cost 1"
    env.reset()
    env.step(0)
    assert env.render() == " S  -0->[S1]  reward 0.5, cost 0\n    -1-> S2   reward 1, cost 1"


def test_the_image_shows_the_state_and_the_payoffs() -> None:
    envs = noisy_constraint_v0.vector_env(3, render_mode="rgb_array", autoreset_mode=AutoresetMode.DISABLED)
    start = envs.render()
    assert start is not None
    envs.reset()
    envs.step([0, 1, 1])
    frames = [start[0], *(envs.render() or ())]
    for frame in frames:
        assert isinstance(frame, np.ndarray)
        assert frame.dtype == np.uint8
        assert frame.shape == start[0].shape == (240, 418, 3)
    np.testing.assert_array_equal(frames[2], frames[3])
    blue = [(np.asarray(frame) == (38, 88, 204)).all(axis=-1) for frame in frames[:3]]
    middles = [np.argwhere(mask).mean(axis=0) for mask in blue]
    for middle, centre in zip(middles, [(120, 60), (62, 230), (178, 230)], strict=True):
        assert abs(middle - centre).max() < 3
    large = {"rewards": (-1 / 3, 1e10), "costs": (6789, 2.45)}
    other = noisy_constraint_v0.single_env(render_mode="rgb_array", **large)
    assert other.render().shape[1] > 418


def test_without_a_render_mode_nothing_is_drawn() -> None:
    assert all(make().render() is None for make in FACES.values())


# Errors.


@each_face
@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"rewards": (1.0,)}, r"^rewards is \(1.0,\); it must be two finite numbers, for S1 and S2$"),
        ({"rewards": 1.0}, r"^rewards is 1.0; it must be two finite numbers"),
        ({"costs": (0.0, math.nan)}, r"^costs is \(0.0, nan\); it must be two finite numbers"),
        ({"costs": "ab"}, r"^costs is 'ab'; it must be two finite numbers"),
        ({"rewards": "01"}, r"^rewards is '01'; it must be two finite numbers"),
        ({"rewards": {1.0: 2, 3.0: 4}}, r"^rewards is \{.*; it must be two finite numbers"),
        ({"costs": {2.0, 1.0}}, r"^costs is \{.*; it must be two finite numbers"),
        ({"rewards": (1e39, 0)}, r"^rewards is \(1e\+39, 0\); it must be two finite numbers"),
        ({"rewards": (0, 10**400)}, r"^rewards is \(0, 10+\); it must be two finite numbers"),
        ({"noise": "0.5"}, r"^noise is '0.5'; it must be a finite number, 0 or more$"),
        ({"noise": True}, r"^noise is True; it must be a finite number, 0 or more$"),
        ({"noise": -0.1}, r"^noise is -0.1; it must be a finite number, 0 or more$"),
        ({"noise": "much"}, r"^noise is 'much'; it must be a finite number, 0 or more$"),
        ({"noise": math.nan}, r"^noise is nan; it must be a finite number, 0 or more$"),
        ({"noise": math.inf}, r"^noise is inf; it must be a finite number, 0 or more$"),
        ({"render_mode": "movie"}, r"^render_mode is 'movie'; it must be None or one of .*'ansi'"),
    ],
)
def test_an_impossible_argument_is_refused(make: Any, arguments: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make(**arguments)


@pytest.mark.parametrize("name", FACES)
def test_the_signature_shows_every_argument(name: str) -> None:
    parameters = inspect.signature(FACES[name]).parameters
    assert {"rewards": (0.5, 1.0), "costs": (0.0, 1.0), "noise": 0.0}.items() <= {
        argument: parameter.default for argument, parameter in parameters.items()
    }.items()
    with pytest.raises(TypeError, match="'view_radius'"):
        FACES[name](noise=0.1, view_radius=2)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: noisy_constraint_v0.vector_env(0), r"^num_envs is 0; it must be at least 1$"),
        (
            lambda: noisy_constraint_v0.vector_env(2.0),
            r"^num_envs is 2.0; it must be an integer, at least 1$",
        ),
        (
            lambda: noisy_constraint_v0.vector_env(autoreset_mode="never"),
            r"^autoreset_mode is 'never'; .*Next",
        ),
        (lambda: noisy_constraint_v0.vector_env(2).reset(seed=[1]), r"^seed has 1 entries; .* or 2$"),
        (
            lambda: noisy_constraint_v0.vector_env(2).reset(options={"reset_mask": [1, 0]}),
            r"^options\['reset_mask'\] is int64 \(2,\); it must be bool \(2,\)$",
        ),
        (lambda: started(2).step([1]), r"^actions have shape \(1,\); .* \(2,\)$"),
        (lambda: started(2).step([1, 2]), r"^actions contain 2; an action is 0 to 1$"),
        (
            lambda: started(2).step([-1, 1]),
            r"^actions contain -1; an action is 0 to 1$",
        ),
        (
            lambda: started(2).step([0.0, 1.0]),
            r"^actions have dtype float64; .*integers$",
        ),
        (lambda: success_probability(0.5, -1.0), r"^noise is -1.0; it must be a finite number, 0 or more$"),
        (
            lambda: success_probability(0.5, math.nan),
            r"^noise is nan; it must be a finite number, 0 or more$",
        ),
        (lambda: success_probability(math.nan, 0.5), r"^threshold is nan; it must be a number$"),
        (lambda: success_probability(0.5, 0, (0, 1, 2)), r"^costs is .*; it must be two finite numbers"),  # type: ignore[arg-type]
    ],
)
def test_what_is_impossible_is_refused(call: Callable[[], Any], match: str) -> None:
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("action", [-1, 2, 0.5, None])
def test_every_face_refuses_what_is_no_action(action: Any) -> None:
    single, parallel, aec = FACES["single_env"](), FACES["parallel_env"](), FACES["env"]()
    for env in (single, parallel, aec):
        env.reset()
    with pytest.raises(ValueError, match=r"^actions "):
        single.step(action)
    with pytest.raises(ValueError, match=r"^actions "):
        parallel.step({"agent_0": action})
    with pytest.raises(ValueError, match=r"^action is .*; it must be 0 to 1$"):
        aec.step(action)
    assert single.step(0)[2]
    assert parallel.step({"agent_0": 0})[2] == {"agent_0": True}


def test_a_step_outside_an_episode_is_refused() -> None:
    single, parallel, aec = FACES["single_env"](), FACES["parallel_env"](), FACES["env"]()
    for _ in range(2):
        with pytest.raises(ValueError, match=r"outside an episode; call reset first"):
            single.step(0)
        with pytest.raises(ValueError, match=r"outside an episode; call reset first"):
            parallel.step({"agent_0": 0})
        with pytest.raises(ValueError, match=r"outside an episode; call reset first"):
            aec.step(0)
        for env in (single, parallel, aec):
            env.reset()
        with pytest.raises(
            ValueError, match=r"^actions are for \['agent_1'\]; they must be for \['agent_0'\]"
        ):
            parallel.step({"agent_1": 0})
        single.step(0)
        parallel.step({"agent_0": 0})
        aec.step(0)
        aec.step(None)


@each_mode
def test_a_batch_refuses_a_step_before_its_first_episode(mode: AutoresetMode) -> None:
    envs = noisy_constraint_v0.vector_env(2, autoreset_mode=mode)
    with pytest.raises(ValueError, match=r"^actions were given before the first episode; call reset first$"):
        envs.step([0, 1])
    envs.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(
        ValueError, match=r"^actions were given before the first episode of environment 1; call"
    ):
        envs.step([0, 1])
    envs.reset(options={"reset_mask": np.array([False, True])})
    assert envs.step([0, 1])[2].tolist() == [True, True]


def test_an_unknown_agent_and_what_is_no_dict_are_refused() -> None:
    parallel, aec = FACES["parallel_env"](), FACES["env"]()
    with pytest.raises(ValueError, match=r"^last was called outside an episode; call reset first$"):
        aec.last()
    for env in (parallel, aec):
        env.reset()
        for method in ("observation_space", "action_space", "reward_space"):
            with pytest.raises(ValueError, match=r"^agent is 'agent_1'; it must be one of \['agent_0'\]$"):
                getattr(env, method)("agent_1")
    with pytest.raises(ValueError, match=r"^agent is 'agent_1'; "):
        aec.observe("agent_1")
    with pytest.raises(ValueError, match=r"^actions are \[0\]; they must be a dict with one for each agent$"):
        parallel.step([0])
