"""The peers' benchmarks: what they feed `imitation`, their row, and small trainings where it is installed."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecNormalize

from benchmarks.harness import Results
from benchmarks.rows import peers
from benchmarks.stages import FromPreferences, LearnedNorm
from benchmarks.strangers import imitation_airl, imitation_preferences
from benchmarks.strangers.egocentric import crop
from benchmarks.strangers.imitation_emergency import (
    EPISODES_OF_A_POINT,
    GOAL_STEP,
    EmergencyVecEnv,
    Progress,
)
from moral_envs import optimal

needs_imitation = pytest.mark.skipif(find_spec("imitation") is None, reason="imitation is not installed")

OBJECTIVES = {"people_saved": 5.9, "goal_time": 20.0}
CURVE = {"env_steps": [1000, 2000], "people_saved": [2.0, 5.9], "goal_time": [1.0, 20.0]}


def play(envs: EmergencyVecEnv, seed: int, actions: Any) -> float:
    envs.seed(seed)
    envs.reset()
    return sum(float(envs.step(np.array([action]))[1][0]) for action in actions)


def start_of(seed: int) -> Any:
    return gymnasium.make("moral/Emergency-v0").reset(seed=seed)[0]


@pytest.mark.parametrize("seed", range(3))
def test_the_reward_adds_up_to_the_counters(seed: int) -> None:
    progress = Progress()
    envs = EmergencyVecEnv(1, 5, progress)
    for saved in (6, 3):
        total = play(envs, seed, optimal.optimal_actions(start_of(seed), 75, saved))
        goal_time, people_saved = progress.final_objectives[-1].tolist()
        assert people_saved == saved
        assert total == saved + GOAL_STEP * goal_time
        assert goal_time > 0
    assert progress.env_steps == 150


def test_one_person_more_outweighs_all_goal_time() -> None:
    assert 75 * GOAL_STEP < 1


def test_the_reward_begins_anew_with_every_episode() -> None:
    envs = EmergencyVecEnv(1, 5, Progress())
    actions = optimal.optimal_actions(start_of(1), 75, 6)
    play(envs, 1, actions[:40])
    assert play(envs, 1, actions) >= 6
    # The next one begins where that one ended.
    assert float(envs.step(np.array([4]))[1][0]) <= GOAL_STEP


def test_a_horizon_cuts_episodes_off() -> None:
    envs = EmergencyVecEnv(2, 2, Progress())
    envs.seed(0)
    first = envs.reset()
    for _ in range(74):
        seen, _, ended, infos = envs.step(np.array([4, 4]))
        assert not ended.any()
        assert infos == [{}, {}]
    seen, _, ended, infos = envs.step(np.array([4, 4]))
    assert ended.all()
    # Who waits sees at the end what it saw at the start, and then another room.
    assert np.array_equal([info["terminal_observation"] for info in infos], first)
    assert not np.array_equal(seen, first)
    assert all(info["TimeLimit.truncated"] for info in infos)


@needs_imitation
def test_the_end_of_an_episode_reaches_the_learner() -> None:
    from imitation.data.wrappers import BufferingWrapper
    from imitation.rewards.reward_wrapper import RewardVecEnvWrapper

    inner = EmergencyVecEnv(2, 2, Progress())
    envs = VecNormalize(
        RewardVecEnvWrapper(BufferingWrapper(inner), lambda *transitions: np.ones(2)), norm_obs=False
    )
    envs.reset()
    for _ in range(75):
        _, _, ended, infos = envs.step(np.array([4, 4]))
    assert ended.all()
    assert all(info["TimeLimit.truncated"] and "terminal_observation" in info for info in infos)


@needs_imitation
def test_the_shaped_reward_knows_no_end() -> None:
    from benchmarks.strangers.imitation_rewards import UnendingRewardNet

    envs = EmergencyVecEnv(3, 2, Progress())
    network = UnendingRewardNet(envs.observation_space, envs.action_space, discount_factor=0.9)
    seen, actions = envs.reset(), np.zeros(3, dtype=np.int64)
    rewards = [network.predict(seen, actions, seen, np.full(3, done)) for done in (False, True)]
    assert np.array_equal(*rewards)


def test_a_curve_shows_the_latest_episodes() -> None:
    progress = Progress()
    progress.note(0)
    assert progress.curve == {}
    progress.begin()
    progress.final_objectives += [np.array([60, 0])] * 7 + [np.array([2, 5])] * EPISODES_OF_A_POINT
    progress.env_steps = 4
    progress.note(1)
    assert progress.curve["goal_time"] == [2.0]
    assert progress.curve["people_saved"] == [5.0]
    assert progress.curve["env_steps"] == [4]


def test_the_demonstrations_are_those_of_an_expert_who_saves() -> None:
    with np.load(imitation_airl.DEMONSTRATIONS, allow_pickle=False) as stored:
        objectives = stored["objectives"]
    assert len(objectives) == max(imitation_airl.Config().demonstrations)
    goal_time, people_saved = objectives.mean(axis=0)
    assert people_saved > 5.9
    assert goal_time < 5


@pytest.mark.parametrize("radius", [1, 2, 5])
def test_environments_are_flat_and_egocentric(radius: int) -> None:
    envs = EmergencyVecEnv(9, radius, Progress())
    envs.seed(3)
    observations = envs.reset()
    assert observations.shape == (9, 3 * (2 * radius + 1) ** 2)
    for number, observation in enumerate(observations):
        assert envs.observation_space.contains(observation)
        assert np.array_equal(observation, crop(start_of(3 + number), radius))


@needs_imitation
def test_too_few_demonstrations_are_refused() -> None:
    with pytest.raises(ValueError, match="holds 500 episodes; it must hold at least 501"):
        imitation_airl.read_demonstrations(imitation_airl.DEMONSTRATIONS, 501, 2)


@needs_imitation
@pytest.mark.parametrize(
    "train",
    [
        lambda: imitation_airl.run(
            100,
            replace(
                imitation_airl.Config(),
                steps=1200,
                demonstrations=(2, 3),
                num_envs=4,
                n_steps=75,
                batch_size=75,
                demo_batch_size=64,
                starts=3,
                radius=2,
            ),
        )["sizes"][-1],
        lambda: imitation_preferences.run(
            100,
            replace(
                imitation_preferences.Config(),
                steps=1200,
                comparisons=20,
                num_iterations=2,
                num_envs=4,
                n_steps=75,
                batch_size=75,
                starts=3,
                radius=2,
            ),
        ),
    ],
    ids=["airl", "preferences"],
)
def test_a_small_training_is_measured(train: Any) -> None:
    found = json.loads(json.dumps(train()))
    assert 0 <= found["people_saved"] <= 6
    assert 0 <= found["goal_time"] <= 75
    assert found["env_steps"] >= 1200
    assert found["curve"]["env_steps"][-1] <= found["env_steps"]


# The row.


def our_results(seconds: float = 10.0, saved: float = 5.9) -> Results:
    found = []
    for run in peers.runs("laptop"):
        assert isinstance(run, (LearnedNorm, FromPreferences))
        result = {
            "objectives": {**OBJECTIVES, "people_saved": saved},
            "env_steps": 2000,
            "seconds": seconds,
            "curve": CURVE,
        }
        found.append((run, result))
    return Results(found)


def store_peers(folder: Path, saved: float) -> None:
    run = {
        **OBJECTIVES,
        "people_saved": saved,
        "env_steps": 2000,
        "processor_seconds": 20.0,
        "curve": {**CURVE, "processor_seconds": [10.0, 20.0]},
    }
    airl = {"runs": [{"seed": 0, "sizes": [{"demonstrations": size, **run} for size in (50, 500)]}]}
    (folder / "imitation_airl.json").write_text(json.dumps(airl))
    (folder / "imitation_preferences.json").write_text(json.dumps({"runs": [{"seed": 0, **run}]}))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(peers, "results_file", lambda name: tmp_path / f"{name}.json")
    return tmp_path


def test_both_sides_are_compared_and_drawn(folder: Path) -> None:
    store_peers(folder, saved=4.0)
    checks = peers.judge(our_results())
    assert len(checks) == 7
    assert all(check.met for check in checks)
    figure = peers.draw(our_results())
    assert [len(axes.lines) for axes in figure.axes] == [4, 4, 2, 2, 2, 2]


def test_each_comparison_can_fail(folder: Path) -> None:
    store_peers(folder, saved=4.0)
    worse = peers.judge(our_results(seconds=30.0, saved=3.0))
    assert [check.met for check in worse if "goal time" not in check.statement] == [False] * 6


def test_without_the_peers_nothing_is_compared(folder: Path) -> None:
    assert peers.judge(our_results()) == []
    assert len(peers.draw(our_results()).axes) == 6
    assert peers.theirs() == {}


def test_a_panel_without_results_stays_empty(folder: Path) -> None:
    airl = Results(our_results().of(LearnedNorm))
    figure = peers.draw(airl)
    assert [len(axes.lines) for axes in figure.axes] == [2, 2, 0, 0, 0, 0]
    assert [axes.get_legend() is not None for axes in figure.axes] == [True, *[False] * 5]


def test_our_curves_are_put_on_the_clock() -> None:
    found = peers.ours(our_results())
    assert sorted(found) == ["1000 preferences", "AIRL, 50 demonstrations", "AIRL, 500 demonstrations"]
    assert found["1000 preferences"].curves[0]["seconds"] == [5.0, 10.0]
    assert len(found["1000 preferences"].people_saved) == 3
