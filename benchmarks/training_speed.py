"""How fast PPO trains: environment steps a second, network updates included.

    python -m benchmarks.training_speed

Each preset trains on a primary reward alone and on learned rewards beside it, with the settings that its
world is trained with: those of `moral train` in Emergency, those of `moral cover` in Delivery. The thesis's
network is also trained as it would be written without a thought for speed, in float32 and with memory in
PyTorch's default order. Rollouts of all variants take turns, so that a busy machine slows all alike.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from benchmarks.provenance import provenance
from moral_algorithms.bridge import (
    EngineVecEnv,
    LearnedReward,
    PrimaryReward,
    RewardComponent,
    ScalarisedRewards,
)
from moral_algorithms.cli.arguments import Machine
from moral_algorithms.learners.covering import CoveringConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.learners.ppo import PPOConfig, learn, make_ppo, sampling_seed, standard_callbacks
from moral_algorithms.networks.rewards import ShapedRewardNetwork
from moral_algorithms.storage import write_json
from moral_algorithms.worlds import WorldSpec

RESULTS = Path(__file__).parent / "results" / "training_speed.json"

VARIANTS = ("fast", "paper", "plain")
"""The presets, and the network of ``paper`` in plain float32."""


@dataclass(frozen=True)
class Rewards:
    """The reward vectors of one world, and who trains on them."""

    primary: str
    """The component that the agent is given."""
    architecture: str
    """What the learned ones are."""
    learned: int
    """How many there are, one for each expert."""
    ppo: PPOConfig
    """How PPO trains on them."""


WORLDS = {
    "emergency": Rewards("extinguish", "fast", 1, MoralConfig().ppo),
    "delivery": Rewards("deliver", "counting", 2, CoveringConfig().ppo),
}


@dataclass(frozen=True)
class Config:
    """What is measured."""

    fast_envs: int = 256
    """Environments side by side for ``fast``."""
    paper_envs: int = 32
    """Environments side by side for ``paper`` and ``plain``, which take a hundred times as long a step."""
    rollout_steps: int = 25
    """Steps per environment between updates."""
    repeats: int = 3
    """Rollouts, with the updates that follow, of which the median is taken."""
    seed: int = 0
    """Seed of environments and networks."""


class _PlainTrunk(BaseFeaturesExtractor):
    """The convolutions that actor and critic share (thesis B.1.1)."""

    def __init__(self, observation_space: spaces.Box) -> None:
        channels, height, width = observation_space.shape
        super().__init__(observation_space, 256 * (height - 2) * (width - 2))
        self.map_shape = (256, height - 2, width - 2)
        self.layers = nn.Sequential(nn.Conv2d(channels, 64, 2), nn.ReLU(), nn.Conv2d(64, 256, 2), nn.ReLU())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        maps: torch.Tensor = self.layers(observations)
        return maps.flatten(1)


class _PlainHeads(nn.Module):
    """One more convolution each for actor and critic."""

    def __init__(self, map_shape: tuple[int, int, int]) -> None:
        super().__init__()
        channels, height, width = map_shape
        self.map_shape = map_shape
        self.latent_dim_pi = self.latent_dim_vf = 32 * (height - 1) * (width - 1)
        self.actor = nn.Sequential(nn.Conv2d(channels, 32, 2), nn.ReLU(), nn.Flatten())
        self.critic = nn.Sequential(nn.Conv2d(channels, 32, 2), nn.ReLU(), nn.Flatten())

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = self.actor(features.reshape(-1, *self.map_shape))
        return latent

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = self.critic(features.reshape(-1, *self.map_shape))
        return latent


class PlainPolicy(ActorCriticPolicy):
    """The network of the preset ``paper``, in float32 and in PyTorch's default order of memory."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.update(features_extractor_class=_PlainTrunk)
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.features_extractor, _PlainTrunk)
        self.mlp_extractor = _PlainHeads(self.features_extractor.map_shape)  # type: ignore[assignment]


