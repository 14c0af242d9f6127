"""Every benchmark is judged and drawn from whatever is finished of it, here of the committed records."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.command import RESULTS, find_benchmarks
from benchmarks.harness import Benchmark, Results, Store
from benchmarks.harness.run import Run

STORE = Store(RESULTS / "laptop")


def finished(benchmark: Benchmark) -> tuple[tuple[Run, dict[str, Any]], ...]:
    """List the runs that have a record, and their results."""
    records = [(run, STORE.record(run)) for run in benchmark.runs("laptop")]
    return tuple((run, record["result"]) for run, record in records if record is not None)


@pytest.mark.parametrize("benchmark", find_benchmarks(["all"]), ids=lambda benchmark: benchmark.id)
def test_a_part_of_the_runs_is_judged_and_drawn(benchmark: Benchmark) -> None:
    found = finished(benchmark)
    assert found, "there are committed records of every benchmark"
    first_of_each_kind = {type(one[0]): one for one in reversed(found)}
    for part in (*([one] for one in first_of_each_kind.values()), found):
        results = Results(part)
        benchmark.judge(results)
        figure = benchmark.draw(results)
        if part is not found:
            # Where its parts come to lie takes most of the time, and is seen for the whole.
            figure.set_layout_engine("none")
        figure.draw_without_rendering()
