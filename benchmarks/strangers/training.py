"""What the learning strangers share: measuring on seeded starts, and the report over training seeds."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from benchmarks.strangers.record import kept_runs, provenance, results_file, store
from moral_envs import optimal

Policy = Callable[[Any], int]
HORIZON = 75
SEEDS = (0, 1, 2)


class Settings(Protocol):
    """What every stranger's configuration has."""

    @property
    def steps(self) -> int:
        """Environment steps of a run."""
        ...

    @property
    def weights(self) -> Sequence[float]:
        """Scalarisation weights."""
        ...

    @property
    def starts(self) -> int:
        """Held-out starts."""
        ...

    @property
    def first_start(self) -> int:
        """Seed of the first of them."""
        ...


def start_seeds(config: Settings) -> range:
    """Seeds of the held-out starts."""
    return range(config.first_start, config.first_start + config.starts)


def final_objectives(env: gymnasium.Env[Any, int], policy: Policy, seeds: Iterable[int]) -> NDArray[np.int64]:
    """Objective counters at the end of one episode from every seed, one row each."""
    rows = []
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        ended = False
        while not ended:
            observation, _, terminated, truncated, info = env.step(policy(observation))
            ended = terminated or truncated
        rows.append(info["objectives"])
    return np.array(rows)


def random_policy(num_actions: int, seed: int = 0) -> Policy:
    """Uniformly random actions."""
    rng = np.random.default_rng(seed)
    return lambda observation: int(rng.integers(num_actions))


def emergency_utility(objectives: NDArray[Any], config: Settings) -> dict[str, float]:
    """Means over starts of the counters, and of the scalarised return that they stand for."""
    goal_time, people_saved = objectives.mean(axis=0).tolist()
    extinguish, save = config.weights
    utility = extinguish * optimal.EXTINGUISH_REWARD * goal_time + save * people_saved
    return {"scalarised_return": utility, "goal_time": goal_time, "people_saved": people_saved}


def emergency_outcome(env: gymnasium.Env[Any, int], policy: Policy, config: Settings) -> dict[str, Any]:
    """Measure a policy on the held-out starts."""
    return emergency_utility(final_objectives(env, policy, start_seeds(config)), config)


def emergency_baselines(config: Settings) -> dict[str, dict[str, float]]:
    """Random actions, and the exact optimum for the weights, on the held-out starts."""
    env = gymnasium.make("moral/Emergency-v0")
    starts = np.array([env.reset(seed=seed)[0] for seed in start_seeds(config)])
    best = optimal.best_returns(starts, HORIZON, config.weights)
    return {
        "random": emergency_outcome(env, random_policy(9), config),
        "optimum": emergency_utility(best, config),
    }


def summarise(runs: Sequence[dict[str, Any]], baselines: dict[str, dict[str, float]]) -> dict[str, float]:
    """Summarise over seeds; where the optimum is known, as a share of the way from random actions to it."""
    returns = [float(one["scalarised_return"]) for one in runs]
    chance = baselines["random"]["scalarised_return"]
    summary = {
        "mean": float(np.mean(returns)),
        "standard_deviation": float(np.std(returns, ddof=1)) if len(returns) > 1 else 0.0,
        "least": min(returns),
        "random": chance,
    }
    if "optimum" in baselines:
        best = baselines["optimum"]["scalarised_return"]
        summary["optimum"] = best
        summary["share_of_the_way"] = (summary["mean"] - chance) / (best - chance)
    return summary


@dataclass(frozen=True)
class Stranger:
    """One stranger and its story.

    Parameters
    ----------
    name
        Name of the module and of the results file.
    description
        The module's docstring.
    run
        Trains with a seed and the settings, and measures what came of it.
    baselines
        Measures what needs no training.
    workarounds
        What had to be worked around.
    packages
        Distributions that took part.
    """

    name: str
    description: str | None
    run: Callable[[int, Any], dict[str, Any]]
    baselines: Callable[[Any], dict[str, dict[str, float]]]
    workarounds: Sequence[str]
    packages: Sequence[str]


def train_and_report(stranger: Stranger, config: Any, options: Sequence[str] | None) -> None:
    """Command line of a stranger: run all seeds, print the figures and store them after every seed.

    Parameters
    ----------
    stranger
        What is run.
    config
        Its settings; ``--steps`` replaces theirs.
    options
        Command-line arguments; those of the process if None.
    """
    parser = argparse.ArgumentParser(description=(stranger.description or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS), help="one run each")
    parser.add_argument("--steps", type=int, default=config.steps, help="environment steps of a run")
    parser.add_argument("--json", type=Path, default=results_file(stranger.name), help="file for the results")
    parser.add_argument("--resume", action="store_true", help="keep the runs that the file already holds")
    arguments = parser.parse_args(options)
    config = replace(config, steps=arguments.steps)
    started = time.perf_counter()
    beside = stranger.baselines(config)
    report("random actions", beside["random"])
    runs = kept_runs(arguments.json, arguments.seeds, asdict(config)) if arguments.resume else []
    for seed in arguments.seeds:
        if seed in [one["seed"] for one in runs]:
            continue
        before = time.perf_counter()
        outcome = stranger.run(seed, config)
        runs.append({"seed": seed, **outcome, "seconds": round(time.perf_counter() - before, 1)})
        report(f"seed {seed}", outcome)
        record = {
            "command": f"python -m benchmarks.strangers.{stranger.name}",
            "config": asdict(config),
            **provenance(started, stranger.packages),
            "workarounds": list(stranger.workarounds),
            "summary": summarise(runs, beside),
            "baselines": beside,
            "runs": runs,
        }
        store(arguments.json, record)
    if "optimum" in beside:
        report("exact optimum", beside["optimum"])
    print("Worked around:", *stranger.workarounds, sep="\n- ")


def report(name: str, outcome: dict[str, Any]) -> None:
    """Print the figures of one policy."""
    figures = (
        f"{key.replace('_', ' ')} {value:.2f}" for key, value in outcome.items() if isinstance(value, float)
    )
    print(f"{name:16}", ", ".join(figures), flush=True)
