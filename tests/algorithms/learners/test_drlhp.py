"""DRLHP on a tiny world: what it learns, what it sees, what it asks, what it writes and how it goes on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from moral_algorithms.bridge import EngineVecEnv, Replay
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners import interview
from moral_algorithms.learners.clips import play_again
from moral_algorithms.learners.drlhp import PRESETS, DRLHPConfig, require_fitting, train_drlhp
from moral_algorithms.learners.ppo import Progress, sampling_seed
from moral_algorithms.learners.reward_model import RewardModelConfig, disagreement
from moral_algorithms.networks.rewards import ActionRewardEnsemble
from moral_algorithms.preferences import LexicographicTeacher, Teacher
from moral_algorithms.run_directory import RunDirectory, append_line, read_lines
from moral_algorithms.storage import StorageError, read_tensors
from moral_algorithms.worlds import WORLDS, WorldSpec
from moral_envs import windy_wall_v0
from moral_envs.world import World
from tests.algorithms.full_disk import files_in
from tests.algorithms.learners.stopping import Recorder, require_same, stop_at
from tests.algorithms.tiny import EMERGENCY, parameters, ppo_config

WORLD = EMERGENCY.build()


def config(**changes: Any) -> DRLHPConfig:
    """Rollouts of 64 steps, in which 8 episodes end."""
    values: dict[str, Any] = {
        "steps": 640,
        "queries": 12,
        "clip_length": 4,
        "initial_share": 0.25,
        "schedule": "constant",
        "query_span": 0.75,
        "candidates": 5,
        "checkpoint_every": 1000,
        "reward": RewardModelConfig(members=2, updates=2, initial_updates=3, batch_size=4),
        "ppo": ppo_config(num_envs=8, rollout_steps=8, batch_size=32, epochs=1),
    }
    return DRLHPConfig(**{**values, **changes})


class Result(NamedTuple):
    """All that must be equal after a run that was interrupted and one that was not."""

    env_steps: int
    policy: dict[str, NDArray[Any]]
    network: dict[str, NDArray[Any]]
    queries: bytes
    metrics: bytes
    checkpoint: dict[str, NDArray[Any]]
    metadata: dict[str, Any]


def run(
    path: Path,
    teacher: Teacher,
    settings: DRLHPConfig,
    on_progress: Callable[[Progress], None] | None = None,
    world: WorldSpec = EMERGENCY,
) -> Result:
    directory = RunDirectory(path)
    path.mkdir(exist_ok=True)
    agent = train_drlhp(world, teacher, settings, 0, directory, on_progress=on_progress, resume=True)
    checkpoint, metadata = read_tensors(directory.checkpoint, "drlhp-checkpoint")
    return Result(
        agent.env_steps,
        parameters(agent.policy),
        parameters(agent.network),
        directory.queries.read_bytes() if directory.queries.exists() else b"",
        directory.metrics.read_bytes(),
        checkpoint,
        metadata,
    )


def require_equal(got: Result, expected: Result) -> None:
    for name in ("env_steps", "queries", "metrics", "metadata"):
        assert getattr(got, name) == getattr(expected, name), name
    for name in ("policy", "network", "checkpoint"):
        require_same(getattr(got, name), getattr(expected, name))


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, Recorder]:
    path = tmp_path_factory.mktemp("uninterrupted") / "run"
    teacher = Recorder()
    return path, run(path, teacher, config()), teacher


def test_it_learns_what_the_teacher_wants(tmp_path: Path) -> None:
    settings = config(
        steps=7_500,
        queries=150,
        initial_share=0.5,
        reward=RewardModelConfig(updates=8, initial_updates=200, learning_rate=3e-3),
        ppo=ppo_config(num_envs=32, rollout_steps=8),
    )
    teacher = LexicographicTeacher(("goal_time",), WORLD.objective_names)
    agent = train_drlhp(EMERGENCY, teacher, settings, 0, RunDirectory(tmp_path))
    with sampling_seed(0):
        goal_time, _ = play_episodes(agent.policy, WORLD, 200, 0).objectives.mean(axis=0)
    # Of 8 steps; four seeds: 6.8 to 6.9, and 0.9 by chance.
    assert goal_time > 5.0


def test_queries_start_with_the_untrained_policy_and_go_on_at_even_intervals(
    uninterrupted: tuple[Path, Result, Recorder],
) -> None:
    path, result, teacher = uninterrupted
    answers = read_lines(path / "queries.jsonl")
    # Three about the 64 steps of the untrained policy; one of nine every 0.75 * 512 / 9 = 42.7 steps after
    # it, at the end of a rollout of 64.
    ends = [128, 192, 192, 256, 320, 320, 384, 448, 448]
    assert [answer["env_steps"] for answer in answers] == [0, 0, 0, *ends]
    assert [answer["slot"] for answer in answers] == [0, 1, 2, 0, 0, 1, 0, 0, 1, 0, 0, 1]
    assert [answer["query"] for answer in answers] == list(range(12))
    assert len(teacher.asked) == 12
    assert result.env_steps == 640
    lines = read_lines(path / "metrics.jsonl")
    assert [line["env_steps"] for line in lines] == list(range(128, 641, 64))
    assert [line["queries"] for line in lines] == [4, 6, 7, 9, 10, 12, 12, 12, 12]
    assert all(line.keys() == {"env_steps", "queries", "losses", "objectives"} for line in lines)


def test_the_teacher_sees_the_clip_and_nothing_else(uninterrupted: tuple[Path, Result, Recorder]) -> None:
    path, _, teacher = uninterrupted
    elsewhere = False
    for answer, query in zip(read_lines(path / "queries.jsonl"), teacher.asked, strict=True):
        assert answer["length"] == 4
        recording = play_again(WORLD, [Replay.from_json(episode) for episode in answer["episodes"]])
        counted = [
            recording.counters[row, start + 4] - recording.counters[row, start]
            for row, start in enumerate(answer["starts"])
        ]
        np.testing.assert_array_equal(query.objectives, counted)
        assert query.objectives.tolist() == answer["objectives"]
        assert query.returns[:, 0].tolist() == answer["returns"]
        elsewhere |= bool((recording.counters[:, -1] != counted).any())
    assert elsewhere, "in no episode anything happened outside its clip"


def test_of_whole_episodes_the_final_counters_are_shown(tmp_path: Path) -> None:
    teacher = Recorder()
    run(tmp_path, teacher, config(clip_length=0, steps=320))
    for answer, query in zip(read_lines(tmp_path / "queries.jsonl"), teacher.asked, strict=True):
        assert (answer["starts"], answer["length"]) == ([0, 0], WORLD.horizon)
        recording = play_again(WORLD, [Replay.from_json(episode) for episode in answer["episodes"]])
        np.testing.assert_array_equal(query.objectives, recording.counters[:, -1])


def test_the_worlds_rewards_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    """Noise instead of the reward vector and of the final counters: the same training, bit by bit."""
    rng = np.random.default_rng(0)
    step_wait = EngineVecEnv.step_wait
    replaced = 0

    def noisy(venv: EngineVecEnv) -> Any:
        nonlocal replaced
        observations, _, dones, infos = step_wait(venv)
        assert venv.transitions is not None
        noise = rng.normal(size=venv.transitions.vector_rewards.shape).astype(np.float32)
        venv.transitions = venv.transitions._replace(vector_rewards=noise)
        for row, info in enumerate(infos):
            info["vector_reward"] = noise[row]
            if "objectives" in info:
                info["objectives"] = rng.integers(100, size=info["objectives"].shape)
                replaced += 1
        return observations, noise.sum(axis=1), dones, infos

    monkeypatch.setattr(EngineVecEnv, "step_wait", noisy)
    got, expected = run(tmp_path, Recorder(), config()), uninterrupted[1]
    assert replaced > 0
    require_same(got.policy, expected.policy)
    require_same(got.network, expected.network)
    assert got.queries == expected.queries


def test_a_world_that_pays_otherwise_is_learned_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    emergency = WORLDS["emergency"]

    def paid_otherwise(**rules: int) -> World:
        world = emergency(**rules)
        (people,), fixture = world.objects, world.fixture
        assert people.on_interact is not None
        assert fixture is not None
        saving = dataclasses.replace(people.on_interact, amount=-3.0)
        standing = dataclasses.replace(fixture.on_stand, amount=0.7)
        people = dataclasses.replace(people, on_interact=saving)
        fixture = dataclasses.replace(fixture, on_stand=standing)
        return dataclasses.replace(world, objects=(people,), fixture=fixture)

    monkeypatch.setitem(WORLDS, "emergency", paid_otherwise)
    assert EMERGENCY.build() != WORLD
    got, expected = run(tmp_path, Recorder(), config()), uninterrupted[1]
    require_same(got.policy, expected.policy)
    require_same(got.network, expected.network)
    assert got.queries == expected.queries


def test_the_most_disputed_pairs_are_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scored: list[NDArray[np.float64]] = []
    shown: list[Any] = []
    original = disagreement

    def watched(rewards: Any, pairs: Any) -> NDArray[np.float64]:
        scores = original(rewards, pairs)
        scored.append(scores)
        shown.append(pairs)
        return scores

    monkeypatch.setattr(interview, "disagreement", watched)
    run(tmp_path, Recorder(), config(candidates=20))
    answers = read_lines(tmp_path / "queries.jsonl")
    moments = [answer["env_steps"] for answer in answers]
    assert len(scored) == len(set(moments))
    for moment, scores, pairs in zip(sorted(set(moments)), scored, shown, strict=True):
        asked = [answer["starts"] for answer in answers if answer["env_steps"] == moment]
        best = np.argsort(-scores, kind="stable")[: len(asked)]
        assert asked == pairs.starts[best].tolist()
        assert scores[best].min() >= np.delete(scores, best).max() > 0


def test_recent_episodes_are_shown_beside_earlier_ones_too(tmp_path: Path) -> None:
    run(tmp_path, Recorder(), config(steps=1280, queries=60))
    answers = read_lines(tmp_path / "queries.jsonl")
    moments = sorted({answer["env_steps"] for answer in answers})
    first_shown: dict[str, int] = {}
    apart = 0
    for answer in answers:
        episodes = [episode["stream"] for episode in answer["episodes"]]
        ages = [first_shown.setdefault(stream, answer["env_steps"]) for stream in episodes]
        # Of the two, at most one was there at an earlier moment.
        assert max(ages) == answer["env_steps"]
        apart += min(ages) < answer["env_steps"]
    assert len(moments) > 5
    assert apart > 3


def test_before_the_first_answer_nothing_is_paid(tmp_path: Path) -> None:
    result = run(tmp_path, Recorder(skip=range(1000)), config(steps=256))
    assert result.queries == b""
    assert not result.network["scales"].any()
    assert {line["queries"] for line in read_lines(tmp_path / "metrics.jsonl")} == {0}


def test_the_agent_is_paid_standardised_rewards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paid: list[NDArray[np.float32]] = []
    original = ActionRewardEnsemble.standardised

    def watched(self: ActionRewardEnsemble, states: Any, actions: Any) -> Any:
        rewards = original(self, states, actions)
        paid.append(rewards.numpy())
        return rewards

    monkeypatch.setattr(ActionRewardEnsemble, "standardised", watched)
    one = RewardModelConfig(members=1, updates=2, initial_updates=50)
    big = ppo_config(num_envs=64, rollout_steps=8, batch_size=128, epochs=1)
    run(tmp_path, Recorder(), config(steps=4096, queries=100, reward=one, ppo=big))
    rewards = np.concatenate(paid)
    assert abs(rewards.mean()) < 0.3
    assert 0.5 < rewards.std() < 2


def test_rewards_are_standardised_by_whole_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[NDArray[np.uint8]] = []
    original = ActionRewardEnsemble.standardise

    def watched(self: ActionRewardEnsemble, states: Any, actions: Any) -> None:
        assert len(states) == len(actions)
        seen.append(states.numpy().copy())
        original(self, states, actions)

    monkeypatch.setattr(ActionRewardEnsemble, "standardise", watched)
    thirds = ppo_config(num_envs=8, rollout_steps=3, batch_size=24, epochs=1)
    run(tmp_path, Recorder(), config(steps=400, ppo=thirds))
    # The untrained policy's 8 episodes of 8 steps; then rollouts of 3 steps, of which 3 hold an episode.
    assert [len(states) for states in seen[:5]] == [64, 24, 48, 72, 72]
    for before, after in pairwise(seen[3:]):
        np.testing.assert_array_equal(after[:48], before[24:])


@pytest.mark.parametrize("asked_before", [0, 2, 3, 6, 11])
def test_an_interrupted_teacher_is_asked_again_and_the_run_ends_the_same(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder], asked_before: int
) -> None:
    _, expected, everything = uninterrupted
    first = Recorder(interrupt_at=asked_before)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first, config())
    assert len(first.asked) == asked_before
    second = Recorder()
    require_equal(run(tmp_path, second, config()), expected)
    # No answered query is asked again, and the others are those of the other run.
    asked = [query.returns.tolist() for query in first.asked + second.asked]
    assert asked == [query.returns.tolist() for query in everything.asked]


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("steps", [64, 192, 512])
def test_a_run_killed_between_rollouts_ends_the_same(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder], steps: int, every: int
) -> None:
    first, second = Recorder(), Recorder()
    settings = config(checkpoint_every=every)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first, settings, stop_at(steps))
    # Killed while it wrote a line.
    with (tmp_path / "metrics.jsonl").open("ab") as file:
        file.write(b'{"env_st')
    require_equal(run(tmp_path, second, settings), uninterrupted[1])
    assert len(first.asked) + len(second.asked) == 12


def test_a_run_that_is_done_stays_as_it_is(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    require_equal(run(tmp_path, Recorder(), config()), uninterrupted[1])
    require_equal(run(tmp_path, Recorder(interrupt_at=0), config()), uninterrupted[1])


def test_skipped_queries_are_not_learned_from_and_not_asked_again(tmp_path: Path) -> None:
    skip = [1, 4, 5]
    whole = Recorder(skip=skip)
    expected = run(tmp_path / "whole", whole, config())
    answers = read_lines(tmp_path / "whole" / "queries.jsonl")
    assert len(whole.asked) == 15
    assert [answer["query"] for answer in answers] == list(range(12))
    answered = [
        query.returns[:, 0].tolist() for number, query in enumerate(whole.asked) if number not in skip
    ]
    assert [answer["returns"] for answer in answers] == answered
    assert expected.metadata["interview"]["answers"] == 12

    # Interrupted after the skips, without a checkpoint: they are not put to the teacher a second time.
    first = Recorder(skip=skip, interrupt_at=8)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "cut", first, config())
    second = Recorder()
    require_equal(run(tmp_path / "cut", second, config()), expected)
    assert len(first.asked) + len(second.asked) == 15


def test_a_start_does_not_adopt_what_another_run_left(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    for left in ("checkpoint.safetensors", "queries.jsonl"):
        path = tmp_path / left
        path.mkdir()
        (path / left).write_bytes((uninterrupted[0] / left).read_bytes())
        with pytest.raises(StorageError, match=f"{left} is there already"):
            train_drlhp(EMERGENCY, Recorder(), config(), 0, RunDirectory(path))
        assert files_in(path) == [left]


@pytest.mark.parametrize(
    "damage",
    [
        lambda answer: answer.pop("returns"),
        lambda answer: answer.update(preference="both"),
        lambda answer: answer.update(query=7),
        lambda answer: answer.update(slot=0, env_steps=0),
        lambda answer: answer.update(starts=[0, 5]),
        lambda answer: answer.update(starts=[-1, 0]),
        lambda answer: answer.update(length=3),
        lambda answer: answer.update(episodes=answer["episodes"][:1]),
        lambda answer: answer["episodes"][0].update(actions="12"),
        lambda answer: answer["episodes"][0].update(actions="99999999"),
        lambda answer: answer.pop("teacher"),
    ],
)
def test_a_damaged_answer_is_named_before_training(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder], damage: Callable[[dict[str, Any]], object]
) -> None:
    answers = read_lines(uninterrupted[0] / "queries.jsonl")
    damage(answers[1])
    for answer in answers:
        append_line(tmp_path / "queries.jsonl", answer)
    with pytest.raises(StorageError, match=r"queries\.jsonl is damaged in line 2") as error:
        run(tmp_path, Recorder(interrupt_at=0), config())
    assert "\n" not in str(error.value)
    assert not (tmp_path / "metrics.jsonl").exists()


def test_a_checkpoint_of_another_run_is_refused(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    for name in ("checkpoint.safetensors", "queries.jsonl"):
        (tmp_path / name).write_bytes((uninterrupted[0] / name).read_bytes())
    others = [
        config(ppo=ppo_config(policy="paper", num_envs=8, rollout_steps=8, batch_size=32)),
        config(ppo=ppo_config(num_envs=4, rollout_steps=16, batch_size=32)),
        config(reward=RewardModelConfig(members=1)),
        config(reward=RewardModelConfig(architecture="paper", members=2)),
    ]
    for other in others:
        with pytest.raises(StorageError, match="does not fit this run") as error:
            run(tmp_path, Recorder(), other)
        assert "\n" not in str(error.value)
    with pytest.raises(StorageError, match="12 answers; this run asks 5"):
        run(tmp_path, Recorder(), config(queries=5))
    (tmp_path / "queries.jsonl").unlink()
    with pytest.raises(StorageError, match=r"queries\.jsonl has 0 answers; the checkpoint has 12"):
        run(tmp_path, Recorder(), config())


@pytest.mark.parametrize("schedule", ["constant", "decaying"])
@pytest.mark.parametrize("queries", [0, 1, 7, 1000])
def test_every_query_gets_its_time(schedule: str, queries: int) -> None:
    settings = config(schedule=schedule, queries=queries, initial_share=0.25, query_span=0.9)
    due = [settings.due_queries(progress) for progress in np.linspace(0, 1, 201)]
    assert due[0] == settings.initial_queries == round(queries / 4)
    assert due[181:] == [queries] * 20
    assert due == sorted(due)
    if queries == 1000:
        rates = np.diff(due)[:180]
        ratio = rates[:10].sum() / rates[-10:].sum()
        # Decaying: 1 / (0.1 + t) at about 0.025 and 0.875.
        assert ratio == pytest.approx(0.975 / 0.125 if schedule == "decaying" else 1, rel=0.1)


@pytest.mark.parametrize(("training", "last"), [(672, 640), (640, 576)])
def test_no_query_falls_due_when_nothing_is_learned_from_it_any_more(
    training: int, last: int, tmp_path: Path
) -> None:
    # Episodes end after every other rollout of 32: of 672 steps the last 32 are of episodes that never end,
    # and of 640 the last rollout ends with an end of episodes, after which there is no training.
    settings = config(
        steps=64 + training,
        query_span=1.0,
        ppo=ppo_config(num_envs=8, rollout_steps=4, batch_size=32, epochs=1),
    )
    run(tmp_path, Recorder(), settings)
    asked = read_lines(tmp_path / "queries.jsonl")
    assert len(asked) == 12
    # After those of the untrained policy.
    assert asked[-1]["env_steps"] == 64 + last


@pytest.mark.parametrize("world", ["emergency", "delivery"])
def test_the_preset_paper_has_the_settings_of_the_thesis(world: str) -> None:
    spec = WorldSpec(world)
    paper = PRESETS["paper"](spec)
    assert (paper.steps, paper.queries) == (12_000_000, {"emergency": 1000, "delivery": 5000}[world])
    assert (paper.clip_length, paper.initial_share, paper.schedule) == (0, 0.0, "constant")
    assert (paper.reward.architecture, paper.reward.members) == ("paper", 1)
    assert paper.reward.learning_rate == 3e-5
    assert paper.reward.batch_size == {"emergency": 32, "delivery": 12}[world]
    ppo = paper.ppo
    assert (ppo.policy, ppo.num_envs, ppo.learning_rate, ppo.gamma) == ("paper", 12, 3e-4, 0.999)
    assert (ppo.clip_range, ppo.epochs, ppo.entropy_start, ppo.entropy_end) == (0.1, 5, 1.0, 1.0)
    assert ppo.rollout_steps == spec.build().horizon
    # The reward model is updated every 50 environment steps.
    assert paper.reward.updates == ppo.num_envs * ppo.rollout_steps // 50


def test_the_preset_paper_runs(tmp_path: Path) -> None:
    paper = PRESETS["paper"](EMERGENCY)
    result = run(tmp_path, Recorder(), dataclasses.replace(paper, steps=288, queries=5))
    assert result.env_steps == 288
    assert result.metadata["interview"]["answers"] == 5
    assert result.network["scales"].shape == (1,)


def test_the_preset_fast_fits_short_episodes() -> None:
    assert PRESETS["fast"](EMERGENCY).clip_length == 8
    assert PRESETS["fast"](WorldSpec()).clip_length == DRLHPConfig().clip_length


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps is 0; it must be at least 1"),
        ({"queries": -1}, "queries is -1; it must be at least 0"),
        ({"clip_length": -1}, "clip_length is -1"),
        ({"candidates": 0}, "candidates is 0"),
        ({"checkpoint_every": 0}, "checkpoint_every is 0"),
        ({"initial_share": 1.5}, "initial_share is 1.5; it must be 0 to 1"),
        ({"schedule": "never"}, r"schedule is 'never'; it must be one of \['constant', 'decaying'\]"),
        ({"query_span": 0.0}, "query_span is 0.0; it must be above 0 and at most 1"),
    ],
)
def test_impossible_configurations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        config(**changes)


def test_configurations_that_do_not_fit_the_world_are_refused() -> None:
    with pytest.raises(ValueError, match=r"clip_length is 9; an episode of emergency.* has 8 steps"):
        require_fitting(config(clip_length=9), WORLD)
    with pytest.raises(ValueError, match="steps is 64; it must be more than the 64 of the untrained policy"):
        require_fitting(config(steps=64), WORLD)
    # What the second rollout of the policy learns from, the first one's episodes, must be there before it.
    with pytest.raises(
        ValueError, match="steps is 128; it must be at least 129, for queries are about whole"
    ):
        require_fitting(config(steps=128), WORLD)
    require_fitting(config(steps=129), WORLD)
    require_fitting(config(steps=128, initial_share=1.0), WORLD)
    with pytest.raises(ValueError, match=r"ppo\.num_envs is 1; it must be at least 2"):
        require_fitting(config(ppo=ppo_config(num_envs=1)), WORLD)
    with pytest.raises(ValueError, match="episodes must all take the same number of steps"):
        require_fitting(config(), windy_wall_v0.world())
