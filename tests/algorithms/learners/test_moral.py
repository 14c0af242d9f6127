"""MORAL on a tiny world with both true rewards: what it learns, what it writes and how it goes on."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from moral_algorithms.bridge import PrimaryReward, Replay
from moral_algorithms.learners import resuming
from moral_algorithms.learners.inference import make_posterior
from moral_algorithms.learners.moral import MoralConfig, require_trainable, train_moral
from moral_algorithms.learners.ppo import Progress
from moral_algorithms.preferences import (
    ACQUISITIONS,
    BallPrior,
    BradleyTerry,
    ExponentialProxy,
    LexicographicTeacher,
    NoisyTeacher,
    RationalityPrior,
    Teacher,
)
from moral_algorithms.run_directory import RunDirectory, append_line, read_lines
from moral_algorithms.storage import StorageError, read_tensors
from moral_envs import windy_wall_v0
from moral_envs.engine import Engine
from tests.algorithms.full_disk import files_in, full_disk
from tests.algorithms.learners.stopping import Recorder, require_same, stop_at
from tests.algorithms.tiny import EMERGENCY, parameters, ppo_config

WORLD = EMERGENCY.build()

# About what policies that pursue one component alone reach.
NORMALISERS = {"extinguish": 0.68, "save": 1.9}


def config(**changes: Any) -> MoralConfig:
    """Rollouts of 64 steps, in which 8 episodes end."""
    values: dict[str, Any] = {
        "steps": 1280,
        "queries": 4,
        "query_span": 0.75,
        "candidates": 50,
        "acquisition": "mutual_information",
        "prior": "rationality",
        "likelihood": "bradley_terry",
        "sampler": "hit_and_run",
        "samples": 100,
        "checkpoint_every": 1000,
        "ppo": ppo_config(num_envs=8, rollout_steps=8, batch_size=32, epochs=1),
    }
    return MoralConfig(**{**values, **changes})


class Result(NamedTuple):
    """All that must be equal after a run that was interrupted and one that was not."""

    weights: list[float]
    env_steps: int
    policy: dict[str, NDArray[Any]]
    queries: bytes
    metrics: bytes
    checkpoint: dict[str, NDArray[Any]]
    metadata: dict[str, Any]


def run(
    path: Path,
    teacher: Teacher,
    settings: MoralConfig,
    on_progress: Callable[[Progress], None] | None = None,
    seed: int = 0,
) -> Result:
    directory = RunDirectory(path)
    path.mkdir(exist_ok=True)
    components = [PrimaryReward(WORLD.reward_names, name, 1 / value) for name, value in NORMALISERS.items()]
    agent = train_moral(
        EMERGENCY, components, teacher, settings, seed, directory, on_progress=on_progress, resume=True
    )
    queries = directory.queries.read_bytes() if directory.queries.exists() else b""
    checkpoint, metadata = read_tensors(directory.checkpoint, "moral-checkpoint")
    return Result(
        agent.weights.tolist(),
        agent.env_steps,
        parameters(agent.policy),
        queries,
        directory.metrics.read_bytes(),
        checkpoint,
        metadata,
    )


@pytest.mark.parametrize("steps", [1280, 1281, 1300])
def test_all_queries_are_asked_by_the_last_rollout(steps: int, tmp_path: Path) -> None:
    result = run(tmp_path, Recorder(), config(steps=steps, query_span=1.0))
    assert result.queries.count(b"\n") == 4


def test_a_training_without_whole_episodes_before_its_end_is_refused(tmp_path: Path) -> None:
    assert run(tmp_path / "one", Recorder(), config(steps=65, queries=1)).queries.count(b"\n") == 1
    with pytest.raises(ValueError, match=r"^steps is 64; it must be at least 65, for queries compare whole"):
        run(tmp_path / "two", Recorder(), config(steps=64, queries=1))
    assert run(tmp_path / "three", Recorder(), config(steps=64, queries=0)).queries == b""
    # Episodes that end in the second rollout of 40 steps, after which a third one begins.
    ppo = ppo_config(num_envs=8, rollout_steps=5, batch_size=40, epochs=1)
    with pytest.raises(ValueError, match=r"^steps is 80; it must be at least 81, for queries compare whole"):
        run(tmp_path / "four", Recorder(), config(steps=80, queries=1, ppo=ppo))
    assert run(tmp_path / "five", Recorder(), config(steps=81, queries=1, ppo=ppo)).queries.count(b"\n") == 1


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    alone = config(ppo=ppo_config(num_envs=1, rollout_steps=8, batch_size=8, epochs=1))
    with pytest.raises(ValueError, match=r"^ppo\.num_envs is 1; it must be at least 2, to compare episodes"):
        run(tmp_path / "alone", Recorder(), alone)
    with pytest.raises(ValueError, match="episodes must all take the same number of steps"):
        require_trainable(config(), windy_wall_v0.world())


def require_equal(got: Result, expected: Result) -> None:
    for name in ("weights", "env_steps", "queries", "metrics", "metadata"):
        assert getattr(got, name) == getattr(expected, name), name
    require_same(got.policy, expected.policy)
    require_same(got.checkpoint, expected.checkpoint)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, Recorder]:
    path = tmp_path_factory.mktemp("uninterrupted") / "run"
    teacher = Recorder()
    return path, run(path, teacher, config(), seed=0), teacher


def test_the_teachers_first_objective_gets_the_weight(tmp_path: Path) -> None:
    teacher = LexicographicTeacher(("people_saved", "goal_time"), WORLD.objective_names)
    result = run(tmp_path, teacher, config(steps=2560, queries=8, samples=300))
    # The prior mean is 0.5. Twelve runs of this size ended at 0.80 to 0.84.
    assert result.weights[1] > 0.7
    assert sum(result.weights) == pytest.approx(1)
    opposite = LexicographicTeacher(("goal_time",), WORLD.objective_names)
    result = run(tmp_path / "opposite", opposite, config(steps=2560, queries=8, samples=300))
    assert result.weights[0] > 0.7


def test_queries_are_asked_at_even_intervals(uninterrupted: tuple[Path, Result, Recorder]) -> None:
    path, result, teacher = uninterrupted
    answers = read_lines(path / "queries.jsonl")
    # Every 0.75 * 1280 / 4 = 240 steps, at the first rollout of 64 that starts then or later.
    assert [answer["env_steps"] for answer in answers] == [256, 512, 768, 960]
    assert [answer["query"] for answer in answers] == [0, 1, 2, 3]
    assert len(teacher.asked) == 4
    assert result.env_steps == 1280


def test_a_query_shows_two_different_recent_episodes(uninterrupted: tuple[Path, Result, Recorder]) -> None:
    path, _, teacher = uninterrupted
    scale = np.array([0.1, 1.0]) / list(NORMALISERS.values())
    seen: set[tuple[int, str]] = set()
    for answer, query in zip(read_lines(path / "queries.jsonl"), teacher.asked, strict=True):
        np.testing.assert_array_equal(query.returns, answer["returns"])
        np.testing.assert_array_equal(query.objectives, answer["objectives"])
        np.testing.assert_allclose(query.returns, query.objectives * scale, rtol=1e-5)
        episodes = [Replay.from_json(episode) for episode in answer["episodes"]]
        for episode, objectives in zip(episodes, answer["objectives"], strict=True):
            # What was shown can be played again.
            engine = Engine(WORLD)
            engine.seed(np.array([episode.stream], dtype=np.uint64))
            engine.reset()
            for actions in episode.actions:
                engine.step(actions[None])
            assert engine.objectives[0, 0].tolist() == objectives
        keys = {(episode.stream, episode.actions.tobytes()) for episode in episodes}
        assert len(keys) == 2, "an episode was compared with itself"
        # Only episodes since the last query are candidates.
        assert not keys & seen
        seen |= keys  # type: ignore[arg-type]


def test_no_episode_is_compared_with_itself(tmp_path: Path) -> None:
    # Two episodes to choose from, and a choice that does not look at them.
    pairs = ppo_config(num_envs=2, rollout_steps=8, batch_size=16, epochs=1)
    settings = config(steps=160, queries=10, query_span=0.9, acquisition="random", ppo=pairs)
    run(tmp_path, Recorder(), settings)
    answers = read_lines(tmp_path / "queries.jsonl")
    assert len(answers) == 10
    assert all(answer["episodes"][0] != answer["episodes"][1] for answer in answers)


@pytest.mark.parametrize("acquisition", ["random", "volume_removal"])
def test_the_best_of_the_candidates_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, acquisition: str
) -> None:
    scored: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    original = ACQUISITIONS[acquisition]

    def watched(samples: Any, candidates: Any, likelihood: Any, rng: Any) -> NDArray[np.float64]:
        scores = original(samples, candidates, likelihood, rng)
        scored.append((candidates, scores))
        return scores

    monkeypatch.setitem(ACQUISITIONS, acquisition, watched)
    teacher = Recorder()
    run(tmp_path, teacher, config(acquisition=acquisition, steps=640, queries=2))
    assert len(scored) == len(teacher.asked) == 2
    for (candidates, scores), query in zip(scored, teacher.asked, strict=True):
        assert candidates.shape[1:] == (2, 2)
        assert 0 < len(candidates) <= 50
        assert not np.isclose(candidates[:, 0], candidates[:, 1]).all(axis=1).any()
        np.testing.assert_array_equal(query.returns, candidates[scores.argmax()])


def test_weights_are_replaced_after_each_answer(uninterrupted: tuple[Path, Result, Recorder]) -> None:
    path, result, _ = uninterrupted
    metrics = read_lines(path / "metrics.jsonl")
    assert [line["env_steps"] for line in metrics] == list(range(64, 1281, 64))
    for line in metrics:
        assert line.keys() == {"env_steps", "queries", "weights", "objectives"}
        assert line["weights"].keys() == {"extinguish", "save"}
        assert sum(line["weights"].values()) == pytest.approx(1)
        assert line["objectives"].keys() == {"goal_time", "people_saved"}
    # A rollout that starts where a query is asked is the first under its weights.
    assert [line["queries"] for line in metrics] == [0] * 4 + [1] * 4 + [2] * 4 + [3] * 3 + [4] * 5
    weights = [tuple(line["weights"].values()) for line in metrics]
    assert weights[0] == (0.5, 0.5)
    changed = [row for row in range(1, 20) if weights[row] != weights[row - 1]]
    assert changed == [4, 8, 12, 15]
    assert weights[-1] == pytest.approx(result.weights)


def test_progress_counts_queries(tmp_path: Path) -> None:
    reported: list[Progress] = []
    run(tmp_path, Recorder(), config(), reported.append)
    assert [progress.queries for progress in reported] == [0] * 4 + [1] * 4 + [2] * 4 + [3] * 3 + [4] * 5
    assert reported[-1].steps == reported[-1].total_steps == 1280


@pytest.mark.parametrize("asked_before", [0, 1, 3])
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


@pytest.mark.parametrize("answer", [0, 2, 3])
def test_an_answer_that_no_checkpoint_followed_is_not_asked_again(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    uninterrupted: tuple[Path, Result, Recorder],
    answer: int,
) -> None:
    _, expected, _ = uninterrupted
    original = resuming.write_tensors
    written = 0

    def fail_once(path: Path, *arguments: Any) -> None:
        nonlocal written
        written += 1
        if written == answer + 1:
            raise StorageError(f"cannot write {path}: No space left on device")
        original(path, *arguments)

    monkeypatch.setattr(resuming, "write_tensors", fail_once)
    first, second = Recorder(), Recorder()
    with pytest.raises(StorageError, match="No space left"):
        run(tmp_path, first, config())
    assert len(read_lines(tmp_path / "queries.jsonl")) == answer + 1
    require_equal(run(tmp_path, second, config()), expected)
    assert (len(first.asked), len(second.asked)) == (answer + 1, 3 - answer)


@pytest.mark.parametrize("steps", [64, 704, 1216])
def test_a_run_killed_between_queries_ends_the_same(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder], steps: int
) -> None:
    _, expected, _ = uninterrupted

    first, second = Recorder(), Recorder()
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first, config(), stop_at(steps))
    # Killed while it wrote a line.
    with (tmp_path / "metrics.jsonl").open("ab") as file:
        file.write(b'{"env_st')
    require_equal(run(tmp_path, second, config()), expected)
    assert len(first.asked) + len(second.asked) == 4


def test_a_run_that_is_done_stays_as_it_is(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    _, expected, _ = uninterrupted
    require_equal(run(tmp_path, Recorder(), config()), expected)
    silent = Recorder(interrupt_at=0)
    require_equal(run(tmp_path, silent, config()), expected)


def test_a_full_disk_keeps_the_last_checkpoint(tmp_path: Path) -> None:
    with ExitStack() as stack:

        def fill(progress: Progress) -> None:
            if progress.queries == 2:
                # Room for lines, not for a checkpoint.
                stack.enter_context(full_disk(20_000))

        with pytest.raises(StorageError, match=r"cannot write .*checkpoint\.safetensors"):
            run(tmp_path, Recorder(), config(), fill)
    _, metadata = read_tensors(tmp_path / "checkpoint.safetensors", "moral-checkpoint")
    assert len(metadata["posterior"]["preferences"]) == 2
    assert len(read_lines(tmp_path / "queries.jsonl")) == 3
    assert files_in(tmp_path) == ["checkpoint.safetensors", "metrics.jsonl", "queries.jsonl"]


def test_how_often_is_saved_changes_nothing(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    often = config(checkpoint_every=3)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, Recorder(), often, stop_at(384))
    _, metadata = read_tensors(tmp_path / "checkpoint.safetensors", "moral-checkpoint")
    # Between two answers, with episodes at hand from which the next query is chosen.
    assert metadata["ppo"]["num_timesteps"] == 320
    require_equal(run(tmp_path, Recorder(), often), uninterrupted[1])


def test_a_start_does_not_adopt_what_another_run_left(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    components = [PrimaryReward(WORLD.reward_names, name) for name in WORLD.reward_names]
    for left in ("checkpoint.safetensors", "queries.jsonl"):
        path = tmp_path / left
        path.mkdir()
        (path / left).write_bytes((uninterrupted[0] / left).read_bytes())
        with pytest.raises(StorageError, match=f"{left} is there already"):
            train_moral(EMERGENCY, components, Recorder(), config(), 0, RunDirectory(path))
        assert files_in(path) == [left]


def test_more_queries_than_batches_of_episodes_are_all_asked(tmp_path: Path) -> None:
    teacher = Recorder()
    run(tmp_path, teacher, config(steps=640, queries=12, query_span=0.75))
    assert len(teacher.asked) == 12
    assert all(answer["env_steps"] <= 0.75 * 640 + 64 for answer in read_lines(tmp_path / "queries.jsonl"))


def test_skipped_queries_never_reach_the_posterior(tmp_path: Path) -> None:
    teacher = Recorder(skip=[0, 2])
    result = run(tmp_path, teacher, config())
    answers = read_lines(tmp_path / "queries.jsonl")
    assert len(teacher.asked) == 6
    assert [answer["query"] for answer in answers] == [0, 1, 2, 3]
    answered = [query.returns.tolist() for number, query in enumerate(teacher.asked) if number not in (0, 2)]
    assert [answer["returns"] for answer in answers] == answered
    assert result.checkpoint["posterior.returns"].tolist() == answered
    assert result.metadata["posterior"]["preferences"] == [answer["preference"] for answer in answers]


def test_a_teacher_who_always_skips_leaves_the_prior(tmp_path: Path) -> None:
    result = run(tmp_path, Recorder(skip=range(100)), config(steps=640))
    assert result.weights == [0.5, 0.5]
    assert result.queries == b""
    assert {line["queries"] for line in read_lines(tmp_path / "metrics.jsonl")} == {0}


def test_without_queries_it_trains_under_the_prior_mean(tmp_path: Path) -> None:
    teacher = Recorder()
    result = run(tmp_path, teacher, config(steps=256, queries=0))
    assert teacher.asked == []
    assert result.weights == [0.5, 0.5]
    assert result.env_steps == 256


def test_checkpoints_follow_answers_and_every_so_many_rollouts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[int] = []
    original = resuming.write_tensors

    def watched(path: Path, arrays: Any, metadata: dict[str, Any]) -> None:
        steps.append(metadata["ppo"]["num_timesteps"])
        original(path, arrays, metadata)

    monkeypatch.setattr(resuming, "write_tensors", watched)
    run(tmp_path, Recorder(), config(checkpoint_every=3))
    answered = {256, 512, 768, 960}
    assert steps == sorted({*answered, *range(128, 1280, 192), 1280})


@pytest.mark.parametrize(
    "damage",
    [
        lambda answer: answer.pop("returns"),
        lambda answer: answer.update(preference="both"),
        lambda answer: answer.update(query=7),
        lambda answer: answer.update(objectives=[[1, 2]]),
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
    silent = Recorder(interrupt_at=0)
    with pytest.raises(StorageError, match=r"queries\.jsonl is damaged in line 2") as error:
        run(tmp_path, silent, config())
    assert "\n" not in str(error.value)
    assert not (tmp_path / "metrics.jsonl").exists()


def test_a_teacher_that_cannot_go_on_from_what_is_recorded_is_named(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    answers = read_lines(uninterrupted[0] / "queries.jsonl")
    answers[0]["teacher"] = {"rng": 0}
    for answer in answers:
        append_line(tmp_path / "queries.jsonl", answer)
    noisy = NoisyTeacher(Recorder(), 0.1, np.random.default_rng(0))
    with pytest.raises(StorageError, match=r"queries\.jsonl is damaged: it holds a state that") as error:
        run(tmp_path, noisy, config())
    assert "\n" not in str(error.value)


def test_a_checkpoint_of_another_run_is_refused(
    tmp_path: Path, uninterrupted: tuple[Path, Result, Recorder]
) -> None:
    for name in ("checkpoint.safetensors", "queries.jsonl"):
        (tmp_path / name).write_bytes((uninterrupted[0] / name).read_bytes())
    others = [
        config(ppo=ppo_config(policy="paper", num_envs=8, rollout_steps=8, batch_size=32)),
        config(ppo=ppo_config(num_envs=4, rollout_steps=16, batch_size=32)),
        config(samples=200),
    ]
    for other in others:
        with pytest.raises(StorageError, match="does not fit this run") as error:
            run(tmp_path, Recorder(), other)
        assert "\n" not in str(error.value)
    (tmp_path / "queries.jsonl").unlink()
    with pytest.raises(StorageError, match=r"queries\.jsonl has 0 answers; the checkpoint has 4"):
        run(tmp_path, Recorder(), config())


def test_the_posterior_is_the_one_asked_for() -> None:
    rng = np.random.default_rng(0)
    posterior = make_posterior(config(), 3, rng)
    assert posterior.prior == RationalityPrior(3)
    assert posterior.likelihood == BradleyTerry(lapse=0.1)
    assert posterior.samples.shape == (100, 3)
    posterior = make_posterior(config(prior="ball", likelihood="exponential", lapse=0.0), 2, rng)
    assert posterior.prior == BallPrior(2)
    assert isinstance(posterior.likelihood, ExponentialProxy)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps is 0; it must be at least 1"),
        ({"queries": -1}, "queries is -1; it must be at least 0"),
        ({"candidates": 0}, "candidates is 0"),
        ({"samples": 1}, "samples is 1; it must be at least 2"),
        ({"checkpoint_every": 0}, "checkpoint_every is 0"),
        ({"query_span": 0.0}, "query_span is 0.0; it must be above 0 and at most 1"),
        ({"query_span": 1.5}, "query_span is 1.5"),
        ({"acquisition": "best"}, "acquisition is 'best'; it must be one of"),
        ({"prior": "flat"}, r"prior is 'flat'; it must be one of \['ball', 'rationality'\]"),
        ({"likelihood": "x"}, "likelihood is 'x'; it must be one of"),
        ({"sampler": "gibbs"}, "sampler is 'gibbs'; it must be one of"),
    ],
)
def test_impossible_configurations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        config(**changes)


def test_answers_are_lines_of_plain_json(uninterrupted: tuple[Path, Result, Recorder]) -> None:
    _, result, _ = uninterrupted
    lines = result.queries.splitlines()
    asked = {"query", "posterior", "env_steps", "expected", "repeats", "returns", "objectives", "episodes"}
    answered = {"version", "record", "preference", "who", "seconds", "when", "key", "teacher"}
    assert all(json.loads(line).keys() == asked | answered for line in lines)
    assert Counter(json.loads(line)["preference"] for line in lines).keys() <= {"first", "second", "equal"}
