"""Every benchmark is judged and drawn from whatever is finished of it, here of the committed records."""

from __future__ import annotations

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from benchmarks.__main__ import RESULTS, find_benchmarks
from benchmarks.harness import Benchmark, Results, Store
from benchmarks.harness.run import Run

STORE = Store(RESULTS / "laptop")


def finished(benchmark: Benchmark) -> list[Run]:
    return [run for run in benchmark.runs("laptop") if STORE.record(run) is not None]


def test_there_are_committed_records() -> None:
    assert sum(bool(finished(benchmark)) for benchmark in find_benchmarks(["all"])) >= 10


@pytest.mark.parametrize("benchmark", find_benchmarks(["all"]), ids=lambda benchmark: benchmark.id)
def test_a_part_of_the_runs_is_judged_and_drawn(benchmark: Benchmark) -> None:
    runs = finished(benchmark)
    for kind in {type(run) for run in runs}:
        first = next(run for run in runs if isinstance(run, kind))
        for part in ([first], [run for run in runs if isinstance(run, kind)]):
            results = Results([(run, STORE.result(run)) for run in part])
            benchmark.judge(results)
            figure = benchmark.draw(results)
            FigureCanvasAgg(figure).draw()
