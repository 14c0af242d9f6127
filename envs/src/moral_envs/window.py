"""A window that shows one environment: the grid, and with it what the episode has brought so far."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from moral_envs.panel import Panel
from moral_envs.rendering import MIN_TILE, draw_icon, draw_rgb

_MARGIN = 16
_FONT_SIZES = (18, 16, 14, 12)
_BEST_TILE, _BEST_GRID = 48, 640
# Names of keys that change what others mean.
_MODIFIERS = re.compile("(left|right) .*|.*lock|alt gr|")
_INK, _FAINT, _PAPER, _WHITE = (38, 42, 50), (128, 132, 140), (245, 244, 240), (255, 255, 255)


class Window:
    """A window for one environment; it opens when something is first shown.

    All windows of a process share one place on the screen, as pygame's do. Who closes the window by hand has
    seen enough: it stays closed, and what the environment would show is not drawn any more.

    Parameters
    ----------
    panel
        What the episode has brought so far.
    metadata
        Its entry ``"render_fps"`` limits the steps per second; 0 is no limit.

    Attributes
    ----------
    dismissed : bool
        Whether the window was closed by hand.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        If pygame is not installed.
    """

    def __init__(self, panel: Panel, metadata: dict[str, Any]) -> None:
        # pygame's objects are made when they are needed and not kept, so that an environment can be copied.
        _import_pygame()
        self.panel = panel
        self.engine = panel.engine
        self.dismissed = False
        self._metadata = metadata
        self._next_frame = 0.0
        self._opened = False

    def reset(self) -> None:
        """Show the start of an episode."""
        self.panel.reset()
        self.refresh()

    def step(self, rewards: NDArray[np.float32]) -> None:
        """Show what a step brought; ``rewards`` has shape (n_agents, k)."""
        self.panel.add(rewards)
        self.refresh()
        fps = self._metadata["render_fps"]
        if fps > 0 and not self.dismissed:
            time.sleep(max(0.0, self._next_frame - time.monotonic()))
            self._next_frame = time.monotonic() + 1 / fps

    def refresh(self) -> None:
        """Show the current state, and notice if the window was closed by hand."""
        pygame = _import_pygame()
        if pygame.display.get_init() and pygame.event.get(pygame.QUIT):
            self._dismiss()
        self.show()

    def show(
        self, notes: Sequence[str] = (), banner: Sequence[str] = (), selected: int | None = None
    ) -> None:
        """Show the current state.

        Parameters
        ----------
        notes
            Lines under the tables.
        banner
            Lines in a box on the grid.
        selected
            An agent to point out.

        Raises
        ------
        RuntimeError
            If there is no screen.
        """
        if self.dismissed:
            return
        pygame = _import_pygame()
        # Here, for the window may be somebody else's, who needs no letters.
        pygame.font.init()
        world, planes, agents = self.engine.world, self.engine.world_planes()[0], self.engine.agent_cells[0]
        if pygame.display.get_surface() is None:
            self._open(notes)
        pygame.display.set_caption(world.name)
        surface = pygame.display.get_surface()
        panel, place = self._fit(surface.get_size(), notes, selected)
        surface.fill(_PAPER)
        surface.blit(panel, place.panel)
        picture = draw_rgb(world, planes, agents, place.tile, self.engine.view_radius)
        surface.blit(_surface(picture), place.grid)
        if selected is not None:
            row, column = agents[selected].tolist()
            corner = (place.grid[0] + column * place.tile, place.grid[1] + row * place.tile)
            _draw_frame(surface, (*corner, place.tile, place.tile))
        if banner:
            height, width, _ = picture.shape
            _draw_banner(surface, banner, (place.grid[0] + width // 2, place.grid[1] + height // 2))
        pygame.display.flip()

    def wait_for_keys(self, patience: int) -> list[str]:
        """Wait for keys for some milliseconds, and notice if the window was closed by hand.

        Returns
        -------
        list of str
            Names of the keys that were pressed, with ``"shift "`` before them if that was held.
        """
        pygame = _import_pygame()
        events = [pygame.event.wait(patience), *pygame.event.get()]
        if any(event.type == pygame.QUIT for event in events):
            self._dismiss()
            return []
        keys = []
        for event in events:
            if event.type == pygame.KEYDOWN:
                name = pygame.key.name(event.key)
                if not _MODIFIERS.fullmatch(name):
                    keys.append(f"shift {name}" if event.mod & pygame.KMOD_SHIFT else name)
        return keys

    def close(self) -> None:
        """Close the window; showing something opens it again unless it was closed by hand."""
        if self._opened:
            _import_pygame().display.quit()
            self._opened = False

    def _dismiss(self) -> None:
        self.dismissed = True
        self.close()

    def _open(self, notes: Sequence[str]) -> None:
        pygame = _import_pygame()
        try:
            pygame.display.init()
        except pygame.error as error:
            raise RuntimeError(f'render_mode is "human", which needs a screen: {error}') from error
        # Without a screen SDL draws where nobody sees it; who wants that has said so.
        if pygame.display.get_driver() == "offscreen" and "SDL_VIDEODRIVER" not in os.environ:
            pygame.display.quit()
            raise RuntimeError('render_mode is "human", which needs a screen; there is none')
        # A loop that only steps takes no events from the queue, which must not fill up.
        pygame.event.set_blocked(pygame.MOUSEMOTION)
        panel = self._draw_panel(_FONT_SIZES[0], notes, None)
        world = self.engine.world
        tile = max(MIN_TILE, min(_BEST_TILE, _BEST_GRID // max(world.height, world.width)))
        width = world.width * tile + panel.get_width() + 3 * _MARGIN
        height = max(world.height * tile, panel.get_height()) + 2 * _MARGIN
        desktop_width, desktop_height = pygame.display.get_desktop_sizes()[0]
        # A part of the desktop belongs to bars and to the window's own frame.
        size = (min(width, desktop_width * 9 // 10), min(height, desktop_height * 17 // 20))
        pygame.display.set_icon(_surface(draw_icon("agent", 32)))
        pygame.display.set_mode(size, pygame.RESIZABLE)
        self._opened = True

    def _fit(self, size: tuple[int, int], notes: Sequence[str], selected: int | None) -> tuple[Any, _Place]:
        """Draw the panel in the largest letters that leave room for a grid as large as them."""
        world = self.engine.world
        for font_size in _FONT_SIZES:
            panel = self._draw_panel(font_size, notes, selected)
            place = _place(size, panel.get_size(), (world.width, world.height))
            if place.fits and place.tile >= 2 * font_size:
                break
        return panel, place

    def _draw_panel(self, font_size: int, notes: Sequence[str], selected: int | None) -> Any:
        pygame = _import_pygame()
        world, agents = self.engine.world, self.engine.num_agents
        page = _Page(pygame.font.Font(None, round(1.4 * font_size)), font_size)
        page.write(f"{world.name}, {self.panel.steps}")
        page.feed(1.5)
        tables = self.panel.tables
        names = 2 * page.indent + max(page.measure(name) for table in tables for name in table.names)
        cells = max(page.measure(cell) for table in tables for row in table.cells for cell in row)
        column = page.indent + max(cells, page.line, page.measure("-10.5"))
        rights = [names + column * (agent + 1) for agent in range(agents)]
        for agent, right in enumerate(rights):
            icon = draw_icon("agent", page.line, agent if agents > 1 else None)
            page.stick(_surface(icon), right - page.line, framed=agent == selected)
        page.feed()
        for table in tables:
            page.write(table.title, colour=_FAINT)
            page.feed()
            for name, row in zip(table.names, table.cells, strict=True):
                page.write(name, page.indent)
                for right, cell in zip(rights, row, strict=True):
                    page.write(cell, right - page.measure(cell), _FAINT if cell == "0" else _INK)
                page.feed()
            page.feed(0.25)
        things = [(kind.pattern, kind.name) for kind in world.objects]
        if world.fixture is not None:
            things.append((world.fixture.pattern, world.fixture.name))
        half = 2 * page.indent + page.line + max((page.measure(name) for _, name in things), default=0)
        for number, (pattern, name) in enumerate(things):
            left = half * (number % 2)
            page.stick(_surface(draw_icon(pattern, page.line)), left)
            page.write(name, left + page.line + page.indent // 2)
            if number % 2 == 1 or number == len(things) - 1:
                page.feed()
        page.feed(0.5)
        for note in notes:
            page.write(note)
            page.feed()
        return page.cut()


class _Place(NamedTuple):
    """Where the grid and the panel go."""

    tile: int
    grid: tuple[int, int]
    panel: tuple[int, int]
    fits: bool


def _place(size: tuple[int, int], panel: tuple[int, int], cells: tuple[int, int]) -> _Place:
    """Put the panel beside the grid or under it, wherever the grid can be larger."""
    (width, height), (columns, rows) = size, cells
    rooms = (
        (width - panel[0] - 3 * _MARGIN, height - 2 * _MARGIN),
        (width - 2 * _MARGIN, height - panel[1] - 3 * _MARGIN),
    )
    tiles = [min(room[0] // columns, room[1] // rows) for room in rooms]
    beside = tiles[0] >= tiles[1]
    tile = max(tiles)
    room = rooms[0][1] if beside else rooms[1][0]
    fits = tile >= MIN_TILE and panel[1 if beside else 0] <= room
    tile = max(tile, MIN_TILE)
    far = 2 * _MARGIN + tile * (columns if beside else rows)
    return _Place(tile, (_MARGIN, _MARGIN), (far, _MARGIN) if beside else (_MARGIN, far), fits)


class _Page:
    """Lines of text and small pictures, on a sheet that grows with them."""

    def __init__(self, font: Any, size: int) -> None:
        self.font = font
        self.line = round(1.35 * size)
        self.indent = size
        self._top = 0
        self._things: list[tuple[Any, int, int, bool]] = []

    def measure(self, text: str) -> int:
        """Width of a text."""
        width: int = self.font.size(text)[0]
        return width

    def write(self, text: str, left: int = 0, colour: tuple[int, int, int] = _INK) -> None:
        """Write on the current line."""
        drawn = self.font.render(text, True, colour)
        self._things.append((drawn, left, self._top + (self.line - drawn.get_height()) // 2, False))

    def stick(self, picture: Any, left: int, framed: bool = False) -> None:
        """Put a picture on the current line."""
        self._things.append((picture, left, self._top, framed))

    def feed(self, lines: float = 1) -> None:
        """Go on to the next line."""
        self._top += round(lines * self.line)

    def cut(self) -> Any:
        """Return everything as one surface."""
        pygame = _import_pygame()
        width = max(left + thing.get_width() for thing, left, _, _ in self._things)
        height = max(top + thing.get_height() for thing, _, top, _ in self._things)
        sheet = pygame.Surface((width, height))
        sheet.fill(_PAPER)
        for thing, left, top, framed in self._things:
            sheet.blit(thing, (left, top))
            if framed:
                _draw_frame(sheet, (left, top, *thing.get_size()))
        return sheet


def _draw_frame(surface: Any, box: tuple[int, int, int, int]) -> None:
    """Draw a frame that is seen on dark and on bright ground."""
    pygame = _import_pygame()
    outer = pygame.Rect(box)
    pygame.draw.rect(surface, _INK, outer, 3)
    pygame.draw.rect(surface, _WHITE, outer.inflate(-2, -2), 1)


def _draw_banner(surface: Any, lines: Sequence[str], centre: tuple[int, int]) -> None:
    pygame = _import_pygame()
    page = _Page(pygame.font.Font(None, 25), 18)
    for line in lines:
        page.write(line)
        page.feed()
    text = page.cut()
    box = text.get_rect(center=centre)
    pygame.draw.rect(surface, _PAPER, box.inflate(32, 24))
    pygame.draw.rect(surface, _INK, box.inflate(32, 24), 3)
    surface.blit(text, box)


def _surface(image: NDArray[np.uint8]) -> Any:
    height, width, _ = image.shape
    return _import_pygame().image.frombuffer(image.tobytes(), (width, height), "RGB")


def _import_pygame() -> Any:
    """Import pygame, or its community edition, which has the same name."""
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(
            'render_mode is "human", which needs pygame: pip install "moral-envs[human]"'
        ) from error
    return pygame
