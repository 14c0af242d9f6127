"""`imitation`'s preference comparisons on Emergency: both objectives after a thousand comparisons.

    python -m benchmarks.strangers.imitation_preferences

The teacher is `imitation`'s ``SyntheticGatherer`` at temperature 0: of two fragments it prefers the one with
more people saved and, on a tie, more goal time. The settings are chosen on seeds from 100 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.strangers.imitation_emergency import (
    PACKAGES,
    WORKAROUNDS,
    LearnerConfig,
    Progress,
    anneal,
    make_envs,
    make_ppo,
    measure,
    scale_by_returns,
    silent_logger,
)
from benchmarks.strangers.training import Stranger, emergency_baselines, train_and_report


@dataclass(frozen=True)
class Config(LearnerConfig):
    """What is run.

    Parameters
    ----------
    weights
        Scalarisation weights of (extinguish, save) for the summary: saving first, as the teacher has it.
    final_ent_coef
        To what PPO's entropy coefficient falls, linearly.
    comparisons
        Preferences in all.
    fragment_length, num_iterations, initial_comparison_frac, initial_epoch_multiplier
        As in `imitation`'s ``PreferenceComparisons``.
    noise_prob
        Probability of a random answer in its ``PreferenceModel``.
    reward_epochs
        Epochs of its reward trainer after every iteration.
    reward_learning_rate
        Step size of the reward trainer's AdamW; it falls linearly to a twentieth.
    reward_reach
        Cells around the agent that the reward sees.
    reward_hidden
        Layers of the reward r(s, a).
    """

    # Every iteration is six rollouts, and there is one more than `imitation` is asked for: 1.21 million,
    # with the untrained policy's.
    steps: int = 1_152_000
    weights: tuple[float, float] = (0.1, 1.0)
    batch_size: int = 800
    n_epochs: int = 5
    gae_lambda: float = 0.9
    ent_coef: float = 0.05
    final_ent_coef: float = 0.0
    comparisons: int = 1000
    fragment_length: int = 25
    num_iterations: int = 30
    initial_comparison_frac: float = 0.25
    initial_epoch_multiplier: float = 20.0
    noise_prob: float = 0.1
    reward_epochs: int = 3
    reward_learning_rate: float = 1e-3
    reward_reach: int = 1
    reward_hidden: tuple[int, ...] = (128, 128)


def query_schedule(elapsed: float) -> float:
    """How many queries there are, up to a factor, after a part of the training: most at the start."""
    return 1 / (0.1 + elapsed)


def train(seed: int, config: Config) -> tuple[Any, Progress]:
    """Train one agent from preferences."""
    from imitation.algorithms import preference_comparisons as comparisons

    from benchmarks.strangers.imitation_rewards import NearbyRewardNet

    rng = np.random.default_rng(seed)
    progress = Progress()
    envs = make_envs(config, progress, seed)
    learner = make_ppo(envs, config, seed)
    reward = NearbyRewardNet(
        envs.observation_space, envs.action_space, config.radius, config.reward_reach, config.reward_hidden
    )
    reward_trainer = comparisons.BasicRewardTrainer(
        comparisons.PreferenceModel(reward, noise_prob=config.noise_prob),
        loss=comparisons.CrossEntropyRewardLoss(),
        epochs=config.reward_epochs,
        lr=config.reward_learning_rate,
        rng=rng,
    )

    def after_iteration(_: int) -> None:
        progress.note()
        done = progress.env_steps / config.steps
        anneal(learner, [reward_trainer.optim], config, config.reward_learning_rate, done)
        learner.ent_coef = config.ent_coef + (config.final_ent_coef - config.ent_coef) * min(done, 1)

    with silent_logger() as logger:
        agent = comparisons.AgentTrainer(
            algorithm=learner, reward_fn=reward, venv=envs, exploration_frac=0.0, rng=rng
        )
        scale_by_returns(learner, agent.venv)
        trainer = comparisons.PreferenceComparisons(
            agent,
            reward,
            num_iterations=config.num_iterations,
            fragmenter=comparisons.RandomFragmenter(rng=rng, warning_threshold=0),
            preference_gatherer=comparisons.SyntheticGatherer(temperature=0, rng=rng),
            reward_trainer=reward_trainer,
            fragment_length=config.fragment_length,
            initial_comparison_frac=config.initial_comparison_frac,
            initial_epoch_multiplier=config.initial_epoch_multiplier,
            query_schedule=query_schedule,
            custom_logger=logger,
        )
        progress.begin()
        trainer.train(config.steps, config.comparisons, callback=after_iteration)
    return learner, progress


def run(seed: int, config: Config) -> dict[str, Any]:
    """Train and measure one agent."""
    learner, progress = train(seed, config)
    return {**measure(learner, progress, config), "comparisons": config.comparisons}


def main(options: Sequence[str] | None = None) -> None:
    """Run all seeds, print the figures and store them."""
    stranger = Stranger("imitation_preferences", __doc__, run, emergency_baselines, WORKAROUNDS, PACKAGES)
    train_and_report(stranger, Config(), options)


if __name__ == "__main__":
    main()
