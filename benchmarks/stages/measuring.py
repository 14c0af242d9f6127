"""What the shared runs measure in the same way: final policies on one set of starts, and training curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from moral_algorithms.networks.files import load_policy
from moral_algorithms.pipeline import evaluate, spawn_seeds

EVALUATION_SEED = 10_000
"""Seed of the starts on which every final policy is measured; no training uses it."""

_POINTS = 60
"""Points of a curve, of which there is one per rollout otherwise."""

STAGES = ("expert", "demonstrations", "airl", "primary", "moral", "drlhp", "coverage")
"""Stages that draw random numbers, each from seeds of its own."""


def stage_seed(seed: int, stage: str) -> int:
    """Seed of one stage of the runs of a benchmark's seed."""
    return spawn_seeds(seed, len(STAGES))[STAGES.index(stage)]


def measure(policy: Path, episodes: int) -> dict[str, Any]:
    """Measure a stored policy on the starts that all are measured on.

    Returns
    -------
    dict
        Mean ``objectives``, their ``standard_errors`` and the exact ``optimum`` on the same starts, where it
        is known.
    """
    stored = load_policy(policy)
    found = evaluate(stored.policy, stored.world, episodes, EVALUATION_SEED)
    return {
        "objectives": found.objectives,
        "standard_errors": found.standard_errors,
        "optimum": found.optimum,
    }


def curve(lines: Sequence[dict[str, Any]], columns: Sequence[str] = ()) -> dict[str, list[float]]:
    """Thin out what a run wrote after its rollouts.

    Parameters
    ----------
    lines
        Of its ``metrics.jsonl``.
    columns
        What is kept beside ``env_steps`` and the mean objectives.

    Returns
    -------
    dict
        Values at up to 60 points by name, the objectives' among them.
    """
    # No episode has ended in the first rollouts.
    lines = [line for line in lines if line["objectives"]]
    rows = np.unique(np.linspace(0, len(lines) - 1, min(_POINTS, len(lines))).round().astype(int))
    kept = [lines[row] for row in rows]
    points = {name: [round(line[name], 4) for line in kept] for name in ("env_steps", *columns)}
    names = kept[0]["objectives"] if kept else ()
    return points | {name: [round(line["objectives"][name], 3) for line in kept] for name in names}
