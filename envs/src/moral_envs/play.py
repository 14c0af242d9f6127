"""Play a world by hand: ``python -m moral_envs.play --world emergency_v0``.

It opens a window, for which pygame must be installed (``pip install "moral-envs[human]"``). With
``--render ansi`` the game is in the terminal and needs nothing more; keys may then come through a pipe, too.
"""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from inspect import signature
from itertools import zip_longest
from types import ModuleType
from typing import NoReturn

import gymnasium
import numpy as np
from gymnasium.error import DependencyNotInstalled

import moral_envs
from moral_envs import layouts
from moral_envs.faces import GridParallelEnv
from moral_envs.panel import Panel
from moral_envs.rendering import draw_ansi
from moral_envs.window import Window
from moral_envs.world import ACTION_NAMES

ACTION_KEYS = {
    "up": "move up",
    "down": "move down",
    "left": "move left",
    "right": "move right",
    "space": "wait",
    "w": "interact up",
    "s": "interact down",
    "a": "interact left",
    "d": "interact right",
    "shift up": "interact up",
    "shift down": "interact down",
    "shift left": "interact left",
    "shift right": "interact right",
}
"""What each key makes the agent do."""

_TERMINAL_KEYS = {" ": "space", "\t": "tab", "\n": "return"}
_TERMINAL_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_END_OF_INPUT = "\x04"
"""What Ctrl-D sends where the terminal hands over every key at once."""

_PATIENCE = 100
"""Milliseconds after which a window that waits for a key looks whether it was interrupted."""


class Game:
    """A world, the seed of its episode, and the agent that the keys move while the others wait.

    Parameters
    ----------
    env
        The world.
    seed
        Seed of the first episode.

    Attributes
    ----------
    panel : Panel
        What the episode has brought so far.
    selected : int
        The agent that the keys move.
    over : bool
        Whether the episode has ended.

    Raises
    ------
    ValueError
        If the seed is negative or there are several agents in a world where they cannot wait.
    """

    def __init__(self, env: GridParallelEnv, seed: int) -> None:
        self.env = env
        self.world = env.engine.world
        self.num_agents = len(env.possible_agents)
        self.panel = Panel(env.engine)
        self.seed = seed
        self.selected = 0
        self.over = False
        self._actions = ACTION_NAMES[: self.world.num_actions]
        self._help_shown = True
        self._notice = ""
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be at least 0")
        if self.num_agents > 1 and "wait" not in self._actions:
            found, name = self.num_agents, self.world.name
            raise ValueError(f"num_agents is {found}; it must be 1 to play {name}, where nobody can wait")
        self.restart()

    def restart(self) -> None:
        """Start the episode of the seed from its beginning."""
        self.env.reset(seed=self.seed)
        self.panel.reset()
        self.over = False

    def press(self, key: str) -> bool:
        """Do what a key says.

        Parameters
        ----------
        key
            Its name as pygame has it, with ``"shift "`` before it if that is held.

        Returns
        -------
        bool
            Whether to go on playing.
        """
        self._notice = ""
        plain = key.removeprefix("shift ")
        if plain in ("q", "escape"):
            return False
        if plain in ("h", "f1"):
            self._help_shown = not self._help_shown
        elif plain == "n":
            self.seed += 1
            self.restart()
        elif plain == "r" or self.over:
            self.restart()
        elif plain == "tab":
            self.selected = (self.selected + 1) % self.num_agents
        else:
            action = ACTION_KEYS.get(key) or ACTION_KEYS.get(plain)
            if action is not None:
                self._act(action)
        return True

    @property
    def notes(self) -> list[str]:
        """Lines to show beside the world: the seed, the keys, and what the last key could not do."""
        notes = [f"seed {self.seed}"]
        if self.num_agents > 1:
            notes[0] += f", you move agent {self.selected:x}"
        if self._help_shown:
            notes.append("arrows: move" + (", space: wait" if "wait" in self._actions else ""))
            if "interact up" in self._actions:
                notes.append("WASD, Shift + arrows: interact")
            if self.num_agents > 1:
                notes.append("Tab: next agent; the others wait")
            notes += ["R: restart, N: next seed", "H: hide the keys, Q: quit"]
        else:
            notes.append("H: show the keys")
        if self._notice:
            notes.append(self._notice)
        return notes

    @property
    def ending(self) -> list[str]:
        """Lines to show once the episode has ended: what all agents brought together."""
        if not self.over:
            return []
        returns, counters = self.panel.totals
        return [
            f"The episode is over: {self.panel.steps}.",
            f"return: {returns}",
            f"objectives: {counters}",
            "Any key: again, N: next seed, Q: quit",
        ]

    def _act(self, action: str) -> None:
        if action not in self._actions:
            self._notice = f"{self.world.name} has no action '{action}'"
            return
        actions = dict.fromkeys(self.env.agents, ACTION_NAMES.index("wait"))
        actions[self.env.possible_agents[self.selected]] = ACTION_NAMES.index(action)
        _, rewards, _, _, _ = self.env.step(actions)
        self.panel.add(np.stack(list(rewards.values())))
        self.over = not self.env.agents


def play_in_window(game: Game) -> None:
    """Play until the player quits or closes the window.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        If pygame is not installed.
    RuntimeError
        If there is no screen.
    """
    window = Window(game.panel, {"render_fps": 0})
    selected = None
    try:
        while not window.dismissed:
            if game.num_agents > 1:
                selected = game.selected
            window.show(game.notes, game.ending, selected)
            for key in window.wait_for_keys(_PATIENCE):
                was_over = game.over
                if not game.press(key):
                    return
                if game.over and not was_over:
                    break  # What was typed before the totals were seen must not take them away.
    finally:
        window.close()


