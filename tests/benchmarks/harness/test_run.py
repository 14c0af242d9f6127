"""A run is recognised by its configuration: no two are taken for one another, and none for two."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, make_dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.harness import Run
from benchmarks.harness.run import agrees, with_needs
from tests.benchmarks.harness.runs import Square, Total, Written


@dataclass(frozen=True)
class Step:
    size: float = 0.5
    many: int = 1


@dataclass(frozen=True)
class Other:
    size: float = 0.5
    many: int = 1


@dataclass(frozen=True)
class Anything(Run):
    value: Any = None
    step: Step | Other = field(default_factory=lambda: Step(many=3))


NUMBERS = st.integers(-(2**70), 2**70) | st.floats(allow_nan=False, allow_infinity=False)
SCALARS = st.none() | st.booleans() | NUMBERS | st.text(max_size=4)
STEPS = st.builds(Step, NUMBERS, st.integers()) | st.builds(Other, NUMBERS, st.integers())
VALUES = st.recursive(
    SCALARS | STEPS | st.builds(Square, NUMBERS),
    lambda inner: (
        st.lists(inner, max_size=3).map(tuple) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=6,
)
RUNS = st.builds(Anything, VALUES, STEPS)


def same(one: Any, other: Any) -> bool:
    """Equality as Python has it, but for booleans, which are no numbers here, and lists, which are tuples."""
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[name], other[name]) for name in one)
    if type(one) is type(other) and hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)
    return bool(one == other)


@settings(max_examples=60)
@given(RUNS, RUNS)
def test_two_runs_have_one_key_exactly_if_they_are_equal(one: Anything, other: Anything) -> None:
    assert (one.key == other.key) == same(one, other)
    assert agrees(one.configuration(), other.configuration()) == same(one, other)


@settings(max_examples=40)
@given(RUNS)
def test_a_configuration_survives_its_file(run: Anything) -> None:
    stored = json.loads(json.dumps(run.configuration(), allow_nan=False))
    assert agrees(stored, run.configuration())


@given(NUMBERS)
def test_a_number_is_the_same_however_it_is_written(number: float) -> None:
    if float(number) == number:
        assert Anything(float(number)).key == Anything(number).key
        assert Anything({"a": (float(number),)}).key == Anything({"a": [number]}).key
    assert Anything(-0.0).key == Anything(0).key
    assert Anything(True).key != Anything(1).key


def test_the_order_of_a_mapping_does_not_matter() -> None:
    assert Anything({"a": 1, "b": 2}).key == Anything({"b": 2, "a": 1}).key


@settings(max_examples=30)
@given(NUMBERS.filter(lambda number: number != 7))
def test_a_setting_added_with_a_default_leaves_the_key(number: float) -> None:
    before = make_dataclass("Grown", [("number", float)], bases=(Run,), frozen=True)
    after = make_dataclass(
        "Grown", [("number", float), ("added", float, field(default=7))], bases=(Run,), frozen=True
    )
    assert before(number).key == after(number).key == after(number, 7.0).key
    assert before(number).key != after(number, number).key
    assert agrees(before(number).configuration(), after(number).configuration())
    assert not agrees(after(number).configuration(), before(number).configuration())


def test_a_mapping_with_more_entries_is_another_setting() -> None:
    def with_default(make: Callable[[], dict[str, int]]) -> Run:
        fields = [("ratio", dict, field(default_factory=make))]
        run: Run = make_dataclass("Changed", fields, bases=(Run,), frozen=True)()
        return run

    less, more = with_default(lambda: {"a": 1}), with_default(lambda: {"a": 1, "b": 2})
    assert less.key == more.key
    assert not agrees(less.configuration(), more.configuration())


def test_dataclasses_of_other_names_are_other_settings() -> None:
    assert Anything(step=Step()).key != Anything(step=Other()).key
    assert Square(3).key != Written(3).key


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, "a run holds nan; its numbers must be finite"),
        ((0.5, -math.inf), "a run holds -inf; its numbers must be finite"),
        ({1: "one"}, "the keys of a mapping must be strings"),
        ({"set": {1}}, "it may hold what JSON can"),
        (Step, "it may hold what JSON can"),
        (Step(math.nan), "a run holds nan"),
    ],
)
def test_what_json_cannot_hold_is_refused(value: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        _ = Anything(value).key


def test_needs_come_first_and_once() -> None:
    shared, own = Written(1), Square(2)
    one, two = Total((shared, own)), Total((own, shared))
    assert with_needs([two, one, own]) == [own, shared, two, one]
