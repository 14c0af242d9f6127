"""A chain of MO-Gymnasium's wrappers around Emergency, and a learner that trains on the vectors it yields.

    python -m benchmarks.strangers.mo_gymnasium_chain

``mo_gymnasium.make``, an observation wrapper, ``MORecordEpisodeStatistics``, ``MONormalizeReward`` for each
component and ``MOSyncVectorEnv`` over 32 of them. The learner is a short advantage actor-critic whose
critic predicts the vector of returns; only the actor sees the scalarisation weights. The trained policy is
measured on held-out seeded starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from benchmarks.strangers.egocentric import Egocentric
from benchmarks.strangers.training import Stranger, emergency_baselines, emergency_outcome, train_and_report

WORKAROUNDS = [
    "MONormalizeReward writes into the reward array it is given: MORecordEpisodeStatistics has to stand "
    "below it to record true returns. The environment hands out a fresh array at every step, so nothing "
    "else is touched.",
    "MONormalizeReward and the vector MORecordEpisodeStatistics do not start their discounted sums afresh "
    "when an episode is truncated; the running scale hardly depends on it, and the discounted statistics "
    "are not used.",
    "MOSyncVectorEnv knows only the next-step reset: the step after an end carries no transition and is "
    "left out of the loss. The last observation of an episode is returned as such, so its value is "
    "bootstrapped from directly.",
]
PACKAGES = ("mo-gymnasium", "torch")


@dataclass(frozen=True)
class Config:
    """What is run.

    Parameters
    ----------
    steps
        Environment steps of a run.
    weights
        Scalarisation weights of the normalised (extinguish, save).
    num_envs
        Environments in the ``MOSyncVectorEnv``.
    starts, first_start
        Held-out starts on which the policies are measured, and the seed of the first of them.
    radius
        Cells that the egocentric crop shows in each direction.
    rollout
        Steps of every environment between two updates.
    hidden, learning_rate, gamma, entropy
        Units of the two hidden layers, Adam's step size, the discount and the weight of the entropy bonus.
    """

    steps: int = 300_000
    weights: tuple[float, float] = (0.5, 0.5)
    num_envs: int = 32
    starts: int = 200
    first_start: int = 10_000
    radius: int = 5
    rollout: int = 16
    hidden: int = 128
    learning_rate: float = 1e-3
    gamma: float = 0.95
    entropy: float = 0.03


def chain(config: Config) -> Any:
    """One environment under MO-Gymnasium's wrappers."""
    import mo_gymnasium
    from mo_gymnasium.wrappers import MONormalizeReward, MORecordEpisodeStatistics

    env: Any = Egocentric(mo_gymnasium.make("moral/Emergency-v0"), config.radius)
    env = MORecordEpisodeStatistics(env, gamma=config.gamma)
    for component in range(2):
        env = MONormalizeReward(env, component, gamma=config.gamma)
    return env


def train(seed: int, config: Config) -> tuple[Any, list[list[float]]]:
    """Train one actor-critic; also returns the mean recorded return vector in each tenth of the training."""
    import torch
    from mo_gymnasium.wrappers.vector import MOSyncVectorEnv
    from torch import nn

    torch.set_num_threads(1)
    choose: Any = torch.distributions.Categorical
    torch.manual_seed(seed)
    envs = MOSyncVectorEnv([lambda: chain(config) for _ in range(config.num_envs)])
    objectives, num_actions = len(config.weights), int(envs.single_action_space.n)
    network = nn.Sequential(
        nn.Linear(envs.single_observation_space.shape[0], config.hidden),
        nn.ReLU(),
        nn.Linear(config.hidden, config.hidden),
        nn.ReLU(),
        nn.Linear(config.hidden, num_actions + objectives),
    )
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    weights = torch.tensor(config.weights)
    observations, _ = envs.reset(seed=seed)
    fresh = np.zeros(config.num_envs, dtype=bool)  # the next step only resets
    updates = config.steps // (config.num_envs * config.rollout)
    recorded: list[list[NDArray[np.float32]]] = [[] for _ in range(10)]
    for update in range(updates):
        batch: list[tuple[Any, ...]] = []
        for _ in range(config.rollout):
            seen = torch.as_tensor(observations)
            with torch.no_grad():
                logits = network(seen)[:, :num_actions]
            actions = choose(logits=logits).sample()
            observations, rewards, _, truncations, infos = envs.step(actions.numpy())
            batch.append((seen, actions, torch.as_tensor(rewards), truncations.copy(), fresh))
            fresh = truncations
            if "episode" in infos:
                recorded[update * 10 // updates] += list(infos["episode"]["r"][infos["_episode"]])
        seen, actions, rewards, ends, resets = (
            torch.stack([torch.as_tensor(part) for part in parts]) for parts in zip(*batch, strict=True)
        )
        outputs = network(seen)
        values = outputs[..., num_actions:]
        with torch.no_grad():
            following = network(torch.as_tensor(observations))[:, num_actions:]
            returns = torch.empty_like(values)
            target = following
            for t in reversed(range(config.rollout)):
                after = following if t + 1 == config.rollout else values[t + 1]
                # A truncated state still has a value; what comes after its reset belongs to another episode.
                target = rewards[t] + config.gamma * torch.where(ends[t, :, None], after, target)
                returns[t] = target
        policy = choose(logits=outputs[..., :num_actions])
        advantages = ((returns - values) @ weights).detach()
        gain = policy.log_prob(actions) * advantages + config.entropy * policy.entropy()
        loss = (0.5 * (returns - values).pow(2).sum(-1) - gain)[~resets].mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 0.5)
        optimiser.step()

    def act(observation: NDArray[np.float32]) -> int:
        with torch.no_grad():
            logits = network(torch.as_tensor(observation))[:num_actions]
            return int(choose(logits=logits).sample())

    return act, [np.mean(tenth, axis=0).tolist() if tenth else [] for tenth in recorded]


def run(seed: int, config: Config) -> dict[str, Any]:
    """Train and measure one policy."""
    policy, curve = train(seed, config)
    env = Egocentric(gymnasium.make("moral/Emergency-v0"), config.radius)
    return {**emergency_outcome(env, policy, config), "recorded_returns": curve}


def main(options: Sequence[str] | None = None) -> None:
    """Run all seeds, print the figures and store them."""
    stranger = Stranger("mo_gymnasium_chain", __doc__, run, emergency_baselines, WORKAROUNDS, PACKAGES)
    train_and_report(stranger, Config(), options)


if __name__ == "__main__":
    main()
