"""Draws the pictures of the documentation: ``python tools/draw_pictures.py`` writes ``docs/pictures/*.png``.

The pictures are the same pixels on every machine but for ``play.png``, whose letters are pygame's; without
pygame it is left as it is.
"""

from __future__ import annotations

import os
import struct
import sys
import zlib
from pathlib import Path
from typing import Any, get_args

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from moral_envs import (
    burning_warehouse_v0,
    delivery_v0,
    emergency_v0,
    layouts,
    noisy_constraint_v0,
    windy_wall_v0,
)
from moral_envs.play import Game
from moral_envs.rendering import draw_icon, draw_rgb
from moral_envs.streams import spawn_streams
from moral_envs.window import Window
from moral_envs.world import Pattern

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "pictures"

Picture = NDArray[np.uint8]


def pictures() -> dict[str, Picture]:
    """Draw everything that needs no pygame, by name of the file."""
    drawn = {
        "emergency_v0": _start(emergency_v0, 2),
        "delivery_v0": _start(delivery_v0, 2),
        "burning_warehouse_v0": _start(burning_warehouse_v0, 4),
        "windy_wall_v0": _start(windy_wall_v0, 0),
        "noisy_constraint_v0": _start(noisy_constraint_v0, 0),
        "several_agents": _start(delivery_v0, 2, num_agents=4),
        "view_radius": _start(delivery_v0, 2, num_agents=2, view_radius=3),
        "layouts": _layouts(),
        "tiles": _tiles(),
    }
    return {f"{name}.png": picture for name, picture in drawn.items()}


def _start(module: Any, seed: int, **arguments: Any) -> Picture:
    """Draw the start of an episode."""
    env = module.parallel_env(render_mode="rgb_array", **arguments)
    env.reset(seed=seed)
    frame: Picture = env.render()
    return frame


def _layouts(tile: int = 12, columns: int = 5) -> Picture:
    """Draw a start in every layout, in the order of their names, row by row."""
    rooms = []
    for name in layouts.NAMES:
        engine = delivery_v0.parallel_env(layout=name).engine
        engine.seed(spawn_streams(1, 1))
        engine.reset()
        room = draw_rgb(engine.world, engine.world_planes()[0], engine.agent_cells[0], tile)
        rooms.append(np.pad(room, ((0, tile), (0, tile), (0, 0)), constant_values=255))
    blank = np.full_like(rooms[0], 255)
    rooms += [blank] * (-len(rooms) % columns)
    rows = [np.concatenate(rooms[i : i + columns], axis=1) for i in range(0, len(rooms), columns)]
    return np.concatenate(rows)[:-tile, :-tile]


def _tiles() -> Picture:
    """Draw everything there is in three sizes, with and without colour."""
    rows = []
    for size in (64, 32, 16):
        icons = [draw_icon(pattern, size) for pattern in get_args(Pattern)]
        icons += [draw_icon("agent", size), *(draw_icon("agent", size, number) for number in (0, 1, 10, 15))]
        row = np.concatenate(icons, axis=1)
        grey = (row @ np.array([0.299, 0.587, 0.114])).round().astype(np.uint8)[..., None].repeat(3, axis=2)
        rows.append(np.concatenate([row, grey]))
    width = max(row.shape[1] for row in rows)
    paper = rows[0][0, 0]
    sheet = np.empty((sum(len(row) for row in rows), width, 3), dtype=np.uint8)
    sheet[:] = paper
    top = 0
    for row in rows:
        sheet[top : top + len(row), : row.shape[1]] = row
        top += len(row)
    return sheet


def play_window() -> Picture:
    """Draw the window of a game after some steps."""
    os.environ["SDL_VIDEODRIVER"] = "dummy"
    game = Game(delivery_v0.parallel_env(num_agents=2), 2)
    for key in ("right", "d", "tab", "left", "a"):
        game.press(key)
    window = Window(game.panel, {"render_fps": 0})
    window.show(game.notes, selected=game.selected)
    import pygame

    surface = pygame.display.get_surface()
    width, height = surface.get_size()
    pixels = np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(height, width, 3)
    window.close()
    return pixels


def png(picture: Picture) -> bytes:
    """Encode a picture, uint8 (height, width, 3)."""
    height, width, _ = picture.shape
    lines = b"".join(b"\0" + line.tobytes() for line in picture)

    def chunk(name: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(name + content))
        return struct.pack(">I", len(content)) + name + content + check

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    drawn = pictures()
    try:
        drawn["play.png"] = play_window()
    except DependencyNotInstalled as error:
        print(f"play.png is left as it is: {error}", file=sys.stderr)
    for name, picture in drawn.items():
        (FOLDER / name).write_bytes(png(picture))


if __name__ == "__main__":
    main()
