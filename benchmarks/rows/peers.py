"""Peers: `imitation`'s AIRL and preference comparisons on Emergency, beside this package's AIRL and DRLHP.

The peer's figures are those of ``benchmarks/strangers``, from the wheel in a virtual environment of its own;
they do not depend on the profile. Both learn from demonstrations of the same kind of expert, or from as many
answers of the same teacher, and see the same crop around the agent.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run
from benchmarks.harness.statistics import spread
from benchmarks.rows.drawing import BLUE, ORANGE, panels
from benchmarks.stages import FromPreferences, LearnedNorm
from benchmarks.stages.settings import EMERGENCY, SAVE_FIRST, drlhp, episodes, saving, seeds
from benchmarks.strangers.record import results_file

_SIZES = (50, 500)
_QUERIES = 1000
_POINTS = 100


class Learner(NamedTuple):
    """What one learner reached with several seeds."""

    people_saved: list[float]
    """Of the final policies, in the mean of many starts."""
    goal_time: list[float]
    """The same."""
    env_steps: list[int]
    """Of training."""
    seconds: list[float]
    """Of training, on one core."""
    curves: list[dict[str, list[float]]]
    """During training: ``env_steps``, ``seconds``, ``people_saved`` and ``goal_time``."""


def runs(profile: Profile) -> list[Run]:
    """List this package's side: AIRL from 50 and 500 demonstrations, and DRLHP."""
    config = drlhp(profile, EMERGENCY, _QUERIES)
    return [
        *(saving(profile, seed, size) for size, seed in product(_SIZES, seeds(profile))),
        *(
            FromPreferences(EMERGENCY, SAVE_FIRST, seed, config, episodes=episodes(profile))
            for seed in seeds(profile)
        ),
    ]


def ours(results: Results) -> dict[str, Learner]:
    """Sort this package's runs by what they learned from."""
    found: dict[str, list[dict[str, Any]]] = {}
    # The smoke test has fewer demonstrations, and one size of them.
    for norm, result in results.of(LearnedNorm):
        found.setdefault(_airl(norm.demonstrations), []).append(result)
    for _, result in results.of(FromPreferences):
        found.setdefault(_PREFERENCES, []).append(result)
    return {name: _learner([_flatten(one) for one in group]) for name, group in found.items()}


def theirs() -> dict[str, Learner]:
    """Read the peer's results files, as far as they are there."""
    found: dict[str, list[dict[str, Any]]] = {}
    for run in _stored("imitation_airl"):
        for size in run["sizes"]:
            found.setdefault(_airl(size["demonstrations"]), []).append(size)
    for run in _stored("imitation_preferences"):
        found.setdefault(_PREFERENCES, []).append(run)
    return {name: _learner([_rename(one) for one in group]) for name, group in found.items()}


_PREFERENCES = f"{_QUERIES} preferences"


def _airl(size: int) -> str:
    return f"AIRL, {size} demonstrations"


def _stored(stranger: str) -> list[dict[str, Any]]:
    path = results_file(stranger)
    listed: list[dict[str, Any]] = json.loads(path.read_text())["runs"] if path.exists() else []
    return listed


def _flatten(result: dict[str, Any]) -> dict[str, Any]:
    """Bring a result of ours into the common form; a curve's steps took equally long."""
    curve = dict(result["curve"])
    rate = result["seconds"] / result["env_steps"]
    curve["seconds"] = [rate * steps for steps in curve["env_steps"]]
    return {**result, **result["objectives"], "curve": curve}


def _rename(result: dict[str, Any]) -> dict[str, Any]:
    """Bring a result of the peer's into the common form: processor seconds, nearest to an idle machine's."""
    curve = {**result["curve"], "seconds": result["curve"]["processor_seconds"]}
    return {**result, "seconds": result["processor_seconds"], "curve": curve}


def _learner(group: Sequence[dict[str, Any]]) -> Learner:
    names = ("people_saved", "goal_time", "env_steps", "seconds", "curve")
    return Learner(*([one[name] for one in group] for name in names))


