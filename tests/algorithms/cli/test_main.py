"""The program itself: help, version, and what is wrong before a command starts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from moral_algorithms.cli import COMMANDS
from tests.algorithms.cli.commands import only_line, refusal, run


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_help_names_every_command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*arguments) == 0
    out = capsys.readouterr().out
    assert out.startswith("usage: moral")
    for name, text in COMMANDS.items():
        assert f"  {name} " in out
        assert text in out


def test_help_and_version_and_simple_errors_do_without_pytorch() -> None:
    code = (
        "import sys; from moral_algorithms.cli import main\n"
        "main(['--help']); main(['--version']); main(['fly'])\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "moral_algorithms.cli" in loaded
    assert not {"torch", "stable_baselines3", "matplotlib", "gymnasium"} & loaded
    assert "moral 0." in done.stdout
    only_line(done.stderr, "moral: error: command is 'fly'; it must be one of demo, expert, ")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_its_options(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(name, "--help") == 0
    out = capsys.readouterr().out
    assert f"usage: moral {name}" in out
    assert "--device {cpu,cuda,auto}" in out
    assert "(default: " in out


def test_an_option_that_does_not_exist_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run("evaluate", "--run", tmp_path, "--speed", "9") == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "--speed" in captured.err
    assert "Traceback" not in captured.err


def test_a_value_that_a_configuration_refuses_takes_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ("expert", "--weights", "0", "1", "--out", out)
    assert refusal(capsys, *options, "--ppo.policy", "huge").startswith("policy is 'huge'; it must be one of")
    assert refusal(capsys, *options, "--max-steps", "0") == "max_steps is 0; it must be at least 1"
    assert not out.exists()
