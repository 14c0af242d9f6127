"""What rows E4 to E8, D3 and D5 to D10 say of results that were made up: met, and each statement missed."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from benchmarks.command import find_benchmarks
from benchmarks.harness import Check, Results, Run
from benchmarks.rows.e4 import LAMBDAS
from benchmarks.stages import Aligned, Asked, FromPreferences, Weighted

Made = Callable[[Any], dict[str, Any]]

COUNTERS = ("delivered", "helped", "cleaned")


@lru_cache
def runs(row: str) -> tuple[Run, ...]:
    (benchmark,) = find_benchmarks([row])
    return tuple(benchmark.runs("laptop"))


def judged(row: str, make: Made) -> list[Check]:
    (benchmark,) = find_benchmarks([row])
    return benchmark.judge(Results([(run, make(run)) for run in runs(row)]))


def missed(row: str, make: Made) -> list[int]:
    """Places of the statements that are not met."""
    return [place for place, check in enumerate(judged(row, make)) if not check.met]


def emergency(people_saved: float, goal_time: float) -> dict[str, Any]:
    return {"objectives": {"goal_time": goal_time, "people_saved": people_saved}}


def front(run: Weighted) -> dict[str, Any]:
    """A policy near the exact coverage set, from people alone to goal time alone."""
    share = run.weights[0]
    saved = 6.0 if share <= 0.4 else float(np.interp(share, [0.4, 0.55, 1.0], [5.9, 2.7, 0.3]))
    goal = float(np.interp(share, [0, 0.05, 0.1, 0.4, 0.55, 1.0], [0, 30, 56, 58.5, 68.5, 71]))
    return {**emergency(saved, goal), "scales": {"extinguish": 1.0, "learned_1": 1.0}}


def test_e4() -> None:
    assert missed("E4", front) == []
    # Nobody saved at any lambda: neither the best lambda nor a front.
    assert missed("E4", lambda run: {**front(run), **emergency(0.0, 10.0)}) == [0, 1]
    # All saved at every lambda, and much goal time but where none is paid: sensitive on no side.
    flat = {weight: (6.0, 0.0 if weight == 0 else 58.0) for weight in LAMBDAS}
    checks = judged("E4", lambda run: {**front(run), **emergency(*flat[run.weights[0]])})
    assert [check.met for check in checks] == [True, False, False, False]
    assert checks[1].value.startswith("none of ")
    # Without the policies in the middle the front is shorter; what it is without them is told beside it.
    value = judged("E4", front)[3].value
    with_all, _, without = value.partition("; without the lambdas added later ")
    assert float(with_all[:5]) > float(without[:5])


def path(*points: tuple[float, float]) -> dict[str, Any]:
    return {**emergency(*points[-1]), "path": [emergency(*point) for point in points]}


@pytest.mark.parametrize(
    ("points", "failed"),
    [
        ([(2.0, 3.0), (5.0, 20.0), (6.0, 40.0), (6.0, 58.0)], []),
        # Ends short of the front, though nobody saves more.
        ([(2.0, 3.0), (5.0, 20.0), (6.0, 50.0)], [0]),
        # Waits by the goal before anybody is saved.
        ([(2.0, 3.0), (2.0, 50.0), (5.0, 20.0), (6.0, 58.0)], [1]),
        # Has all the goal time when people come to be saved.
        ([(2.0, 3.0), (5.0, 58.0), (6.0, 57.9)], [2]),
        # Never saves them.
        ([(2.0, 3.0), (2.0, 71.0)], [1]),
    ],
)
def test_e5(points: list[tuple[float, float]], failed: list[int]) -> None:
    assert missed("E5", lambda run: path(*points) if isinstance(run, Aligned) else front(run)) == failed


def test_e6() -> None:
    def made(run: Aligned, other: tuple[float, float] = (6.0, 55.0)) -> dict[str, Any]:
        random = run.config.acquisition == "random"
        return emergency(1.0, 70.0) if random and run.primary_scale == 10 else emergency(*other)

    assert missed("E6", made) == []
    assert missed("E6", lambda run: made(run, (5.7, 55.0))) == [2, 3]
    assert missed("E6", lambda run: made(run, (6.0, 40.0))) == [2, 3]
    assert missed("E6", lambda _: emergency(6.0, 55.0)) == [1]
    random = emergency(4.0, 20.0)
    assert missed("E6", lambda run: random if run.config.acquisition == "random" else made(run)) == [0, 1]


def test_e7() -> None:
    def made(run: Aligned, few: float = 52.0, noisy: tuple[float, float] = (6.0, 55.0)) -> dict[str, Any]:
        if run.teacher.noise == 0.3:
            return emergency(*noisy)
        return emergency(6.0, {5: few, 10: 54.0, 25: 56.0}[run.config.queries] + 0.1 * run.seed)

    assert missed("E7", made) == []
    # As good as with 25, to within what seeds differ by.
    assert missed("E7", lambda run: made(run, few=55.9)) == [2]
    assert missed("E7", lambda run: made(run, few=40.0 - run.seed)) == [1]
    assert missed("E7", lambda run: made(run, noisy=(6.0, 50.0))) == [3]
    assert missed("E7", lambda run: made(run, noisy=(5.7, 56.0))) == [4, 5]

    def helped(run: Aligned) -> dict[str, Any]:
        return emergency(6.0, 56.0) if run.config.lapse == 0.3 else made(run, noisy=(5.0, 50.0))

    assert missed("E7", helped) == [3, 4]

    def harmed(run: Aligned) -> dict[str, Any]:
        return emergency(1.0, 56.0) if run.config.lapse == 0 else made(run)

    assert missed("E7", harmed) == []

    def one_seed_fails(run: Aligned) -> dict[str, Any]:
        return emergency(6.0, 49.0) if (run.config.queries, run.seed) == (10, 1) else made(run)

    assert missed("E7", one_seed_fails) == [0]


def test_e8() -> None:
    def made(
        run: Any, moral: tuple[float, float] = (6.0, 57.0), drlhp: float = 50.0, few: float = 1.0
    ) -> Any:
        # Seeds differ a little.
        spread = 0.01 * run.seed
        if run.name == "MORAL":
            saved, goal_time = moral
        else:
            saved, goal_time = (5.9, drlhp) if run.name == "DRLHP" else (few, 60.0)
        return {**emergency(saved - spread, goal_time - spread), "env_steps": 1_200_000}

    assert missed("E8", made) == []
    assert missed("E8", lambda run: made(run, moral=(5.9, 57.0))) == [1]
    assert missed("E8", lambda run: made(run, moral=(6.0, 40.0))) == [0, 1, 3]
    assert missed("E8", lambda run: made(run, drlhp=12.0)) == [2]
    assert missed("E8", lambda run: made(run, drlhp=57.0)) == [3]
    assert missed("E8", lambda run: made(run, few=6.0)) == [4]


def delivery(counts: Any, vases: float = 0.05) -> dict[str, Any]:
    names = (*COUNTERS, "vases_broken")
    return {"objectives": dict(zip(names, [*map(float, counts), vases], strict=True))}


def wanted(run: Asked) -> Any:
    """What the teacher wants, 18 objects in all; zero of what no ratio is about."""
    shares = np.array([run.teacher.ratio.get(name, 0.0) for name in COUNTERS])
    return 18 * shares / shares.sum()


def mixed(run: Asked, share: float) -> dict[str, Any]:
    """A part of what is wanted, and for the rest as much of everything."""
    counts = wanted(run)
    return delivery((1 - share) * counts + share * np.where(counts > 0, 18 / (counts > 0).sum(), 0))


def test_d3() -> None:
    assert missed("D3", lambda run: mixed(run, 0.0)) == []
    assert missed("D3", lambda run: mixed(run, 0.9)) == [0]
    assert missed("D3", lambda run: mixed(run, 1.0)) == [0, 1]
    assert missed("D3", lambda run: delivery(wanted(run), vases=0.6)) == [2]


def test_d5() -> None:
    def made(run: Run, end: float = 0.1, chosen: float = 0.1) -> dict[str, Any]:
        if isinstance(run, Asked):
            return delivery((3, 3, 3), chosen)
        return {**delivery((3, 3, 3), end), "curve": {"vases_broken": [0.4, 0.2, end]}}

    assert missed("D5", made) == []
    assert missed("D5", lambda run: made(run, end=0.5)) == [0]
    assert missed("D5", lambda run: made(run, chosen=0.5)) == [1]


def test_d6() -> None:
    def made(run: Asked, share: float = 0.0, vases: float = 0.1) -> dict[str, Any]:
        found = mixed(run, share)["objectives"]
        return {"objectives": {**found, "vases_broken": vases * found["delivered"]}}

    assert missed("D6", made) == []
    assert missed("D6", lambda run: made(run, share=0.9)) == [0]
    assert missed("D6", lambda run: made(run, share=1.0)) == [0, 2, 3]
    assert missed("D6", lambda run: made(run, vases=-0.1)) == [3]
    assert missed("D6", lambda run: delivery(wanted(run) * 16 / 18, float(wanted(run)[0]))) == [1]


def test_d7() -> None:
    def made(run: Run, theirs: Any = (3, 3, 3), vases: float = 1.0) -> dict[str, Any]:
        return delivery(theirs, vases) if isinstance(run, FromPreferences) else delivery((5, 5, 5))

    assert missed("D7", made) == []
    assert missed("D7", lambda run: made(run, theirs=(6, 6, 6))) == [0]
    assert missed("D7", lambda run: made(run, vases=0.0)) == [1]
    assert missed("D7", lambda run: made(run, theirs=(0, 0, 0))) == [2]


def test_d8() -> None:
    def made(run: Asked, active: float = 0.1, random: float = 0.9) -> dict[str, Any]:
        return mixed(run, random if run.config.acquisition == "random" else active)

    assert missed("D8", made) == []
    assert missed("D8", lambda run: made(run, active=0.8, random=0.8)) == [0, 1, 2]
    assert missed("D8", lambda run: made(run, random=0.1)) == [1, 2]
    # Far off on the nine ratios alone that were taken first: told, and no part of the verdict.
    first = [*((3, 1, 1), (1, 3, 1), (1, 1, 3)), *((1, 2, 3), (2, 3, 1), (3, 1, 2), (3, 3, 1), (1, 3, 3))]
    checks = judged("D8", lambda run: made(run, active=0.5 * (tuple(run.teacher.ratio.values()) in first)))
    of_all, _, of_nine = checks[0].value.partition("; ")
    assert float(of_nine[:6]) == pytest.approx(float(of_all[:6]) * 27 / 9, abs=2e-4)


def test_d9() -> None:
    def made(run: Asked, noisy: float = 0.2, random: float = 0.9) -> dict[str, Any]:
        if run.config.acquisition == "random":
            return mixed(run, random)
        return mixed(run, noisy if run.teacher.noise == 0.3 else 0.0)

    assert missed("D9", made) == []
    assert missed("D9", lambda run: made(run, noisy=0.9, random=1.0)) == [0]
    assert missed("D9", lambda run: made(run, random=0.1)) == [1]


def test_d10() -> None:
    def made(run: Asked, active: float = 0.1, random: float = 0.7) -> dict[str, Any]:
        return mixed(run, random if run.config.acquisition == "random" else active)

    assert missed("D10", made) == []
    assert missed("D10", lambda run: made(run, active=0.7, random=0.1)) == [0, 1]
