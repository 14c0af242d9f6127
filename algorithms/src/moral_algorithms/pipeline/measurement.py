"""The last stage: what a policy achieves, beside what can be achieved."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.evaluation import Policy, play_episodes
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.pipeline.stage import name_values, require_positive
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError
from moral_algorithms.worlds import WorldSpec
from moral_envs import optimal

# The time of the exact optimum doubles with every person.
_MOST_PEOPLE_FOR_OPTIMUM = 8


class Evaluation(NamedTuple):
    """What a policy achieves, beside what can be achieved."""

    objectives: dict[str, float]
    """Mean counters at the end of an episode."""
    standard_errors: dict[str, float | None]
    """Standard errors of these means; None after a single episode, which has no spread."""
    optimum: dict[str, float] | None
    """Exact lexicographic optimum (people saved, then goal time) on the same starts, where it is known."""
    starts: NDArray[np.uint8]
    """The starts, shape (n, C, H, W)."""


def evaluate(
    policy: Policy, world: WorldSpec, episodes: int, seed: int, deterministic: bool = False
) -> Evaluation:
    """Measure a policy on seeded starts.

    Parameters
    ----------
    policy
        Chooses the actions.
    world
        Where it acts; in Emergency with up to 8 people who do not walk, the exact optimum is computed.
    episodes
        How many starts.
    seed
        Entropy of starts and actions; the same seed gives the same starts to every policy.
    deterministic
        Take the likeliest action instead of sampling.

    Raises
    ------
    ValueError
        If ``episodes`` is below 1, or ``seed`` is negative.
    """
    require_positive("episodes", episodes)
    starts_seed, actions_seed = spawn_seeds(seed, 2)
    built = world.build()
    with sampling_seed(actions_seed):
        played = play_episodes(policy, built, episodes, starts_seed, deterministic)
    starts = played.states[:, 0].copy()
    optimum = None
    known = world.name == "emergency" and not built.objects[0].walks
    if known and built.num_objects <= _MOST_PEOPLE_FOR_OPTIMUM:
        best = optimal.lexicographic_optimum(starts, built.horizon).mean(axis=0)
        optimum = name_values(built.objective_names, best)
    means = name_values(built.objective_names, played.objectives.mean(axis=0))
    standard_errors: dict[str, float | None] = dict.fromkeys(built.objective_names)
    if episodes > 1:
        deviations = played.objectives.std(axis=0, ddof=1)
        standard_errors |= name_values(built.objective_names, deviations / np.sqrt(episodes))
    return Evaluation(means, standard_errors, optimum, starts)


def find_policy(run: Path) -> Path:
    """Find the policy file of a run directory; of a demo's, that of its aligned agent.

    Raises
    ------
    StorageError
        If there is none.
    """
    for path in (run / "policy.safetensors", run / "moral" / "policy.safetensors"):
        if path.exists():
            return path
    if (run / "covering.safetensors").exists():
        raise StorageError(f"{run} has a policy for all weights; moral align --covered {run} makes one of it")
    if (run / "config.json").exists():
        raise StorageError(f"the run in {run} is not finished: it has no policy yet")
    raise StorageError(f"{run} is no run directory: it has no policy.safetensors")
