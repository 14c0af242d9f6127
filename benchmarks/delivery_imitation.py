"""Imitation in Delivery: an expert for each norm, and AIRL from its demonstrations (targets D1 and D2).

    python -m benchmarks.delivery_imitation

One expert helps people, the other cleans up pollution, and both avoid vases (thesis, figures A.3 and A.6).
AIRL learns a reward and an imitation policy from 1,000 episodes of each. Expert and imitator are measured on
the same starts, which neither has seen. The settings are the same for both norms and all seeds. Finished runs
are kept in the results file as long as settings and versions are the same, so a run that was stopped goes on
where it was.
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
from stable_baselines3.common.policies import ActorCriticPolicy

from benchmarks.provenance import provenance
from benchmarks.runs import finished_runs, store_runs
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.airl import AIRLConfig, train_airl
from moral_algorithms.learners.expert import ExpertConfig, train_expert
from moral_algorithms.learners.ppo import PPOConfig, sampling_seed
from moral_algorithms.run_directory import versions
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.worlds import WorldSpec

RESULTS = Path(__file__).parent / "results" / "delivery_imitation.json"

WORLD = WorldSpec("delivery")

NORMS: dict[str, tuple[str, tuple[float, ...]]] = {
    "help": ("helped", (0.0, 1.0, 0.0, 1.0)),
    "clean": ("cleaned", (0.0, 0.0, 1.0, 1.0)),
}
"""For each expert its own objective and the weights of (deliver, help, clean, vase)."""

EVALUATION_SEED = 10_000


@dataclass(frozen=True)
class Config:
    """What is trained, the same for both norms and all seeds."""

    demonstrations: int = 1000
    """Episodes of the expert."""
    episodes: int = 500
    """Starts on which expert and imitator are measured."""
    expert: ExpertConfig = field(
        default_factory=lambda: ExpertConfig(
            max_steps=1_000_000,
            patience=1_000,
            ppo=PPOConfig(entropy_start=0.03, entropy_end=0.05),
        )
    )
    airl: AIRLConfig = field(
        default_factory=lambda: AIRLConfig(
            steps=1_500_000,
            architecture="counting",
            ppo=PPOConfig(entropy_start=0.1, entropy_end=0.02),
        )
    )


def run(norm: str, seed: int, config: Config) -> dict[str, Any]:
    """Train an expert and its imitator, and measure both."""
    objective, weights = NORMS[norm]
    expert_seed, start_seed, action_seed, airl_seed = spawn_seeds(seed, 4)
    started = time.perf_counter()
    expert = train_expert(WORLD, weights, config.expert, expert_seed)
    expert_seconds = time.perf_counter() - started
    world = WORLD.build()
    with sampling_seed(action_seed):
        recorded = play_episodes(expert.policy, world, config.demonstrations, start_seed)
    demonstrations = Demonstrations(WORLD, recorded.states, recorded.actions, recorded.objectives)
    started = time.perf_counter()
    imitation = train_airl(demonstrations, config.airl, airl_seed)
    airl_seconds = time.perf_counter() - started
    return {
        "norm": norm,
        "seed": seed,
        "objective": objective,
        "expert": measure(expert.policy, config.episodes),
        "imitator": measure(imitation.policy, config.episodes),
        "env_steps": {"expert": expert.env_steps, "airl": imitation.env_steps},
        "wall_seconds": {"expert": round(expert_seconds, 1), "airl": round(airl_seconds, 1)},
    }


def measure(policy: ActorCriticPolicy, episodes: int) -> dict[str, float]:
    """Mean objectives on the starts of the evaluation."""
    with sampling_seed(EVALUATION_SEED):
        played = play_episodes(policy, WORLD.build(), episodes, EVALUATION_SEED)
    means = played.objectives.mean(axis=0).round(3).tolist()
    return dict(zip(WORLD.build().objective_names, means, strict=True))


def share(one: dict[str, Any]) -> float:
    """How much of its expert's own objective an imitator reaches."""
    return float(one["imitator"][one["objective"]] / one["expert"][one["objective"]])


def summarise(runs: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Means over seeds for each norm, and the worst seeds."""
    found = {}
    for norm in sorted({one["norm"] for one in runs}):
        same = [one for one in runs if one["norm"] == norm]
        objective = NORMS[norm][0]
        found[norm] = {
            "seeds": len(same),
            "expert_objective": float(np.mean([one["expert"][objective] for one in same])),
            "expert_vases": float(np.mean([one["expert"]["vases_broken"] for one in same])),
            "imitator_objective": float(np.mean([one["imitator"][objective] for one in same])),
            "imitator_vases": float(np.mean([one["imitator"]["vases_broken"] for one in same])),
            "least_share": min(share(one) for one in same),
            "most_vases": max(one["imitator"]["vases_broken"] for one in same),
            "airl_seconds": float(np.mean([one["wall_seconds"]["airl"] for one in same])),
        }
    return found


def table(summary: dict[str, dict[str, float]]) -> str:
    """Write the summary as a table."""
    head = f"{'':22}" + "".join(f"{norm:>10}" for norm in summary)
    rows = (
        f"{name:22}" + "".join(f"{one[name]:>10.3f}" for one in summary.values())
        for name in next(iter(summary.values()))
    )
    return "\n".join([head, *rows])


def main(options: Sequence[str] | None = None) -> None:
    """Train every expert and imitator that is not in the results file yet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--norms", nargs="+", choices=list(NORMS), default=list(NORMS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--expert-steps", type=int, help="environment steps of an expert")
    parser.add_argument("--airl-steps", type=int, help="environment steps of AIRL")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    arguments = parser.parse_args(options)
    torch.set_num_threads(1)
    config = Config()
    if arguments.expert_steps is not None:
        config = replace(config, expert=replace(config.expert, max_steps=arguments.expert_steps))
    if arguments.airl_steps is not None:
        config = replace(config, airl=replace(config.airl, steps=arguments.airl_steps))
    settings = {"config": json.loads(json.dumps(asdict(config))), "versions": versions()}
    runs = finished_runs(arguments.json, settings)
    done = {(one["norm"], one["seed"]) for one in runs}
    for seed in arguments.seeds:
        for norm in arguments.norms:
            if (norm, seed) in done:
                continue
            started = time.perf_counter()
            runs.append({**run(norm, seed, config), **provenance(started)})
            one = runs[-1]
            print(
                f"{norm}, seed {seed}: expert {one['expert'][one['objective']]:.2f}, imitator "
                f"{one['imitator'][one['objective']]:.2f} with {one['imitator']['vases_broken']:.2f} vases",
                flush=True,
            )
            store_runs(arguments.json, "delivery_imitation", settings, summarise(runs), runs)
    print(table(summarise(runs)))


if __name__ == "__main__":
    main()
