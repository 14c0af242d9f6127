"""Commands that are small enough for a test, and how their output is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from moral_algorithms.cli import main

RULES = ("--rules", "height", "5", "width", "5", "num_people", "2", "max_cycles", "8")
"""Nine free cells, two people, eight steps."""


def ppo(prefix: str = "") -> tuple[str, ...]:
    """Options of a PPO that takes 64 steps between updates."""
    values = {"num-envs": 8, "rollout-steps": 8, "batch-size": 64, "epochs": 1}
    return tuple(word for name, value in values.items() for word in (f"--{prefix}ppo.{name}", str(value)))


EXPERT = ("expert", "--weights", "0", "1", *RULES, "--max-steps", "128", "--no-tensorboard", *ppo())
"""An expert, but for --out."""

DEMONSTRATE = ("demonstrate", "--episodes", "4")
"""Four demonstrations, but for --expert and --out."""

AIRL = (
    *("airl", "--steps", "128", "--discriminator-batch", "16", "--discriminator-updates", "2"),
    *("--normaliser-episodes", "4", "--no-tensorboard", *ppo()),
)
"""AIRL, but for --demonstrations and --out."""

TRAIN = (
    *("train", *RULES, "--steps", "640", "--queries", "3", "--candidates", "20", "--samples", "50"),
    *("--checkpoint-every", "1", "--noise", "0.2", "--no-tensorboard", *ppo()),
    *("--normaliser.max-steps", "128", *ppo("normaliser.")),
)
"""Ten rollouts of MORAL with three queries, but for --rewards and --out."""

DEMO = (
    *("demo", "--demonstrations", "4", "--episodes", "8", "--threads", "1"),
    *("--expert.max-steps", "1200", *ppo("expert.")),
    *(
        "--airl.steps",
        "640",
        "--airl.discriminator-batch",
        "16",
        "--airl.normaliser-episodes",
        "4",
        *ppo("airl."),
    ),
    *("--normaliser.max-steps", "640", *ppo("normaliser.")),
    *("--moral.steps", "1280", "--moral.queries", "2", "--moral.samples", "50", *ppo("moral.")),
)
"""A demo of a few seconds, but for --out."""


def run(*arguments: str | Path) -> int:
    """Exit status of ``moral ARGUMENTS`` in this process."""
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else 1


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The one line on stderr with which ``moral ARGUMENTS`` is refused; nothing else may be said."""
    capsys.readouterr()
    status = run(*arguments)
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    return only_line(captured.err, "moral: error: ")


def only_line(text: str, beginning: str) -> str:
    """The one line that ``text`` is, without its beginning."""
    lines = text.splitlines()
    assert len(lines) == 1, text
    assert lines[0].startswith(beginning)
    return lines[0][len(beginning) :]


def contents(folder: Path, but: Sequence[str] = ()) -> dict[str, bytes]:
    """What the files of a folder hold, by name, but for some."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in but}
