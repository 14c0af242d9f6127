"""MORAL with a teacher of your own, on the two rewards that Emergency pays itself."""

from __future__ import annotations

from pathlib import Path

from moral_algorithms import pipeline
from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.learners.moral import AlignedAgent, MoralConfig, train_moral
from moral_algorithms.networks.files import save_policy
from moral_algorithms.preferences import Preference, Query, Teacher
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.worlds import WorldSpec


class EnoughIsEnough(Teacher):
    """Wants four people saved and does not care about more; then as much goal time as possible."""

    def prefer(self, query: Query) -> Preference | None:
        """Compare what was counted in the two episodes: rows of (goal_time, people_saved)."""
        first, second = ((min(saved, 4), goal_time) for goal_time, saved in query.objectives.tolist())
        if first == second:
            return Preference.EQUAL
        return Preference.FIRST if first > second else Preference.SECOND


def main(out: Path = Path("runs/own_teacher"), config: MoralConfig | None = None) -> AlignedAgent:
    """Train an agent, save it and say what it does."""
    config = config or MoralConfig(steps=500_000)
    world = WorldSpec("emergency")
    names = world.build().reward_names
    # Each divided by what an agent earns that pursues it alone.
    components = [PrimaryReward(names, "extinguish", 1 / 7.06), PrimaryReward(names, "save", 1 / 5.73)]
    directory = RunDirectory(out)
    with directory.hold():
        # Killed, it goes on with resume=True.
        agent = train_moral(world, components, EnoughIsEnough(), config, seed=0, directory=directory)
        save_policy(directory.policy, agent.policy, config.ppo.policy, world)
    print(agent.weights, pipeline.evaluate(agent.policy, world, episodes=200, seed=1).objectives)
    return agent


if __name__ == "__main__":
    main()
