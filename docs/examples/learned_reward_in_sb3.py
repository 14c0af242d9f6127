"""A learned reward and one of the world's own in a learner of Stable-Baselines3, weighed as you like."""

from __future__ import annotations

from pathlib import Path

from stable_baselines3 import A2C
from stable_baselines3.common.vec_env import VecMonitor

from moral_algorithms import pipeline
from moral_algorithms.bridge import EngineVecEnv, LearnedReward, PrimaryReward, ScalarisedRewards
from moral_algorithms.networks.files import load_reward


def main(reward: Path = Path("runs/own_demonstrations/reward.safetensors"), steps: int = 200_000) -> A2C:
    """Train under one pair of weights, then under another."""
    network, normaliser, world = load_reward(reward)
    built = world.build()
    components = [
        PrimaryReward(built.reward_names, "save", 1 / 5.73),
        LearnedReward("demonstrated", network, 1 / normaliser),
    ]
    venv = VecMonitor(ScalarisedRewards(EngineVecEnv(built, 64, seed=0), components, weights=[0.2, 0.8]))
    model = A2C("MlpPolicy", venv, gamma=0.97, seed=0, device="cpu")
    model.learn(steps // 2)
    # From above other wrappers; ScalarisedRewards itself has the attribute `weights`.
    venv.set_attr("weights", [0.8, 0.2])
    model.learn(steps // 2, reset_num_timesteps=False)
    print(pipeline.evaluate(model.policy, world, episodes=200, seed=1).objectives)
    return model


if __name__ == "__main__":
    main()
