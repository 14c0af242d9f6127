"""An episode as a moving picture."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from moral_algorithms.evaluation import RandomPolicy
from moral_algorithms.watching import film, write_film
from moral_envs import delivery_v0
from moral_envs.world import NUM_ACTIONS
from tests.algorithms.cli.commands import refusal, run
from tests.algorithms.cli.conftest import Stages

Capture = pytest.CaptureFixture[str]


def test_the_start_and_every_step_are_a_frame(stages: Stages, tmp_path: Path, capsys: Capture) -> None:
    first, second = tmp_path / "first.gif", tmp_path / "second.gif"
    for out in (first, second):
        assert run("watch", "--run", stages.moral, "--out", out, "--fps", "10") == 0
    assert f"{second}: 8 steps, goal_time " in capsys.readouterr().out
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as picture:
        assert getattr(picture, "n_frames", 1) == 9
        assert picture.info["duration"] == 100
        assert picture.info["loop"] == 0
    assert run("watch", "--run", stages.moral, "--out", second, "--seed", "1") == 0
    assert first.read_bytes() != second.read_bytes()


def test_frames_of_a_large_world_are_even_and_fit_its_objectives(tmp_path: Path) -> None:
    policy = RandomPolicy(NUM_ACTIONS, np.random.default_rng(0))
    frames, objectives = film(policy, delivery_v0.world(max_cycles=3), 0)
    assert len(frames) == 4
    assert objectives.keys() == {"delivered", "helped", "cleaned", "vases_broken"}
    height, width, _ = frames[0].shape
    assert height % 2 == width % 2 == 0
    write_film(tmp_path / "episode.GIF", frames, fps=5)
    with Image.open(tmp_path / "episode.GIF") as picture:
        assert picture.size == (width, height)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "episode.avi"], "out is episode.avi; its name must end with .gif or .mp4"),
        (["--fps", "0"], "fps is 0; it must be 1 to 50"),
        (["--fps", "99"], "fps is 99; it must be 1 to 50"),
        (["--seed", "-1"], "seed is -1; it must be 0 or more"),
    ],
)
def test_what_cannot_be_written_is_refused(
    options: list[str],
    message: str,
    stages: Stages,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert refusal(capsys, "watch", "--run", stages.moral, *options) == message
    assert not list(tmp_path.iterdir())


def test_an_mp4_without_an_encoder_names_the_extra(
    stages: Stages, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    out = tmp_path / "episode.mp4"
    assert "pip install 'moral-algorithms[video]'" in refusal(
        capsys, "watch", "--run", stages.moral, "--out", out
    )
    assert not out.exists()
