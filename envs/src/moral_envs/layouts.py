"""Random rooms for every episode, and fixed floor plans that no random room can equal.

A :class:`Layout` says how the rooms of a world are drawn: size, interior walls, objects and horizon, each
fixed or from a range, anew for each episode and from the environment's own stream. Train on one split and
test on the other::

    train = emergency_v0.vector_env(64, layout=layouts.TRAIN)
    tests = [emergency_v0.vector_env(64, layout=name) for name in layouts.HELD_OUT]

Random walls come from toppled pillars. Pillars may stand on the cells whose row and column are both even and
that do not touch the border wall. Each one that stands falls over and becomes a wall of two cells: in the
first row of pillars to any of the four sides, in the others to any but up. The room may then be mirrored
upside down, left to right, or both. What this guarantees:

- *All free cells are connected.* Take pillars as nodes, the border as one more, and fallen pillars as edges.
  Every pillar has one edge, and none leads up but to the border, so the only cycles are two neighbours that
  fell onto each other; walls without cycles enclose nothing. A place without a pillar is free, and so is the
  cell below it, which only that pillar could have covered.
- *The four corners are free*, and with them the bottom right cell, where a fixture stands.
- *Walls miss a parity.* Before mirroring no cell with odd row and odd column is a wall; a mirror image in a
  room of even size moves these cells, yet all of them alike. So in each room there is one of the four
  combinations of even and odd row and column that no interior wall has. Every plan in :data:`HELD_OUT` has
  walls of all four: it is held out from every random layout, not just improbable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moral_envs.arguments import as_integer
from moral_envs.streams import draw_integers

MIN_SIZE = 3
"""Cells that a room has at least along each axis, the border wall included."""

MIN_PLAN_SIZE = 8
"""Cells that a floor plan needs along each axis, the border wall included."""

Range = int | tuple[int, int]
"""A number, or the least and the greatest of those that are drawn, both included."""

_UNIT = 2**16
"""Values that one draw can tell apart."""


class Rooms(NamedTuple):
    """What was drawn for the episodes of a batch; all arrays are fresh."""

    walls: NDArray[np.bool_]
    """Shape (n, height, width) of the canvas; outside a smaller room everything is wall."""
    counts: NDArray[np.int64]
    """Objects of each kind, shape (n, kinds)."""
    horizons: NDArray[np.int64]
    """Steps after which the episode truncates, shape (n,)."""


@dataclass(frozen=True)
class Layout:
    """How the rooms of a world are drawn, anew for each episode.

    A number is fixed; of a pair (least, greatest) every whole number between, both included, is equally
    likely. Sizes, counts and horizon are drawn independently of each other.

    Parameters
    ----------
    height, width
        Size in cells, the border wall included. None: the world's own.
    walls
        Share of the places for pillars, from 0 to 1, that have one (see the module's docstring); of a pair, a
        share is drawn for each episode first. A room of 8 x 8 cells has 4 places, one of 16 x 16 has 36.
    counts
        Objects of a kind, by the name of its observation plane (``"people"``, ``"vases"``); kinds that are
        not named keep the world's own count. Stored as sorted pairs, so that a layout can be hashed.
    max_cycles
        Steps after which an episode truncates. None: the world's own.
    plan
        Name of a floor plan, one of :data:`HELD_OUT`, instead of random walls.

    Raises
    ------
    ValueError
        If a number is out of range, a range is empty, or the plan is unknown or does not fit.
    """

    height: Range | None = None
    width: Range | None = None
    walls: float | tuple[float, float] = 0.0
    counts: Mapping[str, Range] | tuple[tuple[str, Range], ...] = ()
    max_cycles: Range | None = None
    plan: str | None = None

    def __post_init__(self) -> None:
        if self.plan is not None and self.plan not in HELD_OUT:
            raise ValueError(f"plan is {self.plan!r}; it must be one of {HELD_OUT}")
        least_size = MIN_SIZE if self.plan is None else MIN_PLAN_SIZE
        for name, least in (("height", least_size), ("width", least_size), ("max_cycles", 1)):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _checked_range(name, value, least))
        object.__setattr__(self, "walls", _checked_share("walls", self.walls))
        if self.plan is not None and self._share[1] > 0:
            raise ValueError(f"walls is {self.walls}; it must be 0 beside the plan {self.plan!r}")
        _check_counts(self.counts)
        counts = {kind: _checked_range(f"counts[{kind!r}]", n, 0) for kind, n in self._named_counts()}
        object.__setattr__(self, "counts", tuple(sorted(counts.items())))

    def check(self, names: Iterable[str]) -> None:
        """Raise a ValueError if ``counts`` has a kind that is not among the ``names`` of a world's kinds."""
        known = tuple(names)
        for kind, count in self._named_counts():
            if kind not in known:
                raise ValueError(f"counts[{kind!r}] is {count}; the kind must be one of {known}")

    def canvas(self, height: int, width: int) -> tuple[int, int]:
        """Greatest height and width of a room; ``height`` and ``width`` are the world's own.

        Raises
        ------
        ValueError
            If the world's own size is used and too small for the plan.
        """
        (_, greatest_height), (_, greatest_width) = self._sizes(height, width)
        return greatest_height, greatest_width

    def greatest_counts(self, counts: Mapping[str, int]) -> tuple[int, ...]:
        """How many objects of each kind there can be; ``counts`` are the world's own, in order."""
        return tuple(greatest for _, greatest in self._count_ranges(counts))

    def least_free_cells(self, height: int, width: int) -> int:
        """Free cells of the fullest room that can be drawn; ``height`` and ``width`` are the world's own."""
        (least_height, greatest_height), (least_width, greatest_width) = self._sizes(height, width)
        if self.plan is None:
            # A longer axis brings more cells than pillars could fill, so the smallest room has the fewest
            # free cells. All its pillars may stand and fall onto cells of their own.
            pillars = len(range(2, least_height - 2, 2)) * len(range(2, least_width - 2, 2))
            return (least_height - 2) * (least_width - 2) - (2 * pillars if self._share[1] > 0 else 0)
        sizes = (
            (rows, columns)
            for rows in range(least_height, greatest_height + 1)
            for columns in range(least_width, greatest_width + 1)
        )
        return min(int((~_plan(self.plan, *size)).sum()) for size in sizes)

    def draw(
        self,
        streams: NDArray[np.uint64],
        height: int,
        width: int,
        counts: Mapping[str, int],
        horizon: int,
    ) -> Rooms:
        """Draw a room for each of a batch of streams.

        The number of draws depends on the layout, the world's own size and the number of kinds alone: height,
        width, horizon, one for each kind; where random walls are possible, three for the two mirrors and the
        share of pillars, then two for every place for a pillar on the canvas.

        Parameters
        ----------
        streams
            uint64 array of shape (n,), changed in place.
        height, width
            The world's own size.
        counts
            The world's own counts by the names of its kinds, in order.
        horizon
            The world's own horizon.

        Returns
        -------
        Rooms
            Walls of shape ``(n, *canvas)``, counts of shape (n, kinds) and horizons of shape (n,).
        """
        canvas = self.canvas(height, width)
        cycles = _ends(horizon if self.max_cycles is None else self.max_cycles)
        ranges = np.array([*self._sizes(height, width), cycles, *self._count_ranges(counts)], dtype=np.int64)
        places = _places(*canvas) if self._share[1] > 0 else np.empty((0, 2), dtype=np.int64)
        bounds = [ranges[:, 1] - ranges[:, 0] + 1]
        if len(places):
            # Down, left, right, and in the first row up.
            sides = np.where(places[:, 0] == 2, 4, 3)
            bounds += [np.array([2, 2, _UNIT]), np.full(len(places), _UNIT), sides]
        draws = draw_integers(streams, np.concatenate(bounds).astype(np.uint64))
        heights, widths, horizons, *kinds = draws[: len(ranges)] + ranges[:, :1]

        if self.plan is None:
            walls = _borders(heights, widths, canvas)
        else:
            walls = _planned(self.plan, heights, widths, canvas)
        if len(places):
            _add_pillars(walls, heights, widths, places, self._share, draws[len(ranges) :])
        drawn = np.stack(kinds, axis=1) if kinds else np.empty((len(streams), 0), dtype=np.int64)
        return Rooms(walls, drawn, horizons.copy())

    @property
    def _share(self) -> tuple[float, float]:
        return self.walls if isinstance(self.walls, tuple) else (self.walls, self.walls)

    def _named_counts(self) -> list[tuple[str, Range]]:
        return list(dict(self.counts).items())

    def _sizes(self, height: int, width: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Least and greatest height and width."""
        if self.plan is not None:
            for name, own, value in (("height", height, self.height), ("width", width, self.width)):
                if value is None and own < MIN_PLAN_SIZE:
                    raise ValueError(
                        f"{name} is {own}; the plan {self.plan!r} needs at least {MIN_PLAN_SIZE}"
                    )
        return (
            _ends(height if self.height is None else self.height),
            _ends(width if self.width is None else self.width),
        )

    def _count_ranges(self, counts: Mapping[str, int]) -> list[tuple[int, int]]:
        own: dict[str, Range] = {**counts, **dict(self._named_counts())}
        return [_ends(own[kind]) for kind in counts]


def named(name: str) -> Layout:
    """Return the layout of a name in :data:`NAMES`.

    Raises
    ------
    ValueError
        If there is no such layout.
    """
    if name not in NAMES:
        raise ValueError(f"layout is {name!r}; it must be a Layout or one of {NAMES}")
    return _RANDOM[name] if name in _RANDOM else Layout(plan=name)


def from_arguments(arguments: Mapping[str, Any]) -> Layout:
    """Return the layout of a dict of its arguments.

    Raises
    ------
    ValueError
        If it has no such argument, or as for :class:`Layout`.
    """
    known = [field.name for field in fields(Layout)]
    unknown = [name for name in arguments if name not in known]
    if unknown:
        raise ValueError(f"layout has {unknown[0]!r}; its arguments are {known}")
    return Layout(**arguments)


def floor_plan(name: str, height: int, width: int) -> NDArray[np.bool_]:
    """Draw a floor plan.

    Parameters
    ----------
    name
        One of :data:`HELD_OUT`.
    height, width
        Size in cells, the border wall included, each at least 8.

    Returns
    -------
    bool array of shape (height, width)
        Where there is a wall, the border included; a fresh array.

    Raises
    ------
    ValueError
        If there is no such plan or the room is too small.
    """
    layout = Layout(height=height, width=width, plan=name)
    return _plan(name, *layout.canvas(height, width)).copy()


def _ends(value: Range) -> tuple[int, int]:
    return value if isinstance(value, tuple) else (value, value)


def _checked_range(name: str, value: object, least: int) -> Range:
    """Return ``value`` as a number or a pair of numbers that do not lie below ``least``, or raise."""
    pair = value if isinstance(value, (tuple, list)) else (value, value)
    ends = [end for end in map(as_integer, pair) if end is not None]
    if len(pair) != 2 or len(ends) != 2:
        raise ValueError(
            f"{name} is {value!r}; it must be an integer or a pair of integers (least, greatest)"
        )
    low, high = ends
    if low > high:
        raise ValueError(f"{name} is {value!r}; the least must come first, as in {(high, low)}")
    if low < least:
        raise ValueError(f"{name} is {value!r}; it must be at least {least}")
    if high - low >= _UNIT:
        raise ValueError(f"{name} is {value!r}; a range holds at most {_UNIT} numbers")
    return (low, high) if isinstance(value, (tuple, list)) else low


def _check_counts(value: object) -> None:
    """Raise a ValueError unless ``value`` is a dict, or the pairs of one, with texts for its keys."""
    try:
        by_name = all(isinstance(kind, str) for kind in dict(value))  # type: ignore[call-overload]
    except (TypeError, ValueError):
        by_name = False
    if not by_name:
        raise ValueError(
            f"counts is {value!r}; it must be a dict of numbers by kind, as {{'people': (1, 4)}}"
        )


def _checked_share(name: str, value: object) -> float | tuple[float, float]:
    """Return ``value`` as a share or a pair of shares, or raise."""
    pair = value if isinstance(value, (tuple, list)) else (value, value)
    if len(pair) != 2 or not all(isinstance(end, Real) and not isinstance(end, bool) for end in pair):
        raise ValueError(f"{name} is {value!r}; it must be a number or a pair (least, greatest)")
    low, high = (float(end) for end in pair)
    if not (0 <= low <= 1 and 0 <= high <= 1):
        raise ValueError(f"{name} is {value!r}; a share lies between 0 and 1")
    if low > high:
        raise ValueError(f"{name} is {value!r}; the least must come first, as in {(high, low)}")
    return (low, high) if isinstance(value, (tuple, list)) else low


def _borders(
    heights: NDArray[np.int64], widths: NDArray[np.int64], canvas: tuple[int, int]
) -> NDArray[np.bool_]:
    """Empty rooms, bool (n, *canvas)."""
    rows, columns = (np.arange(size) for size in canvas)
    inside_rows = (rows >= 1) & (rows < heights[:, None] - 1)
    inside_columns = (columns >= 1) & (columns < widths[:, None] - 1)
    return ~(inside_rows[:, :, None] & inside_columns[:, None, :])


def _planned(
    name: str, heights: NDArray[np.int64], widths: NDArray[np.int64], canvas: tuple[int, int]
) -> NDArray[np.bool_]:
    """Rooms of one floor plan, bool (n, *canvas)."""
    walls = np.ones((len(heights), *canvas), dtype=np.bool_)
    for height, width in set(zip(heights.tolist(), widths.tolist(), strict=True)):
        same = (heights == height) & (widths == width)
        walls[same, :height, :width] = _plan(name, height, width)
    return walls


@lru_cache(maxsize=64)
def _places(height: int, width: int) -> NDArray[np.int64]:
    """Row and column of every place for a pillar, int64 (places, 2), read-only."""
    grid = np.meshgrid(np.arange(2, height - 2, 2), np.arange(2, width - 2, 2), indexing="ij")
    places = np.stack(grid, axis=-1).reshape(-1, 2)
    places.flags.writeable = False
    return places


def _add_pillars(
    walls: NDArray[np.bool_],
    heights: NDArray[np.int64],
    widths: NDArray[np.int64],
    places: NDArray[np.int64],
    share: tuple[float, float],
    draws: NDArray[np.int64],
) -> None:
    """Add fallen pillars to ``walls`` (n, H, W); ``draws`` has shape (3 + 2 * places, n)."""
    upside_down, left_to_right, level = draws[:3]
    stand, sides = draws[3:].reshape(2, len(places), -1)
    low, high = share
    limits = np.rint((low + (high - low) * level / (_UNIT - 1)) * _UNIT).astype(np.int64)
    rows, columns = places[:, :1], places[:, 1:]
    standing = (stand < limits) & (rows < heights - 2) & (columns < widths - 2)
    # Mirrored, a cell lies as far from the opposite corner, and what led down leads up.
    num, height, width = walls.shape
    down = np.where(upside_down, -width, width)
    right = np.where(left_to_right, -1, 1)
    corners = np.arange(num) * (height * width)
    corners += upside_down * (heights - 1) * width + left_to_right * (widths - 1)
    pillars = (rows * down + columns * right + corners)[standing]
    steps = np.stack([down, -right, right, -down])
    flat = walls.reshape(-1)
    flat[pillars] = True
    flat[pillars + steps[sides, np.arange(num)][standing]] = True


# Floor plans. Each function gets the rows (height, 1), the columns (1, width) and the numbers of the last row
# and column inside the border, where the fixture's cell lies, and says where the interior walls are.

_Cells = NDArray[np.int64]


def _four_rooms(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    height, width = last_row + 2, last_column + 2
    middle_row, middle = height // 2, width // 2
    # Right of the middle the wall is one row higher, so that walls of all parities meet there.
    across = row == middle_row - (column > middle)
    doors_across = (column == middle // 2) | (column == (middle + width) // 2)
    doors_along = (row == middle_row // 2) | (row == (middle_row + height) // 2)
    walls: NDArray[np.bool_] = across & ~doors_across & (column != middle) | (column == middle) & ~doors_along
    return walls


def _hall(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    top, bottom = (last_row + 2) // 2 - 1, (last_row + 2) // 2 + 1
    between = (column > 2) & (column < last_column)
    above = (row == top) & (column % 3 != 1) | (row < top) & between & (column % 3 == 0)
    below = (row == bottom) & (column % 3 != 2) | (row > bottom) & between & (column % 3 == 1)
    walls: NDArray[np.bool_] = above | below
    return walls


def _spiral(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    walls = np.ones(np.broadcast_shapes(row.shape, column.shape), dtype=np.bool_)
    # Walls of all parities need an even size; an odd one has a thicker border above or on the left.
    top, left = 1 + last_row % 2, 1 + last_column % 2

    def ahead(distance: int) -> tuple[int, int] | None:
        r, c = at[0] + distance * step[0], at[1] + distance * step[1]
        return (r, c) if top <= r <= last_row and left <= c <= last_column else None

    at, step, turns = (last_row, last_column), (-1, 0), 0
    walls[at] = False
    while turns < 2:
        following, beyond = ahead(1), ahead(2)
        if following is not None and walls[following] and (beyond is None or walls[beyond]):
            at, turns = following, 0
            walls[at] = False
        else:
            step, turns = (-step[1], step[0]), turns + 1
    return walls


def _zigzag(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    gap = np.where(row % 2 == 0, last_column, 1)
    walls: NDArray[np.bool_] = (row % 3 == 2) & (row < last_row) & (column != gap)
    return walls


def _comb(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    walls: NDArray[np.bool_] = (column % 3 == 2) & (column < last_column) & (row < last_row - 1)
    return walls


def _cross(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    middle_row, middle = (last_row + 2) // 2, (last_column + 2) // 2
    arms = (row == middle_row) | (row == middle_row - 1) | (column == middle) | (column == middle - 1)
    walls: NDArray[np.bool_] = arms & (row > 1) & (row < last_row) & (column > 1) & (column < last_column)
    return walls


def _ring(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    walls: NDArray[np.bool_] = (row > 2) & (row < last_row - 1) & (column > 2) & (column < last_column - 1)
    return walls


def _islands(row: _Cells, column: _Cells, last_row: int, last_column: int) -> NDArray[np.bool_]:
    walls: NDArray[np.bool_] = (row % 3 != 1) & (row < last_row) & (column % 3 != 1) & (column < last_column)
    return walls


_PLANS: dict[str, Callable[[_Cells, _Cells, int, int], NDArray[np.bool_]]] = {
    "four_rooms": _four_rooms,
    "hall": _hall,
    "spiral": _spiral,
    "zigzag": _zigzag,
    "comb": _comb,
    "cross": _cross,
    "ring": _ring,
    "islands": _islands,
}


@lru_cache(maxsize=1024)
def _plan(name: str, height: int, width: int) -> NDArray[np.bool_]:
    """Where a floor plan has walls, the border included: bool (height, width), read-only."""
    rows, columns = np.arange(height)[:, None], np.arange(width)[None, :]
    walls = np.ones((height, width), dtype=np.bool_)
    walls[1:-1, 1:-1] = _PLANS[name](rows, columns, height - 2, width - 2)[1:-1, 1:-1]
    walls.flags.writeable = False
    return walls


_RANDOM = {"random": Layout(walls=(0.0, 1.0)), "maze": Layout(walls=1.0)}

TRAIN = "random"
"""Name of the layout to train on: the world's own size, from no pillars at all to one on every place."""

HELD_OUT = tuple(_PLANS)
"""Names of the floor plans, to test on; no random layout ever draws one of them."""

NAMES = (*_RANDOM, *HELD_OUT)
"""Names that a ``layout`` argument understands; ``"maze"`` has a pillar on every place."""
