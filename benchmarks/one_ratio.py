"""One of Delivery's ratios from nothing: how long experts, two norms, the policy and 25 queries take.

    python -m benchmarks.one_ratio

The stages are those of D6, in a store of their own, ``--jobs`` at a time, each on one core; times mean
something on an idle machine. Then a second ratio is asked for, with all that was learned at hand.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import Run, Store
from benchmarks.harness.benchmark import PROFILES
from benchmarks.harness.executors import LocalProcesses, Outcome
from benchmarks.harness.run import with_needs
from benchmarks.harness.sweep import Sweep
from benchmarks.provenance import provenance
from benchmarks.rows.ratios import deviation, three_rewards
from benchmarks.stages import Asked
from moral_algorithms.storage import write_json

RESULTS = Path(__file__).parent / "results" / "one_ratio.json"

_FIRST = (1, 1, 1)
_FURTHER = (1, 2, 3)
"""Of (delivered, helped, cleaned)."""


def main(options: Sequence[str] | None = None) -> None:
    """Time both ratios and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--profile", choices=PROFILES, default="laptop", help="size (default: laptop)")
    parser.add_argument("--seed", type=int, default=0, help="of all stages (default: 0)")
    parser.add_argument("--jobs", type=int, default=2, help="stages at a time (default: 2)")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    arguments = parser.parse_args(options)
    for name, least in (("seed", 0), ("jobs", 1)):
        if getattr(arguments, name) < least:
            parser.error(f"{name} is {getattr(arguments, name)}; it must be at least {least}")
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        ratios = [
            carry_out(store, three_rewards(arguments.profile, ratio, arguments.seed), arguments.jobs)
            for ratio in (_FIRST, _FURTHER)
        ]
    results = {
        "command": "python -m benchmarks.one_ratio",
        "profile": arguments.profile,
        "seed": arguments.seed,
        "jobs": arguments.jobs,
        **provenance(started),
        "from_nothing": ratios[0],
        "further": ratios[1],
    }
    write_json(arguments.json, results)


def carry_out(store: Store, run: Asked, jobs: int) -> dict[str, Any]:
    """Do what is not finished of a run and its needs; tell the seconds and what the agent achieves."""
    started = time.perf_counter()
    sweep = Sweep(store, [run])
    missing = list(sweep.todo)
    sweep.carry_out(LocalProcesses(store, jobs), lambda _: None, _fail)
    seconds = time.perf_counter() - started
    result = store.result(run)
    found = {
        "ratio": dict(run.teacher.ratio),
        "wall_seconds": round(seconds, 1),
        "stage_seconds": [
            {"stage": one.kind, "seconds": round(_record(store, one)["duration_seconds"], 1)}
            for one in with_needs([run])
            if one in missing
        ],
        "objectives": result["objectives"],
        "divergence": deviation(run, result),
    }
    achieved = " ".join(f"{name} {value:.2f}" for name, value in found["objectives"].items())
    print(f"{found['ratio']}: {seconds:.0f} s, divergence {found['divergence']:.4f}, {achieved}", flush=True)
    return found


def _record(store: Store, run: Run) -> dict[str, Any]:
    record = store.record(run)
    assert record is not None
    return record


def _fail(outcome: Outcome) -> None:
    raise SystemExit(f"{outcome.run.key} failed: {(outcome.error or '').splitlines()[-1]}")


if __name__ == "__main__":
    main()
