"""DRLHP, the baseline, in Emergency: people saved and goal time from 1000 preferences, and from fewer.

    python -m benchmarks.drlhp_emergency

The teacher prefers more people saved and, on a tie, more goal time, as in table 4.1 of the thesis. Every run
is measured on 1,000 starts that training has not seen; its curve says how far it was after so many
environment steps and answers, for figure 4.7. Nothing is tuned per seed. Finished runs are kept in the
results file as long as settings and versions are the same, so a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.provenance import provenance
from benchmarks.runs import finished_runs, store_runs
from moral_algorithms.learners.drlhp import DRLHPConfig
from moral_algorithms.networks.files import load_policy
from moral_algorithms.pipeline import DRLHPRun, Setting, drlhp, drlhp_preset, evaluate
from moral_algorithms.plotting import THESIS
from moral_algorithms.run_directory import RunDirectory, read_lines, versions
from moral_algorithms.worlds import WorldSpec

RESULTS = Path(__file__).parent / "results" / "drlhp_emergency.json"

WORLD = WorldSpec()

EVALUATION_SEED = 10_000

# Points of a curve, of which there is one per rollout otherwise.
_POINTS = 100


def train(config: DRLHPConfig, seed: int, episodes: int) -> dict[str, Any]:
    """Train one agent and measure it."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        directory = RunDirectory(Path(folder))
        summary = drlhp(directory, DRLHPRun(WORLD, seed=seed, config=config), Setting())
        policy = load_policy(directory.policy).policy
        lines = read_lines(directory.metrics)
        answers = read_lines(directory.queries)
    seconds = time.perf_counter() - started
    found = evaluate(policy, WORLD, episodes, EVALUATION_SEED)
    return {
        "queries": config.queries,
        "seed": seed,
        **{name: round(mean, 4) for name, mean in found.objectives.items()},
        "optimum": found.optimum,
        "env_steps": summary["env_steps"],
        "training_seconds": round(seconds, 1),
        "ties": sum(answer["preference"] == "equal" for answer in answers),
        "curve": curve(lines),
    }


def curve(lines: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """Thin out what a run wrote after its rollouts: environment steps, answers and mean objectives."""
    rows = np.unique(np.linspace(0, len(lines) - 1, min(_POINTS, len(lines))).round().astype(int))
    # No episode has ended in the first rollouts.
    kept = [lines[row] for row in rows if lines[row]["objectives"]]
    points = {
        "env_steps": [line["env_steps"] for line in kept],
        "queries": [line["queries"] for line in kept],
    }
    names = kept[0]["objectives"] if kept else ()
    return points | {name: [round(line["objectives"][name], 3) for line in kept] for name in names}


def summarise(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean and standard deviation over seeds for every number of queries."""
    found = []
    for queries in sorted({run["queries"] for run in runs}):
        same = [run for run in runs if run["queries"] == queries]
        summary: dict[str, Any] = {"queries": queries, "seeds": len(same)}
        for name in ("people_saved", "goal_time", "env_steps", "training_seconds"):
            values = [run[name] for run in same]
            spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            summary[name] = {
                "mean": float(np.mean(values)),
                "standard_deviation": spread,
                "least": float(min(values)),
            }
        found.append(summary)
    return found


def table(summaries: Sequence[dict[str, Any]]) -> str:
    """Write the summaries as a table, beside the thesis's figures."""
    lines = [f"{'preferences':>12}{'people saved':>16}{'goal time':>16}{'env steps':>12}{'seconds':>9}"]
    for one in summaries:
        saved, goal = (
            f"{one[name]['mean']:.2f} ({one[name]['standard_deviation']:.2f})"
            for name in ("people_saved", "goal_time")
        )
        lines.append(
            f"{one['queries']:>12}{saved:>16}{goal:>16}{one['env_steps']['mean']:>12,.0f}"
            f"{one['training_seconds']['mean']:>9.0f}"
        )
    thesis = THESIS["DRLHP"]
    lines.append(f"{'thesis, 1000':>12}{thesis['people_saved']:>16.2f}{thesis['goal_time']:>16.2f}")
    return "\n".join(lines)


def main(options: Sequence[str] | None = None) -> None:
    """Train every agent that is not in the results file yet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--queries", type=int, nargs="+", default=[1000, 100, 25])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--steps", type=int, help="environment steps; by default the preset's")
    parser.add_argument("--episodes", type=int, default=1000, help="starts on which an agent is measured")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    arguments = parser.parse_args(options)
    torch.set_num_threads(1)
    torch.distributions.Distribution.set_default_validate_args(False)
    config = drlhp_preset(arguments.preset, WORLD)
    if arguments.steps is not None:
        config = replace(config, steps=arguments.steps)
    settings = {
        "config": {name: value for name, value in asdict(config).items() if name != "queries"},
        "episodes": arguments.episodes,
        "versions": versions(),
    }
    runs = finished_runs(arguments.json, settings)
    done = {(run["queries"], run["seed"]) for run in runs}
    for queries in arguments.queries:
        for seed in arguments.seeds:
            if (queries, seed) in done:
                continue
            started = time.perf_counter()
            run = train(replace(config, queries=queries), seed, arguments.episodes)
            runs.append({**run, **provenance(started)})
            print(
                f"{queries} preferences, seed {seed}: {run['people_saved']:.3f} saved, "
                f"{run['goal_time']:.2f} goal steps, {run['training_seconds']:.0f} s",
                flush=True,
            )
            store_runs(arguments.json, "drlhp_emergency", settings, summarise(runs), runs)
    print(table(summarise(runs)))


if __name__ == "__main__":
    main()
