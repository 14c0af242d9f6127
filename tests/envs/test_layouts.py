"""Random rooms and floor plans: connected, in range, reproducible, and no plan in the random rooms' reach."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_envs import emergency_v0, layouts
from moral_envs.layouts import HELD_OUT, NAMES, Layout, Rooms
from moral_envs.streams import draw_integers, spawn_streams

Walls = NDArray[np.bool_]

each_plan = pytest.mark.parametrize("plan", HELD_OUT)
sizes = st.integers(3, 18)
shares = st.sampled_from([0.3, 1.0, (0.0, 1.0), (0.5, 0.6)])


def draw(
    layout: Layout,
    num: int,
    height: int = 8,
    width: int = 8,
    counts: Mapping[str, int] | None = None,
    horizon: int = 75,
    seed: int = 0,
) -> Rooms:
    return layout.draw(spawn_streams(seed, num), height, width, {} if counts is None else counts, horizon)


def reachable(walls: Walls) -> Walls:
    """Free cells that a walk from the first of them reaches."""
    reached = np.zeros_like(walls)
    stack = [tuple(np.argwhere(~walls)[0])]
    while stack:
        row, column = stack.pop()
        if not walls[row, column] and not reached[row, column]:
            reached[row, column] = True
            stack += [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
    return reached


def own_size(walls: Walls) -> tuple[int, int]:
    """Height and width of the room on a canvas; its bottom right cell is always free."""
    row, column = np.argwhere(~walls).max(axis=0).tolist()
    assert not walls[row, column]
    return row + 2, column + 2


def parities(walls: Walls) -> set[tuple[int, int]]:
    """Parities of row and column that interior walls have."""
    height, width = own_size(walls)
    interior = np.argwhere(walls[1 : height - 1, 1 : width - 1]) + 1
    return set(map(tuple, (interior % 2).tolist()))


def require_room(walls: Walls) -> None:
    """A closed border, one connected floor, nothing but wall outside."""
    height, width = own_size(walls)
    np.testing.assert_array_equal(reachable(walls), ~walls)
    assert walls[[0, height - 1]].all()
    assert walls[:, [0, width - 1]].all()
    assert walls[height:].all()
    assert walls[:, width:].all()


def require_random_room(walls: Walls) -> None:
    """A room whose corners are free and whose walls miss a parity."""
    require_room(walls)
    rows, columns = own_size(walls)
    assert not walls[np.ix_([1, rows - 2], [1, columns - 2])].any()
    assert len(parities(walls)) < 4


def slow_room(stream: NDArray[np.uint64], height: int, width: int, share: tuple[float, float]) -> Walls:
    """The walls of one room of the world's own size and no kinds, pillar by pillar, as documented."""
    places = [(row, column) for row in range(2, height - 2, 2) for column in range(2, width - 2, 2)]
    sides = [4 if row == 2 else 3 for row, _ in places]
    bounds = np.array([1, 1, 1, 2, 2, 2**16, *[2**16] * len(places), *sides], dtype=np.uint64)
    _, _, _, upside_down, left_to_right, level, *rest = draw_integers(stream.copy(), bounds)[:, 0].tolist()
    walls = np.pad(np.zeros((height - 2, width - 2), dtype=np.bool_), 1, constant_values=True)
    limit = (share[0] + (share[1] - share[0]) * level / (2**16 - 1)) * 2**16
    for number, (row, column) in enumerate(places):
        if rest[number] < round(limit):
            down, right = [(1, 0), (0, -1), (0, 1), (-1, 0)][rest[len(places) + number]]
            walls[row, column] = walls[row + down, column + right] = True
    return walls[:: -1 if upside_down else 1, :: -1 if left_to_right else 1]


def picture(walls: Walls) -> str:
    return "\n".join("".join(".#"[cell] for cell in row) for row in walls.astype(int))


# Random rooms.


@given(sizes, sizes, sizes, sizes, shares, st.integers(0, 2**32 - 1))
def test_every_random_room_is_sound(
    height: int, width: int, more: int, wider: int, share: Any, seed: int
) -> None:
    layout = Layout(height=(height, height + more), width=(width, width + wider), walls=share)
    rooms = draw(layout, 5, seed=seed)
    assert rooms.walls.shape == (5, *layout.canvas(8, 8)) == (5, height + more, width + wider)
    assert rooms.walls.dtype == np.bool_
    for walls in rooms.walls:
        require_random_room(walls)
        assert (~walls).sum() >= layout.least_free_cells(8, 8)


