"""The shared runs at their smallest; the first attempt at one is killed in the middle of its training.

The classes have the names of the ones they stand for, and so the same keys.
"""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import stages
from benchmarks.harness import Run, Workspace
from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.learners.drlhp import DRLHPConfig
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.learners.ppo import PPOConfig
from moral_algorithms.learners.reward_model import RewardModelConfig
from moral_algorithms.pipeline import TeacherConfig
from tests.algorithms.tiny import EMERGENCY

MARK = "killed"
"""File in the store's folder that says that a run was killed already."""


@dataclass(frozen=True)
class Aligned(stages.Aligned):
    def execute(self, workspace: Workspace) -> dict[str, Any]:
        kill_once(workspace.folder)
        return super().execute(workspace)


@dataclass(frozen=True)
class FromPreferences(stages.FromPreferences):
    def execute(self, workspace: Workspace) -> dict[str, Any]:
        kill_once(workspace.folder)
        return super().execute(workspace)


def kill_once(folder: Path) -> None:
    """Kill this process when it flushes a further checkpoint after the second answer, if none was before."""
    mark = folder.parents[1] / MARK
    if mark.exists():
        return
    flush = os.fsync

    def flush_or_die(handle: int) -> None:
        queries = folder / "queries.jsonl"
        answers = queries.read_bytes().count(b"\n") if queries.exists() else 0
        further = (folder / "checkpoint.safetensors").exists()
        if further and answers >= 2 and any(folder.glob(".checkpoint.safetensors.*")):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        flush(handle)

    os.fsync = flush_or_die


PPO = PPOConfig(num_envs=8, rollout_steps=8, batch_size=64, epochs=1)
TEACHER = TeacherConfig(noise=0.2)
EXPERT = stages.TrainedExpert(EMERGENCY, (0.0, 1.0), 0, ExpertConfig(max_steps=128, ppo=PPO), episodes=8)
NORM = stages.LearnedNorm(
    EXPERT,
    seed=0,
    demonstrations=4,
    config=AIRLConfig(
        steps=128, discriminator_batch=16, discriminator_updates=2, normaliser_episodes=4, ppo=PPO
    ),
    episodes=8,
)
PRIMARY = stages.PrimaryReturn(EMERGENCY, "extinguish", 0, ExpertConfig(max_steps=128, ppo=PPO))


def aligned() -> Run:
    config = MoralConfig(steps=640, queries=3, candidates=20, samples=50, checkpoint_every=1, ppo=PPO)
    return Aligned((NORM,), TEACHER, seed=0, primary=(PRIMARY,), config=config, episodes=8)


def from_preferences() -> Run:
    config = DRLHPConfig(
        steps=640,
        queries=6,
        clip_length=4,
        checkpoint_every=2,
        reward=RewardModelConfig(members=2, updates=2, initial_updates=3),
        ppo=PPO,
    )
    return FromPreferences(EMERGENCY, TEACHER, seed=0, config=config, episodes=8)
