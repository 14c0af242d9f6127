"""Which world a run, a demonstration file or a network belongs to, in a form that JSON can hold."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, field
from typing import Any

from moral_envs import delivery_v0, emergency_v0
from moral_envs.world import World

WORLDS = {"emergency": emergency_v0.world, "delivery": delivery_v0.world}
"""Functions that build each world from its rules, by name."""


@dataclass(frozen=True)
class WorldSpec:
    """A world by name, with the rules that differ from its defaults.

    Raises
    ------
    ValueError
        If the world or one of the rules is unknown, or the rules are impossible.
    """

    name: str = "emergency"
    """emergency or delivery."""
    rules: dict[str, int] = field(default_factory=dict)
    """Sizes, counts and horizon that differ from the defaults, such as num_people 4 max_cycles 50."""

    def __post_init__(self) -> None:
        if self.name not in WORLDS:
            raise ValueError(f"world is {self.name!r}; it must be one of {sorted(WORLDS)}")
        known = inspect.signature(WORLDS[self.name]).parameters
        for rule in self.rules:
            if rule not in known:
                raise ValueError(f"rules name {rule!r}; {self.name} has {sorted(known)}")
        self.build()

    def build(self) -> World:
        """The world itself."""
        return WORLDS[self.name](**self.rules)

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {"name": self.name, "rules": dict(self.rules)}

    @classmethod
    def from_json(cls, value: Any) -> WorldSpec:
        """The specification that :meth:`to_json` wrote, checked."""
        try:
            name, rules = value["name"], value["rules"]
            valid = isinstance(name, str) and all(type(number) is int for number in rules.values())
        except (TypeError, KeyError, AttributeError):
            valid = False
        if not valid:
            raise ValueError(f"world is {value!r}; it must be an object with 'name' and integer 'rules'")
        return cls(name, dict(rules))