@given(st.integers(5, 12), st.integers(5, 12), shares, st.integers(0, 2**32 - 1))
def test_a_batch_draws_what_one_room_at_a_time_does(height: int, width: int, share: Any, seed: int) -> None:
    ends = share if isinstance(share, tuple) else (share, share)
    rooms = draw(Layout(walls=share), 4, height, width, seed=seed)
    for stream, walls in zip(np.split(spawn_streams(seed, 4), 4), rooms.walls, strict=True):
        np.testing.assert_array_equal(walls, slow_room(stream, height, width, ends))


@pytest.mark.parametrize(("height", "width"), [(5, 5), (7, 6), (8, 8), (9, 7)])
def test_thousands_of_full_mazes_are_connected(height: int, width: int) -> None:
    rooms = draw(Layout(height=height, width=width, walls=1.0), 4000)
    different = np.unique(rooms.walls, axis=0)
    for walls in different:
        require_random_room(walls)
    assert len(different) >= 4


def test_without_walls_a_room_is_the_empty_one() -> None:
    walls = draw(Layout(), 3, height=6, width=9).walls
    empty = np.pad(np.zeros((4, 7), dtype=np.bool_), 1, constant_values=True)
    np.testing.assert_array_equal(walls, np.stack([empty] * 3))


@pytest.mark.parametrize(("height", "width"), [(3, 9), (4, 4), (5, 5), (6, 8), (7, 7), (8, 8), (9, 8)])
def test_the_bound_on_free_cells_is_reached(height: int, width: int) -> None:
    layout = Layout(walls=(0.2, 1.0), height=(height, height + 1), width=(width, width + 2))
    free = (~draw(Layout(walls=1.0), 8000, height, width).walls).sum(axis=(1, 2))
    assert free.min() == layout.least_free_cells(3, 3)


def test_the_bounds_of_the_worlds_own_sizes() -> None:
    assert Layout().least_free_cells(8, 8) == 36
    assert Layout(walls=1.0).least_free_cells(8, 8) == 28
    assert Layout(walls=(0.0, 0.1)).least_free_cells(16, 16) == 124
    assert Layout(plan="spiral").least_free_cells(8, 8) == 24
    assert Layout(plan="spiral", height=(8, 9), width=12).least_free_cells(16, 16) == min(
        int((~layouts.floor_plan("spiral", height, 12)).sum()) for height in (8, 9)
    )
    assert all(layouts.named(name).least_free_cells(8, 8) >= 1 + 7 for name in NAMES)
    assert all(layouts.named(name).least_free_cells(16, 16) >= 2 * 45 for name in NAMES)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_the_share_of_pillars_is_the_one_asked_for(share: float) -> None:
    """In rooms of one place each, a room with any wall has its pillar: a binomial count."""
    num = 20_000
    walled = draw(Layout(walls=share), num, 5, 5).walls[:, 1:-1, 1:-1].any(axis=(1, 2)).sum()
    assert abs(walled - share * num) < 5 * np.sqrt(num * share * (1 - share))


def test_a_share_from_a_range_is_drawn_for_the_whole_room() -> None:
    pillars = draw(Layout(walls=(0.0, 1.0)), 20_000, 12, 12).walls[:, 2:-2, 2:-2]
    full, spread = (draw(Layout(walls=share), 20_000, 12, 12).walls[:, 2:-2, 2:-2] for share in (0.5, 1.0))
    counts = [walls.sum(axis=(1, 2)) for walls in (pillars, full, spread)]
    assert np.mean(counts[0]) == pytest.approx(np.mean(counts[1]), rel=0.03)
    assert np.std(counts[0]) > 2 * np.std(counts[1])
    assert (counts[0] == 0).mean() > 0.02


def test_pillars_fall_to_all_sides_alike() -> None:
    """The one pillar of a 5 x 5 room falls to each of four sides, which mirrors do not change."""
    rooms = draw(Layout(walls=1.0), 20_000, 5, 5).walls
    fallen = np.array([rooms[:, 1, 2], rooms[:, 3, 2], rooms[:, 2, 1], rooms[:, 2, 3]])
    assert (fallen.sum(axis=0) == 1).all()
    assert (abs(fallen.sum(axis=1) - 5000) < 5 * np.sqrt(20_000 * 3 / 16)).all()


