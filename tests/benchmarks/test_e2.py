"""Row E2: choices by hand, simulation against closed form, and the checks on made-up results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.harness import Results, Workspace
from benchmarks.rows import e2
from moral_envs.noisy_constraint_v0 import success_probability

WORKSPACE = Workspace(Path(), lambda run: Path(), lambda run: {})


def made_up(shares: dict[float, Any], decisions: int = 20_000) -> Results:
    return Results(
        [
            (
                e2.ThresholdChoices(noise, seed, decisions),
                {"successes": [round(share * decisions) for share in of_noise]},
            )
            for noise, of_noise in shares.items()
            for seed in range(2)
        ]
    )


def test_choices_by_hand() -> None:
    safe = np.array([[0.5, 0.1], [0.5, 0.1], [0.5, 0.9], [0.5, 0.9]])
    unsafe = np.array([[1.0, 0.2], [1.0, 0.8], [1.0, 0.2], [1.0, 0.8]])
    # S2 within the threshold pays more; S1 is chosen only where it alone is; the last finds nothing.
    assert e2.wanted_choices(safe, unsafe, 0.5).tolist() == [False, True, False, False]
    assert e2.wanted_choices(safe, unsafe, 0.8).tolist() == [False, False, False, False]


@given(
    costs=st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=20),
    threshold=st.floats(-3, 3),
)
def test_choices_are_those_of_equation_3_5(costs: list[tuple[float, float]], threshold: float) -> None:
    z, y = np.array(costs).T
    safe, unsafe = (np.stack([np.full(len(z), pay), cost], axis=1) for pay, cost in ((0.5, z), (1.0, y)))
    np.testing.assert_array_equal(
        e2.wanted_choices(safe, unsafe, threshold), (y > threshold) & (z <= threshold)
    )


def test_costs_are_seen_as_often_as_asked_for() -> None:
    for decisions in (1, 999, 1001):
        assert e2.observed(e2.UNSAFE, 0.5, decisions, seed=0).shape == (decisions, 2)
    exact = e2.observed(e2.UNSAFE, 0.0, 3, seed=0)
    np.testing.assert_array_equal(exact, [[1.0, 1.0]] * 3)


def test_a_small_run_agrees_with_the_closed_form() -> None:
    run = e2.ThresholdChoices(noise=0.5, seed=100, decisions=4_000)
    shares = np.array(run.execute(WORKSPACE)["successes"]) / run.decisions
    expected = e2.closed_form(0.5)
    assert (abs(shares - expected) <= 5 * np.sqrt(expected * (1 - expected) / run.decisions) + 1e-9).all()


@given(threshold=st.floats(-1, 2), noise=st.floats(0.05, 5))
def test_the_closed_form_is_symmetric_around_its_peak(threshold: float, noise: float) -> None:
    chance = success_probability(threshold, noise)
    assert chance == pytest.approx(success_probability(1 - threshold, noise), abs=1e-9)
    assert chance <= success_probability(e2.PEAK, noise) + 1e-12


def test_runs_differ_and_share_no_noise() -> None:
    listed = e2.runs("laptop")
    assert len({run.key for run in listed}) == len(listed) == 3 * len(e2.NOISES)
    first, second = (e2.ThresholdChoices(1.0, seed, 100).execute(WORKSPACE) for seed in (0, 1))
    assert first != second


def test_all_checks_are_met_by_the_closed_form_itself() -> None:
    found = made_up({noise: e2.closed_form(noise) for noise in e2.NOISES})
    assert [check.met for check in e2.judge(found)] == [True] * 4
    assert e2.draw(found).axes
    assert e2.judge(Results([])) == []


def test_checks_fail_on_another_simulation() -> None:
    """Simulated shares of half the noise, the greatest in the wrong place: all but the closed form's own."""
    shifted = {noise: np.roll(e2.closed_form(0.5), 5) for noise in e2.NOISES}
    assert [check.met for check in e2.judge(made_up(shifted))] == [True, False, False, False]
