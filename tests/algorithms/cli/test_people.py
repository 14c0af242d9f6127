"""What people read for the components of a reward vector."""

from __future__ import annotations

from pathlib import Path

import pytest

from moral_algorithms.cli.people import People
from moral_algorithms.pipeline import MoralRun

ONE = MoralRun(rewards=(Path("airl"),))
TWO = MoralRun(rewards=(Path("help"), Path("clean")), primary=("deliver",))


def test_learned_components_are_called_experts() -> None:
    assert People().name_components(ONE) == {"extinguish": "extinguish", "learned_1": "the expert"}
    assert list(People().name_components(TWO).values()) == ["deliver", "expert 1", "expert 2"]


def test_components_are_called_as_the_person_who_asks_wants() -> None:
    names = {"learned_2": "cleaning up", "deliver": "parcels"}
    assert list(People(names=names).name_components(TWO).values()) == ["parcels", "expert 1", "cleaning up"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"learned_2": "saving"}, "names has 'learned_2'; it must be one of extinguish, learned_1"),
        ({"learned_1": "extinguish"}, "names makes them extinguish, extinguish; no two may be the same"),
        ({"learned_1": " "}, "the name of learned_1 is ' '; it must have 1 to 18 characters"),
        ({"learned_1": "x" * 19}, f"the name of learned_1 is '{'x' * 19}'; it must have 1 to 18 characters"),
    ],
)
def test_names_that_say_nothing_are_refused(names: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        People(names=names).name_components(ONE)
