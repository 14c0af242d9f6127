"""Pictures show everything there is, and are the caller's own."""

from __future__ import annotations

from itertools import combinations
from textwrap import indent
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from moral_envs import delivery_v0, emergency_v0
from moral_envs.rendering import _drawing, draw_ansi, draw_icon, draw_rgb
from moral_envs.world import Effect, Fixture, ObjectKind, Pattern, World

EMERGENCY, DELIVERY = emergency_v0.world(), delivery_v0.world()
TILES = [8, 13, 32, 64]


def scene(world: World, objects: dict[int, list[tuple[int, int]]]) -> NDArray[np.uint8]:
    """Planes of a world without agents, the objects given by kind."""
    planes = np.zeros((len(world.plane_names), world.height, world.width), dtype=np.uint8)
    planes[0] = 1
    planes[0, 1:-1, 1:-1] = 0
    for kind, cells in objects.items():
        for cell in cells:
            planes[2 + kind][cell] = 1
    if world.fixture is not None:
        planes[-1, -2, -2] = 1
    return planes


def cell(image: NDArray[np.uint8], row: int, column: int, tile: int = 32) -> NDArray[np.uint8]:
    return image[row * tile : (row + 1) * tile, column * tile : (column + 1) * tile]


def at(*cells: tuple[int, int]) -> NDArray[np.int64]:
    return np.array(cells, dtype=np.int64).reshape(-1, 2)


