"""Row E1: the exact model against the environment, and the checks on made-up results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.harness import Results, Workspace
from benchmarks.rows import e1
from moral_algorithms.learners.monte_carlo import MonteCarloConfig
from moral_envs import windy_wall_v0

WORKSPACE = Workspace(Path(), lambda run: Path(), lambda run: {})
RANDOM, OPTIMUM = e1.yardsticks()


def result(early: float, late: float, greedy: float) -> dict[str, Any]:
    return {"returns": [early] * 20 + [late] * 80, "greedy_return": greedy}


def results(by_decay: dict[float, list[dict[str, Any]]]) -> Results:
    return Results(
        [
            (e1.WindyWall(MonteCarloConfig(decay=decay), seed), one)
            for decay, seeds in by_decay.items()
            for seed, one in enumerate(seeds)
        ]
    )


def test_without_wind_the_optimum_is_the_shortest_way() -> None:
    """Four down, nine right and four up: 17 steps, of which the last costs nothing."""
    model = e1.model_of(windy_wall_v0.world(wind=0.0))
    assert e1.values_of(model, np.eye(4)[[1] * 96] * 0.7 + 0.075).max() == 0
    best = e1.optimal_policy(model)
    assert e1.values_of(model, best * 0.999 + 0.00025)[model.start] == pytest.approx(-16, abs=0.1)


def test_the_model_moves_as_the_environment_does() -> None:
    """Every transition of random play has its probability in the model, within five standard errors."""
    model = e1.model_of(windy_wall_v0.world())
    counts = np.zeros_like(model.transitions)
    num_envs, rounds = 500, 400
    envs = windy_wall_v0.vector_env(num_envs)
    observations, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    ended = np.zeros(num_envs, dtype=bool)
    for _ in range(rounds):
        cells = observations[:, e1.AGENT].reshape(num_envs, -1).argmax(axis=1)
        actions = rng.integers(4, size=num_envs)
        observations, rewards, terminations, truncations, _ = envs.step(actions)
        after = observations[:, e1.AGENT].reshape(num_envs, -1).argmax(axis=1)
        # A step after an episode's end only resets.
        np.add.at(counts, (cells[~ended], actions[~ended], after[~ended]), 1)
        np.testing.assert_array_equal(rewards[~ended, 0], np.where(terminations, 0.0, -1.0)[~ended])
        ended = terminations | truncations
    tries = counts.sum(axis=2)
    seen = tries[model.inner] > 100
    expected = model.transitions[model.inner][seen]
    shares = counts[model.inner][seen] / tries[model.inner][seen][:, None]
    errors = np.sqrt(expected * (1 - expected) / tries[model.inner][seen][:, None])
    assert seen.mean() > 0.9
    assert (abs(shares - expected) <= 5 * errors).all()


def test_the_optimum_lies_where_the_wind_lets_it() -> None:
    assert RANDOM < 10 * OPTIMUM
    # A quarter of the 17 steps blows elsewhere, some of it in the right direction.
    assert -17 / (1 - 0.75 * 0.25) * 1.3 < OPTIMUM < -16


def test_the_value_of_the_optimum_is_what_its_episodes_return() -> None:
    model = e1.model_of(windy_wall_v0.world())
    best = e1.optimal_policy(model).argmax(axis=1)
    env = windy_wall_v0.single_env()
    returns = []
    for seed in range(300):
        observation, _ = env.reset(seed=seed)
        returns.append(0.0)
        ended = False
        while not ended:
            observation, reward, ended, _, _ = env.step(int(best[observation[e1.AGENT].argmax()]))
            returns[-1] += float(reward[0])
    error = np.std(returns, ddof=1) / np.sqrt(len(returns))
    assert np.mean(returns) == pytest.approx(OPTIMUM, abs=4 * error)


def test_a_small_run_learns() -> None:
    run = e1.WindyWall(MonteCarloConfig(episodes=60, decay=0.05), seed=100)
    found = run.execute(WORKSPACE)
    assert len(found["returns"]) == 12
    assert found["returns"][0] < 2 * found["returns"][-1]
    assert RANDOM < found["greedy_return"] <= OPTIMUM + 1e-9
    assert found["env_steps"] == pytest.approx(-5 * sum(found["returns"]), rel=0.01, abs=60)


@pytest.mark.parametrize("profile", ["smoke", "laptop", "paper"])
def test_the_recommended_decay_is_among_the_runs(profile: Any) -> None:
    listed = [run for run in e1.runs(profile) if isinstance(run, e1.WindyWall)]
    assert e1.REFERENCE in {run.control.decay for run in listed}
    assert len({run.key for run in listed}) == len(listed)
    assert all(e1.LATE.stop <= run.control.episodes for run in listed)


def test_all_checks_are_met_by_the_thesis_s_ordering() -> None:
    good, slow, fast = result(-200, -25, -23), result(-400, -150, -30), result(-90, -40, -60)
    lucky = result(-90, -25, -22)
    found = results({0.001: [slow] * 8, 0.01: [good] * 8, 0.1: [fast] * 5 + [lucky] * 3})
    checks = e1.judge(found)
    assert [check.met for check in checks] == [True] * 5
    assert e1.draw(found).axes


def test_each_check_can_fail() -> None:
    poor = result(-90, -300, -100)
    checks = e1.judge(results({0.001: [poor] * 4, 0.01: [poor] * 4, 0.1: [poor] * 4}))
    assert [check.met for check in checks] == [False] * 5


def test_no_verdict_without_the_recommended_decay() -> None:
    assert e1.judge(results({0.1: [result(-1, -1, -1)]})) == []
