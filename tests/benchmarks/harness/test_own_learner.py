"""A reader's own learner joins E8 as the page says: a short file, loaded by name."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

from benchmarks.command import main
from benchmarks.harness import Store
from benchmarks.harness.report import judge
from benchmarks.rows import e8

DOCS = Path(__file__).parents[3] / "docs"
LEARNER = DOCS / "examples" / "my_learner.py"


def test_a_learner_of_ones_own_takes_less_than_60_lines() -> None:
    assert "```{literalinclude} examples/my_learner.py\n" in (DOCS / "benchmarks.md").read_text()
    assert len(LEARNER.read_text().splitlines()) < 60


def test_it_is_run_and_shown_beside_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(LEARNER, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    # Without the others, who take their time; their runs are carried out by `make smoke`.
    monkeypatch.setattr(e8, "_FEWER", ())
    # A dictionary of its own: the learner stays in the one that it joins.
    monkeypatch.setattr(e8, "CONTENDERS", {})
    options = ["E8", "--profile", "smoke", "--out", "out", "--load", "my_learner"]
    try:
        assert main(["run", *options]) == 0
        assert "1 of 1 runs" in capsys.readouterr().out
        assert main(["report", *options]) == 0
    finally:
        sys.modules.pop("my_learner", None)
    (path,) = (tmp_path / "out" / "records").iterdir()
    assert path.name.startswith("OneBatch-")
    result = json.loads(path.read_text())["result"]
    assert result["preferences"] == 25
    assert result["env_steps"] >= 19_200
    assert result["objectives"].keys() == {"goal_time", "people_saved"}
    assert len(result["curve"]["env_steps"]) == len(result["curve"]["people_saved"]) > 0
    assert "1 of 1 runs" in (tmp_path / "out" / "report" / "index.html").read_text()
    results, _ = judge(e8.BENCHMARK, Store(tmp_path / "out"), "smoke")
    legend = e8.BENCHMARK.draw(results).axes[0].get_legend()
    assert legend is not None
    assert "OneBatch" in [text.get_text() for text in legend.get_texts()]
