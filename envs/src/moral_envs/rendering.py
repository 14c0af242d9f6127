"""Pictures of a world: text and pixels, in NumPy alone.

Every kind of thing has its own outline, so that no two are told apart by colour only. Things that share a
cell are all visible: next to each other in text, smaller and next to each other in pixels.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from moral_envs.world import Pattern, World

MIN_TILE = 8

Mask = NDArray[np.bool_]
Colour = tuple[int, int, int]

_SAMPLES = 4
"""Samples of a pixel along each axis, for smooth edges."""

_INK, _WHITE, _STEEL = (38, 42, 50), (255, 255, 255), (150, 156, 166)
_FLOOR, _GRID = (245, 244, 240), (228, 226, 219)
_BRICK, _MORTAR = (118, 122, 132), (88, 92, 102)
_SKIN, _SHIRT = (238, 188, 140), (230, 140, 20)
_CARDBOARD, _TAPE = (176, 128, 78), (232, 206, 164)
_SLUDGE, _BUBBLE = (104, 116, 72), (206, 214, 178)
_CLAY, _GLAZE = (30, 140, 152), (190, 232, 232)
_RED = (208, 40, 44)
_SHADE, _SHADE_DEPTH = (70, 74, 84), 0.5
_AGENTS: tuple[Colour, ...] = ((38, 88, 204), (136, 48, 160), (16, 112, 80), (148, 68, 20))

# The 16 hexadecimal digits, each five rows of three pixels.
_DIGITS = (
    *("111101101101111", "010110010010111", "111001111100111", "111001111001111"),
    *("101101111001001", "111100111001111", "111100111101111", "111001001010010"),
    *("111101111101111", "111101111001111", "010101111101101", "110101110101110"),
    *("111100100100111", "110101101101110", "111100111100111", "111100111100100"),
)

# Left edge, top edge and size in tiles of the drawings in a cell, by how many there are, from below to above.
_LAYOUTS = {
    1: ((0.0, 0.0, 1.0),),
    2: ((0.02, 0.02, 0.6), (0.38, 0.38, 0.6)),
    3: ((0.0, 0.0, 0.52), (0.48, 0.0, 0.52), (0.24, 0.46, 0.52)),
}


def draw_ansi(
    world: World, planes: NDArray[np.uint8], agents: NDArray[np.int64], view_radius: int | None = None
) -> str:
    """Draw a world as text.

    A cell shows, from left to right, the agent on it, the object, and the fixture if the world has one. A
    single agent is ``A``; several are numbered, in hexadecimal. A cell that no agent sees begins with ``:``.

    Parameters
    ----------
    world
        The rules.
    planes
        uint8 array of shape (C, H, W): the planes of the whole world.
    agents
        int64 array of shape (n_agents, 2): row and column of every agent.
    view_radius
        How far an agent sees, in cells. None: everything.

    Returns
    -------
    str
        One line per row of cells.
    """
    cells = np.full((3, world.height, world.width), " ")
    who, what, where = cells
    for kind, plane in zip(world.objects, planes[2:], strict=False):
        what[plane != 0] = kind.symbol
    if world.fixture is not None:
        where[planes[-1] != 0] = world.fixture.symbol
    for number, (row, column) in enumerate(agents):
        who[row, column] = "A" if len(agents) == 1 else f"{number:x}"
    what[(cells == " ").all(axis=0)] = "."
    cells[:, planes[0] != 0] = "#"
    if view_radius is not None:
        who[_unseen(planes[0].shape, agents, view_radius)] = ":"
    shown = cells if world.fixture is not None else cells[:2]
    return "\n".join("".join(line) for line in np.moveaxis(shown, 0, -1).reshape(world.height, -1).tolist())


def draw_rgb(
    world: World,
    planes: NDArray[np.uint8],
    agents: NDArray[np.int64],
    tile: int = 32,
    view_radius: int | None = None,
) -> NDArray[np.uint8]:
    """Draw a world as an image.

    Parameters
    ----------
    world, planes, agents
        As for :func:`draw_ansi`.
    tile
        Height and width of a cell in pixels, at least 8.
    view_radius
        As for :func:`draw_ansi`. What no agent sees lies in the shade.

    Returns
    -------
    uint8 array of shape (H * tile, W * tile, 3)
        A fresh array.

    Raises
    ------
    ValueError
        If ``tile`` is too small.
    """
    if tile < MIN_TILE:
        raise ValueError(f"tile is {tile}; it must be at least {MIN_TILE} pixels")
    ground = np.stack([_drawing("floor", tile), _drawing("wall", tile)])[..., :3]
    image: NDArray[np.float32] = (
        ground[planes[0]].swapaxes(1, 2).reshape(world.height * tile, world.width * tile, 3)
    )
    for (row, column), names in _things(world, planes, agents).items():
        for name, (left, top, size) in zip(names, _LAYOUTS[len(names)], strict=True):
            drawing = _drawing(name, round(size * tile))
            y, x = round((row + top) * tile), round((column + left) * tile)
            part = image[y : y + len(drawing), x : x + len(drawing)]
            part[...] = part * (1 - drawing[..., 3:]) + drawing[..., :3]
    if view_radius is not None:
        unseen = _unseen(planes[0].shape, agents, view_radius).repeat(tile, axis=0).repeat(tile, axis=1)
        image[unseen] += (np.array(_SHADE, dtype=np.float32) - image[unseen]) * _SHADE_DEPTH
    return image.round().astype(np.uint8)


def draw_icon(pattern: Pattern | Literal["agent"], size: int, number: int | None = None) -> NDArray[np.uint8]:
    """Draw one thing on the floor, for a legend.

    Parameters
    ----------
    pattern
        Which thing.
    size
        Height and width in pixels, at least 8.
    number
        The agent's, if there are several.

    Returns
    -------
    uint8 array of shape (size, size, 3)
        A fresh array.
    """
    drawing = _drawing(pattern if number is None else f"{pattern} {number}", size)
    floor = np.array(_FLOOR, dtype=np.float32)
    icon: NDArray[np.float32] = floor * (1 - drawing[..., 3:]) + drawing[..., :3]
    return icon.round().astype(np.uint8)


def _unseen(shape: tuple[int, ...], agents: NDArray[np.int64], view_radius: int) -> Mask:
    """Cells outside every agent's window."""
    unseen = np.ones(shape, dtype=np.bool_)
    for row, column in agents.tolist():
        top, left = max(row - view_radius, 0), max(column - view_radius, 0)
        unseen[top : row + view_radius + 1, left : column + view_radius + 1] = False
    return unseen