@dataclass(frozen=True)
class Training:
    """A training that goes on rollout by rollout."""

    model: PPO
    callbacks: list[BaseCallback]

    @classmethod
    def start(cls, world: str, variant: str, learned: bool, config: Config, device: str) -> Training:
        """Make the networks and environments of one variant, with or without learned rewards."""
        rules, rewards = WorldSpec(world).build(), WORLDS[world]
        num_envs = config.fast_envs if variant == "fast" else config.paper_envs
        ppo = replace(
            rewards.ppo,
            policy="fast" if variant == "fast" else "paper",
            num_envs=num_envs,
            rollout_steps=config.rollout_steps,
            # No more than a rollout has.
            batch_size=min(rewards.ppo.batch_size, num_envs * config.rollout_steps),
        )
        engine = EngineVecEnv(rules, ppo.num_envs, seed=config.seed)
        components: list[RewardComponent] = [PrimaryReward(rules.reward_names, rewards.primary)]
        if learned:
            with sampling_seed(config.seed):
                networks = [
                    ShapedRewardNetwork(engine.engine.observation_shape, rewards.architecture)
                    for _ in range(rewards.learned)
                ]
            components += [
                LearnedReward(f"learned_{number}", network.to(device))
                for number, network in enumerate(networks, start=1)
            ]
        venv = ScalarisedRewards(engine, components, [1.0] * len(components))
        model = make_ppo(ppo, venv, config.seed, device)
        if variant == "plain":
            plain = PlainPolicy(
                model.observation_space, model.action_space, model.lr_schedule, **model.policy_kwargs
            )
            model.policy = plain.to(model.device)
        # The schedules need an end, which no measurement comes near.
        return cls(model, standard_callbacks(ppo, 10**9, rules.objective_names, None))

    @property
    def steps(self) -> int:
        """Environment steps of a rollout."""
        return self.model.n_steps * self.model.n_envs

    def seconds(self) -> tuple[float, float]:
        """Take one rollout and the updates that follow: seconds by the clock and of the processor."""
        start, processor = time.perf_counter(), time.process_time()
        learn(self.model, self.model.num_timesteps + self.steps, self.callbacks)
        if self.model.device.type == "cuda":
            torch.cuda.synchronize(self.model.device)
        return time.perf_counter() - start, time.process_time() - processor


def measure_case(world: str, learned: bool, config: Config, device: str) -> dict[str, dict[str, float]]:
    """Speed of every variant in one world: environment steps a second, by the clock and of the processor."""
    trainings = {variant: Training.start(world, variant, learned, config, device) for variant in VARIANTS}
    rounds = [
        {variant: training.seconds() for variant, training in trainings.items()}
        for _ in range(config.repeats + 1)
    ]
    found = {}
    for variant, training in trainings.items():
        # The first round warms up.
        clock, processor = zip(*(seconds[variant] for seconds in rounds[1:]), strict=True)
        found[variant] = {
            "steps_per_second": training.steps / statistics.median(clock),
            "steps_per_processor_second": training.steps / statistics.median(processor),
        }
    return found


def measure(worlds: Sequence[str], config: Config, device: str) -> dict[str, Any]:
    """Take all measurements, by world and by rewards."""
    return {
        world: {
            rewards: measure_case(world, rewards == "learned", config, device)
            for rewards in ("primary", "learned")
        }
        for world in worlds
    }


def table(results: dict[str, Any], config: Config) -> str:
    """Format the measurements for reading."""
    names = "".join(f"{name:>10}" for name in VARIANTS)
    lines = [
        f"Environment steps a second with network updates, medians of {config.repeats} rollouts",
        "",
        f"{'world':12}{'rewards':12}{names}{'paper / plain':>16}",
    ]
    for world, cases in results.items():
        for rewards, case in cases.items():
            speeds = [case[name]["steps_per_second"] for name in VARIANTS]
            shown = "".join(f"{speed:>10,.0f}" for speed in speeds)
            lines.append(f"{world:12}{rewards:12}{shown}{speeds[1] / speeds[2]:>16.1f}")
    return "\n".join(lines)


def main(options: Sequence[str] | None = None) -> None:
    """Measure, print a table and store the figures."""
    parser = argparse.ArgumentParser(description="How fast PPO trains, network updates included.")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=list(WORLDS), help="where to train")
    parser.add_argument(
        "--device", choices=("cpu", "cuda", "auto"), default="cpu", help="where networks live"
    )
    parser.add_argument("--threads", type=int, default=1, help="threads of PyTorch; 0 takes one per core")
    parser.add_argument("--fast-envs", type=int, default=Config.fast_envs, help="environments for fast")
    parser.add_argument("--paper-envs", type=int, default=Config.paper_envs, help="environments for paper")
    parser.add_argument(
        "--rollout-steps", type=int, default=Config.rollout_steps, help="steps of each between updates"
    )
    parser.add_argument("--repeats", type=int, default=Config.repeats, help="rollouts to take the median of")
    arguments = parser.parse_args(options)
    config = Config(arguments.fast_envs, arguments.paper_envs, arguments.rollout_steps, arguments.repeats)
    machine = Machine(arguments.device, arguments.threads)
    device = machine.prepare()
    started = time.perf_counter()
    results = measure(arguments.worlds, config, device)
    print(table(results, config))
    record = {
        "command": "python -m benchmarks.training_speed",
        "config": asdict(config),
        "ppo": {world: asdict(WORLDS[world].ppo) for world in arguments.worlds},
        "device": device if device == "cpu" else torch.cuda.get_device_name(),
        "threads": torch.get_num_threads(),
        **provenance(started),
    }
    write_json(arguments.json, {**record, "results": results})


if __name__ == "__main__":
    main()
