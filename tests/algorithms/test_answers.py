"""The record of answers: what stands, what is refused, and that it says where it is damaged."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moral_algorithms.answers import (
    Answer,
    AnswerBook,
    AskedQuery,
    Event,
    parse_answers,
    read_answers,
)
from moral_algorithms.preferences import Preference, Query
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import append_line, read_lines
from moral_algorithms.storage import StorageError


def asked(number: int) -> AskedQuery:
    episodes = (
        Replay(number, np.array([[1], [8]], np.uint8)),
        Replay(number + 1, np.array([[0], [4]], np.uint8)),
    )
    pair = Query(np.array([[0.25, number], [1.0, -0.5]]), np.array([[1, 2], [3, 4]]))
    return AskedQuery(number, 2, 640, pair, episodes, expected=0.125)


def test_an_answer_is_read_as_it_was_written(tmp_path: Path) -> None:
    book = AnswerBook(tmp_path / "queries.jsonl", "ada")
    book.answer(asked(3), Preference.SECOND, 2.5, "key-1")
    (read,) = read_answers(str(tmp_path / "queries.jsonl")).standing.values()
    assert read.asked.to_json() == asked(3).to_json()
    assert (read.preference, read.who, read.seconds, read.key) == (Preference.SECOND, "ada", 2.5, "key-1")
    (line,) = read_lines(tmp_path / "queries.jsonl")
    assert line == read.to_json()


# What happens to a query, again and again: (query, whether it is taken back, key).
HAPPENINGS = st.lists(st.tuples(st.integers(0, 3), st.booleans(), st.integers(0, 8)), max_size=30)


@given(HAPPENINGS)
def test_at_most_one_answer_of_a_query_stands_and_a_key_counts_once(
    tmp_path_factory: pytest.TempPathFactory, happenings: list[tuple[int, bool, int]]
) -> None:
    path = tmp_path_factory.mktemp("answers") / "queries.jsonl"
    book = AnswerBook(path, "ada")
    standing: dict[int, int] = {}
    used: set[int] = set()
    for number, back, key in happenings:
        fits = key not in used and (number in standing) == back
        try:
            if back:
                book.undo(number, f"key-{key}")
            else:
                book.answer(asked(number), Preference.FIRST, 1.0, f"key-{key}")
        except ValueError:
            assert not fits
            continue
        assert fits
        used.add(key)
        if back:
            del standing[number]
        else:
            standing[number] = key
    read = read_answers(path)
    assert {answer.number: answer.key for answer in read.standing.values()} == {
        number: f"key-{key}" for number, key in standing.items()
    }
    assert not read.undone.keys() & read.standing.keys()
    assert read.keys == {f"key-{key}" for key in used}


def test_a_line_that_is_being_written_is_left_out_and_removed_by_the_next_writer(tmp_path: Path) -> None:
    path = tmp_path / "queries.jsonl"
    AnswerBook(path, "ada").answer(asked(0), None, 1.0, "key-1")
    with path.open("ab") as file:
        file.write(b'{"version": 1')
    assert list(read_answers(path).standing) == [0]
    AnswerBook(path, "ada").answer(asked(1), Preference.EQUAL, 1.0, "key-2")
    assert list(read_answers(path).standing) == [0, 1]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda line: line.update(version=2), "it has version 2; this release reads 1"),
        (lambda line: line.pop("version"), "it has version None"),
        (lambda line: line.update(record="guess"), "record is 'guess'; it must be answer, undo or consent"),
        (lambda line: line.update(preference="both"), "preference is 'both'; it must be first, second"),
        (lambda line: line.update(query=-1), "query is -1; it must be 0 or more"),
        (lambda line: line.update(query=True), "query is True; it must be int"),
        (lambda line: line.update(query=0), "query is 0, which is answered already"),
        (lambda line: line.update(key="key-0"), "key is 'key-0', which an earlier record has"),
        (lambda line: line.update(returns=[[1.0, float("nan")], [0.0, 0.0]]), "returns is"),
        (lambda line: line.update(episodes=[]), "not enough values"),
        (lambda line: line.update(who=None), "who is None; it must be str"),
        (lambda line: line.update(record="undo", when="now"), "query is 1, which has no answer to take back"),
    ],
)
def test_a_damaged_line_is_named(
    tmp_path: Path, damage: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = tmp_path / "queries.jsonl"
    lines = [Answer(asked(n), Preference.FIRST, "ada", 1.0, "now", f"key-{n}").to_json() for n in range(2)]
    damage(lines[1])
    with pytest.raises(StorageError, match=r"queries\.jsonl is damaged in line 2: ") as error:
        parse_answers(path, lines)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("line", [[], 5, None, "answer", {}])
def test_what_is_no_record_is_named(tmp_path: Path, line: Any) -> None:
    append_line(tmp_path / "queries.jsonl", line)
    with pytest.raises(StorageError, match=r"queries\.jsonl is damaged in line 1"):
        read_answers(tmp_path / "queries.jsonl")


def test_a_consent_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "queries.jsonl"
    AnswerBook(path, "ada").consent("a-hash", "key-1")
    assert read_answers(path).notices == {"a-hash"}
    (line,) = (json.loads(text) for text in path.read_text().splitlines())
    assert Event.from_json(line).to_json() == line
