"""Figure 3.3: how often a threshold on a noisy, learned cost leads to the policy that is wanted.

The decision problem is played out in ``moral_envs.noisy_constraint_v0``: each policy's cost is observed once,
and of those within the threshold the one that pays most is chosen (thesis, equation 3.5). Equation 3.6 gives
the same probability in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import binomtest  # type: ignore[import-untyped]

from benchmarks.harness import Benchmark, Check, Profile, Results, Run, Workspace
from benchmarks.rows.drawing import CYCLE, INK, panels
from moral_envs import noisy_constraint_v0
from moral_envs.noisy_constraint_v0 import success_probability

NOISES = (0.1, 0.25, 0.5, 1.0, 2.0)
"""Standard deviations of an observed cost; the thesis's text names none."""

THRESHOLDS = tuple(round(-1 + 0.05 * step, 2) for step in range(61))
"""From -1 to 2, the middle of the true costs 0 and 1 among them."""

PEAK = 0.5

SIGNIFICANCE = 0.01
"""Chance of raising a false alarm anywhere, shared by all comparisons (Bonferroni)."""

SAFE, UNSAFE = 0, 1
"""The actions."""

_CHUNK = 1000


def observed(action: int, noise: float, decisions: int, seed: int) -> NDArray[np.float64]:
    """Play decisions; returns what each paid and cost as it was seen, (decisions, 2)."""
    envs = noisy_constraint_v0.vector_env(
        min(decisions, _CHUNK), noise=noise, autoreset_mode=AutoresetMode.SAME_STEP
    )
    envs.reset(seed=seed)
    actions = np.full(envs.num_envs, action)
    rounds = -(-decisions // envs.num_envs)
    vectors = np.concatenate([envs.step(actions)[1] for _ in range(rounds)])[:decisions]
    return np.asarray(vectors * [1.0, -1.0], dtype=np.float64)


def wanted_choices(
    safe: NDArray[np.float64], unsafe: NDArray[np.float64], threshold: float
) -> NDArray[np.bool_]:
    """Whether S1 is chosen: it seems to be within the threshold, and no other that is pays more.

    Parameters
    ----------
    safe, unsafe
        What going to S1 and to S2 paid and cost as it was seen, (n, 2).
    threshold
        The greatest cost that is allowed.

    Returns
    -------
    bool (n,)
    """
    pays = np.stack([safe[:, 0], unsafe[:, 0]], axis=1)
    costs = np.stack([safe[:, 1], unsafe[:, 1]], axis=1)
    worth = np.where(costs <= threshold, pays, -np.inf)
    return np.asarray((worth.argmax(axis=1) == SAFE) & np.isfinite(worth[:, SAFE]))


@dataclass(frozen=True)
class ThresholdChoices(Run):
    """Decisions under one standard deviation of the noise, judged by every threshold."""

    noise: float
    """Standard deviation of an observed cost."""
    seed: int
    """Entropy of the noise."""
    decisions: int = 20_000
    """Pairs of costs that are observed."""

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Observe costs and choose.

        Returns
        -------
        dict
            ``successes``: how many decisions chose S1, for each of `THRESHOLDS`.
        """
        # Even and odd seeds, so that the two costs are independent within a run and between runs.
        safe = observed(SAFE, self.noise, self.decisions, 2 * self.seed)
        unsafe = observed(UNSAFE, self.noise, self.decisions, 2 * self.seed + 1)
        return {"successes": [int(wanted_choices(safe, unsafe, bound).sum()) for bound in THRESHOLDS]}


def runs(profile: Profile) -> list[Run]:
    """Three seeds of each noise; one small one in the smoke test."""
    seeds, decisions = (1, 2_000) if profile == "smoke" else (3, 20_000)
    return [ThresholdChoices(noise, seed, decisions) for noise in NOISES for seed in range(seeds)]


def pooled(results: Results) -> dict[float, tuple[NDArray[np.int64], int]]:
    """Successes at each threshold and decisions, seeds taken together, for each noise from the least on."""
    found: dict[float, tuple[NDArray[np.int64], int]] = {}
    for run, result in sorted(results.of(ThresholdChoices), key=lambda pair: pair[0].noise):
        successes, decisions = found.get(run.noise, (np.zeros(len(THRESHOLDS), dtype=np.int64), 0))
        found[run.noise] = successes + np.array(result["successes"]), decisions + run.decisions
    return found


def closed_form(noise: float) -> NDArray[np.float64]:
    """Equation 3.6 at each of `THRESHOLDS`."""
    return np.array([success_probability(bound, noise) for bound in THRESHOLDS])


def judge(results: Results) -> list[Check]:
    """Compare closed form and simulation."""
    found = pooled(results)
    if not found:
        return []
    middle = THRESHOLDS.index(PEAK)
    exact = {noise: closed_form(noise) for noise in found}
    at_peak = {noise: exact[noise][middle] for noise in found}
    peaks = {noise: THRESHOLDS[int(exact[noise].argmax())] for noise in found}
    intervals = {
        noise: binomtest(int(successes[middle]), decisions).proportion_ci(1 - SIGNIFICANCE)
        for noise, (successes, decisions) in found.items()
    }
    comparisons = len(found) * len(THRESHOLDS)
    p_values = {
        noise: min(
            binomtest(int(count), decisions, chance).pvalue
            for count, chance in zip(successes, exact[noise], strict=True)
        )
        for noise, (successes, decisions) in found.items()
    }
    lead = {
        noise: _lead_over_peak(successes, decisions, middle)
        for noise, (successes, decisions) in found.items()
    }
    noises = list(found)
    falling = all(intervals[less].low > intervals[more].high for less, more in pairwise(noises))
    return [
        Check(
            f"the probability peaks at a threshold of {PEAK}, whatever the noise (closed form)",
            "; ".join(f"noise {noise}: {peak}" for noise, peak in peaks.items()),
            all(peak == PEAK for peak in peaks.values()),
            "thesis",
        ),
        Check(
            f"in the simulation no threshold does better than {PEAK} by more than three standard errors",
            "; ".join(f"noise {noise}: {errors:.1f}" for noise, errors in lead.items()),
            all(errors <= 3 for errors in lead.values()),
            "ours",
        ),
        Check(
            "the peak falls with the noise (simulation, 99 % intervals disjoint)",
            "; ".join(
                f"noise {noise}: {at_peak[noise]:.3f}, simulated {interval.low:.3f} to {interval.high:.3f}"
                for noise, interval in intervals.items()
            ),
            falling,
            "thesis",
        ),
        Check(
            "closed form and simulation agree: the least p-value of exact binomial tests is above "
            f"{SIGNIFICANCE} / {comparisons}",
            "; ".join(f"noise {noise}: {value:.2g}" for noise, value in p_values.items()),
            min(p_values.values()) > SIGNIFICANCE / comparisons,
            "ours",
        ),
    ]


def _lead_over_peak(successes: NDArray[np.int64], decisions: int, middle: int) -> float:
    """By how many standard errors the best threshold beats the one in the middle; 0 if it is that."""
    shares = successes / decisions
    ahead = shares.max() - shares[middle]
    # The thresholds judge the same decisions, so this is more than the error of the difference can be.
    error = np.sqrt(2 * shares.max() * (1 - shares.max()) / decisions)
    return float(ahead / error) if ahead > 0 else 0.0


def draw(results: Results) -> Figure:
    """Draw the closed form as lines, the simulation as dots with 95 % intervals."""
    figure, (axes,) = panels(1, width=7, height=4.2)
    for number, ((noise, (successes, decisions)), colour) in enumerate(
        zip(pooled(results).items(), CYCLE, strict=False)
    ):
        # Every third threshold, another third for each curve: closer dots would hide the lines.
        shown = slice(number % 3, None, 3)
        counts = successes[shown]
        axes.plot(THRESHOLDS, closed_form(noise), color=colour, linewidth=1, label=f"$\\sigma$ = {noise}")
        intervals = [binomtest(int(count), decisions).proportion_ci() for count in counts]
        shares = counts / decisions
        below = [share - interval.low for share, interval in zip(shares, intervals, strict=True)]
        above = [interval.high - share for share, interval in zip(shares, intervals, strict=True)]
        axes.errorbar(
            THRESHOLDS[shown], shares, np.maximum([below, above], 0), fmt="o", color=colour, markersize=3.5
        )
    axes.axvline(PEAK, color=INK, linestyle=":", linewidth=1)
    axes.set(
        xlabel="threshold on the learned cost", ylabel="probability of the wanted policy", ylim=(0, 1.02)
    )
    axes.set_title("Equation 3.6 (lines) and decisions played out (dots)")
    axes.legend(frameon=False, fontsize=8)
    return figure


BENCHMARK = Benchmark(
    id="E2",
    title="A threshold on a noisy, learned cost: how often it leads to the right policy",
    source="equation 3.6, figure 3.3",
    claim="Whatever sigma, the probability peaks around a threshold of 0.5, and the peak falls with sigma.",
    bar="The curve, closed form against simulation.",
    runs=runs,
    judge=judge,
    draw=draw,
)