def _things(
    world: World, planes: NDArray[np.uint8], agents: NDArray[np.int64]
) -> dict[tuple[int, int], list[str]]:
    """Names of the drawings in every cell that is not empty, from below to above."""
    layers: list[tuple[str, NDArray[np.int64]]] = []
    if world.fixture is not None:
        layers.append((world.fixture.pattern, np.argwhere(planes[-1])))
    for kind, plane in zip(world.objects, planes[2:], strict=False):
        layers.append((kind.pattern, np.argwhere(plane)))
    for number, cell in enumerate(agents):
        layers.append(("agent" if len(agents) == 1 else f"agent {number}", cell[None]))
    things: dict[tuple[int, int], list[str]] = {}
    for name, cells in layers:
        for row, column in cells.tolist():
            things.setdefault((row, column), []).append(name)
    return things


@lru_cache(maxsize=256)
def _drawing(name: str, size: int) -> NDArray[np.float32]:
    """One thing, read-only: float32 (size, size, 4), colours weighted by their coverage and the coverage."""
    pattern, _, number = name.partition(" ")
    canvas = _Canvas(size)
    _PAINT[pattern](canvas)
    if number:
        _paint_number(canvas, int(number))
    return canvas.drawing()


class _Canvas:
    """A square whose coordinates go from 0, left and top, to 1."""

    def __init__(self, size: int) -> None:
        centres = (np.arange(size * _SAMPLES) + 0.5) / (size * _SAMPLES)
        self.x, self.y = centres[None, :], centres[:, None]
        self.samples = np.zeros((size, _SAMPLES, size, _SAMPLES, 4), dtype=np.float32)
        self.size = size
        self.thin_line = max(1, round(0.03 * size)) / size

    def whole(self, x: float) -> float:
        """Move a coordinate to the nearest edge of a pixel, so that a line there is sharp."""
        return round(x * self.size) / self.size

    def fill(self, mask: Mask, colour: Colour) -> None:
        """Colour the samples of a mask, over what is there."""
        self.samples.reshape(*mask.shape, 4)[mask] = (*colour, 1)

    def box(self, left: float, top: float, right: float, bottom: float) -> Mask:
        """Mask of a rectangle."""
        return (self.x >= left) & (self.x < right) & (self.y >= top) & (self.y < bottom)

    def disc(self, x: float, y: float, half_width: float, half_height: float | None = None) -> Mask:
        """Mask of an ellipse around (x, y), or of a circle."""
        half_height = half_width if half_height is None else half_height
        inside: Mask = ((self.x - x) / half_width) ** 2 + ((self.y - y) / half_height) ** 2 < 1
        return inside

    def drawing(self) -> NDArray[np.float32]:
        """Average over the samples of each pixel, read-only because it is cached."""
        drawing: NDArray[np.float32] = self.samples.mean(axis=(1, 3))
        drawing.flags.writeable = False
        return drawing


