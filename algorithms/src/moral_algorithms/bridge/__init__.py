"""From the engine's reward vector to Stable-Baselines3's scalar reward."""

from moral_algorithms.bridge.reward_vector import (
    LearnedActionReward,
    LearnedReward,
    PrimaryReward,
    RewardComponent,
    ScalarisedRewards,
)
from moral_algorithms.bridge.vec_env import EngineVecEnv, Transitions
from moral_algorithms.replay import Replay

__all__ = [
    "EngineVecEnv",
    "LearnedActionReward",
    "LearnedReward",
    "PrimaryReward",
    "Replay",
    "RewardComponent",
    "ScalarisedRewards",
    "Transitions",
]