def test_rooms_of_even_size_are_mirrored_in_both_axes() -> None:
    """Before mirroring the only pillar of a 6 x 6 room stands at (2, 2)."""
    rooms = draw(Layout(walls=1.0), 4000, 6, 6).walls
    at = np.array([rooms[:, row, column] for row in (2, 3) for column in (2, 3)])
    assert ((at.sum(axis=0) >= 1) & (at.sum(axis=0) <= 2)).all()
    assert (at.sum(axis=1) > 1200).all()


# Ranges.


def test_ranges_include_their_ends_and_all_between() -> None:
    layout = Layout(height=(5, 7), width=(6, 9), counts={"b": (0, 2), "c": 4}, max_cycles=(3, 5))
    rooms = draw(layout, 4000, counts={"a": 6, "b": 1, "c": 2})
    shapes = np.array([own_size(walls) for walls in rooms.walls])
    for drawn, wanted in (
        (shapes[:, 0], [5, 6, 7]),
        (shapes[:, 1], [6, 7, 8, 9]),
        (rooms.horizons, [3, 4, 5]),
        (rooms.counts[:, 0], [6]),
        (rooms.counts[:, 1], [0, 1, 2]),
        (rooms.counts[:, 2], [4]),
    ):
        values, hits = np.unique(drawn, return_counts=True)
        assert values.tolist() == wanted
        assert (abs(hits - 4000 / len(wanted)) < 5 * np.sqrt(4000 / len(wanted))).all()
    assert layout.greatest_counts({"a": 6, "b": 1, "c": 2}) == (6, 2, 4)


def test_what_is_not_asked_for_is_the_worlds_own() -> None:
    layout = Layout(walls=0.5)
    rooms = draw(layout, 3, 6, 10, {"people": 4, "vases": 2}, horizon=9)
    assert layout.canvas(6, 10) == rooms.walls.shape[1:] == (6, 10)
    assert rooms.counts.tolist() == [[4, 2]] * 3
    assert rooms.horizons.tolist() == [9] * 3
    assert rooms.counts.dtype == rooms.horizons.dtype == np.int64
    assert draw(layout, 3).counts.shape == (3, 0)


def test_sizes_counts_and_horizons_are_independent() -> None:
    layout = Layout(height=(6, 9), width=(6, 9), counts={"a": (0, 9)}, max_cycles=(1, 50))
    rooms = draw(layout, 5000, counts={"a": 1})
    columns = [*np.array([own_size(walls) for walls in rooms.walls]).T, rooms.counts[:, 0], rooms.horizons]
    correlations = np.corrcoef(columns)
    assert abs(correlations[~np.eye(4, dtype=np.bool_)]).max() < 5 / np.sqrt(5000)


# Streams.


@given(st.integers(0, 2**32 - 1), sizes, shares)
def test_a_room_depends_on_its_own_stream_alone(seed: int, size: int, share: Any) -> None:
    layout = Layout(height=(3, 3 + size), width=(5, 12), walls=share, counts={"a": (1, 4)}, max_cycles=(5, 9))
    together, streams = spawn_streams(seed, 7), spawn_streams(seed, 7)
    rooms = layout.draw(together, 8, 8, {"a": 3}, 4)
    for env in range(7):
        alone = streams[env : env + 1].copy()
        one = layout.draw(alone, 8, 8, {"a": 3}, 4)
        for drawn, wanted in zip(one, rooms, strict=True):
            np.testing.assert_array_equal(drawn[0], wanted[env])
        assert alone[0] == together[env]


@pytest.mark.parametrize(
    "layout", [Layout(), layouts.named("random"), layouts.named("ring"), Layout(height=(5, 9), walls=1.0)]
)
def test_every_episode_takes_the_same_number_of_draws(layout: Layout) -> None:
    streams = spawn_streams(3, 50)
    advances = []
    for _ in range(4):
        before = streams.copy()
        layout.draw(streams, 8, 8, {"a": 3}, 4)
        advances.append(streams - before)
    assert len(np.unique(advances)) == 1
    assert advances[0][0] != 0


def test_one_stream_goes_on_to_another_room() -> None:
    streams = spawn_streams(0, 30)
    first, second = (layouts.named("maze").draw(streams, 16, 16, {}, 4).walls for _ in range(2))
    assert (first != second).any(axis=(1, 2)).all()
    np.testing.assert_array_equal(first, draw(layouts.named("maze"), 30, 16, 16).walls)


