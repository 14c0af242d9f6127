"""Policies under fixed weights: what they are trained on, and what is measured of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from moral_algorithms.bridge import EngineVecEnv, LearnedReward, PrimaryReward, ScalarisedRewards
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.airl import episode_returns
from moral_algorithms.learners.coverage import CoverageConfig, Solution, solve, train_weighted
from moral_algorithms.learners.expert import ExpertConfig, StopWhenConverged, train_expert
from moral_algorithms.learners.ppo import Progress, learn, make_ppo, sampling_seed, standard_callbacks
from moral_algorithms.networks.rewards import ShapedRewardNetwork
from moral_algorithms.pipeline import evaluate
from moral_algorithms.seeding import spawn_seeds
from tests.algorithms.tiny import EMERGENCY, parameters, ppo_config

NAMES = EMERGENCY.build().reward_names
SHORT = ppo_config(num_envs=8, rollout_steps=8, batch_size=32)
# One over the return of a policy that does nothing else, about: 0.7 by the extinguisher, two people.
SCALES = {"extinguish": 1.4, "save": 0.5}


def primary(name: str) -> PrimaryReward:
    return PrimaryReward(NAMES, name, SCALES[name])


def learned() -> LearnedReward:
    torch.manual_seed(0)
    return LearnedReward("learned", ShapedRewardNetwork((4, 5, 5), "fast", 0.95), 0.1)


def config(**changes: Any) -> CoverageConfig:
    return CoverageConfig(**{"steps": 15_000, "episodes": 100, "ppo": ppo_config(), **changes})


@pytest.fixture(scope="module")
def sweep() -> list[Solution]:
    components = [primary("extinguish"), primary("save")]
    return [
        solve(EMERGENCY, components, (weight, 1 - weight), config(), seed=0, evaluation_seed=4)
        for weight in (0.0, 0.45, 1.0)
    ]


def test_the_weights_decide_what_a_policy_does(sweep: list[Solution]) -> None:
    goal_time, people_saved = np.array([solution.objectives.mean(axis=0) for solution in sweep]).T
    # Four seeds: 0.2 to 0.3, 5.4 to 6.2 and 6.7 to 6.9 goal steps; 1.9, 0.9 to 1.2 and 0.0 people.
    assert goal_time[0] < 2 < goal_time[2] - 3
    assert people_saved[2] < 0.5 < 1.5 < people_saved[0]
    # In between it does some of both, more of either than the policy that does not care.
    assert goal_time[0] + 1 < goal_time[1]
    assert people_saved[2] + 0.5 < people_saved[1]


def test_returns_are_the_objectives_in_the_components_units(sweep: list[Solution]) -> None:
    for solution in sweep:
        assert solution.objectives.shape == (100, 2)
        rates = np.array([0.1 * SCALES["extinguish"], SCALES["save"]])
        np.testing.assert_allclose(solution.returns, solution.objectives.mean(axis=0) * rates, rtol=1e-5)


def test_policies_are_measured_as_everywhere(sweep: list[Solution]) -> None:
    for solution in sweep:
        found = evaluate(solution.policy, EMERGENCY, 100, seed=4)
        assert solution.objectives.mean(axis=0).tolist() == list(found.objectives.values())
        assert solution.env_steps == 30 * 512


def test_returns_in_a_learned_component_are_those_of_its_network() -> None:
    component = learned()
    components = [primary("extinguish"), component]
    short = config(steps=500, ppo=SHORT)
    solution = solve(EMERGENCY, components, (0.2, 0.8), short, seed=1, evaluation_seed=2)
    np.testing.assert_array_equal(solution.weights, np.float32([0.2, 0.8]))
    starts_seed, actions_seed = spawn_seeds(2, 2)
    with sampling_seed(actions_seed):
        episodes = play_episodes(solution.policy, EMERGENCY.build(), 100, starts_seed)
    assert isinstance(component.network, ShapedRewardNetwork)
    expected = 0.1 * episode_returns(component.network, episodes.states).mean()
    assert solution.returns[1] == pytest.approx(expected, rel=1e-4)


def test_a_policy_is_the_same_for_the_same_seed() -> None:
    short = config(steps=500, ppo=SHORT, episodes=10)
    components = [primary("extinguish"), primary("save")]
    first, second, other = (solve(EMERGENCY, components, (0.5, 0.5), short, seed) for seed in (3, 3, 4))
    one, two, three = (parameters(solution.policy) for solution in (first, second, other))
    assert all((one[name] == two[name]).all() for name in one)
    assert any((one[name] != three[name]).any() for name in one)
    np.testing.assert_array_equal(first.objectives, second.objectives)
    np.testing.assert_array_equal(first.returns, second.returns)


def test_training_is_what_its_parts_make_of_it() -> None:
    # The same by hand, from the parts that every learner is made of. No return grows a thousandfold.
    settings = ExpertConfig(max_steps=3000, window=512, patience=1, tolerance=1000.0, ppo=SHORT)
    weights = np.float32([0.3, 1.0])
    world = EMERGENCY.build()
    components = [PrimaryReward(NAMES, name) for name in NAMES]
    venv = ScalarisedRewards(EngineVecEnv(world, 8, seed=7), components, weights)
    model = make_ppo(SHORT, venv, 7)
    standard = standard_callbacks(SHORT, 3000, world.objective_names, None)
    learn(model, 3000, [*standard, StopWhenConverged(weights, settings)])

    expert = train_expert(EMERGENCY, weights, settings, seed=7)
    assert 0 < expert.env_steps == model.num_timesteps < 3000, "it should end before its time"
    for name, value in parameters(model.policy).items():
        np.testing.assert_array_equal(parameters(expert.policy)[name], value)


def test_progress_is_reported() -> None:
    reported: list[Progress] = []
    trained = train_weighted(
        EMERGENCY, [primary("save")], [1.0], SHORT, steps=130, seed=0, on_progress=reported.append
    )
    assert [progress.steps for progress in reported] == [64, 128, 192]
    assert reported[0].total_steps == 130
    assert trained.env_steps == 192


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ((1.0,), "weights are .* there must be 2"),
        ((1.0, -1.0), "not negative"),
        ((0.0, 0.0), "not all zero"),
        ((np.nan, 1.0), "finite"),
    ],
)
def test_impossible_weights_are_refused(weights: tuple[float, ...], message: str) -> None:
    components = [primary("extinguish"), primary("save")]
    with pytest.raises(ValueError, match=message):
        solve(EMERGENCY, components, weights, config(), seed=0)
    with pytest.raises(ValueError, match=message):
        train_weighted(EMERGENCY, components, weights, SHORT, steps=100, seed=0)


@pytest.mark.parametrize("name", ["steps", "episodes"])
def test_impossible_configurations_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} is 0; it must be at least 1"):
        config(**{name: 0})