def play_in_terminal(game: Game) -> None:
    """Play until the player quits or the input ends, with Ctrl-D for instance."""
    with single_keys():
        _print_screen(game)
        while (key := _read_key()) and game.press(key):
            _print_screen(game)


def _print_screen(game: Game) -> None:
    planes, agents = game.env.engine.world_planes()[0], game.env.engine.agent_cells[0]
    things = [("A" if game.num_agents == 1 else f"0-{game.num_agents - 1:x}", "agent")]
    things += [(kind.symbol, kind.name) for kind in game.world.objects]
    if game.world.fixture is not None:
        things.append((game.world.fixture.symbol, game.world.fixture.name))
    if game.env.engine.view_radius is not None:
        things.append((":", "out of sight"))
    legend = ", ".join(f"{symbol} {name}" for symbol, name in things)
    lines = [f"{game.world.name}, {game.panel.steps}", ""]
    frame = draw_ansi(game.world, planes, agents, game.env.engine.view_radius)
    lines += _beside(frame, game.panel.text)
    for text in ("", legend, "; ".join(game.notes), *game.ending):
        lines += textwrap.wrap(text, shutil.get_terminal_size().columns) or [""]
    on_terminal = sys.stdin.isatty() and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # From the top left corner over the old screen, which is cleared.
    print(("\x1b[H\x1b[2J" if on_terminal else "") + "\n".join(lines), flush=True)


def _beside(frame: str, tables: str) -> list[str]:
    """Put the tables to the right of the frame, or under it where there is no room."""
    left, right = frame.splitlines(), tables.splitlines()
    if len(left[0]) + 3 + max(map(len, right)) > shutil.get_terminal_size().columns:
        return [*left, "", *right]
    pairs = zip_longest(left, right, fillvalue="")
    return [f"{one.ljust(len(left[0]))}   {other}".rstrip() for one, other in pairs]


@contextmanager
def single_keys() -> Iterator[None]:
    """Let a terminal hand over every key at once, and not show it."""
    if not sys.stdin.isatty():
        yield
        return
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _read_key() -> str:
    """Name of the next key as :meth:`Game.press` wants it; empty at the end of the input."""
    while (character := sys.stdin.read(1)) not in ("", _END_OF_INPUT):
        if character == "\x1b":
            # An escape sequence: arrows end in A to D, and a 2 before that is Shift. Escape alone would look
            # the same until the next key, so it does nothing here.
            if sys.stdin.read(1) not in ("[", "O"):
                continue
            sequence = sys.stdin.read(1)
            while sequence and not ("@" <= sequence[-1] <= "~"):
                sequence += sys.stdin.read(1) or "~"
            arrow = _TERMINAL_ARROWS.get(sequence[-1:])
            if arrow is not None:
                return f"shift {arrow}" if sequence[:-1].endswith("2") else arrow
        elif character != "\n" or sys.stdin.isatty():
            return _TERMINAL_KEYS.get(character, character.lower())
    return ""


def _module_name(world: str) -> str:
    """Return the name of the module behind an id of this package; any other name as it is."""
    entry_point = gymnasium.registry[world].entry_point if world in gymnasium.registry else None
    if not isinstance(entry_point, str) or not entry_point.startswith("moral_envs."):
        return world
    return entry_point.removeprefix("moral_envs.").partition(":")[0]


def _modules() -> dict[str, ModuleType]:
    """Every world of the package by name."""
    names = [module.name for module in pkgutil.iter_modules(moral_envs.__path__)]
    worlds = [name for name in names if re.fullmatch(r"\w+_v\d+", name)]
    return {name: importlib.import_module(f"moral_envs.{name}") for name in worlds}


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")


def _game(arguments: Sequence[str] | None) -> tuple[Game, bool]:
    """Read the command line; returns the game that it asks for, and whether it is in the terminal."""
    modules = _modules()
    playable = [name for name, module in modules.items() if hasattr(module, "world")]
    parser = _Parser("python -m moral_envs.play", description="Play a world by hand.")
    parser.add_argument(
        "--world",
        default="emergency_v0",
        help=f"one of {', '.join(playable)}, or an id like moral/Emergency-v0; %(default)s unless given",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the first episode (%(default)s)")
    parser.add_argument(
        "--num-agents", type=int, default=1, help="agents; you move one at a time (%(default)s)"
    )
    parser.add_argument("--layout", help=f"how rooms are drawn: {', '.join(layouts.NAMES)}")
    parser.add_argument("--view-radius", type=int, help="how far agents see; what none sees is marked")
    parser.add_argument(
        "--render", choices=("human", "ansi"), default="human", help="a window or the terminal (%(default)s)"
    )
    given = parser.parse_args(arguments)
    name = _module_name(given.world)
    if name not in playable:
        found = "has no grid to play on" if name in modules else "is not a world"
        parser.error(f"--world {given.world} {found}; choose from {', '.join(playable)}")
    if given.layout is not None and "layout" not in signature(modules[name].world).parameters:
        parser.error(f"--layout {given.layout}: {given.world} has no layouts")
    chosen = {"layout": given.layout, "view_radius": given.view_radius}
    options = {option: value for option, value in chosen.items() if value is not None}
    try:
        env = modules[name].parallel_env(num_agents=given.num_agents, **options)
        return Game(env, given.seed), given.render == "ansi"
    except ValueError as error:
        parser.error(str(error))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    game, in_terminal = _game(arguments)
    try:
        if in_terminal:
            play_in_terminal(game)
        else:
            play_in_window(game)
    except (DependencyNotInstalled, RuntimeError) as error:
        print(f"{error}; or play in the terminal with --render ansi", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # Nobody reads the frames any more. Python's own last flush must not fail, too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
