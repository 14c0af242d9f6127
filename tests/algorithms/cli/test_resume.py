"""A run of MORAL goes on exactly where it was stopped, however that happened."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from moral_algorithms.cli.arguments import Machine
from moral_algorithms.pipeline import reward_vector
from tests.algorithms.cli.commands import TRAIN, contents, only_line, refusal, run
from tests.algorithms.cli.conftest import Stages
from tests.algorithms.cli.killing import killed

Capture = pytest.CaptureFixture[str]

MOMENTS = {
    "beginning": "writing('config.json')",
    "normaliser": "writing('normalisers.json')",
    "answer before the first checkpoint": "lines('queries.jsonl') == 1",
    "checkpoint": "writing('checkpoint.safetensors') and lines('queries.jsonl') == 2",
    "rollout": "lines('metrics.jsonl') == 8",
    "result": "writing('summary.json')",
}


def require_same_result(run_: Path, other: Path) -> None:
    """Nothing but the wall seconds of two runs may differ, and nothing may be left of unfinished files."""
    timed = ("summary.json", "normalisers.json")
    assert contents(run_, timed) == contents(other, timed)
    assert {path.name for path in run_.iterdir()} == {path.name for path in other.iterdir()}
    for name in timed:
        found, wanted = (without_seconds(json.loads((path / name).read_text())) for path in (run_, other))
        assert found == wanted


def without_seconds(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: without_seconds(part) for name, part in value.items() if name != "wall_seconds"}
    return value


def answers(folder: Path) -> list[int]:
    """Numbers of the queries that were answered."""
    return [json.loads(line)["query"] for line in (folder / "queries.jsonl").read_text().splitlines()]


def at_flush(moment: Callable[[], bool], error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise an error, once, when a file is about to be flushed to the disk at a moment."""
    flush = os.fsync

    def fail(handle: int) -> None:
        if moment():
            monkeypatch.setattr(os, "fsync", flush)
            raise error
        flush(handle)

    monkeypatch.setattr(os, "fsync", fail)