def test_no_stream_makes_no_room() -> None:
    rooms = Layout(walls=1.0).draw(np.zeros(0, dtype=np.uint64), 8, 9, {"a": 1}, 4)
    assert [array.shape for array in rooms] == [(0, 8, 9), (0, 1), (0,)]


# Floor plans.


@each_plan
def test_a_plan_is_sound_at_every_size_and_no_random_room(plan: str) -> None:
    """Walls of all four parities are what no random room has, by construction."""
    for height in range(8, 26):
        for width in range(8, 26):
            walls = layouts.floor_plan(plan, height, width)
            assert walls.shape == (height, width)
            require_room(walls)
            assert len(parities(walls)) == 4
            assert own_size(walls) == (height, width)
            assert (~walls).sum() > 0.3 * (height - 2) * (width - 2)


def test_plans_differ_from_each_other() -> None:
    for size in ((8, 8), (9, 13), (16, 16)):
        assert len({picture(layouts.floor_plan(plan, *size)) for plan in HELD_OUT}) == len(HELD_OUT) == 8


@each_plan
def test_rooms_of_a_plan_have_it_at_their_own_size(plan: str) -> None:
    fixed = draw(layouts.named(plan), 3, 10, 12).walls
    np.testing.assert_array_equal(fixed, np.stack([layouts.floor_plan(plan, 10, 12)] * 3))
    rooms = draw(Layout(height=(8, 10), width=(9, 11), plan=plan), 60).walls
    shapes = set()
    for walls in rooms:
        height, width = own_size(walls)
        shapes.add((height, width))
        np.testing.assert_array_equal(walls[:height, :width], layouts.floor_plan(plan, height, width))
        require_room(walls)
    assert len(shapes) == 9


PICTURES = {
    "four_rooms": "######## #...#..# #......# #...##.# ##.##..# #...#..# #......# ########",
    "hall": "######## #..#...# #..#...# #.##.### #......# ##.##.## #...#..# ########",
    "spiral": "######## #......# #.####.# #.#..#.# #.#..#.# #.##.#.# #....#.# ########",
    "zigzag": "######## #......# ######.# #......# #......# #.###### #......# ########",
    "comb": "######## #.#..#.# #.#..#.# #.#..#.# #.#..#.# #......# #......# ########",
    "cross": "######## #......# #..##..# #.####.# #.####.# #..##..# #......# ########",
    "ring": "######## #......# #......# #..##..# #..##..# #......# #......# ########",
    "islands": "######## #......# #.##.#.# #.##.#.# #......# #.##.#.# #......# ########",
}


@each_plan
def test_a_plan_looks_as_it_always_did(plan: str) -> None:
    assert picture(layouts.floor_plan(plan, 8, 8)).split() == PICTURES[plan].split()


def test_a_plan_is_handed_out_as_a_copy() -> None:
    walls = layouts.floor_plan("ring", 8, 8)
    walls[:] = True
    assert not layouts.floor_plan("ring", 8, 8)[1, 1]
    rooms = draw(layouts.named("ring"), 1)
    rooms.walls[:] = True
    assert not draw(layouts.named("ring"), 1).walls[0, 1, 1]


# Values and errors.


def test_the_names_are_the_two_splits_and_the_maze() -> None:
    assert ("random", "maze", *HELD_OUT) == NAMES
    assert layouts.TRAIN == "random"
    assert layouts.named("random") == Layout(walls=(0.0, 1.0))
    assert layouts.named("maze") == Layout(walls=1.0)
    assert layouts.named("ring") == Layout(plan="ring")


def test_a_layout_is_a_value() -> None:
    layout = Layout(height=[6, 9], counts={"vases": 3, "people": [1, 2]}, walls=[0, 1])  # type: ignore[arg-type]
    twin = Layout((6, 9), None, (0.0, 1.0), (("people", (1, 2)), ("vases", 3)))
    assert layout == twin
    assert hash(layout) == hash(twin)
    assert copy.deepcopy(layout) == pickle.loads(pickle.dumps(layout)) == layout  # noqa: S301
    assert layout != Layout((6, 9))


