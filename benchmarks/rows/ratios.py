"""Agents in Delivery whose teacher wants the objectives in a given ratio."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.harness import Profile, Results
from benchmarks.stages import Asked
from benchmarks.stages.settings import asking, covered, episodes
from moral_algorithms.indicators import preference_deviation
from moral_algorithms.pipeline import TeacherConfig

COLLECTED = ("delivered", "helped", "cleaned")
"""Objectives that three-dimensional ratios are about."""

ALL_RATIOS = tuple(product((1, 2, 3), repeat=3))
"""The 27 ratios of section 5.2.2, of (delivered, helped, cleaned)."""


def three_rewards(profile: Profile, ratio: Sequence[int], seed: int, queries: int = 25) -> Asked:
    """MORAL on (deliver, f_help, f_clean), asked by a teacher who wants a ratio of what is collected."""
    teacher = _teacher(dict(zip(COLLECTED, ratio, strict=True)))
    return Asked(covered(profile, seed), teacher, seed, asking(profile, queries), episodes(profile))


def two_rewards(profile: Profile, ratio: Sequence[int], seed: int, queries: int = 25) -> Asked:
    """MORAL on (f_help, f_clean), asked by a teacher who wants a ratio of help and cleaning."""
    teacher = _teacher(dict(zip(COLLECTED[1:], ratio, strict=True)))
    policy = covered(profile, seed, with_primary=False)
    return Asked(policy, teacher, seed, asking(profile, queries), episodes(profile))


def _teacher(ratio: Mapping[str, int]) -> TeacherConfig:
    return TeacherConfig(teacher="ratio", ratio={name: float(share) for name, share in ratio.items()})


def deviation(run: Asked, result: Mapping[str, Any]) -> float:
    """Divergence of what an agent collects on average from its teacher's ratio (eq. 5.12)."""
    achieved = [result["objectives"][name] for name in run.teacher.ratio]
    return float(preference_deviation([achieved], list(run.teacher.ratio.values()))[0])


def deviations_by_seed(found: Sequence[tuple[Asked, Mapping[str, Any]]]) -> list[list[float]]:
    """Sort the :func:`deviation` of agents by seed: those of one share a policy for all weights."""
    seeds = sorted({run.seed for run, _ in found})
    return [[deviation(run, result) for run, result in found if run.seed == seed] for seed in seeds]


def collected(results: Results) -> tuple[list[Asked], NDArray[np.float64]]:
    """List the agents, and what they deliver, help, clean and break on average, shape (n, 4)."""
    found = results.of(Asked)
    names = (*COLLECTED, "vases_broken")
    rows = [[result["objectives"][name] for name in names] for _, result in found]
    return [run for run, _ in found], np.array(rows).reshape(-1, 4)


def projections(
    figure: Figure,
    axes: Sequence[Axes],
    points: NDArray[np.float64],
    colours: NDArray[np.float64] | None,
    label: str,
    radii: NDArray[np.float64] | None = None,
) -> None:
    """Draw the three projections of what agents (n, 3) collect.

    Parameters
    ----------
    figure, axes
        Where.
    points
        Deliveries, help and cleaning of each agent.
    colours
        Of the agents; None colours each projection by the objective that it leaves out.
    label
        Of the colour bar.
    radii
        Of grey circles around the agents.
    """
    for one, (x, y, left_out) in zip(axes, ((0, 1, 2), (0, 2, 1), (1, 2, 0)), strict=True):
        if radii is not None:
            one.scatter(points[:, x], points[:, y], s=40 + 900 * radii, color="0.85", zorder=1)
        dots = one.scatter(
            points[:, x],
            points[:, y],
            c=points[:, left_out] if colours is None else colours,
            s=26,
            cmap="viridis",
            edgecolors="white",
            linewidths=0.5,
            zorder=3,
        )
        figure.colorbar(dots, ax=one, label=COLLECTED[left_out] if colours is None else label, pad=0.01)
        one.set(xlabel=COLLECTED[x], ylabel=COLLECTED[y])
