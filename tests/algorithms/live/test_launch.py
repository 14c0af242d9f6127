"""The training process of a session ends, however impatient somebody is."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from moral_algorithms.live import launch


def test_training_is_gone_when_ctrl_c_is_pressed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "live").mkdir()
    popen = subprocess.Popen
    endless = [sys.executable, "-c", "import time; time.sleep(600)"]
    monkeypatch.setattr(subprocess, "Popen", lambda command, **options: popen(endless, **options))
    training = launch.Training(tmp_path)
    process = training._process

    def press(seconds: float) -> int:
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr(process, "wait", press)
    with pytest.raises(KeyboardInterrupt):
        training.end()
    assert process.returncode == -signal.SIGKILL


def test_why_training_has_failed_is_told_as_the_command_itself_would(tmp_path: Path) -> None:
    (tmp_path / "live").mkdir()
    training = launch.Training(tmp_path)
    assert training.wait() == "failed"
    training.end()
    assert training.failure() == f"there is no run in {tmp_path} to resume; start it without --resume"