def _paint_floor(canvas: _Canvas) -> None:
    line = canvas.thin_line
    canvas.fill(canvas.box(0, 0, 1, 1), _GRID)
    canvas.fill(canvas.box(0, 0, 1 - line, 1 - line), _FLOOR)


def _paint_wall(canvas: _Canvas) -> None:
    canvas.fill(canvas.box(0, 0, 1, 1), _MORTAR)
    courses = [canvas.whole(part / 3) for part in range(4)]
    line = canvas.whole(0.05) or canvas.thin_line
    for number, (top, bottom) in enumerate(pairwise(courses)):
        joints = (0.0, 0.5, 1.0) if number % 2 == 0 else (-0.25, 0.25, 0.75, 1.25)
        for left, right in pairwise(joints):
            brick = canvas.box(canvas.whole(left), top, canvas.whole(right) - line, bottom - line)
            canvas.fill(brick, _BRICK)


def _paint_person(canvas: _Canvas) -> None:
    for edge, shirt, skin in ((0.04, _INK, _INK), (0.0, _SHIRT, _SKIN)):
        shoulders = canvas.disc(0.5, 0.9, 0.28 + edge, 0.42 + edge)
        canvas.fill(shoulders & canvas.box(0, 0, 1, 0.88 + edge), shirt)
        canvas.fill(canvas.disc(0.5, 0.29, 0.17 + edge), skin)


def _paint_box(canvas: _Canvas) -> None:
    canvas.fill(canvas.box(0.13, 0.2, 0.87, 0.88), _INK)
    canvas.fill(canvas.box(0.17, 0.24, 0.83, 0.84), _CARDBOARD)
    canvas.fill(canvas.box(0.17, 0.42, 0.83, 0.45), _INK)
    canvas.fill(canvas.box(0.42, 0.24, 0.58, 0.58), _TAPE)


def _paint_pollution(canvas: _Canvas) -> None:
    for edge, colour in ((0.04, _INK), (0.0, _SLUDGE)):
        canvas.fill(canvas.disc(0.5, 0.66, 0.36 + edge, 0.2 + edge), colour)
        for x, y, radius in ((0.32, 0.52, 0.17), (0.56, 0.42, 0.2), (0.72, 0.58, 0.16)):
            canvas.fill(canvas.disc(x, y, radius + edge), colour)
    for x, y, radius in ((0.34, 0.56, 0.06), (0.56, 0.44, 0.075), (0.64, 0.68, 0.065), (0.46, 0.71, 0.04)):
        canvas.fill(canvas.disc(x, y, radius), _BUBBLE)


