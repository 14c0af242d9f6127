"""The posterior after 25 queries in three dimensions: seconds per update, distance to a dense-grid integral.

    python -m benchmarks.posterior_accuracy

A simulated teacher with known weights answers random pairs; every answer is one update. The mean weights are
then compared with an integral over a dense grid, which shares nothing with the sampler but the model itself.
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
from moral_algorithms.preferences import BradleyTerry, Posterior, Preference, RationalityPrior
from moral_algorithms.storage import write_json

RESULTS = Path(__file__).parent / "results" / "posterior_accuracy.json"
QUERIES = 25
MEAN_RATIONALITY = 40.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure for every seed and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(10)))
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    runs = [measure(seed) for seed in options.seeds]
    results = {
        "command": "python -m benchmarks.posterior_accuracy",
        "queries": QUERIES,
        **provenance(started),
        "slowest_update_seconds": max(run["slowest_update_seconds"] for run in runs),
        "largest_error": max(run["error"] for run in runs),
        "runs": runs,
    }
    print(f"{QUERIES} queries, 3 components, {len(runs)} seeds")
    print(f"slowest update: {1e3 * results['slowest_update_seconds']:.1f} ms")
    print(f"largest distance of a mean weight to the grid's: {results['largest_error']:.4f}")
    write_json(options.json, results)


def measure(seed: int) -> dict[str, Any]:
    """Answer the queries of one seed; returns the slowest update and the largest error of a mean weight."""
    rng = np.random.default_rng(seed)
    true_weights = rng.dirichlet(np.ones(3))
    posterior = Posterior(RationalityPrior(3, MEAN_RATIONALITY), BradleyTerry(), rng=rng)
    returns = rng.normal(scale=0.3, size=(QUERIES, 2, 3))
    signs, slowest = [], 0.0
    for pair in returns:
        first = rng.random() < 1 / (1 + np.exp(-20 * (pair[0] - pair[1]) @ true_weights))
        start = time.perf_counter()
        posterior.add(pair, Preference.FIRST if first else Preference.SECOND)
        slowest = max(slowest, time.perf_counter() - start)
        signs.append(1.0 if first else -1.0)
    differences = (returns[:, 0] - returns[:, 1]) * np.array(signs)[:, None]
    error = float(np.abs(posterior.weights() - grid_mean(differences)).max())
    return {"seed": seed, "slowest_update_seconds": slowest, "error": error}


def grid_mean(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean weights by brute force, for answers that all preferred the first of ``differences`` (q, 3)."""
    cells = 80
    first, second = (index.ravel() for index in np.meshgrid(np.arange(cells), np.arange(cells)))
    third = cells - 1 - first - second
    # A third, so that the triangular lattice lies symmetrically in the simplex.
    weights = (np.stack([first, second, third], axis=1)[third >= 0] + 1 / 3) / cells
    rationality = np.arange(0.5, 300) * 1.0
    # A priori the weights are uniform on the simplex and their scale is Gamma distributed with shape 3.
    log_mass = 2 * np.log(rationality) - 3 * rationality / MEAN_RATIONALITY
    scores = weights @ differences.T
    log_density = np.stack([-np.logaddexp(0, -scale * scores).sum(axis=1) for scale in rationality], axis=1)
    log_density += log_mass
    density = np.exp(log_density - log_density.max()).sum(axis=1)
    mean: NDArray[np.float64] = density @ weights / density.sum()
    return mean


if __name__ == "__main__":
    main()