def judge(results: Results) -> list[Check]:
    """Compare final policies and the time they took, wherever both sides have some."""
    here, there = ours(results), theirs()
    if not there:
        return []
    checks = [
        Check(f"{name}: imitation's side is measured", "no results; see benchmarks/strangers", False, "ours")
        for name in here.keys() - there.keys()
    ]
    for name in here.keys() & there.keys():
        mine, peer = here[name], there[name]
        checks += [
            Check(
                f"{name}: saves at least as many people as imitation's, in the mean",
                f"{spread(mine.people_saved)}; imitation {spread(peer.people_saved)}",
                bool(np.mean(mine.people_saved) >= np.mean(peer.people_saved)),
                "ours",
            ),
            Check(
                f"{name}: takes no more seconds of one core than imitation's, in the mean",
                f"{_cost(mine)}; imitation {_cost(peer)}",
                bool(np.mean(mine.seconds) <= np.mean(peer.seconds)),
                "ours",
            ),
        ]
        if name == _PREFERENCES:
            checks.append(
                Check(
                    f"{name}: spends at least as much goal time as imitation's, in the mean",
                    f"{spread(mine.goal_time)}; imitation {spread(peer.goal_time)}",
                    bool(np.mean(mine.goal_time) >= np.mean(peer.goal_time)),
                    "ours",
                )
            )
    return sorted(checks)


def _cost(learner: Learner) -> str:
    return f"{np.mean(learner.seconds):.0f} s for {np.mean(learner.env_steps) / 1e6:.2f} million steps"


def draw(results: Results) -> Figure:
    """Draw people saved and goal time over environment steps and over seconds, all learners of both sides."""
    figure, axes = panels(2, rows=3, width=5.2, height=3.2)
    here, there = ours(results), theirs()
    for row, (which, objective) in enumerate(
        (("AIRL", "people_saved"), (_PREFERENCES, "people_saved"), (_PREFERENCES, "goal_time"))
    ):
        for column, unit in enumerate(("env_steps", "seconds")):
            panel = axes[2 * row + column]
            for learners, side, colour in ((here, "ours", BLUE), (there, "imitation", ORANGE)):
                shown = sorted(name for name in learners if which in name)
                for name, style in zip(shown, ("-", "--"), strict=False):
                    _draw_curve(panel, learners[name], unit, objective, f"{side}: {name}", colour, style)
            top = 6.2 if objective == "people_saved" else 75.0
            panel.set(ylabel=objective.replace("_", " "), ylim=(0, top))
            panel.set(xlabel="million environment steps" if column == 0 else "seconds of one core")
            panel.set_xlim(left=0)
            # There is nothing to explain where neither side has results; matplotlib warns of an empty legend.
            if column == 0 and panel.lines:
                panel.legend(frameon=False, fontsize=8)
    return figure


def _draw_curve(
    axes: Axes, learner: Learner, unit: str, objective: str, label: str, colour: str, style: str
) -> None:
    """Draw the mean over seeds, and the range of them as a band."""
    curves = [curve for curve in learner.curves if curve.get(unit)]
    if not curves:
        return
    grid = np.linspace(max(one[unit][0] for one in curves), min(one[unit][-1] for one in curves), _POINTS)
    values = np.array([np.interp(grid, one[unit], one[objective]) for one in curves])
    x = grid / 1e6 if unit == "env_steps" else grid
    axes.plot(x, values.mean(axis=0), color=colour, linestyle=style, linewidth=1.6, label=label)
    axes.fill_between(x, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.15, linewidth=0)


BENCHMARK = Benchmark(
    id="PEERS",
    title="AIRL and learning from preferences: imitation's and ours, on one machine",
    source="none; table 4.1's task",
    claim="The thesis compares with no other implementation.",
    bar="At least as many people saved, and as much goal time, in no more seconds.",
    runs=runs,
    judge=judge,
    draw=draw,
)
