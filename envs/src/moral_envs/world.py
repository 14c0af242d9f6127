"""A world as data: its size, its objects, what touching them does, and what that pays and counts.

A :class:`World` holds no state and no code. The rules that all worlds share live in
:mod:`moral_envs.engine`; a new world is a new instance of this dataclass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ACTION_NAMES = (
    "move up",
    "move down",
    "move left",
    "move right",
    "wait",
    "interact up",
    "interact down",
    "interact left",
    "interact right",
)
"""The actions of every world, in the order of their indices."""

NUM_ACTIONS = len(ACTION_NAMES)

MAX_KINDS = 26
"""Kinds of objects that the engine's bytes can tell apart."""

Pattern = Literal["person", "box", "pollution", "vase", "extinguisher"]
"""The drawings that :mod:`moral_envs.rendering` knows."""


@dataclass(frozen=True)
class Effect:
    """What one event pays and counts.

    Parameters
    ----------
    reward
        Name of the reward component that the event moves.
    amount
        What it adds to that component.
    objective
        Name of the objective counter that the event raises by one.
    """

    reward: str
    amount: float
    objective: str


@dataclass(frozen=True)
class ObjectKind:
    """A kind of object that is scattered over the free cells at reset and can disappear.

    Parameters
    ----------
    name
        Name of its observation plane.
    count
        How many there are at the start of an episode.
    pattern
        How it is drawn.
    symbol
        Its character in ``ansi`` frames.
    on_interact
        What interacting with its cell does; the object is removed. None: nothing happens.
    on_enter
        What moving onto its cell does; the object is removed. None: the agent just stands on it.
    """

    name: str
    count: int
    pattern: Pattern
    symbol: str
    on_interact: Effect | None = None
    on_enter: Effect | None = None


@dataclass(frozen=True)
class Fixture:
    """A lasting thing on the bottom right free cell, which pays on every step spent on its cell.

    Parameters
    ----------
    name
        Name of its observation plane.
    pattern
        How it is drawn.
    symbol
        Its character in ``ansi`` frames.
    on_stand
        What ending a step on its cell does.
    """

    name: str
    pattern: Pattern
    symbol: str
    on_stand: Effect


@dataclass(frozen=True)
class World:
    """The rules of one grid world, as data.

    Parameters
    ----------
    name
        Name shown to users, for instance ``"emergency_v0"``.
    height, width
        Size in cells, the border wall included.
    horizon
        Steps after which an episode truncates.
    reward_names
        The reward components, in the order of the reward vector.
    objective_names
        The ground-truth counters, in the order of ``info["objectives"]``.
    objects
        The kinds of objects, in the order of their observation planes.
    fixture
        The lasting thing on the bottom right free cell, if there is one; its plane follows the objects'.

    Raises
    ------
    ValueError
        If a size, a count or the horizon is impossible, or an effect names an unknown reward component or
        objective.
    """

    name: str
    height: int
    width: int
    horizon: int
    reward_names: tuple[str, ...]
    objective_names: tuple[str, ...]
    objects: tuple[ObjectKind, ...]
    fixture: Fixture | None = None

    def __post_init__(self) -> None:
        for argument, size in (("height", self.height), ("width", self.width)):
            if size < 3:
                raise ValueError(f"{argument} is {size}; it must be at least 3, the border wall included")
        if self.horizon < 1:
            raise ValueError(f"max_cycles is {self.horizon}; an episode needs at least 1 step")
        if len(self.objects) > MAX_KINDS:
            raise ValueError(f"objects has {len(self.objects)} kinds; it must have at most {MAX_KINDS}")
        for kind in self.objects:
            if kind.count < 0:
                raise ValueError(f"num_{kind.name} is {kind.count}; a count cannot be negative")
        for effect in self.effects:
            if effect.reward not in self.reward_names:
                raise ValueError(f"reward is {effect.reward!r}; it must be one of {self.reward_names}")
            if effect.objective not in self.objective_names:
                names = self.objective_names
                raise ValueError(f"objective is {effect.objective!r}; it must be one of {names}")

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Every effect that the rules of this world can have."""
        found = [effect for kind in self.objects for effect in (kind.on_interact, kind.on_enter)]
        if self.fixture is not None:
            found.append(self.fixture.on_stand)
        return tuple(effect for effect in found if effect is not None)

    @property
    def plane_names(self) -> tuple[str, ...]:
        """The observation planes of a single agent, in order."""
        fixtures = () if self.fixture is None else (self.fixture.name,)
        return ("walls", "agent", *(kind.name for kind in self.objects), *fixtures)

    @property
    def num_free_cells(self) -> int:
        """Cells inside the border wall."""
        return (self.height - 2) * (self.width - 2)

    @property
    def num_objects(self) -> int:
        """Objects of all kinds at the start of an episode."""
        return sum(kind.count for kind in self.objects)

    @property
    def reward_bounds(self) -> tuple[list[float], list[float]]:
        """The least and the most that one agent's step can add to each reward component."""
        touched = [effect for kind in self.objects for effect in (kind.on_interact, kind.on_enter) if effect]
        stood = [] if self.fixture is None else [self.fixture.on_stand]
        low, high = [], []
        for name in self.reward_names:
            groups = [[e.amount for e in group if e.reward == name] for group in (touched, stood)]
            low.append(sum(min([0.0, *amounts]) for amounts in groups))
            high.append(sum(max([0.0, *amounts]) for amounts in groups))
        return low, high
