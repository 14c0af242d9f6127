"""AIRL and the primary reward in a single loop (part II of the thesis, first paper, eq. 2).

Algorithm 4 learns a reward from demonstrations and then trains a policy on it and on the primary reward. Here
both happen at once: the discriminator is trained as in AIRL, on a policy that meanwhile maximises
``lambda * (f - log pi) + (1 - lambda) * r_P``. That is one training per lambda instead of two.

The paper's lambda is the weight of the demonstrations, one minus the thesis's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from moral_algorithms.bridge import RewardComponent
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.learners.airl import AIRLConfig, Imitation, train_airl
from moral_algorithms.learners.ppo import OnProgress


def train_single_loop(
    demonstrations: Demonstrations,
    primary: RewardComponent,
    imitation_weight: float,
    config: AIRLConfig,
    seed: int,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
) -> Imitation:
    """Train a policy on a primary reward and on a reward that is learned from demonstrations meanwhile.

    With an imitation weight of 1 this is AIRL, step for step; with 0 it is PPO on the primary reward.

    Parameters
    ----------
    demonstrations
        Episodes of one expert.
    primary
        The primary reward. It is weighed against f, whose units are those of log-probabilities.
    imitation_weight
        Weight of the demonstrations, from 0 to 1: lambda in eq. 2, one minus the thesis's.
    config
        How AIRL trains. Its entropy bonus stands for ``-log pi`` and is multiplied with the imitation weight,
        as in the equation. That is a heuristic: PPO sees rewards in units of their spread, and the bonus is
        in none.
    seed
        Entropy of environments, networks, batches and actions.
    device
        Where networks live.
    tensorboard
        Folder for TensorBoard's event files.
    on_progress
        Called after every rollout.

    Raises
    ------
    ValueError
        If the weight is not 0 to 1.
    """
    if not 0 <= imitation_weight <= 1:
        raise ValueError(f"imitation_weight is {imitation_weight}; it must be 0 to 1")
    ppo = replace(
        config.ppo,
        entropy_start=imitation_weight * config.ppo.entropy_start,
        entropy_end=imitation_weight * config.ppo.entropy_end,
    )
    return train_airl(
        demonstrations,
        replace(config, ppo=ppo),
        seed,
        device,
        tensorboard,
        on_progress,
        others=[primary],
        weights=[1 - imitation_weight, imitation_weight],
    )
