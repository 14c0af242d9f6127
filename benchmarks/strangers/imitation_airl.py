"""`imitation`'s AIRL on Emergency: people saved after learning from demonstrations of an expert who saves.

    python -m benchmarks.strangers.imitation_airl

One run learns from 50 episodes of this project's own expert and, anew, from 500. They lie in ``saving.npz``,
which was made by ``moral expert --world emergency --weights 0 1 --seed 100 --out EXPERT`` and
``moral demonstrate --expert EXPERT --episodes 500 --out saving.npz``. The settings are chosen on seeds from
100 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from benchmarks.strangers.egocentric import batch_crop
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

DEMONSTRATIONS = Path(__file__).parent / "saving.npz"


@dataclass(frozen=True)
class Config(LearnerConfig):
    """What is run.

    Parameters
    ----------
    weights
        Scalarisation weights of (extinguish, save): the expert's.
    demonstrations
        Episodes to learn from, one training each.
    demo_batch_size, n_disc_updates_per_round
        As in `imitation`'s AIRL; a round is one rollout.
    disc_learning_rate
        Step size of the discriminator's Adam; it falls linearly to a twentieth.
    reward_hidden
        Layers of g and of h in the reward f = g(s) + gamma * h(s') - h(s).
    """

    steps: int = 512_000
    weights: tuple[float, float] = (0.0, 1.0)
    ent_coef: float = 0.3
    demonstrations: tuple[int, ...] = (50, 500)
    demo_batch_size: int = 512
    n_disc_updates_per_round: int = 16
    disc_learning_rate: float = 1e-3
    reward_hidden: tuple[int, ...] = (128, 128)


def read_demonstrations(path: Path, episodes: int, radius: int) -> list[Any]:
    """Read the first episodes of a file as `imitation`'s trajectories of crops.

    Raises
    ------
    ValueError
        If the file holds fewer.
    """
    from imitation.data.types import Trajectory

    with np.load(path, allow_pickle=False) as stored:
        states, actions = stored["states"], stored["actions"]
    if len(actions) < episodes:
        raise ValueError(f"{path} holds {len(actions)} episodes; it must hold at least {episodes}")
    return [
        Trajectory(
            obs=batch_crop(states[episode], radius),
            acts=actions[episode].astype(np.int64),
            infos=None,
            # A horizon cuts episodes off.
            terminal=False,
        )
        for episode in range(episodes)
    ]


def train(seed: int, config: Config, episodes: int) -> tuple[Any, Progress]:
    """Train one imitator."""
    from imitation.algorithms.adversarial.airl import AIRL

    from benchmarks.strangers.imitation_rewards import UnendingRewardNet

    progress = Progress()
    envs = make_envs(config, progress, seed)
    learner = make_ppo(envs, config, seed)
    reward = UnendingRewardNet(
        envs.observation_space,
        envs.action_space,
        reward_hid_sizes=config.reward_hidden,
        potential_hid_sizes=config.reward_hidden,
        use_action=False,
        discount_factor=config.gamma,
        activation=nn.LeakyReLU,
    )
    optimiser = torch.optim.Adam(reward.parameters(), lr=config.disc_learning_rate)

    def after_round(_: int) -> None:
        progress.note()
        anneal(learner, [optimiser], config, config.disc_learning_rate, progress.env_steps / config.steps)

    with silent_logger() as logger:
        trainer = AIRL(
            demonstrations=read_demonstrations(DEMONSTRATIONS, episodes, config.radius),
            demo_batch_size=config.demo_batch_size,
            n_disc_updates_per_round=config.n_disc_updates_per_round,
            # It makes its optimiser out of a class; this one has to be at hand.
            disc_opt_cls=lambda _: optimiser,
            venv=envs,
            gen_algo=learner,
            reward_net=reward,
            custom_logger=logger,
        )
        scale_by_returns(learner, trainer.venv_train)
        progress.begin()
        trainer.train(config.steps, callback=after_round)
    return learner, progress


def run(seed: int, config: Config) -> dict[str, Any]:
    """Train from every number of demonstrations and measure; the figures are those from the most."""
    sizes = []
    for episodes in config.demonstrations:
        learner, progress = train(seed, config, episodes)
        sizes.append({"demonstrations": episodes, **measure(learner, progress, config)})
    most = sizes[-1]
    return {name: most[name] for name in ("scalarised_return", "goal_time", "people_saved")} | {
        "sizes": sizes
    }


def main(options: Sequence[str] | None = None) -> None:
    """Run all seeds, print the figures and store them."""
    stranger = Stranger("imitation_airl", __doc__, run, emergency_baselines, WORKAROUNDS, PACKAGES)
    train_and_report(stranger, Config(), options)


if __name__ == "__main__":
    main()
