"""The Python on the pages of the site that needs PyTorch runs, and shows what happens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moral_algorithms.cli import COMMANDS
from tests.pages import DOCS, run_page


def test_the_page_on_stable_baselines3_shows_what_happens() -> None:
    run_page("ecosystem/stable-baselines3.md")


def test_the_page_on_people_reads_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Where there are no runs there are no answers to show.
    monkeypatch.chdir(tmp_path)
    run_page("live.md")


def test_the_code_that_the_page_on_morl_baselines_includes_runs() -> None:
    reason = "morl-baselines has a virtual environment of its own, see benchmarks/strangers"
    pytest.importorskip("morl_baselines", reason=reason)
    from benchmarks.strangers import envelope

    config = envelope.Config(steps=1_200, starts=1, weights=2, batch_size=8, net_arch=(8,))
    front = envelope.found_front(envelope.train(0, config), config)
    assert front.shape == (2, 2)
    assert np.isfinite(front).all()


def test_the_page_about_the_library_shows_what_happens() -> None:
    run_page("library.md")


def test_the_page_about_the_command_line_has_every_command() -> None:
    page = (DOCS / "commands.md").read_text()
    asked = [line for line in page.splitlines() if line.startswith("<!--")]
    assert asked == [f"<!-- help of moral {name} -->" for name in COMMANDS]
