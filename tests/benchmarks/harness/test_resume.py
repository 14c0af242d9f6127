"""A killed run of MORAL or DRLHP goes on in its run directory, and ends as if nothing had happened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.harness import Run, Store
from benchmarks.harness.executors import LocalProcesses, Outcome
from benchmarks.harness.sweep import Sweep
from tests.benchmarks.harness import killed


def sweep(store: Store, run: Run) -> list[Outcome]:
    one = Sweep(store, [run])
    one.carry_out(LocalProcesses(store, 1), lambda sweep: None, lambda outcome: None)
    return one.failed


def untimed(result: dict[str, Any]) -> dict[str, Any]:
    """What must be the same however a run came to its end."""
    return {name: value for name, value in result.items() if name not in ("seconds", "whole")}


@pytest.mark.parametrize("make", [killed.aligned, killed.from_preferences])
def test_a_killed_run_ends_as_if_nothing_had_happened(make: Callable[[], Run], tmp_path: Path) -> None:
    run = make()
    whole, cut_off = Store(tmp_path / "whole"), Store(tmp_path / "cut off")
    for store in (whole, cut_off):
        store.require_writable()
    (whole.folder / killed.MARK).touch()
    assert sweep(whole, run) == []
    (failed,) = sweep(cut_off, run)
    assert failed.run == run
    assert "signal 9" in (failed.error or "")
    assert (cut_off.files(run) / "checkpoint.safetensors").exists()
    assert cut_off.record(run) is None
    assert sweep(cut_off, run) == []
    assert untimed(cut_off.result(run)) == untimed(whole.result(run))
    assert (cut_off.result(run)["whole"], whole.result(run)["whole"]) == (False, True)