def _paint_vase(canvas: _Canvas) -> None:
    for edge, clay, glaze in ((0.04, _INK, _INK), (0.0, _CLAY, _GLAZE)):
        belly = canvas.disc(0.5, 0.6, 0.27 + edge, 0.29 + edge)
        canvas.fill(belly, clay)
        canvas.fill(canvas.box(0.42 - edge, 0.2, 0.58 + edge, 0.4), clay)
        canvas.fill(canvas.box(0.31 - edge, 0.14 - edge, 0.69 + edge, 0.21 + edge), clay)
        canvas.fill(canvas.box(0.34 - edge, 0.82 - edge, 0.66 + edge, 0.88 + edge), clay)
        canvas.fill(belly & canvas.box(0, 0.53, 1, 0.66), glaze)


def _paint_extinguisher(canvas: _Canvas) -> None:
    hose = canvas.disc(0.64, 0.42, 0.24, 0.26) & ~canvas.disc(0.64, 0.42, 0.18, 0.2)
    canvas.fill(hose & canvas.box(0.64, 0, 1, 0.62), _INK)
    canvas.fill(hose & canvas.box(0.5, 0, 1, 0.24), _INK)
    canvas.fill(canvas.box(0.78, 0.42, 0.92, 0.66), _INK)
    canvas.fill(canvas.box(0.4, 0.12, 0.52, 0.34), _STEEL)
    canvas.fill(canvas.box(0.24, 0.08, 0.56, 0.15), _INK)
    for edge, red, white in ((0.04, _INK, _INK), (0.0, _RED, _WHITE)):
        canvas.fill(canvas.box(0.28 - edge, 0.4, 0.64 + edge, 0.9 + edge), red)
        canvas.fill(canvas.disc(0.46, 0.42, 0.18 + edge, 0.14 + edge), red)
        canvas.fill(canvas.box(0.28, 0.54, 0.64, 0.72), white)


def _paint_goal(canvas: _Canvas) -> None:
    canvas.fill(canvas.disc(0.27, 0.9, 0.17, 0.07), _INK)
    canvas.fill(canvas.box(0.23, 0.08, 0.31, 0.9), _INK)
    canvas.fill(canvas.box(0.23, 0.08, 0.93, 0.62), _INK)
    columns = [canvas.whole(0.31 + 0.145 * part) for part in range(5)]
    rows = [canvas.whole(0.12 + 0.153 * part) for part in range(4)]
    for row, (top, bottom) in enumerate(pairwise(rows)):
        for column, (left, right) in enumerate(pairwise(columns)):
            if (row + column) % 2 == 0:
                canvas.fill(canvas.box(left, top, right, bottom), _WHITE)


def _paint_agent(canvas: _Canvas) -> None:
    canvas.fill(canvas.box(0.47, 0.06, 0.53, 0.2), _INK)
    canvas.fill(canvas.disc(0.5, 0.08, 0.06), _INK)
    canvas.fill(canvas.box(0.08, 0.42, 0.92, 0.64), _INK)
    canvas.fill(canvas.box(0.14, 0.16, 0.86, 0.9), _INK)
    canvas.fill(canvas.box(0.18, 0.2, 0.82, 0.86), _AGENTS[0])
    for x in (0.35, 0.65):
        canvas.fill(canvas.disc(x, 0.42, 0.11), _WHITE)
        canvas.fill(canvas.disc(x, 0.43, 0.05), _INK)
    canvas.fill(canvas.box(0.32, 0.66, 0.68, 0.74), _WHITE)


def _paint_number(canvas: _Canvas, number: int) -> None:
    canvas.fill(canvas.box(0.18, 0.2, 0.82, 0.86), _AGENTS[number % len(_AGENTS)])
    for position, pixel in enumerate(_DIGITS[number]):
        row, column = divmod(position, 3)
        if pixel == "1":
            left, top = 0.32 + 0.12 * column, 0.25 + 0.112 * row
            canvas.fill(canvas.box(left, top, left + 0.12, top + 0.112), _WHITE)


_PAINT = {
    "floor": _paint_floor,
    "wall": _paint_wall,
    "person": _paint_person,
    "box": _paint_box,
    "pollution": _paint_pollution,
    "vase": _paint_vase,
    "extinguisher": _paint_extinguisher,
    "goal": _paint_goal,
    "agent": _paint_agent,
}
