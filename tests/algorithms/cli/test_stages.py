"""The single commands, one after the other, and what they leave."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any

import pytest

from moral_algorithms import pipeline
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.networks.files import load_conditioned_policy, load_policy, load_reward
from moral_algorithms.pipeline import CoverRun, MoralRun, evaluate, spawn_seeds
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.cli.commands import AIRL, DEMONSTRATE, EXPERT, RULES, TRAIN, contents, ppo, run
from tests.algorithms.cli.conftest import Stages

WORLD = WorldSpec("emergency", {RULES[i]: int(RULES[i + 1]) for i in range(1, len(RULES), 2)})


def test_every_stage_leaves_what_the_next_one_needs(stages: Stages) -> None:
    assert load_policy(stages.expert / "policy.safetensors").world == WORLD
    demonstrations = Demonstrations.load(stages.demonstrations)
    assert (demonstrations.world, demonstrations.num_episodes) == (WORLD, 4)
    _, normaliser, world = load_reward(stages.airl / "reward.safetensors")
    summary = json.loads((stages.airl / "summary.json").read_text())
    assert (normaliser, world) == (summary["normaliser"], WORLD)
    assert load_policy(stages.moral / "policy.safetensors").world == WORLD
    summary = json.loads((stages.moral / "summary.json").read_text())
    assert summary["queries"] == 3
    assert summary["weights"].keys() == {"extinguish", "learned_1"}
    assert sum(summary["weights"].values()) == pytest.approx(1)
    assert summary["env_steps"] == {"primary": 128 + 200 * 8, "moral": 640}


def test_the_same_seed_gives_the_same_result(stages: Stages, tmp_path: Path) -> None:
    expert, recorded, airl = (tmp_path / name for name in ("expert", "demonstrations.npz", "airl"))
    assert run(*EXPERT, "--out", expert) == 0
    assert run(*DEMONSTRATE, "--expert", expert, "--out", recorded) == 0
    assert run(*AIRL, "--demonstrations", recorded, "--out", airl) == 0
    networks = ("policy.safetensors", "reward.safetensors")
    for made, before in ((expert, stages.expert), (airl, stages.airl)):
        again, first = contents(made), contents(before)
        assert [again.get(name) for name in networks] == [first.get(name) for name in networks]
    first_states, states = (Demonstrations.load(path).states for path in (stages.demonstrations, recorded))
    assert (first_states == states).all()


def test_worlds_are_compared_by_what_they_are(tmp_path: Path) -> None:
    expert, recorded, airl = (tmp_path / name for name in ("expert", "demonstrations.npz", "airl"))
    steps = ("--rules", "max_cycles", "8")
    assert run(*EXPERT, *steps, "--out", expert) == 0
    assert run(*DEMONSTRATE, "--expert", expert, "--out", recorded) == 0
    assert run(*AIRL, *steps, "height", "8", "--demonstrations", recorded, "--out", airl) == 0
    spelled = ("--world", "emergency", *steps, "num_people", "6")
    assert run(*TRAIN, *spelled, "--rewards", airl, "--out", tmp_path / "moral") == 0


def test_without_a_world_moral_trains_in_that_of_the_rewards(stages: Stages, tmp_path: Path) -> None:
    command, options = TRAIN[0], TRAIN[1 + len(RULES) :]
    assert run(command, *options, "--rewards", stages.airl, "--out", tmp_path) == 0
    policy = "policy.safetensors"
    assert (tmp_path / policy).read_bytes() == (stages.moral / policy).read_bytes()


def test_another_seed_gives_another_result(stages: Stages, tmp_path: Path) -> None:
    assert run(*EXPERT, "--out", tmp_path, "--seed", "1") == 0
    policy = "policy.safetensors"
    assert (tmp_path / policy).read_bytes() != (stages.expert / policy).read_bytes()


@pytest.mark.parametrize("teacher", ["ratio", "target"])
def test_several_experts_and_another_teacher(teacher: str, stages: Stages, tmp_path: Path) -> None:
    options = ("--teacher", teacher, f"--{teacher}", "goal_time", "3", "people_saved", "1")
    assert run(*TRAIN, "--rewards", stages.airl, stages.airl, "--out", tmp_path, *options) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert list(summary["weights"]) == ["extinguish", "learned_1", "learned_2"]
    assert {"learned_1.safetensors", "learned_2.safetensors"} <= contents(tmp_path).keys()
    stored = json.loads((tmp_path / "config.json").read_text())["teacher"]
    assert (stored["teacher"], stored[teacher]) == (teacher, {"goal_time": 3.0, "people_saved": 1.0})
    assert run("train", "--resume", "--out", tmp_path) == 0


def test_given_rewards_are_balanced_without_an_expert(tmp_path: Path) -> None:
    given = ("--primary", "extinguish", "save", "--returns", "extinguish", "0.5", "save", "1.5")
    assert run(*TRAIN, *given, "--out", tmp_path / "moral") == 0
    weights = json.loads((tmp_path / "moral" / "summary.json").read_text())["weights"]
    assert weights.keys() == {"extinguish", "save"}
    assert run("replay", "--run", tmp_path / "moral", "--out", tmp_path / "again") == 0
    again = json.loads((tmp_path / "again" / "summary.json").read_text())["weights"]
    assert again == weights
    cover = ("cover", *RULES, "--steps", "64", "--no-tensorboard", *given, *ppo())
    assert run(*cover, "--out", tmp_path / "covered") == 0
    assert load_conditioned_policy(tmp_path / "covered" / "covering.safetensors").policy.components == 2


def test_event_files_go_into_the_run_directory(tmp_path: Path) -> None:
    assert run(*(word for word in EXPERT if word != "--no-tensorboard"), "--out", tmp_path) == 0
    assert list(tmp_path.glob("tensorboard/events.out.tfevents.*"))


def test_an_evaluation_is_seeded_and_set_beside_the_optimum(
    stages: Stages, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(*options: str) -> dict[str, dict[str, float]]:
        capsys.readouterr()
        assert run("evaluate", "--run", stages.moral, "--episodes", "16", "--json", *options) == 0
        result: dict[str, dict[str, float]] = json.loads(capsys.readouterr().out)
        return result

    first = measure()
    assert first == measure()
    assert first["objectives"] != measure("--seed", "1")["objectives"]
    likeliest = measure("--deterministic")
    assert likeliest["optimum"] == first["optimum"]
    assert first["optimum"]["people_saved"] >= first["objectives"]["people_saved"]
    assert first["objectives"].keys() == first["standard_errors"].keys() == {"goal_time", "people_saved"}
    assert all(error > 0 for error in first["standard_errors"].values())


def test_an_agent_is_not_measured_on_the_starts_of_the_demonstrations(
    stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = []

    def watched(*arguments: Any) -> Any:
        found = evaluate(*arguments)
        measured.append(found.starts)
        return found

    monkeypatch.setattr(pipeline, "evaluate", watched)
    assert run("evaluate", "--run", stages.expert, "--episodes", "4") == 0
    demonstrated = Demonstrations.load(stages.demonstrations).states[:, 0]
    assert measured[0].shape == demonstrated.shape
    assert not (measured[0] == demonstrated).all(axis=(1, 2, 3)).all()


@pytest.mark.parametrize(("world", "steps"), [("emergency", 150_000), ("delivery", 1_000_000)])
def test_primary_components_are_normalised_as_suits_the_world(
    world: str, steps: int, capsys: pytest.CaptureFixture[str]
) -> None:
    for make in (MoralRun, CoverRun):
        assert make(rewards=(), world=WorldSpec(world)).normaliser.max_steps == steps
    for command in ("train", "live", "cover"):
        capsys.readouterr()
        assert run(command, "--world", world, "--help") == 0
        _, shown = capsys.readouterr().out.split("--normaliser.max-steps", 1)
        assert f"(default: {steps})" in shown.split("--normaliser", 1)[0]


def test_one_episode_has_no_standard_error(stages: Stages, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("evaluate", "--run", stages.moral, "--episodes", "1", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["standard_errors"] == {"goal_time": None, "people_saved": None}
    assert run("evaluate", "--run", stages.moral, "--episodes", "1") == 0
    assert "+-" not in capsys.readouterr().out


def test_a_standard_error_is_that_of_the_sample(stages: Stages) -> None:
    policy, world = load_policy(stages.moral / "policy.safetensors")
    found = evaluate(policy, world, 16, seed=0)
    starts_seed, actions_seed = spawn_seeds(0, 2)
    with sampling_seed(actions_seed):
        counters = play_episodes(policy, world.build(), 16, starts_seed).objectives
    wanted = [statistics.stdev(column) / 4 for column in counters.T.tolist()]
    assert list(found.standard_errors.values()) == pytest.approx(wanted)


def test_an_evaluation_is_shown_as_a_table(stages: Stages, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("evaluate", "--run", stages.moral, "--episodes", "4") == 0
    out = capsys.readouterr().out
    assert "exact optimum" in out
    assert "people_saved" in out
    assert "\x1b" not in out


def test_people_who_walk_are_evaluated_without_an_optimum(
    stages: Stages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, options in enumerate([("--world", "burning_warehouse"), ("--rules", "walk", "1")]):
        policy = tmp_path / str(number)
        assert run(*EXPERT, *options, "--out", policy) == 0
        capsys.readouterr()
        assert run("evaluate", "--run", policy, "--episodes", "4", "--json") == 0
        result = json.loads(capsys.readouterr().out)
        assert result["optimum"] is None
        assert result["objectives"].keys() == {"goal_time", "people_saved"}


def test_delivery_is_evaluated_without_an_optimum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rules = ("--world", "delivery", "--rules", "max_cycles", "8")
    assert run(*EXPERT, "--out", tmp_path, *rules, "--weights", "1", "1", "1", "0") == 0
    capsys.readouterr()
    assert run("evaluate", "--run", tmp_path, "--episodes", "4", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["optimum"] is None
    assert result["objectives"].keys() == {"delivered", "helped", "cleaned", "vases_broken"}


def test_defaults_are_those_of_the_world(tmp_path: Path) -> None:
    counts = {"num_deliveries": 2, "num_people": 2, "num_pollution": 2, "num_vases": 2}
    expert = ("expert", "--world", "delivery", "--weights", "0", "1", "0", "1", "--no-tensorboard")
    rules = ("--rules", *(word for rule, count in counts.items() for word in (rule, str(count))))
    short = ("--max-steps", "128", *ppo())
    assert run(*expert, *rules, *short, "--out", tmp_path / "expert") == 0
    stored = RunDirectory(tmp_path / "expert").read_config()["expert"]
    assert stored["patience"] == pipeline.expert_config("delivery").patience
    assert stored["max_steps"] == 128
    recorded = tmp_path / "recorded.npz"
    assert run(*DEMONSTRATE, "--expert", tmp_path / "expert", "--out", recorded) == 0
    assert run(*AIRL, "--demonstrations", recorded, "--out", tmp_path / "airl") == 0
    stored = RunDirectory(tmp_path / "airl").read_config()["airl"]
    assert stored["architecture"] == pipeline.airl_config("delivery").architecture == "counting"
    assert stored["steps"] == 128
