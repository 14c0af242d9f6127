"""``moral drlhp``: what it leaves, its presets, and that it goes on where it was stopped."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from moral_algorithms.cli.drlhp import Command
from moral_algorithms.networks.files import load_action_reward, load_policy
from moral_algorithms.pipeline import DRLHPRun, TeacherConfig, drlhp_preset
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.cli.commands import RULES, contents, only_line, ppo, refusal, run
from tests.algorithms.cli.killing import killed
from tests.algorithms.cli.test_resume import at_flush, without_seconds

Capture = pytest.CaptureFixture[str]

WORLD = WorldSpec("emergency", {RULES[i]: int(RULES[i + 1]) for i in range(1, len(RULES), 2)})

DRLHP = (
    *("drlhp", *RULES, "--steps", "640", "--queries", "6", "--clip-length", "4", "--checkpoint-every", "2"),
    *("--reward.members", "2", "--reward.updates", "2", "--reward.initial-updates", "3"),
    *("--noise", "0.2", "--no-tensorboard", *ppo()),
)
"""Nine rollouts with six queries, but for --out."""


def require_same_result(one: Path, other: Path) -> None:
    """Nothing but the wall seconds of two runs may differ."""
    assert contents(one, ("summary.json",)) == contents(other, ("summary.json",))
    found, wanted = (json.loads((path / "summary.json").read_text()) for path in (one, other))
    assert without_seconds(found) == without_seconds(wanted)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("drlhp") / "run"
    assert run(*DRLHP, "--out", out) == 0
    return out


def test_a_run_leaves_what_other_commands_take(finished: Path, tmp_path: Path, capsys: Capture) -> None:
    assert load_policy(finished / "policy.safetensors").world == WORLD
    network, world = load_action_reward(finished / "reward.safetensors")
    assert (world, len(network.members)) == (WORLD, 2)
    summary = json.loads((finished / "summary.json").read_text())
    assert summary.keys() == {"queries", "objectives", "env_steps", "wall_seconds"}
    assert (summary["queries"], summary["env_steps"]) == (6, 640)
    assert len((finished / "queries.jsonl").read_text().splitlines()) == 6
    assert len((finished / "metrics.jsonl").read_text().splitlines()) == 9
    capsys.readouterr()
    assert run("evaluate", "--run", finished, "--episodes", "4", "--json") == 0
    assert json.loads(capsys.readouterr().out)["objectives"].keys() == {"goal_time", "people_saved"}
    assert run("watch", "--run", finished, "--out", tmp_path / "episode.gif") == 0
    assert (tmp_path / "episode.gif").read_bytes().startswith(b"GIF8")


def test_the_same_seed_gives_the_same_result(finished: Path, tmp_path: Path) -> None:
    assert run(*DRLHP, "--out", tmp_path / "again") == 0
    require_same_result(tmp_path / "again", finished)
    assert run(*DRLHP, "--out", tmp_path / "other", "--seed", "1") == 0
    policy = "policy.safetensors"
    assert (tmp_path / "other" / policy).read_bytes() != (finished / policy).read_bytes()


def test_a_preset_is_for_a_new_run(finished: Path, capsys: Capture) -> None:
    told = refusal(capsys, "drlhp", "--resume", "--out", finished, "--preset", "paper")
    assert told == "preset is for a new run; one that goes on has its settings"


def test_the_help_shows_the_defaults_of_what_is_asked_for(capsys: Capture) -> None:
    assert run("drlhp", "--preset", "paper", "--world", "delivery", "--help") == 0
    told = capsys.readouterr().out
    assert "12000000" in told
    assert "delivered" in told


MOMENTS = {
    "first answer": "lines('queries.jsonl') == 1",
    "checkpoint": "writing('checkpoint.safetensors') and lines('queries.jsonl') > 2",
    "rollout": "lines('metrics.jsonl') == 5",
    "result": "writing('summary.json')",
}


@pytest.fixture(scope="module")
def killed_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return killed(DRLHP, MOMENTS, tmp_path_factory.mktemp("killed"))


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_run_is_resumed_exactly(moment: str, killed_runs: dict[str, Path], finished: Path) -> None:
    out = killed_runs[moment]
    assert not (out / "summary.json").exists()
    assert run("drlhp", "--resume", "--out", out) == 0
    require_same_result(out, finished)


def test_an_interrupted_run_says_how_to_go_on(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "run"
    at_flush((out / "metrics.jsonl").exists, KeyboardInterrupt(), monkeypatch)
    assert run(*DRLHP, "--out", out) == 130
    line = only_line(capsys.readouterr().err, "moral: interrupted; ")
    assert line == f"3 of 6 answers are saved; go on with: moral drlhp --resume --out {out}"
    config = json.loads((out / "config.json").read_text())
    config["versions"]["torch"] = "1.0"
    (out / "config.json").write_text(json.dumps(config))
    capsys.readouterr()
    assert run("drlhp", "--resume", "--out", out) == 0
    line = only_line(capsys.readouterr().err, "moral: warning: the run was started with torch 1.0, now ")
    assert line.endswith("; results may differ")
    assert (out / "policy.safetensors").read_bytes() == (finished / "policy.safetensors").read_bytes()


def test_a_finished_run_is_left_as_it_is(finished: Path, capsys: Capture) -> None:
    before = contents(finished)
    assert run("drlhp", "--resume", "--out", finished) == 0
    assert f"The run in {finished} was finished before." in capsys.readouterr().out
    assert contents(finished) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seed", "5"], "was started with seed = 0; now it is 5"),
        (["--queries", "9"], "was started with drlhp.queries = 6; now it is 9"),
        (["--reward.lapse", "0.5"], "was started with drlhp.reward.lapse = 0.1; now it is 0.5"),
    ],
)
def test_a_run_is_not_resumed_as_another(
    options: list[str], message: str, finished: Path, capsys: Capture
) -> None:
    assert refusal(capsys, "drlhp", "--resume", "--out", finished, *options).endswith(message)


def test_only_a_run_of_drlhp_is_resumed(finished: Path, tmp_path: Path, capsys: Capture) -> None:
    nowhere = tmp_path / "nowhere"
    message = refusal(capsys, "drlhp", "--resume", "--out", nowhere)
    assert message == f"there is no run in {nowhere} to resume; start it without --resume"
    assert "holds a run of moral drlhp" in refusal(capsys, "train", "--resume", "--out", finished)
    config = json.loads((finished / "config.json").read_text())
    del config["drlhp"]["queries"], config["teacher"]
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert "configuration is damaged" in refusal(capsys, "drlhp", "--resume", "--out", tmp_path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("queries.jsonl", "[]\n"),
        ("metrics.jsonl", "[]\n"),
        ("metrics.jsonl", '{"env_steps": "many"}\n'),
        ("metrics.jsonl", ""),
        ("config.json", "[]"),
        ("checkpoint.safetensors", "{}"),
    ],
)
def test_a_damaged_file_takes_one_line(
    name: str, content: str, finished: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "run"
    shutil.copytree(finished, out)
    (out / "summary.json").unlink()
    (out / name).write_text(content)
    capsys.readouterr()
    assert run("drlhp", "--resume", "--out", out) == 2
    assert str(out / name) in only_line(capsys.readouterr().err, "moral: error: ")
    (out / "summary.json").write_text("{}")
    if name == "checkpoint.safetensors":
        assert "is damaged: it is not the summary" in refusal(capsys, "drlhp", "--resume", "--out", out)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--preset", "slow"], r"preset is 'slow'; it must be one of ['fast', 'paper']"),
        (["--clip-length", "9"], "clip_length is 9; an episode of emergency_v0 has 8 steps"),
        (["--teacher", "target", "--target", "people_saved", "2"], "it must be 0 for a target"),
        (["--order", "fun"], "fun"),
        (["--rules", "height", "five"], "Error parsing --rules"),
    ],
)
def test_impossible_options_take_one_line(
    options: list[str], message: str, tmp_path: Path, capsys: Capture
) -> None:
    assert message in refusal(capsys, *DRLHP, "--out", tmp_path / "run", *options)
    assert not (tmp_path / "run").exists()


def test_a_preset_gives_the_defaults() -> None:
    options = ["--out", "run", "--preset", "paper", "--world", "delivery", "--rules", "max_cycles", "20"]
    command = Command.defaults(options)
    assert command is not None
    assert command.config == drlhp_preset("paper", WorldSpec("delivery", {"max_cycles": 20}))
    fast = Command.defaults(["--out", "run"])
    assert fast is not None
    assert fast.config == drlhp_preset("fast", WorldSpec())
    bare = Command.defaults([])
    assert bare is not None
    assert bare.config == fast.config


@pytest.mark.parametrize(
    "damage", [{"noise": None}, {"order": [1]}, {"ratio": {"people_saved": "much"}}, {"teacher": 3}]
)
def test_a_damaged_teacher_is_refused(damage: dict[str, Any]) -> None:
    value = DRLHPRun(WORLD, TeacherConfig(), 0, drlhp_preset("fast", WORLD)).to_json()
    value["teacher"] |= damage
    with pytest.raises(ValueError, match=r"^the run's configuration is damaged: a teacher's settings have"):
        DRLHPRun.from_json(value)


def test_a_run_comes_back_from_json() -> None:
    teacher = TeacherConfig("ratio", ratio={"people_saved": 1.0, "goal_time": 3.0})
    for preset in ("fast", "paper"):
        described = DRLHPRun(WORLD, teacher, 3, drlhp_preset(preset, WORLD))
        assert DRLHPRun.from_json(json.loads(json.dumps(described.to_json()))) == described
