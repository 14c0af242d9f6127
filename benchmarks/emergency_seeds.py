"""``moral demo`` over several seeds: what it reaches, how long it takes, and how far it is from the optimum.

    python -m benchmarks.emergency_seeds

Every seed is a process of its own, ``--jobs`` at a time; times mean something with one job on an idle
machine. The results file holds the summary of every seed and the mean and spread over seeds. Nothing is tuned
per seed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import provenance
from moral_algorithms.plotting import THESIS
from moral_algorithms.storage import write_json

RESULTS = Path(__file__).parent / "results" / "emergency_seeds.json"


def main() -> None:
    """Run the demo for every seed and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--jobs", type=int, default=1, help="demos at a time")
    parser.add_argument("--threads", type=int, help="threads of each demo (default: the demo's own)")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    arguments = parser.parse_args()
    started = time.perf_counter()
    with ThreadPoolExecutor(arguments.jobs) as pool:
        summaries = list(pool.map(lambda seed: run_demo(seed, arguments.threads), arguments.seeds))
    results = {
        "command": "python -m benchmarks.emergency_seeds",
        "jobs": arguments.jobs,
        "threads": summaries[0]["platform"]["threads"],
        **provenance(started),
        "summary": summarise(summaries),
        "runs": summaries,
    }
    report(results)
    write_json(arguments.json, results)


def run_demo(seed: int, threads: int | None) -> dict[str, Any]:
    """Run one demo in a process of its own and return its summary; None leaves it its own threads."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", "from moral_algorithms.cli import main; raise SystemExit(main())"]
        options = ["demo", "--seed", str(seed), "--out", f"{folder}/demo"]
        options += [] if threads is None else ["--threads", str(threads)]
        subprocess.run([*command, *options], check=True, stdout=subprocess.DEVNULL)
        summary: dict[str, Any] = json.loads(Path(folder, "demo", "summary.json").read_text())
    print(f"seed {seed}: {_objectives(summary)}, {summary['wall_seconds']['total']:.0f} s", flush=True)
    return summary


def summarise(summaries: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Mean, standard deviation, least and most over seeds of each figure."""
    figures = {
        "people_saved": [run["people_saved"] for run in summaries],
        "goal_time": [run["goal_time"] for run in summaries],
        "optimal_people_saved": [run["optimum"]["people_saved"] for run in summaries],
        "optimal_goal_time": [run["optimum"]["goal_time"] for run in summaries],
        "env_steps": [run["env_steps"]["total"] for run in summaries],
        "wall_seconds": [run["wall_seconds"]["total"] for run in summaries],
    }
    return {
        name: {
            "mean": float(np.mean(values)),
            "standard_deviation": float(np.std(values, ddof=1)) if len(values) > 1 else 0.0,
            "least": float(min(values)),
            "most": float(max(values)),
        }
        for name, values in figures.items()
    }


def report(results: dict[str, Any]) -> None:
    """Print the figures beside the thesis's."""
    print(f"{'':22}{'mean':>12}{'spread':>12}{'least':>12}{'most':>12}{'thesis':>10}")
    for name, figure in results["summary"].items():
        thesis = f"{THESIS['MORAL'][name]:.2f}" if name in THESIS["MORAL"] else ""
        values = "".join(f"{figure[key]:>12,.2f}" for key in ("mean", "standard_deviation", "least", "most"))
        print(f"{name:22}{values}{thesis:>10}")


def _objectives(summary: dict[str, Any]) -> str:
    return f"{summary['people_saved']:.3f} saved, {summary['goal_time']:.2f} goal steps"


if __name__ == "__main__":
    main()
