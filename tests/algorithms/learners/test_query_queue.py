"""Queries that wait for people: what is open, what is retired, what answers do to posterior and pace."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moral_algorithms.answers import AnswerBook, AskedQuery
from moral_algorithms.learners.asking import Episode, QueryChooser
from moral_algorithms.learners.pace import Pace
from moral_algorithms.learners.query_queue import ENOUGH, People, QueryQueue
from moral_algorithms.preferences import BradleyTerry, Posterior, Preference, RationalityPrior
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import RunDirectory

STEPS, QUERIES, SPAN = 1000, 10, 0.75
INTERVAL = SPAN * STEPS / QUERIES


def episodes(scale: float = 1.0, seed: int = 0) -> deque[Episode]:
    """Episodes that trade one return for the other."""
    rng = np.random.default_rng(seed)
    shares = rng.random(40)
    returns = scale * np.stack([shares, 1 - shares], axis=1) + 0.01 * rng.random((40, 2))
    actions = np.zeros((8, 1), dtype=np.uint8)
    return deque(
        Episode(row.astype(np.float32), (row * 10).astype(np.int64), Replay(number, actions))
        for number, row in enumerate(returns)
    )


def make(run: Path, people: People | None = None) -> tuple[QueryQueue, Posterior]:
    run.mkdir(exist_ok=True)
    posterior = Posterior(RationalityPrior(2), BradleyTerry(), num_samples=200, rng=np.random.default_rng(0))
    chooser = QueryChooser(posterior, "expected_regret", 100, 0)
    queue = QueryQueue(people or People(), chooser, posterior, Pace(STEPS, QUERIES, SPAN), RunDirectory(run))
    queue.read()
    return queue, posterior


def say(run: Path, asked: AskedQuery | None, preference: Preference | None = Preference.FIRST) -> None:
    book = AnswerBook(run / "queries.jsonl", "ada")
    assert asked is not None
    book.answer(asked, preference, 1.0, f"key-{len(book.answers.keys)}")


def undo(run: Path, number: int) -> None:
    book = AnswerBook(run / "queries.jsonl", "ada")
    book.undo(number, f"key-{len(book.answers.keys)}")


def test_a_few_queries_are_open_as_soon_as_they_are_due(tmp_path: Path) -> None:
    queue, _ = make(tmp_path)
    folder = QueryFolder(tmp_path)
    counts = []
    for env_steps in (0, int(INTERVAL) + 1, int(2 * INTERVAL) + 1, int(9 * INTERVAL)):
        queue.act(env_steps, episodes())
        counts.append(len(folder.read_open()))
    assert counts == [0, 1, 2, 3]
    expected = list(folder.read_open().values())
    assert expected == sorted(expected, reverse=True)
    # They are not all copies of the best one.
    pairs = [folder.read(number) for number in folder.read_open()]
    differences = [asked.pair.returns[0] - asked.pair.returns[1] for asked in pairs if asked is not None]
    assert len({tuple(np.round(np.abs(difference), 3)) for difference in differences}) >= 2


def test_nobody_is_shown_a_pair_twice(tmp_path: Path) -> None:
    queue, _ = make(tmp_path)
    folder = QueryFolder(tmp_path)
    # Three episodes make three pairs, whichever side they are on.
    few = deque(list(episodes())[:3])
    for step in range(8):
        queue.act(700 + step, few)
        for number in list(folder.read_open())[:1]:
            say(tmp_path, folder.read(number), None if step == 0 else Preference.FIRST)
    pairs = [{one.stream for one in asked.episodes} for asked in map(folder.read, folder.numbers()) if asked]
    assert len(pairs) == len({frozenset(pair) for pair in pairs}) == 3
    # Others are there to be asked about.
    queue.act(720, episodes())
    assert len(folder.read_open()) == 3


def test_answers_count_from_the_next_rollout_on(tmp_path: Path) -> None:
    queue, posterior = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes())
    assert queue.act(500, episodes()) is False
    for number in list(folder.read_open())[:2]:
        say(tmp_path, folder.read(number))
    assert posterior.num_queries == 0
    assert queue.act(520, episodes()) is True
    assert posterior.num_queries == 2
    assert queue.act(520, episodes()) is False
    assert len(folder.read_open()) == 3
    assert not {0, 1} & set(folder.read_open())


def test_a_torn_line_is_left_until_it_is_whole(tmp_path: Path) -> None:
    queue, posterior = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes())
    say(tmp_path, folder.read(0))
    whole = (tmp_path / "queries.jsonl").read_bytes()
    (tmp_path / "queries.jsonl").write_bytes(whole[:-20])
    assert queue.act(520, episodes()) is False
    (tmp_path / "queries.jsonl").write_bytes(whole)
    assert queue.act(540, episodes()) is True
    assert posterior.num_queries == 1


def test_cannot_tell_leaves_the_posterior_and_another_query_comes(tmp_path: Path) -> None:
    queue, posterior = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes())
    first = next(iter(folder.read_open()))
    say(tmp_path, folder.read(first), None)
    assert queue.act(520, episodes()) is False
    assert posterior.num_queries == 0
    assert first not in folder.read_open()
    assert len(folder.read_open()) == 3


def test_an_answer_taken_back_is_forgotten(tmp_path: Path) -> None:
    queue, posterior = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes())
    asked = [folder.read(number) for number in range(3)]
    say(tmp_path, asked[0])
    queue.act(520, episodes())
    only_first = posterior.samples
    say(tmp_path, asked[1], Preference.SECOND)
    queue.act(540, episodes())
    assert posterior.num_queries == 2
    undo(tmp_path, 1)
    assert queue.act(560, episodes()) is True
    assert posterior.num_queries == 1
    # As if it had never been given.
    np.testing.assert_array_equal(posterior.samples, only_first)
    # It waits where it was; no other comes in its place.
    posted = folder.numbers()
    queue.act(580, episodes())
    assert folder.numbers() == posted


def test_a_pointless_query_is_replaced_and_counts_if_it_is_answered(tmp_path: Path) -> None:
    queue, posterior = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes(scale=0.01))
    first = list(folder.read_open())
    for _ in range(6):
        queue.act(500, episodes(scale=1.0))
    assert not set(first) & set(folder.read_open())
    assert len(folder.read_open()) == 3
    say(tmp_path, folder.read(first[0]))
    assert queue.act(520, episodes()) is True
    assert posterior.num_queries == 1


def test_a_restart_goes_on_with_the_same_queries_under_new_numbers(tmp_path: Path) -> None:
    queue, _ = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes())
    before, numbers = folder.read_open(), folder.numbers()
    say(tmp_path, folder.read(0))
    state = queue.state_dict()
    again, posterior = make(tmp_path)
    again.load_state_dict(state)
    assert again.act(520, episodes()) is True
    assert posterior.num_queries == 1
    assert set(before) - {0} <= set(folder.read_open())
    assert folder.numbers() == [*numbers, 3]


def test_every_so_many_th_query_repeats_one_with_its_sides_swapped(tmp_path: Path) -> None:
    queue, _ = make(tmp_path, People(repeat_every=4))
    folder = QueryFolder(tmp_path)
    repeats: list[tuple[int, int]] = []
    for step in range(60):
        queue.act(700 + step, episodes())
        number = next(iter(folder.read_open()), None)
        if number is None:
            break
        say(tmp_path, folder.read(number))
    for number in folder.numbers():
        asked = folder.read(number)
        assert asked is not None
        if asked.repeats is not None:
            original = folder.read(asked.repeats)
            assert original is not None
            repeats.append((number, asked.repeats))
            np.testing.assert_array_equal(asked.pair.returns, original.pair.returns[::-1])
            assert asked.episodes[0].to_json() == original.episodes[1].to_json()
    assert repeats
    assert all(number % 4 == 3 for number, _ in repeats)
    assert len({original for _, original in repeats}) == len(repeats)


def test_it_says_when_more_answers_would_change_little(tmp_path: Path) -> None:
    queue, _ = make(tmp_path)
    folder = QueryFolder(tmp_path)
    assert queue.advice() is None
    said: list[dict[str, Any]] = []
    for step in range(60):
        queue.act(700 + step, episodes())
        advice = queue.advice()
        assert advice is not None
        assert advice["threshold"] == ENOUGH
        said.append(advice)
        number = next(iter(folder.read_open()), None)
        if number is None:
            break
        # Somebody to whom only the first component matters.
        asked = folder.read(number)
        assert asked is not None
        first_is_better = asked.pair.returns[0, 0] > asked.pair.returns[1, 0]
        say(tmp_path, asked, Preference.FIRST if first_is_better else Preference.SECOND)
    assert not said[0]["enough"]
    assert said[0]["regret"] > 5 * ENOUGH
    assert said[-1]["enough"]
    assert said[-1]["regret"] < ENOUGH


def test_training_rests_when_nobody_answers_for_long(tmp_path: Path) -> None:
    queue, _ = make(tmp_path)
    queue.act(10_000_000, episodes())
    assert queue.is_idle(10_000_000)
    say(tmp_path, QueryFolder(tmp_path).read(0))
    queue.take_in(10_000_000)
    assert not queue.is_idle(10_000_000)


def test_a_stop_closes_the_questions(tmp_path: Path) -> None:
    queue, _ = make(tmp_path)
    folder = QueryFolder(tmp_path)
    queue.act(500, episodes())
    folder.stop()
    queue.act(520, episodes())
    assert folder.read_open() == {}
    assert queue.pace.closing
    # The training that was asked for is done all the same.
    assert queue.pace.progress(STEPS - 1) < 1
    assert queue.pace.progress(STEPS) == pytest.approx(1)


def test_the_pace_never_runs_ahead_of_the_answers() -> None:
    pace = Pace(STEPS, QUERIES, SPAN)
    pace.update(0, 0, False)
    assert pace.progress(30) == pytest.approx(0.03)
    assert pace.progress(10**6) == pytest.approx(SPAN / QUERIES)
    before = -1.0
    for answers in range(QUERIES):
        pace.update(5000 + answers, answers, False)
        assert pace.progress(5000 + answers) > before
        before = pace.progress(5000 + answers)
    pace.update(6000, QUERIES, False)
    assert pace.closing
    assert pace.progress(6000) == pytest.approx(SPAN)
    assert pace.progress(6125) == pytest.approx((1 + SPAN) / 2)
    assert pace.progress(6250) == 1
    # One is taken back: the questions go on.
    pace.update(6100, QUERIES - 1, False)
    assert not pace.closing


def test_a_fast_teacher_goes_through_training_as_a_simulated_one() -> None:
    pace = Pace(STEPS, QUERIES, SPAN)
    for env_steps in range(0, STEPS, 25):
        pace.update(env_steps, pace.due(env_steps), False)
        assert pace.progress(env_steps) == pytest.approx(env_steps / STEPS, abs=0.03)
    assert pace.due(int(INTERVAL) - 1) == 0
    assert pace.due(10**9) == QUERIES


def test_the_pace_is_saved_and_continued() -> None:
    pace, again = Pace(STEPS, QUERIES, SPAN), Pace(STEPS, QUERIES, SPAN)
    pace.update(300, QUERIES, False)
    again.load_state_dict(pace.state_dict())
    assert again.closing
    assert again.progress(400) == pace.progress(400)


def test_repeats_are_not_negative() -> None:
    with pytest.raises(ValueError, match="repeat_every is -1; it must be at least 0"):
        People(-1)
