"""How experts and AIRL are trained and what teachers want by default: not the same in every world."""

from __future__ import annotations

from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.ppo import PPOConfig


def expert_config(world: str) -> ExpertConfig:
    """Find how an expert is trained in a world.

    Parameters
    ----------
    world
        Its name; one that nothing was chosen for is treated as Emergency.
    """
    if world == "delivery":
        # Trained to the end: patience would end it where help is learned and vases are not.
        return ExpertConfig(
            max_steps=1_000_000, patience=1000, ppo=PPOConfig(entropy_start=0.03, entropy_end=0.05)
        )
    return ExpertConfig()


def teacher_order(world: str) -> tuple[str, ...]:
    """Find what a lexicographic teacher wants in a world, the most important first.

    Parameters
    ----------
    world
        Its name; one that nothing was chosen for is treated as Emergency.
    """
    if world == "delivery":
        return ("delivered", "helped", "cleaned")
    return ("people_saved", "goal_time")


def airl_config(world: str) -> AIRLConfig:
    """Find how AIRL learns from demonstrations in a world.

    Parameters
    ----------
    world
        Its name; one that nothing was chosen for is treated as Emergency.
    """
    if world == "delivery":
        return AIRLConfig(
            steps=1_500_000,
            architecture="counting",
            discriminator_weight_decay=1.0,
            ppo=PPOConfig(entropy_start=0.1, entropy_end=0.02),
        )
    return AIRLConfig()
