"""morl-baselines' Envelope Q-learning on Emergency: how much of the exact hypervolume it reaches.

    python -m benchmarks.strangers.envelope

One network conditioned on the scalarisation weights learns one policy for each weight. Afterwards its
policies for 11 weights are run, undiscounted, from held-out seeded starts; the hypervolume of their mean
returns is compared with that of the exact convex coverage set (``moral_envs.optimal``) of the very same
starts, by the same function of morl-baselines and from the same reference point. The settings were chosen
on seeds from 100 on and other starts; seeds 0 to 2 were run once.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from benchmarks.strangers.egocentric import Egocentric
from benchmarks.strangers.record import kept_runs, provenance, results_file, store
from moral_envs import optimal

HORIZON = 75
REFERENCE_POINT = (0.0, 0.0)
BAR = 0.6
WORKAROUNDS = [
    "morl-baselines declares pycddlib==2.1.6 (built from source against GMP), cvxpy, moviepy and seaborn; "
    "Envelope imports none of them, so morl-baselines is installed without its dependencies, and torch, "
    "scipy, pymoo, wandb and mo-gymnasium beside it.",
    "morl-baselines imports wandb wherever it logs: it has to be installed, and log=False keeps it "
    "silent. Without logging Envelope.train evaluates nothing, so the evaluation is this script's own.",
    "Envelope passes every image through Atari's convolutions, whose 8x8 kernel leaves no room for two "
    "more layers on 8x8 cells: the observations are flattened first, here by an egocentric crop.",
    "Its replay samples from NumPy's global random state and its network from PyTorch's: "
    "morl_baselines.common.evaluation.seed_everything is needed besides the seed argument.",
]


@dataclass(frozen=True)
class Config:
    """What is run.

    Parameters
    ----------
    seeds
        One run each.
    steps
        Environment steps of a run, with one gradient step each.
    starts
        Held-out starts on which the policies are measured.
    first_start
        Seed of the first of them.
    weights
        Number of equally spaced scalarisation weights that the coverage set is made from.
    radius
        Cells that the crop shows in each direction; 5 shows the whole world from anywhere.
    learning_rate, gamma, batch_size, num_sample_w, net_arch, target_net_update_freq, max_grad_norm
        As in Envelope.
    epsilon_decay_steps
        Steps over which exploration falls from 1 to 0.05.
    """

    seeds: tuple[int, ...] = (0, 1, 2)
    steps: int = 25_000
    starts: int = 128
    first_start: int = 10_000
    weights: int = 11
    radius: int = 5
    learning_rate: float = 1e-3
    gamma: float = 0.9
    batch_size: int = 64
    num_sample_w: int = 4
    net_arch: tuple[int, ...] = (128, 128)
    target_net_update_freq: int = 200
    max_grad_norm: float = 10.0
    epsilon_decay_steps: int = 10_000


def make_env(radius: int) -> gymnasium.Env[NDArray[np.float32], int]:
    """Emergency for one agent, seen egocentrically."""
    return Egocentric(gymnasium.make("moral/Emergency-v0"), radius)


def start_seeds(config: Config) -> range:
    """Seeds of the held-out starts."""
    return range(config.first_start, config.first_start + config.starts)


def exact_front(config: Config) -> NDArray[np.float64]:
    """Vertices of the exact coverage set of the held-out starts, as reward vectors (extinguish, save)."""
    env = gymnasium.make("moral/Emergency-v0")
    starts = np.array([env.reset(seed=seed)[0] for seed in start_seeds(config)])
    return optimal.coverage_set(starts, HORIZON).points * [optimal.EXTINGUISH_REWARD, 1.0]


def train(seed: int, config: Config) -> Any:
    """Train one agent."""
    import torch
    from morl_baselines.common.evaluation import seed_everything
    from morl_baselines.multi_policy.envelope.envelope import Envelope

    torch.set_num_threads(1)
    seed_everything(seed)
    env = make_env(config.radius)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    agent = Envelope(
        env,
        learning_rate=config.learning_rate,
        gamma=config.gamma,
        batch_size=config.batch_size,
        num_sample_w=config.num_sample_w,
        net_arch=list(config.net_arch),
        target_net_update_freq=config.target_net_update_freq,
        max_grad_norm=config.max_grad_norm,
        initial_epsilon=1.0,
        final_epsilon=0.05,
        epsilon_decay_steps=config.epsilon_decay_steps,
        learning_starts=1_000,
        buffer_size=config.steps,
        log=False,
        seed=seed,
        device="cpu",
    )
    agent.train(config.steps)
    return agent


def found_front(agent: Any, config: Config) -> NDArray[np.float64]:
    """Mean undiscounted returns on the held-out starts, one row for each weight."""
    env = make_env(config.radius)
    front = np.zeros((config.weights, 2))
    for row, save_weight in zip(front, np.linspace(0, 1, config.weights), strict=True):
        weights = np.array([1 - save_weight, save_weight])
        for seed in start_seeds(config):
            observation, _ = env.reset(seed=seed)
            ended = False
            while not ended:
                observation, reward, terminated, truncated, _ = env.step(agent.eval(observation, weights))
                row += np.asarray(reward)
                ended = terminated or truncated
    return front / config.starts


def run(seed: int, config: Config) -> dict[str, Any]:
    """Train, measure and compare."""
    from morl_baselines.common.performance_indicators import hypervolume

    started, before = time.perf_counter(), time.process_time()
    agent = train(seed, config)
    trained, after = time.perf_counter(), time.process_time()
    exact, found = exact_front(config), found_front(agent, config)
    reference = np.array(REFERENCE_POINT)
    exact_volume, found_volume = float(hypervolume(reference, exact)), float(hypervolume(reference, found))
    return {
        "seed": seed,
        "hypervolume": found_volume,
        "exact_hypervolume": exact_volume,
        "ratio": found_volume / exact_volume,
        "front": found.tolist(),
        "exact_front": exact.tolist(),
        "training_seconds": round(trained - started, 1),
        # On a machine that does other work, too, these are the ones to compare.
        "training_processor_seconds": round(after - before, 1),
        "measuring_seconds": round(time.perf_counter() - trained, 1),
    }


def summarise(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Mean and spread over seeds of the share of the exact hypervolume."""
    ratios = [one["ratio"] for one in runs]
    return {
        "ratio_mean": float(np.mean(ratios)),
        "ratio_standard_deviation": float(np.std(ratios, ddof=1)) if len(ratios) > 1 else 0.0,
        "ratio_least": min(ratios),
        "bar": BAR,
        "reached": min(ratios) >= BAR,
    }


