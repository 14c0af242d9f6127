"""Whole sessions in processes of their own: a link, answers, an end, a kill and a restart, a replay."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest

from moral_algorithms.answers import read_answers
from moral_algorithms.run_directory import read_lines
from tests.algorithms.cli.commands import RULES, only_line, ppo, refusal, run
from tests.algorithms.cli.conftest import Stages, stages

__all__ = ["stages"]

COMMAND = (
    *("live", *RULES, "--steps", "640", "--queries", "3", "--candidates", "20", "--samples", "50"),
    *("--checkpoint-every", "1", "--no-tensorboard", *ppo(), "--normaliser.max-steps", "128"),
    *(*ppo("normaliser."), "--port", "0"),
)
MORAL = "import sys; from moral_algorithms.cli import main; sys.exit(main())"


@contextmanager
def started(*options: str | Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A session and its link."""
    command = [sys.executable, "-u", "-c", MORAL, *map(str, options)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line and process.stderr is not None:
            pytest.fail(process.stderr.read())
        yield process, line.split()[-1]
    finally:
        process.kill()
        process.communicate()


@contextmanager
def entered(link: str) -> Iterator[httpx2.Client]:
    """Somebody in a browser, who has followed a link."""
    with httpx2.Client(base_url=link.partition("/?")[0], timeout=60) as browser:
        assert browser.get(link).status_code == 303
        yield browser


def until(browser: httpx2.Client, holds: Any) -> dict[str, Any]:
    """The first state that an event makes true of."""
    state: dict[str, Any] = {}
    with browser.stream("GET", "/api/events") as response:
        name = ""
        for line in response.iter_lines():
            if line.startswith("event: "):
                name = line[7:]
            elif line.startswith("data: "):
                value = json.loads(line[6:])
                state = value if name == "state" else {**state, name: value}
                if holds(state):
                    return state
    raise AssertionError("the stream of events has ended")


def test_a_session_is_killed_and_goes_on_to_its_end(stages: Stages, tmp_path: Path) -> None:
    out = tmp_path / "live"
    with (
        started(*COMMAND, "--rewards", stages.airl, "--out", out) as (process, link),
        entered(link) as browser,
    ):
        assert "<html" in browser.get("/").text
        state = until(browser, lambda state: state["queue"]["open"])
        number = state["queue"]["open"][0]["query"]
        body = {"preference": "first", "seconds": 1.0, "key": "key-number-1"}
        assert browser.post(f"/api/queries/{number}/answer", json=body).status_code == 200
        process.send_signal(signal.SIGKILL)
        process.wait()
    # Training ends with its session, or the run could not be resumed.
    port = httpx2.URL(link).port
    with started("live", "--resume", "--out", out) as (process, again), entered(again) as browser:
        assert httpx2.URL(again).params["token"] == httpx2.URL(link).params["token"]
        assert port == httpx2.URL(again).port
        # The page sends again what it does not know to have arrived.
        assert browser.post(f"/api/queries/{number}/answer", json=body).json()["duplicate"] is True
        for key in range(2, 4):
            state = until(browser, lambda state: state["queue"]["open"])
            body = {"preference": "second", "seconds": 1.0, "key": f"key-number-{key}"}
            number = state["queue"]["open"][0]["query"]
            assert browser.post(f"/api/queries/{number}/answer", json=body).status_code == 200
        status = until(browser, lambda state: (state["status"] or {}).get("phase") == "finished")["status"]
        assert (status["answers"], status["progress"]) == (3, 1.0)
        # Ctrl-C as soon as the page says so: a page is open, and the training process may still be ending.
        with browser.stream("GET", "/api/events") as response:
            assert next(response.iter_lines()) == "event: state"
            process.send_signal(signal.SIGINT)
            told, errors = process.communicate()
        assert (process.returncode, errors) == (0, "")
        assert "Weights after 3 queries" in told
        assert "the expert" in told
        assert f"The agent is in {out}" in told
    assert len(read_answers(out / "queries.jsonl").informative) == 3
    assert json.loads((out / "summary.json").read_text())["queries"] == 3
    assert (out / "policy.safetensors").exists()
    assert (out / "live" / "access.json").stat().st_mode & 0o077 == 0

    # The record alone is enough to learn again, alone and beside another person's.
    replayed = tmp_path / "replayed"
    other = tmp_path / "other.jsonl"
    shutil.copy(out / "queries.jsonl", other)
    options = ("--answers", out / "queries.jsonl", other, "--report", tmp_path / "report.json")
    assert run("replay", "--run", out, *options, "--out", replayed, "--no-tensorboard") == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert [one["answers"] for one in report] == [3, 3]
    assert json.loads((replayed / "summary.json").read_text())["queries"] == 6
    assert [line["queries"] for line in read_lines(replayed / "metrics.jsonl")][-1] == 6


def test_recorded_returns_are_found_again_in_the_episodes(stages: Stages) -> None:
    import numpy as np

    from moral_algorithms import pipeline
    from moral_algorithms.learners.recorded import vector_returns
    from moral_algorithms.run_directory import RunDirectory

    directory = RunDirectory(stages.moral)
    answers = read_answers(directory.queries).informative
    described = pipeline.read_moral_run(directory)
    world = described.world.build()
    replays = [episode for answer in answers for episode in answer.asked.episodes]
    returns = vector_returns(world, pipeline.reward_components(directory, described, "cpu"), replays)
    recorded = np.concatenate([answer.asked.pair.returns for answer in answers])
    np.testing.assert_allclose(returns, recorded, rtol=1e-4, atol=1e-5)


def test_a_replay_is_the_same_every_time(stages: Stages, tmp_path: Path) -> None:
    for name in ("one", "other"):
        options = ("--run", stages.moral, "--out", tmp_path / name, "--no-tensorboard")
        assert run("replay", *options) == 0
    one, other = ((tmp_path / name / "metrics.jsonl").read_bytes() for name in ("one", "other"))
    assert one == other
    assert (tmp_path / "one" / "recorded.jsonl").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("train", "--teacher", "web", "--noise", "0.1"),
            "noise is 0.1; it must be 0 unless the teacher is simulated",
        ),
        (("train", "--repeat-every", "3"), "repeat_every is 3; it must be 0 for a simulated teacher"),
        (
            ("train", "--teacher", "recorded"),
            "teacher is 'recorded', whose answers moral replay",
        ),
        (("live", "--teacher", "ratio"), "teacher is 'ratio'; for moral live it must be 'web'"),
        (("live", "--notice", "/nowhere"), "cannot read the notice /nowhere"),
        (
            ("live", "--names", "learned_2", "saving"),
            "names has 'learned_2'; it must be one of extinguish, learned_1",
        ),
        (("live", "--port", "70000"), "port is 70000; it must be 0 to 65535"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_written(
    options: tuple[str, ...],
    message: str,
    stages: Stages,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command, *others = options
    out = tmp_path / "out"
    told = refusal(capsys, command, *RULES, "--rewards", stages.airl, "--out", out, *others)
    assert told.startswith(message)
    assert not out.exists()


def test_drlhp_asks_no_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, "drlhp", "--teacher", "web", "--out", tmp_path / "out")
    assert told == "teacher is 'web'; for DRLHP it must be a simulated one"


def test_a_replay_of_nothing_takes_one_line(
    stages: Stages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = tmp_path / "nowhere.jsonl"
    told = refusal(capsys, "replay", "--run", stages.moral, "--answers", nowhere)
    assert told == f"there is no file {nowhere}"
    damaged = tmp_path / "damaged.jsonl"
    damaged.write_text('{"version": 7}\n')
    told = refusal(capsys, "replay", "--run", stages.moral, "--answers", damaged)
    assert told == f"{damaged} is damaged in line 1: it has version 7; this release reads 1"


def test_a_persons_demonstrations_are_what_airl_takes(
    stages: Stages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.npz"
    with (
        started("demonstrate", "--human", *RULES, "--out", out, "--port", "0") as (process, link),
        entered(link) as browser,
    ):
        assert browser.get("/api/state").json()["mode"] == "demonstrate"
        for number in range(2):
            play = browser.post("/api/plays", json={}).json()
            assert not play.keys() & {"counters", "objectives", "rewards"}
            name = play["play"]
            while not play["over"]:
                body = {"action": play["step"] % 9, "step": play["step"]}
                play = browser.post(f"/api/plays/{name}/step", json=body).json()
            assert browser.post(f"/api/plays/{name}/keep", json={}).json() == {
                "kept": number + 1,
                "duplicate": False,
            }
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate()
        assert process.returncode == 0
        assert "Episodes in the file: 2" in told
    airl = ("--steps", "128", "--discriminator-batch", "16", "--normaliser-episodes", "4", "--no-tensorboard")
    assert run("airl", "--demonstrations", out, *airl, *ppo(), "--out", tmp_path / "airl") == 0
    capsys.readouterr()
    assert run("demonstrate", "--human", "--norm", "clean", "--out", out) == 2
    message = only_line(capsys.readouterr().err, "moral: error: ")
    assert message == "norm is 'clean'; in emergency it must be one of ['extinguish', 'save']"
