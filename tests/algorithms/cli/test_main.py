"""The program itself: help, version, and what is wrong before a command starts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from moral_algorithms.cli import COMMANDS
from tests.algorithms.cli.commands import only_line, refusal, run
from tests.closed_output import run_into_closed_pipe


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


def test_help_is_as_wide_as_the_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "500")
    assert run("evaluate", "--help") == 0
    # In the code it is two lines.
    assert "more pay only for the thesis's large ones." in capsys.readouterr().out


def test_an_option_that_does_not_exist_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    message = refusal(capsys, "evaluate", "--run", tmp_path, "--speed", "9")
    assert message.startswith("Unrecognized options: --speed, 9; ")
    assert message.endswith("; see moral evaluate --help")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--queries", "abc"], ["--queries", "'abc'", "INT"]),
        (["--device", "tpu"], ["--device", "'tpu'", "('cpu', 'cuda', 'auto')"]),
        (["--rules", "a", "b"], ["--rules", "STR INT"]),
        (["--seed"], ["--seed", "Expected 1"]),
        (["--out"], ["--out", "Expected 1"]),
        (["--querie", "3"], ["--querie", "--queries INT"]),
        (["--tensorboard", "--bogus"], ["--bogus"]),
    ],
)
def test_malformed_options_take_one_line(
    options: list[str], words: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    message = refusal(capsys, "train", "--rewards", tmp_path, "--out", tmp_path / "out", *options)
    assert all(word in message for word in words), message
    assert message.endswith("; see moral train --help")
    assert not set("╭╰│─") & set(message)
    assert "---" not in message
    assert "full helptext" not in message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_a_malformed_option_reads_the_same_in_every_encoding(encoding: str) -> None:
    done = subprocess.run(
        [
            *(sys.executable, "-c", "import sys; from moral_algorithms.cli import main; sys.exit(main())"),
            *("watch", "--run", "x", "--fps", "fast"),
        ],
        capture_output=True,
        encoding=encoding,
        env={**os.environ, "PYTHONIOENCODING": encoding},
        check=False,
    )
    assert done.returncode == 2
    assert only_line(done.stderr, "moral: error: ") == (
        "Error parsing --fps: invalid literal for int() with base 10: 'fast'; it must be: --fps INT; "
        "see moral watch --help"
    )


def test_missing_options_are_named_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    message = refusal(capsys, "airl", "--steps", "3")
    assert message == "Missing from moral airl: --demonstrations PATH, --out PATH; see moral airl --help"


def test_a_value_that_a_configuration_refuses_takes_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ("expert", "--weights", "0", "1", "--out", out)
    assert refusal(capsys, *options, "--ppo.policy", "huge").startswith("policy is 'huge'; it must be one of")
    assert refusal(capsys, *options, "--max-steps", "0") == "max_steps is 0; it must be at least 1"
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "unbuffered"), [(["--help"], False), (["--help"], True), (["train", "--help"], False)]
)
def test_a_reader_that_has_gone_is_no_error(arguments: list[str], unbuffered: bool) -> None:
    code = "import sys; from moral_algorithms.cli import main; sys.exit(main())"
    assert run_into_closed_pipe([sys.executable, "-c", code, *arguments], unbuffered) == (1, "")


@pytest.mark.parametrize(
    ("given", "expected"),
    [({}, "2000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "active"}, "None")],
)
def test_threads_that_wait_do_not_spin_for_long_unless_the_user_says_so(
    given: dict[str, str], expected: str
) -> None:
    code = (
        "import os, sys; from moral_algorithms.cli import main\n"
        "sys.argv[1:] = ['--version']; main()\n"
        "print('torch' in sys.modules, os.environ.get('GOMP_SPINCOUNT'))"
    )
    kept = {
        name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=kept | given, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == f"False {expected}"


def test_ctrl_c_while_python_ends_takes_no_traceback() -> None:
    code = (
        "import signal, sys; from moral_algorithms.cli import main\n"
        "sys.argv[1:] = ['--version']; main(); signal.raise_signal(signal.SIGINT)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