def main(options: Sequence[str] | None = None) -> None:
    """Run all seeds, print the figures and store them after every seed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(Config.seeds))
    parser.add_argument("--steps", type=int, default=Config.steps, help="environment steps of a run")
    parser.add_argument("--json", type=Path, default=results_file("envelope"), help="file for the results")
    parser.add_argument("--resume", action="store_true", help="keep the runs that the file already holds")
    arguments = parser.parse_args(options)
    config = replace(Config(), seeds=tuple(arguments.seeds), steps=arguments.steps)
    started = time.perf_counter()
    runs = kept_runs(arguments.json, config.seeds, asdict(config)) if arguments.resume else []
    for seed in config.seeds:
        if seed in [one["seed"] for one in runs]:
            continue
        runs.append(run(seed, config))
        share, seconds = runs[-1]["ratio"], runs[-1]["training_seconds"]
        print(f"seed {seed}: {share:.1%} of the exact hypervolume, trained in {seconds:.0f} s", flush=True)
        record = {
            "command": "python -m benchmarks.strangers.envelope",
            "config": asdict(config),
            **provenance(started, ("morl-baselines", "mo-gymnasium", "torch", "pymoo", "wandb")),
            "reference_point": list(REFERENCE_POINT),
            "workarounds": WORKAROUNDS,
            "summary": summarise(runs),
            "runs": runs,
        }
        store(arguments.json, record)
    summary = summarise(runs)
    spread = f"{summary['ratio_mean']:.1%} ({summary['ratio_standard_deviation']:.1%})"
    print(f"{spread} of the exact hypervolume over {len(runs)} seeds, least {summary['ratio_least']:.1%}")
    print("Worked around:", *WORKAROUNDS, sep="\n- ")


if __name__ == "__main__":
    main()
