"""A world as data: its size, its objects, what touching them does, and what that pays and counts.

A :class:`World` holds no state and no code. The rules that all worlds share live in
:mod:`moral_envs.engine`; a new world is a new instance of this dataclass.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from moral_envs import layouts
from moral_envs.arguments import as_integer, is_chance, is_finite, require_bool, require_integer
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
"""The actions of a grid, in the order of their indices; a world has all, or the first 4 or 5 of them."""

NUM_ACTIONS = len(ACTION_NAMES)

NUM_MOVES = 4
"""The first actions are the moves: up, down, left, right."""

MAX_HORIZON = 2**31 - 1
"""The most steps of an episode; clocks count them in 64 bits."""
MAX_KINDS = 26
"""Kinds of objects that the engine's bytes can tell apart."""

Pattern = Literal["person", "box", "pollution", "vase", "extinguisher", "goal"]
"""The drawings that :mod:`moral_envs.rendering` knows."""

RESERVED_SYMBOLS = "#.: A0123456789abcdef"
"""Characters that ``ansi`` frames need for walls, free and unseen cells, and agents."""

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

    Raises
    ------
    ValueError
        If a name is no string or the amount no finite number.
    """

    reward: str
    amount: float
    objective: str

    def __post_init__(self) -> None:
        _require_name("reward", self.reward)
        _require_name("objective", self.objective)
        if not is_finite(self.amount):
            raise ValueError(f"amount is {self.amount!r}; it must be a finite number")
        object.__setattr__(self, "amount", float(self.amount))


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
        Its character in ``ansi`` frames, none of :data:`RESERVED_SYMBOLS`.
    on_interact
        What interacting with its cell does; the object is removed. None: nothing happens.
    on_enter
        What moving onto its cell does; the object is removed. None: the agent just stands on it.
    walks
        Chance, at every step, that it moves in a random direction once the agents have acted, to the nearest
        1/65536. Walls, agents and other objects block it.

    Raises
    ------
    ValueError
        If the count, the chance, the pattern, the symbol or the type of another argument is impossible.
    """

    name: str
    count: int
    pattern: Pattern
    symbol: str
    on_interact: Effect | None = None
    on_enter: Effect | None = None
    walks: float = 0.0

    def __post_init__(self) -> None:
        _require_looks(self.name, self.pattern, self.symbol)
        count = require_integer(f"num_{self.name}", self.count, 0, "a count, 0 or more")
        object.__setattr__(self, "count", count)
        _require_effect("on_interact", self.on_interact)
        _require_effect("on_enter", self.on_enter)
        if not is_chance(self.walks):
            raise ValueError(f"walks is {self.walks!r} for {self.name}; a chance is 0 to 1")
        object.__setattr__(self, "walks", float(self.walks))


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
        Its character in ``ansi`` frames, none of :data:`RESERVED_SYMBOLS`.
    on_stand
        What ending a step on its cell does.
    cell
        Where it is. None: on the bottom right free cell.
    terminates
        Whether the episode then ends.

    Raises
    ------
    ValueError
        If the pattern, the symbol or the type of another argument is impossible.
    """

    name: str
    pattern: Pattern
    symbol: str
    on_stand: Effect
    cell: Cell | None = None
    terminates: bool = False

    def __post_init__(self) -> None:
        _require_looks(self.name, self.pattern, self.symbol)
        if not isinstance(self.on_stand, Effect):
            raise ValueError(f"on_stand is {self.on_stand!r}; it must be an Effect")
        if self.cell is not None:
            object.__setattr__(self, "cell", _require_cell(f"the {self.name}'s cell is", self.cell))
        object.__setattr__(self, "terminates", require_bool("terminates", self.terminates))


def _require_name(argument: str, name: object) -> None:
    if not isinstance(name, str) or not name:
        raise ValueError(f"{argument} is {name!r}; it must be a name")


def _require_looks(name: object, pattern: object, symbol: object) -> None:
    """Raise a ValueError unless something that is drawn has a name, a known pattern and a symbol."""
    _require_name("name", name)
    patterns = get_args(Pattern)
    if pattern not in patterns:
        raise ValueError(f"pattern is {pattern!r} for {name}; it must be one of {patterns}")
    if not isinstance(symbol, str) or len(symbol) != 1 or not symbol.isprintable():
        raise ValueError(f"symbol is {symbol!r} for {name}; it must be one printable character")
    if symbol in RESERVED_SYMBOLS:
        raise ValueError(f"symbol is {symbol!r} for {name}; it must be none of {RESERVED_SYMBOLS!r}")


def _require_effect(argument: str, effect: object) -> None:
    if effect is not None and not isinstance(effect, Effect):
        raise ValueError(f"{argument} is {effect!r}; it must be an Effect or None")


def _require_cell(found: str, cell: object) -> Cell:
    """Return row and column; ``found`` begins the message of the ValueError if it is no cell."""
    pair = tuple(cell) if isinstance(cell, Iterable) else ()
    numbers = [number for number in map(as_integer, pair) if number is not None]
    if len(pair) != 2 or len(numbers) != 2:
        raise ValueError(f"{found} {cell!r}; a cell is two integers, row and column")
    return numbers[0], numbers[1]


def _require_names(argument: str, names: object) -> tuple[str, ...]:
    """Return names as a tuple, or raise a ValueError if they are none."""
    listed = tuple(names) if isinstance(names, Sequence) and not isinstance(names, str) else ()
    valid = all(isinstance(name, str) and name for name in listed)
    if not listed or not valid:
        example = f"({names!r},)" if isinstance(names, str) and names else "('first', 'second')"
        raise ValueError(f"{argument} is {names!r}; it must be a tuple of distinct names, as in {example}")
    return listed


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
        How many of :data:`ACTION_NAMES` there are: 4 (only moves), 5 (waiting too) or all 9, as any
        ``on_interact`` needs.
    layout
        How size, walls, counts and horizon are drawn anew for each episode. It is set by :meth:`in_layout`,
        which makes size, counts and horizon the greatest that it draws.

    Raises
    ------
    ValueError
        If a size, a chance, a cell or the horizon is impossible, a name or a symbol stands for two things, an
        effect names an unknown reward component or objective or can never happen, the layout does not fit, or
        an argument has the wrong type.
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
        _require_name("name", self.name)
        self._store_integers()
        self._store_tuples()
        if len(self.objects) > MAX_KINDS:
            raise ValueError(f"objects has {len(self.objects)} kinds; it must have at most {MAX_KINDS}")
        if self.fixture is not None and not isinstance(self.fixture, Fixture):
            raise ValueError(f"fixture is {self.fixture!r}; it must be a Fixture or None")
        for argument, names in (
            ("reward_names", self.reward_names),
            ("objective_names", self.objective_names),
            ("plane_names", self.plane_names),
        ):
            if len(set(names)) < len(names):
                raise ValueError(f"{argument} is {names}; every name must be another one")
        symbols = [thing.symbol for thing in (*self.objects, self.fixture) if thing is not None]
        for symbol in symbols:
            if symbols.count(symbol) > 1:
                raise ValueError(f"symbol is {symbol!r} for two things; each needs a symbol of its own")
        for kind in self.objects:
            if kind.on_interact is not None and self.num_actions < NUM_ACTIONS:
                wanted = f"{NUM_ACTIONS}, for {kind.name} have an on_interact"
                raise ValueError(f"num_actions is {self.num_actions}; it must be {wanted}")
        if not is_chance(self.slip):
            raise ValueError(f"slip is {self.slip!r}; a chance is 0 to 1")
        object.__setattr__(self, "slip", float(self.slip))
        if self.start not in ("random", "corner"):
            raise ValueError(f"start is {self.start!r}; it must be 'random' or 'corner'")
        for row, column in self.interior_walls:
            if not (0 < row < self.height - 1 and 0 < column < self.width - 1):
                raise ValueError(f"interior_walls has {(row, column)}; it must be inside the border")
        if self.fixture is not None and self.fixture.cell is not None:
            row, column = self.fixture.cell
            inside = 0 < row < self.height - 1 and 0 < column < self.width - 1
            if not inside or self.fixture.cell in self.interior_walls:
                raise ValueError(f"the {self.fixture.name}'s cell is {(row, column)}; it must be a free cell")
        if self.layout is not None:
            self._check_layout(self.layout)
        _require_effect("on_step", self.on_step)
        for effect in self.effects:
            if effect.reward not in self.reward_names:
                raise ValueError(f"reward is {effect.reward!r}; it must be one of {self.reward_names}")
            if effect.objective not in self.objective_names:
                names = self.objective_names
                raise ValueError(f"objective is {effect.objective!r}; it must be one of {names}")

    def _store_integers(self) -> None:
        """Keep sizes, horizon and number of actions as Python's integers, which do not overflow."""
        for argument, size in (("height", self.height), ("width", self.width)):
            integer = require_integer(argument, size, 3, "at least 3, the border wall included")
            object.__setattr__(self, argument, integer)
        horizon = require_integer("max_cycles", self.horizon, 1, "at least 1, the steps of an episode")
        if horizon > MAX_HORIZON:
            raise ValueError(f"max_cycles is {horizon}; it must be at most {MAX_HORIZON}")
        object.__setattr__(self, "horizon", horizon)
        num_actions = as_integer(self.num_actions)
        if num_actions not in (NUM_MOVES, NUM_MOVES + 1, NUM_ACTIONS):
            raise ValueError(f"num_actions is {self.num_actions!r}; it must be 4, 5 or {NUM_ACTIONS}")
        object.__setattr__(self, "num_actions", num_actions)

    def _store_tuples(self) -> None:
        """Keep what is listed as tuples, so that a world can be hashed."""
        for argument, names in (
            ("reward_names", self.reward_names),
            ("objective_names", self.objective_names),
        ):
            object.__setattr__(self, argument, _require_names(argument, names))
        objects: object = self.objects
        walls: object = self.interior_walls
        if not isinstance(objects, Sequence) or not all(isinstance(kind, ObjectKind) for kind in objects):
            raise ValueError(f"objects is {objects!r}; it must be a tuple of ObjectKind")
        object.__setattr__(self, "objects", tuple(objects))
        if not isinstance(walls, Iterable) or isinstance(walls, (str, Mapping)):
            raise ValueError(f"interior_walls is {walls!r}; it must be a tuple of cells")
        cells = tuple(_require_cell("interior_walls has", cell) for cell in walls)
        object.__setattr__(self, "interior_walls", cells)

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
        """The least and the most that one agent's step can add to each reward component, 0 among them.

        A step that only resets pays 0, even in a world that pays on every step.
        """
        touched = [effect for kind in self.objects for effect in (kind.on_interact, kind.on_enter) if effect]
        stood = [] if self.fixture is None else [self.fixture.on_stand]
        always = [] if self.on_step is None else [self.on_step]
        # The step that ends an episode pays for that alone.
        ends = self.fixture is not None and self.fixture.terminates
        exclusive = [touched, always + stood] if ends else [touched, always, stood]
        low, high = [], []
        for name in self.reward_names:
            groups = [[e.amount for e in group if e.reward == name] for group in exclusive]
            low.append(sum(min([0.0, *amounts]) for amounts in groups))
            high.append(sum(max([0.0, *amounts]) for amounts in groups))
        return low, high

    def in_layout(self, layout: Layout | Mapping[str, Any] | str | None) -> World:
        """Return this world with rooms drawn anew for each episode.

        Sizes become the layout's greatest ones, which are those of the observations, and so do counts and
        horizon.

        Parameters
        ----------
        layout
            A :class:`~moral_envs.layouts.Layout`, a dict of its arguments, as Gymnasium reads it from a
            specification in JSON, or one of :data:`~moral_envs.layouts.NAMES`. None: the world as it is.

        Raises
        ------
        ValueError
            If the name is unknown or the layout does not fit this world.
        """
        if layout is None:
            return self
        if isinstance(layout, str):
            layout = layouts.named(layout)
        if isinstance(layout, Mapping):
            layout = layouts.from_arguments(layout)
        if not isinstance(layout, Layout):
            raise ValueError(f"layout is {layout!r}; it must be a Layout or one of {layouts.NAMES}")
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

    def _check_layout(self, layout: Layout) -> None:
        """Raise a ValueError unless the world is one that :meth:`in_layout` has made."""
        if not isinstance(layout, Layout):
            raise ValueError(f"layout is {layout!r}; it must be a Layout, or a name given to in_layout")
        if self.interior_walls or self.start != "random" or (self.fixture and self.fixture.cell):
            raise ValueError(
                f"layout is {layout}; it must be None, for {self.name} has walls or places of its own"
            )
        counts = {kind.name: kind.count for kind in self.objects}
        layout.check(counts)
        same_size = layout.canvas(self.height, self.width) == (self.height, self.width)
        cycles = layout.max_cycles or self.horizon
        same_horizon = (max(cycles) if isinstance(cycles, tuple) else cycles) == self.horizon
        if not (same_size and same_horizon and layout.greatest_counts(counts) == tuple(counts.values())):
            raise ValueError(f"layout is {layout}; it must be given to in_layout, which fits the world to it")
