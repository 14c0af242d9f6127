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
    make_envs,
    make_ppo,
    measure,
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
    comparisons
        Preferences in all.
    fragment_length, num_iterations, initial_comparison_frac, initial_epoch_multiplier
        As in `imitation`'s ``PreferenceComparisons``.
    exploration_frac
        As in its ``AgentTrainer``.
    reward_epochs
        Epochs of its ``BasicRewardTrainer``.
    reward_hid_sizes
        As in its ``BasicRewardNet``.
    """

    steps: int = 300_000
    weights: tuple[float, float] = (0.1, 1.0)
    comparisons: int = 1000
    fragment_length: int = 25
    num_iterations: int = 30
    initial_comparison_frac: float = 0.1
    initial_epoch_multiplier: float = 20.0
    exploration_frac: float = 0.05
    reward_epochs: int = 3
    reward_hid_sizes: tuple[int, ...] = (64, 64)


def train(seed: int, config: Config) -> tuple[Any, Progress]:
    """Train one agent from preferences."""
    from imitation.algorithms import preference_comparisons
    from imitation.rewards.reward_nets import BasicRewardNet, NormalizedRewardNet
    from imitation.util.networks import RunningNorm

    rng = np.random.default_rng(seed)
    progress = Progress()
    envs = make_envs(config, progress, seed)
    learner = make_ppo(envs, config, seed)
    reward = BasicRewardNet(envs.observation_space, envs.action_space, hid_sizes=config.reward_hid_sizes)
    with silent_logger() as logger:
        trainer = preference_comparisons.PreferenceComparisons(
            preference_comparisons.AgentTrainer(
                algorithm=learner,
                reward_fn=NormalizedRewardNet(reward, normalize_output_layer=RunningNorm),
                venv=envs,
                exploration_frac=config.exploration_frac,
                rng=rng,
            ),
            reward,
            num_iterations=config.num_iterations,
            fragmenter=preference_comparisons.RandomFragmenter(rng=rng, warning_threshold=0),
            preference_gatherer=preference_comparisons.SyntheticGatherer(temperature=0, rng=rng),
            reward_trainer=preference_comparisons.BasicRewardTrainer(
                preference_comparisons.PreferenceModel(reward),
                loss=preference_comparisons.CrossEntropyRewardLoss(),
                epochs=config.reward_epochs,
                rng=rng,
            ),
            fragment_length=config.fragment_length,
            initial_comparison_frac=config.initial_comparison_frac,
            initial_epoch_multiplier=config.initial_epoch_multiplier,
            custom_logger=logger,
        )
        progress.begin()
        trainer.train(config.steps, config.comparisons, callback=progress.note)
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
