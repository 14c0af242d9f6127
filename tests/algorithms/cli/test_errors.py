"""Bad input gets one line and exit status 2, and leaves nothing behind."""

from __future__ import annotations

import fcntl
import io
import socket
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from moral_algorithms.evaluation import Episodes, play_episodes
from moral_algorithms.pipeline import reward_vector
from tests.algorithms.cli.commands import (
    AIRL,
    DEMO,
    DEMONSTRATE,
    EXPERT,
    TRAIN,
    contents,
    only_line,
    refusal,
    run,
)
from tests.algorithms.cli.conftest import Stages

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--world", "mars"],
            "world is 'mars'; it must be one of ['burning_warehouse', 'delivery', 'emergency']",
        ),
        (["--weights", "0", "1", "0"], "there must be 2, one for each of ('extinguish', 'save')"),
        (["--weights", "1", "-1"], "weights are [1.0, -1.0]; they must be finite and not negative"),
        (["--weights", "0", "0"], "not all zero"),
        (["--weights", "0", "nan"], "they must be finite"),
        (["--rules", "speed", "4"], "rules name 'speed'; emergency has"),
        (["--rules", "num_people", "400"], "has 36 free cells"),
        (["--seed", "-1"], "seed is -1; it must be 0 or more"),
        (["--threads", "-1"], "threads is -1; it must be 0 to 4096"),
        (["--threads", "99999999999999999999"], "threads is 99999999999999999999; it must be 0 to 4096"),
    ],
)
def test_an_impossible_expert_is_refused(
    options: list[str], message: str, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert message in refusal(capsys, *EXPERT, "--out", out, *options)
    assert not out.exists()


def test_a_device_that_is_not_there_is_refused(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    message = refusal(capsys, *EXPERT, "--out", tmp_path / "out", "--device", "cuda")
    assert message.startswith("device is 'cuda'")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", [EXPERT, DEMO])
def test_a_folder_that_cannot_be_made_is_refused(
    command: tuple[str, ...], tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "file").write_text("text")
    message = refusal(capsys, *command, "--out", tmp_path / "file" / "out")
    assert message.endswith("as a run directory: Not a directory")


def test_a_demonstration_file_that_cannot_be_written_is_refused(
    stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "file").write_text("text")
    out = tmp_path / "file" / "demonstrations.npz"
    capsys.readouterr()
    assert run(*DEMONSTRATE, "--expert", stages.expert, "--out", out) == 2
    only_line(capsys.readouterr().err, f"moral: error: cannot write {out}: ")
    assert contents(tmp_path) == {"file": b"text"}


def test_finished_results_are_not_replaced(stages: Stages, capsys: Capture) -> None:
    before = [contents(folder) for folder in (stages.expert, stages.airl, stages.moral)]
    message = refusal(capsys, *EXPERT, "--out", stages.expert)
    assert message.endswith("holds a finished run; choose another folder")
    assert "holds a run of moral expert" in refusal(
        capsys, *AIRL, "--demonstrations", stages.demonstrations, "--out", stages.expert
    )
    assert "holds a finished run" in refusal(
        capsys, *AIRL, "--demonstrations", stages.demonstrations, "--out", stages.airl
    )
    assert "--resume" in refusal(capsys, *TRAIN, "--rewards", stages.airl, "--out", stages.moral)
    recorded = stages.demonstrations.read_bytes()
    options = ("--expert", stages.expert, "--out", stages.demonstrations)
    assert refusal(capsys, *DEMONSTRATE, *options).endswith("exists; choose another name")
    assert stages.demonstrations.read_bytes() == recorded
    assert [contents(folder) for folder in (stages.expert, stages.airl, stages.moral)] == before


def damaged(source: Path, target: Path, damage: str) -> None:
    """A demonstration file that is damaged in one way."""
    if damage == "truncated":
        content = source.read_bytes()
        target.write_bytes(content[: len(content) // 2])
    elif damage == "text":
        target.write_text("no archive")
    elif damage == "object":
        with zipfile.ZipFile(source) as archive, zipfile.ZipFile(target, "w") as changed:
            for name in archive.namelist():
                if name != "actions.npy":
                    changed.writestr(name, archive.read(name))
            payload = io.BytesIO()
            np.save(payload, np.array([{"actions": 1}], dtype=object), allow_pickle=True)
            changed.writestr("actions.npy", payload.getvalue())


@pytest.mark.parametrize("damage", ["truncated", "text", "object", "missing"])
def test_a_damaged_demonstration_file_is_refused(
    damage: str, stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "demonstrations.npz"
    damaged(stages.demonstrations, file, damage)
    message = refusal(capsys, *AIRL, "--demonstrations", file, "--out", tmp_path / "out")
    assert str(file) in message
    assert not (tmp_path / "out").exists()


def test_what_was_learned_in_another_world_is_refused(
    stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    message = refusal(
        capsys, *TRAIN, "--rewards", stages.airl, "--out", tmp_path / "out", "--rules", "num_people", "3"
    )
    assert "was learned in" in message
    assert "'num_people': 3" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [["--world", "delivery"], ["--rules", "num_people", "3"]])
def test_demonstrations_of_another_world_are_refused(
    options: list[str], stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    message = refusal(capsys, *AIRL, "--demonstrations", stages.demonstrations, "--out", out, *options)
    assert message.startswith(f"{stages.demonstrations} was demonstrated in")
    assert options[-1] in message
    assert not out.exists()


def test_a_component_that_is_never_rewarded_is_refused(
    stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    options = ("--world", "delivery", "--order", "delivered", "--primary", "vase")
    message = refusal(capsys, "train", "--rewards", stages.airl, "--out", out, *options)
    assert message == (
        "primary is 'vase', whose reward is never positive; it must be one of ['deliver', 'help', 'clean']"
    )
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--primary", "fly"], "reward component is 'fly'; it must be one of ('extinguish', 'save')"),
        (["--primary", "save", "save"], "it must name no component twice"),
        (["--teacher", "strict"], "teacher is 'strict'; it must be one of lexicographic, ratio, target"),
        (["--teacher", "ratio"], "ratio is {}"),
        (["--teacher", "ratio", "--ratio", "gold", "1"], "the objectives are ['goal_time', 'people_saved']"),
        (["--teacher", "target"], "target is {}; it must name counts"),
        (
            ["--teacher", "target", "--target", "people_saved", "-1"],
            "target is {'people_saved': -1.0}; it must name counts, none negative or infinite",
        ),
        (["--teacher", "target", "--target", "gold", "1"], "target names ['gold']; the objectives are"),
        (["--target", "goal_time", "9"], "but teacher is 'lexicographic'; it must be 'target'"),
        (
            ["--teacher", "target", "--ratio", "goal_time", "9"],
            "ratio is {'goal_time': 9.0}, but teacher is 'target'; it must be 'ratio'",
        ),
        (["--order", "gold"], "the objectives are ['goal_time', 'people_saved']"),
        (["--noise", "2"], "noise is 2.0; it must be 0 to 1"),
        (["--acquisition", "luck"], "acquisition is 'luck'; it must be one of"),
        (["--rewards"], "rewards names 0 learned and primary 1 given components; weights need two or more"),
        (["--rewards", "nowhere"], "there is no file nowhere/reward.safetensors"),
    ],
)
def test_an_impossible_run_of_moral_is_refused(
    options: list[str], message: str, stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    rewards = [] if "--rewards" in options else ["--rewards", str(stages.airl)]
    out = tmp_path / "out"
    assert message in refusal(capsys, *TRAIN, *rewards, "--out", out, *options)
    assert not out.exists()


def test_too_few_steps_are_refused_before_anything_is_trained(
    stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    message = refusal(capsys, *TRAIN, "--rewards", stages.airl, "--out", out, "--steps", "64")
    assert message.startswith("steps is 64; it must be at least 65, for queries compare whole episodes")
    assert not out.exists()


def test_a_folder_is_free_again_after_a_normaliser_of_zero(
    stages: Stages, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = (*TRAIN, "--rewards", stages.airl, "--out", tmp_path / "out")
    with monkeypatch.context() as patched:
        patched.setattr(reward_vector, "play_episodes", _unpaid)
        capsys.readouterr()
        assert run(*arguments) == 2
    assert "train it longer (--normaliser.max-steps)" in capsys.readouterr().err
    assert run(*arguments, "--normaliser.max-steps", "192") == 0


def _unpaid(*arguments: Any) -> Episodes:
    played = play_episodes(*arguments)
    return played._replace(returns=np.zeros_like(played.returns))


def test_a_damaged_network_is_refused(stages: Stages, tmp_path: Path, capsys: Capture) -> None:
    for name, command in (("policy", "evaluate"), ("policy", "watch")):
        content = (stages.expert / f"{name}.safetensors").read_bytes()
        (tmp_path / f"{name}.safetensors").write_bytes(content[: len(content) // 2])
        assert "is damaged" in refusal(capsys, command, "--run", tmp_path)
    (tmp_path / "reward.safetensors").write_bytes((stages.airl / "policy.safetensors").read_bytes())
    message = refusal(capsys, *TRAIN, "--rewards", tmp_path, "--out", tmp_path / "out")
    assert message.endswith("holds 'moral-policy'; it must hold 'moral-reward'")
    assert not (tmp_path / "out").exists()


def test_a_folder_without_a_run_is_not_replayed(tmp_path: Path, capsys: Capture) -> None:
    nowhere = tmp_path / "nowhere"
    assert (
        refusal(capsys, "replay", "--run", nowhere) == f"{nowhere} is no run directory: it has no config.json"
    )


@pytest.mark.parametrize("command", ["evaluate", "watch"])
def test_a_folder_without_a_policy_is_refused(command: str, tmp_path: Path, capsys: Capture) -> None:
    assert "is no run directory" in refusal(capsys, command, "--run", tmp_path / "nowhere")
    (tmp_path / "config.json").write_text("{}")
    assert "is not finished" in refusal(capsys, command, "--run", tmp_path)


@pytest.mark.parametrize("episodes", ["0", "-3"])
def test_no_episodes_are_refused(episodes: str, stages: Stages, tmp_path: Path, capsys: Capture) -> None:
    message = refusal(capsys, "evaluate", "--run", stages.expert, "--episodes", episodes)
    assert message == f"episodes is {episodes}; it must be at least 1"
    assert "episodes" in refusal(capsys, *DEMO, "--episodes", episodes, "--out", tmp_path / "out")
    out = tmp_path / "demonstrations.npz"
    assert "episodes" in refusal(
        capsys, *DEMONSTRATE, "--expert", stages.expert, "--out", out, "--episodes", episodes
    )
    assert not list(tmp_path.iterdir())


def test_a_run_directory_in_use_is_refused(stages: Stages, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with (out / "run.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for command in (EXPERT, DEMO, (*TRAIN, "--rewards", str(stages.airl))):
            assert refusal(capsys, *command, "--out", out) == f"{out} is in use by another process"
    assert set(contents(out)) == {"run.lock"}
    assert run(*EXPERT, "--out", out) == 0


def test_a_demo_does_not_touch_a_folder_that_is_something_else(
    stages: Stages, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert "holds no demo; choose another folder" in refusal(capsys, *DEMO, "--out", tmp_path)
    assert contents(tmp_path) == {"notes.txt": b"mine"}
    before = contents(stages.expert)
    assert "holds a run of moral expert" in refusal(capsys, *DEMO, "--out", stages.expert)
    assert contents(stages.expert) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--world", "burning_warehouse"],
            "world is 'burning_warehouse'; for people to play in it must be one of ['delivery', 'emergency']",
        ),
        (["--norm", "clean"], "norm is 'clean'; in emergency it must be one of ['extinguish', 'save']"),
        (["--terminal"], "standard input is closed; it must be open for keys to come from it"),
    ],
)
def test_what_a_person_cannot_play_leaves_nothing(
    options: list[str], message: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    given = ("--out", tmp_path / "saving.npz", *options)
    assert refusal(capsys, "demonstrate", "--human", *given) == message
    assert not list(tmp_path.iterdir())


def test_nobody_is_asked_in_a_terminal_that_gives_no_keys(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    given = ("--primary", "extinguish", "save", "--returns", "extinguish", "7", "save", "6")
    told = refusal(capsys, "train", "--teacher", "terminal", *given, "--out", tmp_path / "run")
    assert told.startswith("standard input is closed")
    assert not list(tmp_path.iterdir())


def test_a_page_that_cannot_be_served_leaves_no_run(tmp_path: Path, capsys: Capture) -> None:
    given = ("--primary", "extinguish", "save", "--returns", "extinguish", "7", "save", "6")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        told = refusal(capsys, "live", *given, "--port", str(port), "--out", tmp_path / "run")
    assert told.startswith(f"cannot listen on 127.0.0.1:{port}: ")
    assert not (tmp_path / "run" / "config.json").exists()
