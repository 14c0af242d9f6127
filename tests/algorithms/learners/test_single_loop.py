"""The single loop: between AIRL and PPO, and exactly these at its ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.airl import AIRLConfig, Imitation, train_airl
from moral_algorithms.learners.coverage import train_weighted
from moral_algorithms.learners.expert import ExpertConfig, train_expert
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.learners.single_loop import train_single_loop
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.tiny import parameters, ppo_config

WAREHOUSE = WorldSpec("burning_warehouse", {"height": 5, "width": 5, "num_people": 2, "max_cycles": 12})
EXTINGUISH = PrimaryReward(WAREHOUSE.build().reward_names, "extinguish", 10.0)


def config(steps: int) -> AIRLConfig:
    return AIRLConfig(
        steps=steps,
        architecture="fast",
        discriminator_updates=8,
        discriminator_batch=128,
        discriminator_learning_rate=1e-3,
        averaging=0.9,
        normaliser_episodes=20,
        ppo=ppo_config(entropy_start=0.1, entropy_end=0.1),
    )


@pytest.fixture(scope="module")
def demonstrations() -> Demonstrations:
    """Ten episodes of an expert who picks people up."""
    expert = train_expert(
        WAREHOUSE, (0.0, 1.0), ExpertConfig(max_steps=20_000, ppo=ppo_config(entropy_end=0.1)), seed=0
    )
    with sampling_seed(0):
        episodes = play_episodes(expert.policy, WAREHOUSE.build(), 10, seed=0)
    return Demonstrations(WAREHOUSE, episodes.states, episodes.actions, episodes.objectives)


def require_same(one: Imitation, policy: object) -> None:
    for name, value in parameters(policy).items():
        np.testing.assert_array_equal(parameters(one.policy)[name], value)


def test_with_all_weight_on_the_demonstrations_it_is_airl(demonstrations: Demonstrations) -> None:
    found = train_single_loop(demonstrations, EXTINGUISH, 1.0, config(1500), seed=3)
    imitation = train_airl(demonstrations, config(1500), seed=3)
    require_same(found, imitation.policy)
    for name, value in parameters(imitation.network).items():
        np.testing.assert_array_equal(parameters(found.network)[name], value)
    assert found.normaliser == imitation.normaliser
    assert found.env_steps == imitation.env_steps


def test_with_no_weight_on_them_it_is_ppo_on_the_primary_reward(demonstrations: Demonstrations) -> None:
    found = train_single_loop(demonstrations, EXTINGUISH, 0.0, config(1500), seed=3)
    ppo = replace(config(1500).ppo, entropy_start=0.0, entropy_end=0.0)
    alone = train_weighted(WAREHOUSE, [EXTINGUISH], [1.0], ppo, 1500, seed=spawn_seeds(3, 5)[0])
    require_same(found, alone.policy)


def test_the_weight_is_the_rewards_share(demonstrations: Demonstrations) -> None:
    # 0.5 f + 0.5 * 10 r and 0.2 f + 0.8 * 2.5 r have the same ratio, and the scale of returns is divided out.
    names = WAREHOUSE.build().reward_names
    settings = replace(config(500), ppo=ppo_config(entropy_start=0.0, entropy_end=0.0))
    first, second, other = (
        parameters(
            train_single_loop(
                demonstrations, PrimaryReward(names, "extinguish", scale), weight, settings, seed=5
            ).policy
        )
        for scale, weight in ((10.0, 0.5), (2.5, 0.2), (10.0, 0.2))
    )
    same, different = (
        sum(float(abs(first[name] - run[name]).sum()) for name in first) for run in (second, other)
    )
    assert same < different / 20


@pytest.mark.parametrize("weight", [-0.1, 1.1, float("nan")])
def test_impossible_weights_are_refused(demonstrations: Demonstrations, weight: float) -> None:
    with pytest.raises(ValueError, match=r"imitation_weight is .*; it must be 0 to 1"):
        train_single_loop(demonstrations, EXTINGUISH, weight, config(100), seed=0)
