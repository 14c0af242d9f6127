"""Several agents in Delivery: parameter-shared PPO with two and four agents against one.

    python -m benchmarks.delivery_teams

All agents share one policy, which sees the other agents in a plane of their own. Every run takes the same
number of agent steps, so a larger team sees as much experience in fewer environment steps. The components of
the reward vector weigh the same (+1 for a delivery, a person helped or a pollution cleaned up, -1 for a vase
broken) and are paid to each agent for itself or to the whole team. The result is what a team collects in an
episode, on starts that training has not seen. Finished runs are kept in the results file as long as settings
and versions are the same, so a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO

from benchmarks.provenance import provenance
from benchmarks.runs import finished_runs, store_runs
from moral_algorithms.bridge import EngineVecEnv, PrimaryReward, ScalarisedRewards
from moral_algorithms.learners.ppo import PPOConfig, learn, make_ppo, standard_callbacks
from moral_algorithms.run_directory import versions
from moral_envs import delivery_v0
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams

RESULTS = Path(__file__).parent / "results" / "delivery_teams.json"

WORLD = delivery_v0.world()

EVALUATION_SEED = 10_000


@dataclass(frozen=True)
class Config:
    """What is trained, the same for every team."""

    agent_steps: int = 1_000_000
    """Steps of all agents together."""
    episodes: int = 200
    """Starts on which a team is measured."""
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(entropy_start=0.03, entropy_end=0.0))
    """``num_envs`` is the number of agents that act side by side, in all environments together."""


@dataclass(frozen=True)
class Team:
    """One run."""

    num_agents: int
    team_reward: bool
    seed: int


def train(team: Team, config: Config) -> dict[str, Any]:
    """Train one team and measure it."""
    started = time.perf_counter()
    num_envs = config.ppo.num_envs // team.num_agents
    venv = EngineVecEnv(WORLD, num_envs, team.num_agents, team.team_reward, seed=team.seed)
    names = WORLD.reward_names
    rewards = ScalarisedRewards(venv, [PrimaryReward(names, name) for name in names], np.ones(len(names)))
    model = make_ppo(config.ppo, rewards, team.seed)
    callbacks = standard_callbacks(config.ppo, config.agent_steps, WORLD.objective_names, None)
    learn(model, config.agent_steps, callbacks)
    training_seconds = time.perf_counter() - started
    return {
        **asdict(team),
        **evaluate(model, team.num_agents, config.episodes),
        "environment_steps": model.num_timesteps // team.num_agents,
        "training_seconds": round(training_seconds, 1),
    }


def evaluate(model: PPO, num_agents: int, episodes: int) -> dict[str, Any]:
    """Mean objectives that a team reaches together, and how the work was shared."""
    engine = Engine(WORLD, episodes, num_agents)
    engine.seed(spawn_streams(EVALUATION_SEED, episodes))
    engine.reset()
    for _ in range(WORLD.horizon):
        observations = engine.observe().reshape(episodes * num_agents, *engine.observation_shape)
        actions, _ = model.policy.predict(observations, deterministic=False)
        engine.step(actions.reshape(episodes, num_agents))
    counters = engine.objectives
    together = counters.sum(axis=1).mean(axis=0)
    collected = counters[:, :, :3].sum(axis=2)
    return {
        "objectives": dict(zip(WORLD.objective_names, together.round(3).tolist(), strict=True)),
        "collected": round(float(collected.sum(axis=1).mean()), 3),
        "collected_per_agent": round(float(collected.mean()), 3),
    }


def teams(sizes: Sequence[int], seeds: Sequence[int]) -> list[Team]:
    """All runs: an agent on its own has no team to share with."""
    return [
        Team(size, shared, seed)
        for size in sizes
        for shared in ((False, True) if size > 1 else (False,))
        for seed in seeds
    ]


def summarise(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean and standard deviation over seeds for every kind of team."""
    kinds = sorted({(run["num_agents"], run["team_reward"]) for run in runs})
    found = []
    for num_agents, team_reward in kinds:
        same = [r for r in runs if (r["num_agents"], r["team_reward"]) == (num_agents, team_reward)]
        summary: dict[str, Any] = {"num_agents": num_agents, "team_reward": team_reward, "seeds": len(same)}
        figures = {
            "collected": [run["collected"] for run in same],
            "collected_per_agent": [run["collected_per_agent"] for run in same],
            "vases_broken": [run["objectives"]["vases_broken"] for run in same],
            "training_seconds": [run["training_seconds"] for run in same],
        }
        for name, values in figures.items():
            spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            summary[name] = {"mean": float(np.mean(values)), "standard_deviation": spread}
        found.append(summary)
    return found


def table(summaries: Sequence[dict[str, Any]]) -> str:
    """Write the summaries as a table."""
    lines = [f"{'agents':>6} {'reward':>10} {'collected':>16} {'per agent':>10} {'vases':>6} {'seconds':>8}"]
    for one in summaries:
        collected = f"{one['collected']['mean']:.2f} ({one['collected']['standard_deviation']:.2f})"
        lines.append(
            f"{one['num_agents']:>6} {'team' if one['team_reward'] else 'individual':>10} {collected:>16} "
            f"{one['collected_per_agent']['mean']:>10.2f} {one['vases_broken']['mean']:>6.2f} "
            f"{one['training_seconds']['mean']:>8.0f}"
        )
    return "\n".join(lines)


def main(options: Sequence[str] | None = None) -> None:
    """Train every team that is not in the results file yet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 2, 4], help="agents in a team")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--agent-steps", type=int, default=Config.agent_steps, help="steps of a run")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    arguments = parser.parse_args(options)
    torch.set_num_threads(1)
    config = replace(Config(), agent_steps=arguments.agent_steps)
    settings = {"config": json.loads(json.dumps(asdict(config))), "versions": versions()}
    runs = finished_runs(arguments.json, settings)
    done = {Team(run["num_agents"], run["team_reward"], run["seed"]) for run in runs}
    for team in teams(arguments.sizes, arguments.seeds):
        if team in done:
            continue
        started = time.perf_counter()
        runs.append({**train(team, config), **provenance(started)})
        print(f"{team}: {runs[-1]['collected']:.2f} collected, {runs[-1]['training_seconds']} s", flush=True)
        store_runs(arguments.json, "delivery_teams", settings, summarise(runs), runs)
    print(table(summarise(runs)))


if __name__ == "__main__":
    main()
