"""A world as data: its size, its objects, what touching them does, and what that pays and counts.

A :class:`World` holds no state and no code. The rules that all worlds share live in
:mod:`moral_envs.engine`; a new world is a new instance of this dataclass.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from typing import Literal, SupportsFloat, SupportsIndex

from moral_envs import layouts
from moral_envs.layouts import Layout

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

NUM_MOVES = 4
"""The first actions are the moves: up, down, left, right."""

MAX_KINDS = 26
"""Kinds of objects that the engine's bytes can tell apart."""

Pattern = Literal["person", "box", "pollution", "vase", "extinguisher", "goal"]
"""The drawings that :mod:`moral_envs.rendering` knows."""

Cell = tuple[int, int]
"""Row and column; (0, 0) is the top left corner of the border wall."""


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
    walks
        Chance, at every step, that it moves in a random direction once the agents have acted. Walls, agents
        and other objects block it.
    """

    name: str
    count: int
    pattern: Pattern
    symbol: str
    on_interact: Effect | None = None
    on_enter: Effect | None = None
    walks: float = 0.0


@dataclass(frozen=True)
class Fixture:
    """A lasting thing that pays on every step which an agent ends on its cell.

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
    cell
        Where it is. None: on the bottom right free cell.
    terminates
        Whether the episode then ends.
    """

    name: str
    pattern: Pattern
    symbol: str
    on_stand: Effect
    cell: Cell | None = None
    terminates: bool = False


def is_chance(value: object) -> bool:
    """Whether something is a number from 0 to 1."""
    return isinstance(value, SupportsFloat) and 0 <= float(value) <= 1


def is_integer(value: object, least: int) -> bool:
    """Whether something is an integer that does not lie below ``least``."""
    return isinstance(value, SupportsIndex) and operator.index(value) >= least


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
        The lasting thing, if there is one; its plane follows the objects'.
    interior_walls
        Cells inside the border that are walls.
    start
        Where agents start: on ``"random"`` free cells, or in the ``"corner"``: on the first free cells, row
        by row from the top left.
    slip
        Chance that an agent's action is replaced by a move in a random direction.
    on_step
        What every step does, unless it ends on a fixture that terminates.
    num_actions
        How many of :data:`ACTION_NAMES` there are: 4 (only moves), 5 (waiting too) or all 9.
    layout
        How size, walls, counts and horizon are drawn anew for each episode; see :meth:`in_layout`.

    Raises
    ------
    ValueError
        If a size, a count, a chance, a cell or the horizon is impossible, or an effect names an unknown
        reward component or objective.
    """

    name: str
    height: int
    width: int
    horizon: int
    reward_names: tuple[str, ...]
    objective_names: tuple[str, ...]
    objects: tuple[ObjectKind, ...]
    fixture: Fixture | None = None
    interior_walls: tuple[Cell, ...] = ()
    start: Literal["random", "corner"] = "random"
    slip: float = 0.0
    on_step: Effect | None = None
    num_actions: int = NUM_ACTIONS
    layout: Layout | None = None

    def __post_init__(self) -> None:
        for argument, size in (("height", self.height), ("width", self.width)):
            if not is_integer(size, least=3):
                raise ValueError(f"{argument} is {size!r}; it must be at least 3, the border wall included")
        if not is_integer(self.horizon, least=1):
            raise ValueError(f"max_cycles is {self.horizon!r}; an episode needs at least 1 step")
        if len(self.objects) > MAX_KINDS:
            raise ValueError(f"objects has {len(self.objects)} kinds; it must have at most {MAX_KINDS}")
        for kind in self.objects:
            if not is_integer(kind.count, least=0):
                raise ValueError(f"num_{kind.name} is {kind.count!r}; it must be a count, 0 or more")
            if not is_chance(kind.walks):
                raise ValueError(f"walks is {kind.walks!r} for {kind.name}; a chance is 0 to 1")
        if not is_chance(self.slip):
            raise ValueError(f"slip is {self.slip!r}; a chance is 0 to 1")
        if self.start not in ("random", "corner"):
            raise ValueError(f"start is {self.start!r}; it must be 'random' or 'corner'")
        if self.num_actions not in (NUM_MOVES, NUM_MOVES + 1, NUM_ACTIONS):
            raise ValueError(f"num_actions is {self.num_actions}; it must be 4, 5 or {NUM_ACTIONS}")
        for row, column in self.interior_walls:
            if not (0 < row < self.height - 1 and 0 < column < self.width - 1):
                raise ValueError(f"interior_walls has {(row, column)}; it must be inside the border")
        if self.fixture is not None and self.fixture.cell is not None:
            row, column = self.fixture.cell
            inside = 0 < row < self.height - 1 and 0 < column < self.width - 1
            if not inside or self.fixture.cell in self.interior_walls:
                raise ValueError(f"the {self.fixture.name}'s cell is {(row, column)}; it must be a free cell")
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
        found.append(self.on_step)
        return tuple(effect for effect in found if effect is not None)

    @property
    def plane_names(self) -> tuple[str, ...]:
        """The observation planes of a single agent, in order."""
        fixtures = () if self.fixture is None else (self.fixture.name,)
        return ("walls", "agent", *(kind.name for kind in self.objects), *fixtures)

    @property
    def num_free_cells(self) -> int:
        """Free cells inside the border wall; with a layout, the fewest that an episode can have."""
        if self.layout is not None:
            return self.layout.least_free_cells(self.height, self.width)
        return (self.height - 2) * (self.width - 2) - len(set(self.interior_walls))

    @property
    def num_objects(self) -> int:
        """Objects of all kinds at the start of an episode."""
        return sum(kind.count for kind in self.objects)

    @property
    def ends_early(self) -> bool:
        """Whether an episode can end before ``horizon`` steps."""
        terminates = self.fixture is not None and self.fixture.terminates
        return terminates or (self.layout is not None and isinstance(self.layout.max_cycles, tuple))

    @property
    def reward_bounds(self) -> tuple[list[float], list[float]]:
        """The least and the most that one agent's step can add to each reward component."""
        touched = [effect for kind in self.objects for effect in (kind.on_interact, kind.on_enter) if effect]
        stood = [] if self.fixture is None else [self.fixture.on_stand]
        always = [] if self.on_step is None else [self.on_step]
        low, high = [], []
        for name in self.reward_names:
            groups = [[e.amount for e in group if e.reward == name] for group in (touched, stood, always)]
            low.append(sum(min([0.0, *amounts]) for amounts in groups))
            high.append(sum(max([0.0, *amounts]) for amounts in groups))
        return low, high

    def in_layout(self, layout: Layout | str | None) -> World:
        """Return this world with rooms drawn anew for each episode.

        Sizes become the layout's greatest ones, which are those of the observations, and so do counts and
        horizon.

        Parameters
        ----------
        layout
            A :class:`~moral_envs.layouts.Layout` or one of :data:`~moral_envs.layouts.NAMES`. None: the world
            as it is.

        Raises
        ------
        ValueError
            If the name is unknown or the layout does not fit this world.
        """
        if layout is None:
            return self
        if isinstance(layout, str):
            layout = layouts.named(layout)
        if not isinstance(layout, Layout):
            raise ValueError(f"layout is {layout!r}; it must be a Layout or one of {layouts.NAMES}")
        if self.interior_walls or self.start != "random" or (self.fixture and self.fixture.cell):
            raise ValueError(f"layout is {layout}; it must be None, for {self.name} has walls of its own")
        counts = {kind.name: kind.count for kind in self.objects}
        layout.check(counts)
        height, width = layout.canvas(self.height, self.width)
        kinds = zip(self.objects, layout.greatest_counts(counts), strict=True)
        cycles = self.horizon if layout.max_cycles is None else layout.max_cycles
        return replace(
            self,
            height=height,
            width=width,
            horizon=max(cycles) if isinstance(cycles, tuple) else cycles,
            objects=tuple(replace(kind, count=count) for kind, count in kinds),
            layout=layout,
        )
