"""A reward from demonstrations of your own, here those of a script that walks to the extinguisher."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.airl import AIRLConfig, Imitation, train_airl
from moral_algorithms.networks.files import save_reward
from moral_algorithms.worlds import WorldSpec
from moral_envs.world import ACTION_NAMES


class WalksToTheExtinguisher:
    """Goes up or down, then left or right, and waits there: whatever has ``predict`` can be recorded."""

    def predict(
        self, observation: NDArray[np.uint8], deterministic: bool = False
    ) -> tuple[NDArray[np.int64], Any]:
        """Choose actions (n,) for planes (n, 4, 8, 8): walls, agent, people, extinguisher."""
        agents, goals = (np.argwhere(observation[:, plane])[:, 1:] for plane in (1, 3))
        down, right = (goals - agents).T
        conditions = [down > 0, down < 0, right > 0, right < 0]
        chosen = np.select(conditions, ["move down", "move up", "move right", "move left"], "wait")
        return np.array([ACTION_NAMES.index(name) for name in chosen.tolist()]), None


def main(out: Path = Path("runs/own_demonstrations"), config: AIRLConfig | None = None) -> Imitation:
    """Record 200 episodes, learn what they are after, and save both."""
    world = WorldSpec("emergency")
    played = play_episodes(WalksToTheExtinguisher(), world.build(), num_episodes=200, seed=0)
    demonstrations = Demonstrations(world, played.states, played.actions, played.objectives)
    out.mkdir(parents=True, exist_ok=True)
    demonstrations.save(out / "demonstrations.npz")
    found = train_airl(demonstrations, config or AIRLConfig(), seed=0)
    save_reward(out / "reward.safetensors", found.network, found.normaliser, world)
    print(play_episodes(found.policy, world.build(), num_episodes=200, seed=1).objectives.mean(axis=0))
    return found


if __name__ == "__main__":
    main()
