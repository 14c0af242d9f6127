"""How all figures look, and marks that several of them share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.harness.statistics import mean_with_interval

# Okabe and Ito's colours, which colour-blind readers can tell apart.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, INK = (
    *("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9"),
    "#26303c",
)
CYCLE = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY)

THESIS_MARK: dict[str, Any] = {"color": INK, "marker": "s", "markersize": 7, "linestyle": "none", "zorder": 5}
"""How the thesis's own figures are marked."""


def panels(columns: int, rows: int = 1, width: float = 4.6, height: float = 3.6) -> tuple[Figure, list[Axes]]:
    """Make a figure of equal panels, and list them row by row."""
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    axes = [figure.add_subplot(rows, columns, place + 1) for place in range(columns * rows)]
    for one in axes:
        one.spines[["top", "right"]].set_visible(False)
        one.grid(axis="y", color="0.92", linewidth=0.8)
        one.set_axisbelow(True)
    return figure, axes


def over_seeds(
    axes: Axes, x: Sequence[float], groups: Sequence[Sequence[float]], colour: str, label: str
) -> None:
    """Draw means over seeds with standard deviations, and every seed as a small dot."""
    means = [float(np.mean(group)) for group in groups]
    deviations = [float(np.std(group, ddof=1)) if len(group) > 1 else 0.0 for group in groups]
    style: dict[str, Any] = {"marker": "o", "markersize": 5, "capsize": 3, "linewidth": 1.4}
    axes.errorbar(x, means, deviations, color=colour, label=label, zorder=3, **style)
    for place, group in zip(x, groups, strict=True):
        axes.plot([place] * len(group), group, ".", color=colour, alpha=0.45, markersize=4, zorder=2)


def mean_intervals(
    axes: Axes, x: Sequence[float], groups: Sequence[Sequence[Sequence[float]]], colour: str, label: str
) -> None:
    """Draw means of groups, whose values are sorted by seed, with their 95 % intervals over seeds."""
    found = np.array([mean_with_interval(by_seed) for by_seed in groups]).reshape(-1, 3)
    means = found[:, 0]
    errors = np.abs(found[:, 1:].T - means)
    axes.errorbar(x, means, errors, marker="o", capsize=3, color=colour, label=label)


def curves(
    axes: Axes,
    runs: Sequence[Mapping[str, Sequence[float]]],
    name: str,
    colour: str,
    label: str,
    offset: float = 0,
) -> None:
    """Draw training curves of several seeds: their mean as a line, one standard deviation as a band.

    Parameters
    ----------
    axes
        Where.
    runs
        Curves with ``env_steps`` and values by name.
    name
        Which values.
    colour, label
        Of the line.
    offset
        Environment steps spent before the curves begin.
    """
    ends = [run["env_steps"][-1] for run in runs if run["env_steps"]]
    if not ends:
        return
    grid = np.linspace(max(run["env_steps"][0] for run in runs if run["env_steps"]), min(ends), 100)
    values = np.array([np.interp(grid, run["env_steps"], run[name]) for run in runs if run["env_steps"]])
    mean, deviation = values.mean(axis=0), values.std(axis=0)
    x = (grid + offset) / 1e6
    axes.plot(x, mean, color=colour, label=label, linewidth=1.6)
    axes.fill_between(x, mean - deviation, mean + deviation, color=colour, alpha=0.18, linewidth=0)
    axes.set_xlabel("million environment steps")


def coloured_points(
    figure: Figure,
    axes: Axes,
    points: NDArray[np.float64],
    colours: NDArray[np.float64],
    label: str,
) -> None:
    """Scatter points (n, 2) with a colour bar."""
    dots = axes.scatter(
        points[:, 0],
        points[:, 1],
        c=colours,
        s=42,
        cmap="viridis",
        edgecolors="white",
        linewidths=0.6,
        zorder=3,
    )
    figure.colorbar(dots, ax=axes, label=label, pad=0.01)
