"""The picture of a demo: the way of the agent, beside what others reached and what can be reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from moral_algorithms.storage import atomic_write
from moral_envs.optimal import coverage_set

THESIS = {
    "MORAL": {"goal_time": 40.08, "people_saved": 5.76},
    "DRLHP": {"goal_time": 12.32, "people_saved": 5.62},
}
"""What the thesis reports for Emergency (table 4.1)."""

_AGENT, _OTHERS, _BEYOND = "#d02828", "#26303c", "#eceae4"


def plot_front(
    path: Path,
    starts: NDArray[np.uint8],
    horizon: int,
    metrics: Sequence[Mapping[str, Any]],
    agent: Mapping[str, float],
    optimum: Mapping[str, float],
) -> None:
    """Draw goal time against people saved as a PNG.

    Parameters
    ----------
    path
        The file.
    starts
        Emergency's starts that the coverage set is averaged over, shape (n, 4, H, W).
    horizon
        Steps of an episode.
    metrics
        The lines of a run's ``metrics.jsonl``.
    agent, optimum
        Mean goal_time and people_saved of the trained agent and of the exact lexicographic optimum.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    figure = Figure(figsize=(9, 5.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    vertices = coverage_set(starts, horizon).points
    right, top = vertices[:, 0].max() + 4, vertices[:, 1].max() + 0.5
    _draw_coverage_set(axes, vertices, right, top)
    _draw_training(figure, axes, metrics)
    for name, objectives in THESIS.items():
        place = _place(objectives)
        axes.plot(*place, "s", color=_OTHERS, markersize=7, zorder=5)
        _label(axes, f"{name} in the thesis\n{place[0]:.1f}, {place[1]:.2f}", place, (0, -12), _OTHERS)
    best, reached = _place(optimum), _place(agent)
    axes.plot(*best, "P", color=_OTHERS, markersize=10, zorder=5)
    _label(axes, f"optimum: {best[0]:.1f}, {best[1]:.2f}", best, (8, 10), _OTHERS)
    axes.plot(*reached, "*", color=_AGENT, markeredgecolor="white", markersize=18, zorder=6)
    beside = (0, -58) if reached[1] > top / 2 else (0, 40)
    _label(axes, f"MORAL, this run\n{reached[0]:.1f}, {reached[1]:.2f}", reached, beside, _AGENT)
    axes.set(xlim=(-1, right), ylim=(-0.1, top), xlabel="goal time (steps per episode)")
    axes.set_ylabel("people saved (per episode)")
    axes.set_title("Emergency: people saved against time at the extinguisher", loc="left")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")


def _draw_coverage_set(axes: Axes, vertices: NDArray[np.float64], right: float, top: float) -> None:
    # To its left less goal time can be had with as many people.
    x, y = np.concatenate([[[0.0, vertices[-1, 1]]], vertices[::-1]]).T
    outline = ([-1, *x, x[-1], right, right, -1], [y[0], *y, -1, -1, top, top])
    axes.fill(*outline, color=_BEYOND, zorder=0, label="out of reach")
    axes.plot(
        *vertices.T, "-o", color=_OTHERS, markersize=3, linewidth=1.2, zorder=3, label="exact coverage set"
    )


def _draw_training(figure: Figure, axes: Axes, metrics: Sequence[Mapping[str, Any]]) -> None:
    lines = [line for line in metrics if line["objectives"]]
    if not lines:
        return
    x, y = np.array([_place(line["objectives"]) for line in lines]).T
    steps = np.array([line["env_steps"] for line in lines])
    axes.plot(x, y, color="0.75", linewidth=0.8, zorder=1)
    dots = axes.scatter(
        x, y, c=steps / 1000, s=14, cmap="viridis", zorder=2, label="agent in training, mean of a rollout"
    )
    figure.colorbar(dots, ax=axes, label="thousand environment steps", pad=0.01)
    asked = np.flatnonzero(np.diff([line["queries"] for line in lines], prepend=0))
    if asked.size:
        axes.scatter(
            x[asked],
            y[asked],
            s=46,
            facecolors="none",
            edgecolors=_AGENT,
            linewidths=1.0,
            zorder=4,
            label="after a query",
        )


def _place(objectives: Mapping[str, float]) -> tuple[float, float]:
    return objectives["goal_time"], objectives["people_saved"]


def _label(axes: Axes, text: str, place: tuple[float, float], offset: tuple[int, int], colour: str) -> None:
    below = offset[1] < 0
    axes.annotate(
        text,
        place,
        offset,
        textcoords="offset points",
        color=colour,
        ha="center" if offset[0] == 0 else "left",
        va="top" if below else "bottom",
        fontsize=9,
        zorder=4.5,
        arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.8},
        bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
    )
