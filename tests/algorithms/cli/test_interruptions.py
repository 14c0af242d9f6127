"""What commands say when they are interrupted."""

from __future__ import annotations

from pathlib import Path

import pytest

from moral_algorithms.cli import airl, align, cover, drlhp, expert, live, replay, train
from moral_algorithms.cli.arguments import BaseCommand

COMMANDS = {
    "agent": (
        lambda out: train.Command(out),
        lambda out: live.Command(out),
        lambda out: align.Command(Path("covered"), out),
        lambda out: drlhp.Command(out=out),
        lambda out: replay.Command(Path("run"), out=out),
    ),
    "policy": (lambda out: cover.Command(out),),
    "expert": (lambda out: expert.Command(out=out, weights=(0.0, 1.0)),),
    "reward network": (lambda out: airl.Command(Path("demonstrations.npz"), out),),
}


@pytest.mark.parametrize(
    ("what", "number"), [(w, i) for w, made in COMMANDS.items() for i in range(len(made))]
)
def test_an_interruption_after_the_end_is_told_as_that(what: str, number: int, tmp_path: Path) -> None:
    command: BaseCommand = COMMANDS[what][number](tmp_path)
    (tmp_path / "config.json").write_text("{}")
    assert "finished" not in command.hint
    (tmp_path / "summary.json").write_text("{}")
    assert command.hint == f"the run is finished; the {what} is in {tmp_path}"
