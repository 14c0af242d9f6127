"""Worlds by name and rules."""

from __future__ import annotations

import json

import pytest

from moral_algorithms.worlds import WorldSpec
from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0


def test_builds_the_world_it_names() -> None:
    assert WorldSpec("emergency").build() == emergency_v0.world()
    assert WorldSpec("burning_warehouse").build() == burning_warehouse_v0.world()
    rules = {"num_vases": 2, "max_cycles": 9}
    assert WorldSpec("delivery", rules).build() == delivery_v0.world(num_vases=2, max_cycles=9)


def test_comes_back_from_json() -> None:
    spec = WorldSpec("emergency", {"height": 5, "num_people": 1})
    assert WorldSpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec


@pytest.mark.parametrize(
    ("name", "rules", "message"),
    [
        (
            "warehouse",
            {},
            r"world is 'warehouse'; it must be one of \['burning_warehouse', 'delivery', 'emergency'\]",
        ),
        ("emergency", {"num_vases": 1}, "rules name 'num_vases'; emergency has"),
        (
            "emergency",
            {"layout": 1},
            r"rules name 'layout'; emergency has \['height', 'max_cycles', 'num_people', 'walk', 'width'\]",
        ),
        ("emergency", {"height": 2}, "height is 2"),
        ("emergency", {"height": 5.5}, "rule height is 5.5; it must be an integer"),
        ("emergency", {"height": True}, "rule height is True; it must be an integer"),
        ("emergency", {"max_cycles": 0}, "max_cycles is 0"),
        ("emergency", {"height": 4, "width": 4}, "add up to 7; emergency_v0 has 4 free cells"),
    ],
)
def test_impossible_worlds_are_refused(name: str, rules: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        WorldSpec(name, rules)
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match=message):
        WorldSpec.from_json({"name": name, "rules": rules})


@pytest.mark.parametrize(
    "value",
    [
        None,
        "emergency",
        [],
        {},
        {"name": "emergency"},
        {"name": 1, "rules": {}},
        {"name": "emergency", "rules": [1]},
    ],
)
def test_what_is_no_world_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="it must be an object with 'name' and 'rules'"):
        WorldSpec.from_json(value)