@pytest.fixture(scope="module")
def killed_runs(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return killed([*TRAIN, "--rewards", str(stages.airl)], MOMENTS, tmp_path_factory.mktemp("killed"))


@pytest.mark.parametrize("moment", [name for name in MOMENTS if name != "beginning"])
def test_a_killed_run_is_resumed_exactly(moment: str, killed_runs: dict[str, Path], stages: Stages) -> None:
    out = killed_runs[moment]
    assert not (out / "summary.json").exists()
    assert run("train", "--resume", "--out", out, "--no-tensorboard") == 0
    assert answers(out) == [0, 1, 2]
    require_same_result(out, stages.moral)


def test_a_run_killed_before_it_began_is_started_anew(
    killed_runs: dict[str, Path], stages: Stages, capsys: Capture
) -> None:
    out = killed_runs["beginning"]
    message = refusal(capsys, "train", "--resume", "--out", out)
    assert message == f"there is no run in {out} to resume; start it without --resume"
    assert run(*TRAIN, "--rewards", stages.airl, "--out", out) == 0
    require_same_result(out, stages.moral)


def test_the_normaliser_is_not_computed_again(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "moral"
    at_flush((out / "metrics.jsonl").exists, KeyboardInterrupt(), monkeypatch)
    assert run(*TRAIN, "--rewards", stages.airl, "--out", out) == 130
    monkeypatch.delattr(reward_vector, "train_expert")
    assert run("train", "--resume", "--out", out, "--no-tensorboard") == 0
    require_same_result(out, stages.moral)


def test_an_interrupted_run_says_what_is_saved_and_how_to_go_on(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "moral"
    at_flush(
        lambda: (out / "queries.jsonl").exists() and any(out.glob(".checkpoint.*")),
        KeyboardInterrupt(),
        monkeypatch,
    )
    assert run(*TRAIN, "--rewards", stages.airl, "--out", out) == 130
    line = only_line(capsys.readouterr().err, "moral: interrupted; ")
    assert line == f"1 of 3 answers are saved; go on with: moral train --resume --out {out}"
    assert not list(out.glob(".*"))
    assert run("train", "--resume", "--out", out, "--no-tensorboard") == 0
    require_same_result(out, stages.moral)


def test_a_full_disk_leaves_the_last_checkpoint(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "moral"
    checkpoint = out / "checkpoint.safetensors"
    kept: list[bytes] = []

    def writes_second_checkpoint() -> bool:
        if checkpoint.exists() and any(out.glob(".checkpoint.*")):
            kept.append(checkpoint.read_bytes())
            return True
        return False

    at_flush(writes_second_checkpoint, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), monkeypatch)
    capsys.readouterr()
    assert run(*TRAIN, "--rewards", stages.airl, "--out", out) == 2
    line = only_line(
        capsys.readouterr().err, f"moral: error: cannot write {checkpoint}: No space left on device"
    )
    assert line == f"; go on with: moral train --resume --out {out}"
    assert [checkpoint.read_bytes()] == kept
    assert not list(out.glob(".*"))
    assert run("train", "--resume", "--out", out, "--no-tensorboard") == 0
    assert answers(out) == [0, 1, 2]
    require_same_result(out, stages.moral)


def test_a_full_disk_loses_no_answer_that_counted(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "moral"
    queries = out / "queries.jsonl"

    def answers_second() -> bool:
        return queries.exists() and queries.read_bytes().count(b"\n") == 2

    at_flush(answers_second, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), monkeypatch)
    capsys.readouterr()
    assert run(*TRAIN, "--rewards", stages.airl, "--out", out) == 2
    only_line(
        capsys.readouterr().err, f"moral: error: cannot write {queries}: No space left on device; go on"
    )
    assert answers(out) == [0]
    assert run("train", "--resume", "--out", out, "--no-tensorboard") == 0
    require_same_result(out, stages.moral)


def test_a_finished_run_is_left_as_it_is(stages: Stages, capsys: Capture) -> None:
    before = contents(stages.moral)
    assert run("train", "--resume", "--out", stages.moral) == 0
    assert f"The run in {stages.moral} was finished before." in capsys.readouterr().out
    assert contents(stages.moral) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seed", "5"], "was started with seed = 0; now it is 5"),
        (["--queries", "9"], "was started with moral.queries = 3; now it is 9"),
        (["--noise", "0.3"], "was started with teacher.noise = 0.2; now it is 0.3"),
        (["--normaliser.max-steps", "1"], "was started with normaliser.max_steps = 128; now it is 1"),
    ],
)
def test_a_run_is_not_resumed_as_another(
    options: list[str], message: str, stages: Stages, capsys: Capture
) -> None:
    before = contents(stages.moral)
    assert refusal(capsys, "train", "--resume", "--out", stages.moral, *options).endswith(message)
    assert contents(stages.moral) == before


def test_only_a_run_of_moral_is_resumed(stages: Stages, tmp_path: Path, capsys: Capture) -> None:
    nowhere = tmp_path / "nowhere"
    message = refusal(capsys, "train", "--resume", "--out", nowhere)
    assert message == f"there is no run in {nowhere} to resume; start it without --resume"
    assert not nowhere.exists()
    assert "holds a run of moral airl" in refusal(capsys, "train", "--resume", "--out", stages.airl)
    config = json.loads((stages.moral / "config.json").read_text())
    del config["moral"]["queries"], config["teacher"]
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert "configuration is damaged" in refusal(capsys, "train", "--resume", "--out", tmp_path)


def interrupted(stages: Stages, out: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> None:
    """Leave a run that was interrupted while the checkpoint after its first answer was written."""
    at_flush(
        lambda: (out / "queries.jsonl").exists() and any(out.glob(".checkpoint.*")),
        KeyboardInterrupt(),
        monkeypatch,
    )
    assert run(*TRAIN, "--rewards", stages.airl, "--out", out, *options) == 130


def test_a_resumed_run_keeps_its_machine_and_tensorboard(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "moral"
    interrupted(stages, out, monkeypatch, "--tensorboard", "--threads", "2")
    setting = json.loads((out / "config.json").read_text())["setting"]
    assert setting == {"device": "cpu", "threads": 2, "tensorboard": True}
    files = set(out.glob("tensorboard/events.out.tfevents.*"))
    prepared: list[Machine] = []

    def prepare(machine: Machine) -> str:
        prepared.append(machine)
        return "cpu"

    monkeypatch.setattr(Machine, "prepare", prepare)
    capsys.readouterr()
    assert run("train", "--resume", "--out", out) == 0
    assert capsys.readouterr().err == ""
    assert prepared == [Machine("cpu", 2)]
    assert set(out.glob("tensorboard/events.out.tfevents.*")) > files


def test_a_run_that_is_resumed_otherwise_warns_in_one_line(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "moral"
    interrupted(stages, out, monkeypatch)
    monkeypatch.setattr(Machine, "prepare", lambda machine: "cpu")
    capsys.readouterr()
    assert run("train", "--resume", "--out", out, "--threads", "2") == 0
    line = only_line(capsys.readouterr().err, "moral: warning: the run was started with ")
    assert line == "threads 1, now 2; results may differ"


def test_other_versions_are_warned_of_in_one_line(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "moral"
    interrupted(stages, out, monkeypatch)
    config = json.loads((out / "config.json").read_text())
    now = config["versions"]["torch"]
    config["versions"]["torch"] = "1.0"
    (out / "config.json").write_text(json.dumps(config))
    capsys.readouterr()
    assert run("train", "--resume", "--out", out) == 0
    line = only_line(capsys.readouterr().err, "moral: warning: the run was started with ")
    assert line == f"torch 1.0, now {now}; results may differ"


def test_torn_lines_are_repaired_when_the_run_goes_on(
    stages: Stages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "moral"
    interrupted(stages, out, monkeypatch)
    for name in ("queries.jsonl", "metrics.jsonl"):
        with (out / name).open("ab") as file:
            file.write(b'{"torn')
    assert run("train", "--resume", "--out", out) == 0
    require_same_result(out, stages.moral)


@pytest.fixture
def unfinished(stages: Stages, tmp_path: Path) -> Path:
    """A run of MORAL that lacks nothing but its summary."""
    out = tmp_path / "moral"
    shutil.copytree(stages.moral, out)
    (out / "summary.json").unlink()
    return out


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("queries.jsonl", "[]\n"),
        ("queries.jsonl", "5\n"),
        ("metrics.jsonl", "[]\n"),
        ("metrics.jsonl", '{"env_steps": "many"}\n'),
        ("normalisers.json", "[1]"),
        ("normalisers.json", '{"extinguish": {"return": 0.0, "env_steps": 1, "wall_seconds": 0.1}}'),
        ("config.json", "[]"),
        ("checkpoint.safetensors", "{}"),
    ],
)
def test_a_file_of_another_shape_takes_one_line(
    name: str, content: str, unfinished: Path, capsys: Capture
) -> None:
    (unfinished / name).write_text(content)
    capsys.readouterr()
    assert run("train", "--resume", "--out", unfinished) == 2
    assert str(unfinished / name) in only_line(capsys.readouterr().err, "moral: error: ")
    assert not (unfinished / "summary.json").exists()


def test_a_finished_training_without_metrics_takes_one_line(unfinished: Path, capsys: Capture) -> None:
    (unfinished / "metrics.jsonl").write_text("")
    capsys.readouterr()
    assert run("train", "--resume", "--out", unfinished) == 2
    message = only_line(capsys.readouterr().err, "moral: error: ")
    assert f"{unfinished / 'metrics.jsonl'} is damaged: it holds no rollout" in message


def test_a_damaged_summary_takes_one_line(stages: Stages, unfinished: Path, capsys: Capture) -> None:
    summary = unfinished / "summary.json"
    whole = json.loads((stages.moral / "summary.json").read_text())
    for damage in ({"weights": {"extinguish": "most"}}, {"objectives": {"saved": None}}, None):
        damaged = {} if damage is None else {**whole, **damage}
        summary.write_text(json.dumps(damaged))
        message = refusal(capsys, "train", "--resume", "--out", unfinished)
        assert message == f"{summary} is damaged: it is not the summary of a run of moral train"


def test_without_a_damaged_checkpoint_the_answers_are_enough(
    stages: Stages, unfinished: Path, capsys: Capture
) -> None:
    checkpoint = unfinished / "checkpoint.safetensors"
    checkpoint.write_bytes(checkpoint.read_bytes()[:100])
    message = refusal(capsys, "train", "--resume", "--out", unfinished)
    assert "without that file the run begins anew, with the answers that were given" in message
    checkpoint.unlink()
    answers = (unfinished / "queries.jsonl").read_bytes()
    assert run("train", "--resume", "--out", unfinished) == 0
    assert (unfinished / "queries.jsonl").read_bytes() == answers
    require_same_result(unfinished, stages.moral)
