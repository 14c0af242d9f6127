"""``moral cover`` and ``moral align``: what they leave, and that answers are never lost."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from moral_algorithms.networks.files import load_conditioned_policy, load_policy
from moral_algorithms.pipeline import AlignRun, CoverRun, TeacherConfig
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.cli.commands import contents, only_line, ppo, refusal, run
from tests.algorithms.cli.conftest import Stages
from tests.algorithms.cli.test_resume import at_flush, without_seconds

Capture = pytest.CaptureFixture[str]

COVER = ("cover", "--primary", "extinguish", "--steps", "256", "--no-tensorboard", *ppo())
"""Four rollouts, but for --rewards, --returns and --out."""

ALIGN = (
    *("align", "--teacher", "ratio", "--ratio", "goal_time", "3", "people_saved", "1", "--noise", "0.2"),
    *("--queries", "4", "--episodes", "8", "--candidates", "20", "--samples", "50"),
)
"""Four queries, but for --covered and --out."""


@pytest.fixture(scope="module")
def covered(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("align") / "covered"
    known = ("--returns", "extinguish", "0.5")
    assert run(*COVER, "--rewards", stages.airl, *known, "--out", out) == 0
    return out


@pytest.fixture(scope="module")
def aligned(covered: Path) -> Path:
    out = covered.parent / "aligned"
    assert run(*ALIGN, "--covered", covered, "--out", out) == 0
    return out


def test_every_command_leaves_what_the_next_one_needs(
    covered: Path, aligned: Path, tmp_path: Path, capsys: Capture
) -> None:
    policy, world = load_conditioned_policy(covered / "covering.safetensors")
    assert (policy.components, world.rules["height"]) == (2, 5)
    assert {"learned_1.safetensors", "normalisers.json"} <= contents(covered).keys()
    made = json.loads((covered / "summary.json").read_text())
    assert made["env_steps"] == {"primary": 0, "cover": 256}
    summary = json.loads((aligned / "summary.json").read_text())
    assert (summary["queries"], summary["env_steps"]) == (4, {"align": 5 * 8 * 8})
    assert summary["weights"].keys() == {"extinguish", "learned_1"}
    assert sum(summary["weights"].values()) == pytest.approx(1)
    assert len((aligned / "queries.jsonl").read_text().splitlines()) == 4
    found = load_policy(aligned / "policy.safetensors").policy.state_dict()
    wanted = policy.policy_at(list(summary["weights"].values())).state_dict()
    assert all((found[name] == wanted[name]).all() for name in wanted)
    capsys.readouterr()
    assert run("evaluate", "--run", aligned, "--episodes", "4", "--json") == 0
    assert json.loads(capsys.readouterr().out)["objectives"].keys() == {"goal_time", "people_saved"}
    assert run("watch", "--run", aligned, "--out", tmp_path / "episode.gif") == 0


def test_a_policy_for_all_weights_is_not_measured_but_aligned(covered: Path, capsys: Capture) -> None:
    for command in (("evaluate",), ("watch", "--out", covered / "episode.gif")):
        assert refusal(capsys, *command, "--run", covered) == (
            f"{covered} has a policy for all weights; moral align --covered {covered} makes one of it"
        )


def test_the_same_seed_gives_the_same_result(
    stages: Stages, covered: Path, aligned: Path, tmp_path: Path
) -> None:
    known = ("--returns", "extinguish", "0.5")
    assert run(*COVER, "--rewards", stages.airl, *known, "--out", tmp_path / "covered") == 0
    name = "covering.safetensors"
    assert (tmp_path / "covered" / name).read_bytes() == (covered / name).read_bytes()
    assert run(*ALIGN, "--covered", covered, "--out", tmp_path / "other", "--seed", "1") == 0
    assert (tmp_path / "other" / "queries.jsonl").read_bytes() != (aligned / "queries.jsonl").read_bytes()


def test_a_run_that_was_cut_off_leaves_nothing_to_the_next(stages: Stages, tmp_path: Path) -> None:
    out = tmp_path / "covered"
    for known in ("0.5", "7"):
        (out / "summary.json").unlink(missing_ok=True)
        returns = ("--returns", "extinguish", known)
        assert run(*COVER, "--rewards", stages.airl, *returns, "--out", out) == 0
    normalisers = json.loads((out / "normalisers.json").read_text())
    assert normalisers["extinguish"]["return"] == 7


def test_an_interrupted_run_keeps_its_answers(
    covered: Path, aligned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    out = tmp_path / "run"
    queries = out / "queries.jsonl"
    at_flush(
        lambda: queries.exists() and len(queries.read_text().splitlines()) > 2,
        KeyboardInterrupt(),
        monkeypatch,
    )
    assert run(*ALIGN, "--covered", covered, "--out", out) == 130
    line = only_line(capsys.readouterr().err, "moral: interrupted; ")
    assert line == f"3 of 4 answers are saved; go on with: moral align --resume --out {out}"
    assert "started with align.queries = 4; now it is 9" in refusal(
        capsys, "align", "--resume", "--out", out, "--queries", "9"
    )
    assert run("align", "--resume", "--out", out) == 0
    assert contents(out, ("summary.json",)) == contents(aligned, ("summary.json",))
    found, wanted = (json.loads((path / "summary.json").read_text()) for path in (out, aligned))
    assert without_seconds(found) == without_seconds(wanted)
    before = contents(out)
    assert run("align", "--resume", "--out", out) == 0
    assert f"The run in {out} was finished before." in capsys.readouterr().out
    assert contents(out) == before


def test_what_cannot_be_asked_about_takes_one_line(
    stages: Stages, covered: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"

    def told(path: Path, *options: str) -> str:
        return refusal(capsys, *ALIGN, *options, "--covered", path, "--out", out)

    assert told(tmp_path / "nowhere").startswith(f"{tmp_path / 'nowhere'} is no run directory")
    assert "not one of moral cover" in told(stages.moral)
    assert "teacher is 'nobody'" in told(covered, "--teacher", "nobody")
    for teacher in ("web", "terminal", "recorded"):
        wanted = f"teacher is '{teacher}'; for moral align it must be a simulated one"
        assert told(covered, "--teacher", teacher) == wanted
    unfinished, damaged = tmp_path / "unfinished", tmp_path / "damaged"
    for copy in (unfinished, damaged):
        shutil.copytree(covered, copy)
    (unfinished / "summary.json").unlink()
    assert told(unfinished) == f"the run in {unfinished} is not finished: it has no policy yet"
    (damaged / "normalisers.json").unlink()
    assert told(damaged) == f"{damaged / 'normalisers.json'} has no normaliser of ['extinguish']"
    (damaged / "covering.safetensors").write_bytes((stages.moral / "policy.safetensors").read_bytes())
    assert "covering.safetensors" in told(damaged)
    assert not out.exists()


def test_what_cannot_be_covered_takes_one_line(stages: Stages, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"

    def told(*options: str) -> str:
        return refusal(capsys, *COVER, "--rewards", str(stages.airl), "--out", out, *options)

    assert "reward component is 'fire'" in told("--primary", "fire")
    assert "steps is 0" in told("--steps", "0")
    assert "ppo.policy is 'paper'; it must be 'fast'" in told("--ppo.policy", "paper")
    assert "it must be" in told("--world", "delivery")
    assert not out.exists()


def test_runs_come_back_from_json() -> None:
    teacher = TeacherConfig("ratio", ratio={"people_saved": 1.0, "goal_time": 3.0})
    asked = AlignRun(Path("covered"), teacher, 3)
    assert AlignRun.from_json(json.loads(json.dumps(asked.to_json()))) == asked
    trained = CoverRun(
        (Path("a"), Path("b")), WorldSpec("delivery"), ("deliver",), 2, returns={"deliver": 9.0}
    )
    assert CoverRun.from_json(json.loads(json.dumps(trained.to_json()))) == trained
    for kind in (AlignRun, CoverRun):
        with pytest.raises(ValueError, match="configuration is damaged"):
            kind.from_json({})