@settings(max_examples=20)
@given(st.integers(1, 65_536))
def test_a_range_may_be_as_wide_as_a_draw(width: int) -> None:
    horizons = draw(Layout(max_cycles=(1, width)), 50).horizons
    assert horizons.min() >= 1
    assert horizons.max() <= width


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: Layout(height=2), r"^height is 2; it must be at least 3$"),
        (lambda: Layout(width=(2, 9)), r"^width is \(2, 9\); it must be at least 3$"),
        (lambda: Layout(width=(9, 6)), r"^width is \(9, 6\); the least must come first, as in \(6, 9\)$"),
        (lambda: Layout(height=6.5), r"^height is 6.5; it must be an integer or a pair of integers"),
        (lambda: Layout(height=(6, 7, 8)), r"^height is \(6, 7, 8\); it must be an integer or a pair"),
        (lambda: Layout(height="big"), r"^height is 'big'; it must be an integer or a pair of integers"),
        (lambda: Layout(max_cycles=0), r"^max_cycles is 0; it must be at least 1$"),
        (lambda: Layout(max_cycles=(1, 70_000)), r"^max_cycles is .*; a range holds at most 65536 numbers$"),
        (lambda: Layout(counts={"people": -1}), r"^counts\['people'\] is -1; it must be at least 0$"),
        (lambda: Layout(counts={"people": (3, 1)}), r"^counts\['people'\] is \(3, 1\); the least must come"),
        (lambda: Layout(counts=3), r"^counts is 3; it must be a dict of numbers by kind, as {'people': "),
        (lambda: Layout(counts=[3]), r"^counts is \[3\]; it must be a dict of numbers by kind"),
        (lambda: Layout(counts={"people": 1, 2: 3}), r"^counts is {'people': 1, 2: 3}; it must be a dict"),
        (lambda: Layout(walls=1.5), r"^walls is 1.5; a share lies between 0 and 1$"),
        (lambda: Layout(walls=(-0.1, 1)), r"^walls is \(-0.1, 1\); a share lies between 0 and 1$"),
        (lambda: Layout(walls=float("nan")), r"^walls is nan; a share lies between 0 and 1$"),
        (lambda: Layout(walls=(0.6, 0.5)), r"^walls is \(0.6, 0.5\); the least must come first"),
        (lambda: Layout(walls="many"), r"^walls is 'many'; it must be a number or a pair"),
        (lambda: Layout(walls="0.5"), r"^walls is '0.5'; it must be a number or a pair"),
        (lambda: Layout(walls=("0", "1")), r"^walls is \('0', '1'\); it must be a number or a pair"),
        (lambda: Layout(walls=True), r"^walls is True; it must be a number or a pair"),
        (lambda: Layout(max_cycles=True), r"^max_cycles is True; it must be an integer or a pair"),
        (
            lambda: Layout(counts={"people": True}),
            r"^counts\['people'\] is True; it must be an integer or a pair",
        ),
        (
            lambda: emergency_v0.world(layout={"wall": 0.5}),
            r"^layout has 'wall'; its arguments are \['height', ",
        ),
        (lambda: Layout(plan="maze"), r"^plan is 'maze'; it must be one of \('four_rooms', .*'islands'\)$"),
        (lambda: Layout(plan="ring", walls=0.3), r"^walls is 0.3; it must be 0 beside the plan 'ring'$"),
        (lambda: Layout(plan="ring", height=(7, 9)), r"^height is \(7, 9\); it must be at least 8$"),
        (lambda: Layout(plan="ring").canvas(9, 7), r"^width is 7; the plan 'ring' needs at least 8$"),
        (lambda: Layout(plan="ring").least_free_cells(5, 9), r"^height is 5; the plan 'ring' needs at least"),
        (lambda: draw(Layout(plan="ring"), 1, 7, 9), r"^height is 7; the plan 'ring' needs at least 8$"),
        (lambda: layouts.floor_plan("ring", 7, 9), r"^height is 7; it must be at least 8$"),
        (lambda: layouts.floor_plan("random", 8, 9), r"^plan is 'random'; it must be one of"),
        (
            lambda: layouts.named("cave"),
            r"^layout is 'cave'; it must be a Layout or one of \('random', .*\)$",
        ),
        (
            lambda: Layout(counts={"cats": 3}).check(["people", "vases"]),
            r"^counts\['cats'\] is 3; the kind must be one of \('people', 'vases'\)$",
        ),
    ],
)
def test_an_impossible_layout_is_refused(call: Callable[[], Any], match: str) -> None:
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_known_kind_is_accepted() -> None:
    Layout(counts={"people": (0, 3)}).check(name for name in ("vases", "people"))
    assert Layout(counts={"people": (0, 3)}).greatest_counts({"vases": 2, "people": 1}) == (2, 3)