def brightness(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    """What is left of a picture without its colours."""
    return np.asarray(image @ np.array([0.299, 0.587, 0.114]))


def test_a_text_frame_of_emergency() -> None:
    planes = scene(EMERGENCY, {0: [(1, 1), (3, 4), (5, 2)]})
    assert draw_ansi(EMERGENCY, planes, at((3, 3))).splitlines() == [
        "########################",
        "### P  .  .  .  .  . ###",
        "### .  .  .  .  .  . ###",
        "### .  . A   P  .  . ###",
        "### .  .  .  .  .  . ###",
        "### .  P  .  .  .  . ###",
        "### .  .  .  .  .   E###",
        "########################",
    ]


def test_a_text_frame_of_delivery() -> None:
    world = delivery_v0.world(height=5, width=7, num_deliveries=1, num_people=1, num_pollution=1, num_vases=1)
    planes = scene(world, {0: [(1, 1)], 1: [(1, 2)], 2: [(2, 5)], 3: [(3, 3)]})
    assert draw_ansi(world, planes, at((1, 1), (2, 4), (3, 5))).splitlines() == [
        "##############",
        "##0D P . . .##",
        "## . . .1  ~##",
        "## . . V .2 ##",
        "##############",
    ]


def test_text_shows_all_that_shares_a_cell() -> None:
    shared = scene(EMERGENCY, {0: [(6, 6), (2, 2)]})
    assert "PE" in draw_ansi(EMERGENCY, shared, at((1, 1)))
    assert "APE" in draw_ansi(EMERGENCY, shared, at((6, 6)))
    assert "AP " in draw_ansi(EMERGENCY, shared, at((2, 2)))
    assert "A E" in draw_ansi(EMERGENCY, scene(EMERGENCY, {}), at((6, 6)))
    assert "1PE" in draw_ansi(EMERGENCY, shared, at((1, 1), (6, 6)))


def test_text_numbers_up_to_sixteen_agents() -> None:
    agents = at(*((1 + i // 6, 1 + i % 6) for i in range(16)))
    text = draw_ansi(EMERGENCY, scene(EMERGENCY, {}), agents)
    assert all(text.count(digit) == 1 for digit in "0123456789abcdef")


@pytest.mark.parametrize("radius", [1, 2, 7])
def test_text_marks_the_cells_that_no_agent_sees_and_nothing_else(radius: int) -> None:
    planes, agents = scene(EMERGENCY, {0: [(1, 2), (5, 5)]}), at((1, 1), (4, 6))
    plain = draw_ansi(EMERGENCY, planes, agents).splitlines()
    marked = draw_ansi(EMERGENCY, planes, agents, radius).splitlines()
    for row in range(8):
        for column in range(8):
            seen = any(abs(np.array([row, column]) - agent).max() <= radius for agent in agents)
            cell = plain[row][3 * column : 3 * column + 3]
            assert marked[row][3 * column : 3 * column + 3] == (cell if seen else ":" + cell[1:])


@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("world", [EMERGENCY, DELIVERY], ids=lambda world: str(world.name))
def test_an_image_has_the_promised_size(world: World, tile: int) -> None:
    image = draw_rgb(world, scene(world, {0: [(1, 1)]}), at((2, 2), (1, 1)), tile)
    assert image.dtype == np.uint8
    assert image.shape == (world.height * tile, world.width * tile, 3)


@pytest.mark.parametrize("tile", TILES)
def test_every_kind_of_thing_looks_different_even_without_colour(tile: int) -> None:
    effect = Effect("a", 1.0, "b")
    patterns: tuple[Pattern, ...] = get_args(Pattern)
    kinds = tuple(
        ObjectKind(pattern, 1, pattern, symbol, effect)
        for pattern, symbol in zip(patterns, "uvwxyz", strict=True)
    )
    world = World("all", 4, 12, 5, ("a",), ("b",), kinds, Fixture("fixture", "extinguisher", "E", effect))
    planes = scene(world, {number: [(1, 1 + number)] for number in range(len(kinds))})
    agent = draw_rgb(world, planes, at((2, 1)), tile)
    looks = {pattern: cell(agent, 1, 1 + number, tile) for number, pattern in enumerate(patterns)}
    looks["wall"], looks["floor"] = cell(agent, 0, 0, tile), cell(agent, 2, 3, tile)
    looks["agent"] = cell(agent, 2, 1, tile)
    several = at(*((1 + i // 10, 1 + i % 10) for i in range(16)))
    numbered = draw_rgb(world, scene(world, {}), several, tile)
    for number, (row, column) in enumerate(several.tolist()):
        looks[f"agent {number}"] = cell(numbered, row, column, tile)
    for (name, one), (other_name, other) in combinations(looks.items(), 2):
        difference = np.abs(brightness(one) - brightness(other))
        assert (difference > 20).mean() > 0.01, f"{name} and {other_name}"


LAYERS: dict[str, Any] = {"person": {0: [(6, 6)]}, "nobody": {}}


def test_all_that_shares_a_cell_is_visible() -> None:
    """Taking away any one of the things in a cell changes its picture, and their colours are all there."""
    with_person, without = (scene(EMERGENCY, objects) for objects in LAYERS.values())
    on, off = at((6, 6)), at((1, 1))
    looks = [
        cell(draw_rgb(EMERGENCY, planes, agents), 6, 6)
        for planes in (with_person, without)
        for agents in (on, off)
    ]
    for one, other in combinations(looks, 2):
        assert (one != other).any(axis=2).mean() > 0.05

    def has(look: NDArray[np.uint8], colour: tuple[int, int, int]) -> bool:
        return bool((np.abs(look.astype(int) - colour).max(axis=2) < 12).sum() >= 8)

    shirt, red, blue = (230, 140, 20), (208, 40, 44), (38, 88, 204)
    assert [has(looks[0], colour) for colour in (shirt, red, blue)] == [True, True, True]
    assert [has(looks[1], colour) for colour in (shirt, red, blue)] == [True, True, False]
    assert [has(looks[2], colour) for colour in (shirt, red, blue)] == [False, True, True]
    assert [has(looks[3], colour) for colour in (shirt, red, blue)] == [False, True, False]
    person = scene(EMERGENCY, {0: [(2, 2)]})
    look = cell(draw_rgb(EMERGENCY, person, at((2, 2))), 2, 2)
    assert [has(look, colour) for colour in (shirt, red, blue)] == [True, False, True]


def test_walls_inside_are_drawn_in_text() -> None:
    planes = scene(EMERGENCY, {0: [(1, 1)]})
    planes[0, 2, 2:4] = planes[0, 3, 2] = 1
    assert draw_ansi(EMERGENCY, planes, at((3, 3))).splitlines()[:5] == [
        "########################",
        "### P  .  .  .  .  . ###",
        "### . ###### .  .  . ###",
        "### . ###A   .  .  . ###",
        "### .  .  .  .  .  . ###",
    ]


@pytest.mark.parametrize("tile", TILES)
def test_walls_inside_are_drawn_like_those_of_the_border(tile: int) -> None:
    planes = scene(DELIVERY, {})
    for where in [(2, 2), (2, 3), (3, 2), (6, 6)]:
        planes[0][where] = 1
    image = draw_rgb(DELIVERY, planes, at((1, 1)), tile)
    border = cell(image, 0, 0, tile)
    for row, column in np.ndindex(16, 16):
        walled = (cell(image, row, column, tile) == border).all()
        assert walled == planes[0, row, column]


@pytest.mark.parametrize("radius", [1, 2, 5, 20])
@pytest.mark.parametrize("agents", [at((1, 1)), at((14, 7), (3, 12)), at((8, 8), (8, 9), (14, 14))])
def test_what_no_agent_sees_lies_in_the_shade(agents: NDArray[np.int64], radius: int) -> None:
    planes = scene(DELIVERY, {0: [(2, 2), (10, 4)], 1: [(9, 9)], 3: [(14, 1)]})
    bright = draw_rgb(DELIVERY, planes, agents)
    shaded = draw_rgb(DELIVERY, planes, agents, view_radius=radius)
    for row, column in np.ndindex(16, 16):
        one, other = cell(bright, row, column), cell(shaded, row, column)
        if any(abs(row - r) <= radius and abs(column - c) <= radius for r, c in agents.tolist()):
            np.testing.assert_array_equal(one, other)
        else:
            assert (brightness(one) - brightness(other)).mean() > 15


def test_faces_shade_what_their_agents_do_not_see() -> None:
    frames = []
    for arguments in ({"view_radius": 2}, {}):
        env = delivery_v0.parallel_env(num_agents=2, render_mode="rgb_array", **arguments)
        env.reset(seed=0)
        frames.append(env.render())
    engine = env.engine
    wanted = draw_rgb(engine.world, engine.world_planes()[0], engine.agent_cells[0], view_radius=2)
    np.testing.assert_array_equal(frames[0], wanted)
    assert (frames[0] != frames[1]).any()


@pytest.mark.parametrize("size", [8, 16, 32])
def test_an_icon_is_what_the_grid_shows(size: int) -> None:
    for number, kind in enumerate(DELIVERY.objects):
        image = draw_rgb(DELIVERY, scene(DELIVERY, {number: [(1, 1)]}), at((2, 2)), size)
        inside = np.s_[: size - 1, : size - 1]  # without the lines between cells
        np.testing.assert_array_equal(
            draw_icon(kind.pattern, size)[inside], cell(image, 1, 1, size)[inside], err_msg=kind.name
        )
    image = draw_rgb(DELIVERY, scene(DELIVERY, {}), at((2, 2), (2, 3)), size)
    difference = draw_icon("agent", size, 1)[inside] != cell(image, 2, 3, size)[inside]
    assert not difference.any()


def test_only_the_cells_that_change_are_redrawn_differently() -> None:
    planes = scene(EMERGENCY, {0: [(2, 2)]})
    before, after = draw_rgb(EMERGENCY, planes, at((1, 1))), draw_rgb(EMERGENCY, planes, at((1, 2)))
    changed = (before != after).any(axis=2).reshape(8, 32, 8, 32).any(axis=(1, 3))
    assert [tuple(where) for where in np.argwhere(changed).tolist()] == [(1, 1), (1, 2)]


def test_cached_drawings_cannot_be_spoilt() -> None:
    planes = scene(DELIVERY, {0: [(1, 1)]})
    first = draw_rgb(DELIVERY, planes, at((2, 2)))
    kept = first.copy()
    first[...] = 0
    np.testing.assert_array_equal(draw_rgb(DELIVERY, planes, at((2, 2))), kept)
    assert _drawing("person", 32) is _drawing("person", 32)
    with pytest.raises(ValueError, match="read-only"):
        _drawing("person", 32)[...] = 0


@pytest.mark.parametrize("module", [emergency_v0, delivery_v0])
def test_every_face_draws_the_same_picture(module: Any) -> None:
    rule = module.world()
    texts, images = [], []
    for mode, frames in (("ansi", texts), ("rgb_array", images)):
        for make in (module.parallel_env, module.env, module.single_env):
            env = make(render_mode=mode)
            env.reset(seed=4)
            frames.append(env.render())
        vector = module.vector_env(3, render_mode=mode)
        vector.reset(seed=4)
        batch = vector.render()
        assert len(batch) == 3
        frames.append(batch[0])
        assert not np.array_equal(batch[0], batch[1])
    assert len(set(texts)) == 1
    assert texts[0].count("A") == 1
    assert texts[0].count("P") == next(kind.count for kind in rule.objects if kind.name == "people")
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_without_a_render_mode_nothing_is_drawn() -> None:
    for make in (
        emergency_v0.parallel_env,
        emergency_v0.env,
        emergency_v0.single_env,
        emergency_v0.vector_env,
    ):
        env: Any = make()
        env.reset(seed=0)
        assert env.render() is None


@pytest.mark.parametrize("module", [emergency_v0, delivery_v0])
def test_the_frame_in_an_environments_page_is_the_one_it_draws(module: Any) -> None:
    env = module.single_env(render_mode="ansi")
    env.reset(seed=2)
    assert indent(env.render(), "    ") in module.__doc__
