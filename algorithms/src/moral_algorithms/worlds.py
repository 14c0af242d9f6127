"""Which world a run, a demonstration file or a network belongs to, in a form that JSON can hold."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.world import World

WORLDS: dict[str, Callable[..., World]] = {
    "emergency": emergency_v0.world,
    "burning_warehouse": burning_warehouse_v0.world,
    "delivery": delivery_v0.world,
}
"""Functions that build each world from its rules, by name."""


def _numeric_rules(build: Callable[..., World]) -> list[str]:
    """List the rules that are numbers; others, such as layouts, are for the worlds' own functions."""
    parameters = inspect.signature(build).parameters.values()
    return sorted(parameter.name for parameter in parameters if isinstance(parameter.default, (int, float)))


@dataclass(frozen=True)
class WorldSpec:
    """A world by name, with the rules that differ from its defaults.

    Raises
    ------
    ValueError
        If the world or one of the rules is unknown, or the rules are impossible.
    """

    name: str = "emergency"
    """emergency, burning_warehouse or delivery."""
    rules: dict[str, int] = field(default_factory=dict)
    """Sizes, counts and horizon that differ from the defaults, such as num_people 4 max_cycles 50."""

    def __post_init__(self) -> None:
        if self.name not in WORLDS:
            raise ValueError(f"world is {self.name!r}; it must be one of {sorted(WORLDS)}")
        known = _numeric_rules(WORLDS[self.name])
        for rule, value in self.rules.items():
            if rule not in known:
                raise ValueError(f"rules name {rule!r}; {self.name} has {known}")
            if type(value) is not int:
                raise ValueError(f"rule {rule} is {value!r}; it must be an integer")
        # Only an engine knows whether everything fits on the free cells.
        Engine(self.build())

    def build(self) -> World:
        """Make the world itself."""
        return WORLDS[self.name](**self.rules)

    def to_json(self) -> dict[str, Any]:
        """Return plain values for :meth:`from_json`."""
        return {"name": self.name, "rules": dict(self.rules)}

    @classmethod
    def from_json(cls, value: Any) -> WorldSpec:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else, or the world or one of its rules is impossible.
        """
        fields = value if isinstance(value, dict) else {}
        name, rules = fields.get("name"), fields.get("rules")
        if not isinstance(name, str) or not isinstance(rules, dict):
            raise ValueError(f"world is {value!r}; it must be an object with 'name' and 'rules'")
        return cls(name, dict(rules))
