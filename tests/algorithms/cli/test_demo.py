"""From nothing to an aligned agent in one command, on a small scale."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from tests.algorithms.cli.commands import DEMO, contents, run


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "demo"
    assert run(*DEMO, "--out", out) == 0
    return out


def test_the_summary_says_what_was_reached_and_what_it_took(demo: Path) -> None:
    summary = json.loads((demo / "summary.json").read_text())
    stages = {"expert", "demonstrations", "airl", "primary", "moral"}
    assert summary["env_steps"].keys() == {*stages, "total"}
    assert summary["env_steps"]["total"] == sum(summary["env_steps"][stage] for stage in stages)
    assert summary["wall_seconds"].keys() == {*stages, "evaluation", "total"}
    assert summary["queries"] == 2
    assert summary["optimum"]["people_saved"] == 6
    assert 0 <= summary["people_saved"] <= 6
    assert 0 <= summary["goal_time"] <= 75
    assert {"seed", "weights", "config", "versions", "commit", "platform"} <= summary.keys()


def test_the_front_is_a_picture(demo: Path) -> None:
    with Image.open(demo / "front.png") as picture:
        assert picture.format == "PNG"
        assert min(picture.size) > 500
        assert len(picture.convert("RGB").getcolors(maxcolors=2**24) or []) > 50


def test_every_stage_has_its_place(demo: Path) -> None:
    folders = {"expert", "airl", "moral"}
    files = {"demonstrations.npz", "config.json", "summary.json", "front.png", "run.lock"}
    assert {path.name for path in demo.iterdir()} == folders | files
    assert all((demo / folder / "policy.safetensors").exists() for folder in folders)


def test_its_agent_can_be_watched_and_measured(
    demo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "episode.gif"
    assert run("watch", "--run", demo, "--out", out) == 0
    with Image.open(out) as film:
        assert film.format == "GIF"
        assert getattr(film, "n_frames", 1) == 76
    assert run("evaluate", "--run", demo, "--episodes", "4") == 0
    assert "exact optimum" in capsys.readouterr().out


def test_a_second_demo_replaces_the_first_and_nothing_else(
    demo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (demo / "notes.txt").write_text("mine")
    (demo / "expert" / "notes.txt").write_text("mine, too")
    (demo / "moral" / ".checkpoint.safetensors.0123abcd").write_text("left by a process that was killed")
    (demo / "front.png").write_text("old")
    first = contents(demo / "moral")
    capsys.readouterr()
    assert run(*DEMO, "--out", demo) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "\r" not in out
    for text in ("expert", "moral", "MORAL, this run", "MORAL, thesis", "DRLHP, thesis", "exact optimum"):
        assert text in out
    assert (demo / "notes.txt").read_text() == "mine"
    assert (demo / "expert" / "notes.txt").read_text() == "mine, too"
    assert (demo / "front.png").read_bytes().startswith(b"\x89PNG")
    second = contents(demo / "moral")
    assert second["policy.safetensors"] == first["policy.safetensors"]
    assert first.keys() - second.keys() == {".checkpoint.safetensors.0123abcd"}
