"""A chain of MOMAland's wrappers around Delivery with two agents, then SuperSuit and Stable-Baselines3's PPO.

    python -m benchmarks.strangers.momaland_chain

``RecordEpisodeStatistics``, ``NormalizeReward`` for each agent and component and ``LinearizeReward`` from
MOMAland; SuperSuit's ``observation_lambda_v0``, ``pettingzoo_env_to_vec_env_v1`` and
``concat_vec_envs_v1``; one policy for both agents. It is measured on held-out seeded starts beside random
actions: both agents' counters together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.strangers.egocentric import crop, cropped_space
from benchmarks.strangers.training import Stranger, random_policy, start_seeds, train_and_report
from moral_envs import delivery_v0

WORKAROUNDS = [
    "momaland.utils.aec_wrappers does not import with Gymnasium 1.x (it looks for "
    "gymnasium.wrappers.normalize): the parallel wrappers are used.",
    "SuperSuit's concat_vec_envs_v1 copies one environment, random stream included, and its SB3 wrapper "
    "can neither seed (ConcatVecEnv has no seed, so PPO(seed=...) fails) nor pass a seed to reset: the "
    "inner vector is reset with a seed once, which gives the copies seeds of their own, and "
    "stable_baselines3's set_random_seed does the rest.",
    "SuperSuit drops the difference between termination and truncation, so PPO would take the horizon for "
    "a terminal state: a VecEnvWrapper sets TimeLimit.truncated where an episode has ended.",
    "SuperSuit lays the infos of the reset over the final ones: final objectives are read from the "
    "parallel face.",
    "MOMAland's RecordEpisodeStatistics adds the key 'episode' to the infos, beside the agents; SuperSuit "
    "drops it.",
]
PACKAGES = ("momaland", "supersuit", "stable-baselines3", "torch")


@dataclass(frozen=True)
class Config:
    """What is run.

    Parameters
    ----------
    steps
        Agent steps of a run.
    weights
        Scalarisation weights of the normalised (deliver, help, clean, vase).
    num_envs
        Environments, of ``num_agents`` agents each.
    num_agents
        Agents in Delivery.
    starts, first_start
        Held-out starts on which the policies are measured, and the seed of the first of them.
    radius
        Cells that the egocentric crop shows in each direction.
    n_steps, batch_size, n_epochs, learning_rate, gamma, ent_coef
        As in SB3's PPO.
    """

    steps: int = 300_000
    weights: tuple[float, float, float, float] = (0.25, 0.25, 0.25, 0.25)
    num_envs: int = 16
    num_agents: int = 2
    starts: int = 100
    first_start: int = 10_000
    radius: int = 4
    n_steps: int = 50
    batch_size: int = 400
    n_epochs: int = 8
    learning_rate: float = 1e-3
    gamma: float = 0.97
    ent_coef: float = 0.02


def chain(config: Config) -> Any:
    """Delivery under MOMAland's wrappers, with scalar rewards and flat egocentric observations."""
    import supersuit
    from momaland.utils.parallel_wrappers import LinearizeReward, NormalizeReward, RecordEpisodeStatistics

    env: Any = RecordEpisodeStatistics(delivery_v0.parallel_env(num_agents=config.num_agents))
    for agent in env.possible_agents:
        for component in range(len(config.weights)):
            env = NormalizeReward(env, agent, component, gamma=config.gamma)
    env = LinearizeReward(env, {agent: np.array(config.weights) for agent in env.possible_agents})
    return supersuit.observation_lambda_v0(
        env,
        lambda observation, space: crop(observation, config.radius),
        lambda space: cropped_space(space, config.radius),
    )


def train(seed: int, config: Config) -> Any:
    """Train one policy for all agents."""
    import supersuit
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.utils import set_random_seed
    from stable_baselines3.common.vec_env import VecEnvWrapper

    class HorizonIsTruncation(VecEnvWrapper):
        """Tells PPO that an end is a truncation; no state of Delivery is terminal."""

        def reset(self) -> Any:
            return self.venv.reset()

        def step_wait(self) -> Any:
            observations, rewards, dones, infos = self.venv.step_wait()
            for done, info in zip(dones, infos, strict=True):
                info["TimeLimit.truncated"] = bool(done)
            return observations, rewards, dones, infos

    torch.set_num_threads(1)
    set_random_seed(seed)
    envs: Any = supersuit.concat_vec_envs_v1(
        supersuit.pettingzoo_env_to_vec_env_v1(chain(config)), config.num_envs, base_class="stable_baselines3"
    )
    # Copy i takes seed + i: training seeds stand far apart, or they would share copies.
    envs.venv.reset(seed=1_000_000 * (seed + 1))
    model = PPO(
        "MlpPolicy",
        HorizonIsTruncation(envs),
        learning_rate=config.learning_rate,
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.gamma,
        ent_coef=config.ent_coef,
        policy_kwargs={"net_arch": [128, 128]},
        device="cpu",
    )
    return model.learn(config.steps)


def final_objectives(policy: Callable[[Any], int], config: Config) -> NDArray[np.int64]:
    """Counters of all agents together at the end of an episode from every held-out start."""
    env = delivery_v0.parallel_env(num_agents=config.num_agents)
    rows = []
    for seed in start_seeds(config):
        observations, infos = env.reset(seed=seed)
        while env.agents:
            actions = {agent: policy(observations[agent]) for agent in env.agents}
            observations, _, _, _, infos = env.step(actions)
        rows.append(sum(info["objectives"] for info in infos.values()))
    return np.array(rows)


def outcome(policy: Callable[[Any], int], config: Config) -> dict[str, float]:
    """Means over starts of the counters, and of the scalarised return that they stand for."""
    means = final_objectives(policy, config).mean(axis=0)
    utility = float(means @ (np.array(config.weights) * [1, 1, 1, -1]))
    names = ("delivered", "helped", "cleaned", "vases_broken")
    return {"scalarised_return": utility, **dict(zip(names, means.tolist(), strict=True))}


def baselines(config: Config) -> dict[str, dict[str, float]]:
    """Random actions."""
    return {"random": outcome(random_policy(9), config)}


def run(seed: int, config: Config) -> dict[str, Any]:
    """Train and measure one policy."""
    model = train(seed, config)

    def act(observation: NDArray[np.uint8]) -> int:
        return int(model.predict(crop(observation, config.radius), deterministic=False)[0])

    return outcome(act, config)


def main(options: Sequence[str] | None = None) -> None:
    """Run all seeds, print the figures and store them."""
    stranger = Stranger("momaland_chain", __doc__, run, baselines, WORKAROUNDS, PACKAGES)
    train_and_report(stranger, Config(), options)


if __name__ == "__main__":
    main()
