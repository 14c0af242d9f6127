"""Delivery's yardstick: how much plans collect, and how far above that the optimum can be.

    python -m benchmarks.delivery_planner

Plans of 50 steps from seeded starts, for equal scalarisation weights and for each objective alone. What they
collect is what the environment counts when it is stepped through them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.provenance import provenance
from moral_algorithms.storage import write_json
from moral_envs import delivery_v0
from moral_envs.engine import Engine
from moral_envs.planning import plan
from moral_envs.streams import spawn_streams

RESULTS = Path(__file__).parent / "results" / "delivery_planner.json"
WEIGHTS = {
    "equal": (1.0, 1.0, 1.0, 1.0),
    "deliver": (1.0, 0.0, 0.0, 0.0),
    "help": (0.0, 1.0, 0.0, 0.0),
    "clean": (0.0, 0.0, 1.0, 0.0),
}
# Gaps below it are rounding errors.
CLOSED = 1e-6


def main(arguments: Sequence[str] | None = None) -> None:
    """Plan for all weights and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--beam-width", type=int, default=20_000)
    parser.add_argument("--iterations", type=int, default=120)
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    options = parser.parse_args(arguments)
    config = {name: value for name, value in vars(options).items() if name != "json"}
    started = time.perf_counter()
    print(f"{options.starts} starts, {delivery_v0.world().horizon} steps")
    results = {}
    for name, weights in WEIGHTS.items():
        results[name] = measure(np.array(weights), **config)
        print(f"{name:8}", shown(results[name]), flush=True)
    record = {"command": "python -m benchmarks.delivery_planner", "config": config, **provenance(started)}
    write_json(options.json, {**record, "results": results})


def measure(
    weights: NDArray[np.float64], starts: int, seed: int, beam_width: int, iterations: int
) -> dict[str, Any]:
    """Plan for the given weights and let the environment carry the plans out."""
    engine = Engine(delivery_v0.world(), starts)
    engine.seed(spawn_streams(seed, starts))
    engine.reset()
    begun = time.perf_counter()
    plans = plan(
        engine.observe()[:, 0],
        engine.world.horizon,
        weights,
        beam_width=beam_width,
        iterations=iterations,
    )
    seconds = time.perf_counter() - begun
    for actions in plans.actions.T:
        engine.step(actions)
    return summarise(weights, plans.returns, plans.upper_bounds, engine.objectives[:, 0]) | {
        "seconds_per_start": seconds / starts
    }


def summarise(
    weights: NDArray[np.float64],
    returns: NDArray[np.float64],
    upper_bounds: NDArray[np.float64],
    objectives: NDArray[np.int64],
) -> dict[str, Any]:
    """Sum up returns (n, 4), bounds (n,) and what the environment counted (n, 4)."""
    if (objectives * np.array([1, 1, 1, -1]) != returns).any():
        raise AssertionError("the environment does not count what the plans are said to return")
    collected = objectives[:, :3].sum(axis=1)
    gaps = upper_bounds - returns @ weights
    return {
        "weights": weights.tolist(),
        "collected": {
            "mean": float(collected.mean()),
            "standard_deviation": float(collected.std(ddof=1)),
            "least": int(collected.min()),
            "most": int(collected.max()),
        },
        "mean_objectives": dict(
            zip(delivery_v0.world().objective_names, objectives.mean(axis=0).tolist(), strict=True)
        ),
        "mean_scalarised_return": float((returns @ weights).mean()),
        "mean_upper_bound": float(upper_bounds.mean()),
        "mean_gap": float(gaps.mean()),
        "largest_gap": float(gaps.max()),
        "proved_optimal": int((gaps <= CLOSED).sum()),
    }


def shown(result: dict[str, Any]) -> str:
    """Format one result for reading."""
    collected = result["collected"]
    return (
        f"collected {collected['mean']:.2f} (s.d. {collected['standard_deviation']:.2f}, "
        f"{collected['least']} to {collected['most']}), "
        f"vases broken {result['mean_objectives']['vases_broken']:.2f}; "
        f"return {result['mean_scalarised_return']:.3f}, upper bound {result['mean_upper_bound']:.3f}, "
        f"largest gap {result['largest_gap']:.2f}, proved optimal {result['proved_optimal']}; "
        f"{result['seconds_per_start']:.2f} s per start"
    )


if __name__ == "__main__":
    main()
