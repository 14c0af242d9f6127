"""Every key does what the screen says it does, in a window and in a terminal."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0, play, windy_wall_v0
from moral_envs.faces import GridParallelEnv
from moral_envs.play import Game, main
from moral_envs.world import ACTION_NAMES

KEYS = {
    "up": 0,
    "down": 1,
    "left": 2,
    "right": 3,
    "space": 4,
    "w": 5,
    "s": 6,
    "a": 7,
    "d": 8,
    "shift up": 5,
    "shift down": 6,
    "shift left": 7,
    "shift right": 8,
    "shift w": 5,
    "shift space": 4,
}


def same_state(one: Any, other: Any) -> bool:
    return all(
        np.array_equal(own, its)
        for own, its in zip(one.engine.state_dict().values(), other.engine.state_dict().values(), strict=True)
    )


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield pygame
    pygame.display.quit()


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Put characters into the standard input."""
    return lambda keys: monkeypatch.setattr(sys, "stdin", io.StringIO(keys))


@pytest.mark.parametrize(("key", "action"), KEYS.items())
@pytest.mark.parametrize("seed", range(5))
def test_a_key_does_its_action(key: str, action: int, seed: int) -> None:
    game, env = Game(delivery_v0.parallel_env(), seed), delivery_v0.parallel_env()
    env.reset(seed=seed)
    for _ in range(2):
        assert game.press(key)
        env.step({"agent_0": action})
    assert same_state(game.env, env)


def test_all_actions_have_a_key() -> None:
    assert set(play.ACTION_KEYS.values()) == set(ACTION_NAMES)


def test_the_selected_agent_acts_and_the_others_wait() -> None:
    game, env = Game(delivery_v0.parallel_env(num_agents=3), 4), delivery_v0.parallel_env(num_agents=3)
    env.reset(seed=4)
    for agent in (0, 1, 2, 0):
        game.press("down")
        game.press("d")
        for action in (1, 8):
            env.step({f"agent_{i}": action if i == agent else 4 for i in range(3)})
        assert same_state(game.env, env)
        assert f"agent {agent}" in game.notes[0]
        game.press("tab")


def test_restarting_repeats_the_start_and_n_takes_the_next_seed() -> None:
    game, env = Game(emergency_v0.parallel_env(), 7), emergency_v0.parallel_env()
    for key, seed in (("r", 7), ("n", 8), ("r", 8), ("shift n", 9)):
        game.press("down")
        game.press(key)
        env.reset(seed=seed)
        assert same_state(game.env, env)
        assert game.notes[0] == f"seed {seed}"
        assert game.panel.steps == "step 0 of 75"


def test_an_unknown_key_does_nothing() -> None:
    game = Game(emergency_v0.parallel_env(), 0)
    before = game.env.engine.world_planes()
    assert game.press("x")
    assert game.panel.steps == "step 0 of 75"
    np.testing.assert_array_equal(game.env.engine.world_planes(), before)


@pytest.mark.parametrize("key", ["q", "escape"])
def test_quitting(key: str) -> None:
    assert not Game(emergency_v0.parallel_env(), 0).press(key)


@pytest.mark.parametrize("key", ["h", "f1"])
def test_help_can_be_hidden_and_shown(key: str) -> None:
    game = Game(emergency_v0.parallel_env(), 0)
    shown = game.notes
    assert any("WASD" in note for note in shown)
    game.press(key)
    assert game.notes == ["seed 0", "H: show the keys"]
    game.press(key)
    assert game.notes == shown


def test_the_end_shows_totals_and_any_key_starts_again() -> None:
    game = Game(emergency_v0.parallel_env(max_cycles=2, height=3, width=4, num_people=1), 0)
    start = game.env.engine.world_planes()
    game.press("d")
    assert game.ending == []
    game.press("a")
    assert game.over
    returns, counters = game.panel.totals
    assert "save 1" in returns
    assert "people_saved 1" in counters
    assert game.ending[:3] == [
        "The episode is over: step 2 of 2.",
        f"return: {returns}",
        f"objectives: {counters}",
    ]
    game.press("h")
    assert game.over
    game.press("x")
    assert not game.over
    assert game.ending == []
    np.testing.assert_array_equal(game.env.engine.world_planes(), start)


def test_a_goal_ends_the_episode() -> None:
    game = Game(GridParallelEnv(replace(windy_wall_v0.world(), slip=0.0)), 0)
    planes = game.env.engine.world_planes()[0]
    goal, start = np.argwhere(planes[-1])[0], game.env.engine.agent_cells[0, 0]
    for key in _way(planes[0], tuple(start.tolist()), tuple(goal.tolist())):
        assert not game.over
        game.press(key)
    assert game.over
    assert "goals_reached 1" in game.ending[2]


def _way(walls: NDArray[np.uint8], start: tuple[int, int], goal: tuple[int, int]) -> list[str]:
    """Shortest way between two cells, as keys."""
    ways: dict[tuple[int, int], list[str]] = {start: []}
    queue = [start]
    for row, column in queue:
        for key, (down, right) in {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}.items():
            cell = (row + down, column + right)
            if cell not in ways and not walls[cell]:
                ways[cell] = [*ways[row, column], key]
                queue.append(cell)
    return ways[goal]


def test_a_key_for_an_action_that_the_world_has_not_says_so() -> None:
    game = Game(windy_wall_v0.parallel_env(), 0)
    assert not any("interact" in note or "wait" in note for note in game.notes)
    game.press("w")
    assert game.notes[-1] == "windy_wall_v0 has no action 'interact up'"
    assert game.panel.steps.startswith("step 0 of")
    game.press("left")
    assert "has no action" not in game.notes[-1]


@pytest.mark.parametrize("module", [emergency_v0, burning_warehouse_v0, delivery_v0])
def test_a_window_is_played_with_keys(module: Any, screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    env = module.parallel_env()
    game = Game(module.parallel_env(), 3)
    keys = [screen.K_RIGHT, screen.K_d, screen.K_SPACE, screen.K_UP, screen.K_q]
    shown: list[str] = []
    flip = screen.display.flip

    def flip_and_type() -> None:
        flip()
        shown.append(game.panel.steps)
        key = keys[len(shown) - 1]
        screen.event.post(screen.event.Event(screen.KEYDOWN, key=key, mod=0, unicode=""))

    monkeypatch.setattr(screen.display, "flip", flip_and_type)
    play.play_in_window(game)
    assert [text.split()[1] for text in shown] == ["0", "1", "2", "3", "4"]
    env.reset(seed=3)
    for action in (3, 8, 4, 0):
        env.step({"agent_0": action})
    assert same_state(game.env, env)
    assert screen.display.get_surface() is None


def test_keys_typed_before_the_totals_are_seen_do_not_take_them_away(
    screen: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    game = Game(emergency_v0.parallel_env(max_cycles=3), 0)
    endings: list[bool] = []
    flip = screen.display.flip

    def flip_and_type() -> None:
        flip()
        endings.append(game.over)
        keys = [screen.K_q] if len(endings) > 1 else [screen.K_SPACE] * 6
        for key in keys:
            screen.event.post(screen.event.Event(screen.KEYDOWN, key=key, mod=0, unicode=""))

    monkeypatch.setattr(screen.display, "flip", flip_and_type)
    play.play_in_window(game)
    assert endings == [False, True]


def test_closing_the_window_ends_the_game(screen: Any) -> None:
    screen.display.init()
    screen.event.post(screen.event.Event(screen.QUIT))
    assert main(["--world", "windy_wall_v0"]) == 0
    assert screen.display.get_surface() is None


def test_a_terminal_is_played_through_a_pipe(
    typed: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    typed("\x1b[C\x1bOB\x1b[1;2A w\n\x1bx\x1b[5~DHqd")
    assert main(["--world", "delivery_v0", "--seed", "5", "--render", "ansi"]) == 0
    frames = capsys.readouterr().out.split("delivery_v0, ")[1:]
    assert [frame.split()[1] for frame in frames] == list("01234566")
    env = delivery_v0.parallel_env(render_mode="ansi")
    env.reset(seed=5)
    for number, action in enumerate((None, 3, 1, 5, 4, 5, 8)):
        if action is not None:
            env.step({"agent_0": action})
        lines = frames[number].splitlines()[2:18]
        assert [line[:32] for line in lines] == env.render().splitlines()
    assert "return so far" in frames[0]
    assert "A agent, D deliveries, P people, ~ pollution, V vases" in frames[0]
    assert "WASD" in frames[0]
    assert "WASD" not in frames[-1]


def test_the_end_of_the_input_ends_the_game(
    typed: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    typed(" " * 75)
    assert main(["--render", "ansi"]) == 0
    assert "The episode is over: step 75 of 75." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "legend"),
    [
        (["--num-agents", "2"], "0-1 agent, P people, E extinguisher"),
        (["--num-agents", "16", "--layout", "random"], "0-f agent, P people, E extinguisher"),
        (["--view-radius", "1"], "A agent, P people, E extinguisher, : out of sight"),
    ],
)
def test_the_legend_names_what_there_is(
    options: list[str], legend: str, typed: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    typed("")
    assert main([*options, "--render", "ansi"]) == 0
    printed = capsys.readouterr().out
    assert legend in printed.splitlines()
    frame = "".join(line[:24] for line in printed.splitlines()[2:10])
    # With one agent inside the room, nine of the 64 cells are in sight.
    assert frame.count(":") == (55 if "--view-radius" in options else 0)


def test_the_key_for_the_end_of_the_input_ends_the_game(
    typed: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    typed("  \x04  ")
    assert main(["--render", "ansi"]) == 0
    printed = capsys.readouterr().out
    assert "step 2 of 75" in printed
    assert "step 3 of 75" not in printed


@pytest.mark.parametrize(("world", "name"), [("moral/Delivery-v0", "delivery_v0"), ("windy_wall_v0",) * 2])
def test_a_world_is_chosen_by_name_or_id(
    world: str, name: str, typed: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    typed("q")
    assert main(["--world", world, "--render", "ansi"]) == 0
    assert capsys.readouterr().out.startswith(f"{name}, step 0 of ")


@pytest.mark.parametrize(("columns", "beside"), [("80", True), ("40", False)])
def test_tables_stand_where_there_is_room(
    columns: str,
    beside: bool,
    typed: Callable[[str], None],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    typed("q")
    main(["--render", "ansi"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].endswith("reward of the last step") == beside
    assert lines[2].startswith("#" * 24)
    assert max(map(len, lines)) <= int(columns)


@pytest.mark.parametrize("last", [b"q", b"\x04"])
def test_a_real_terminal_gives_single_keys_and_is_left_as_it_was(
    last: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    termios = pytest.importorskip("termios")
    master, slave = os.openpty()
    before = termios.tcgetattr(slave)
    drawn = []

    def draw_and_type(game: Game) -> None:
        drawn.append(game.panel.steps)
        os.write(master, b"\x1b[A" if len(drawn) < 3 else last)

    with os.fdopen(slave, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        monkeypatch.setattr(play, "_print_screen", draw_and_type)
        assert main(["--render", "ansi"]) == 0
        assert drawn == ["step 0 of 75", "step 1 of 75", "step 2 of 75"]
        assert termios.tcgetattr(slave) == before
    os.close(master)


def command(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "moral_envs.play", *arguments],
        check=False,
        capture_output=True,
        text=True,
        **options,
    )


def test_an_interrupt_ends_the_game_quietly() -> None:
    game = subprocess.Popen(
        [sys.executable, "-m", "moral_envs.play", "--render", "ansi"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with game:
        assert game.stdout is not None
        assert game.stderr is not None
        while "Q: quit" not in game.stdout.readline():
            pass
        game.send_signal(signal.SIGINT)
        assert game.wait() == 130
        assert game.stderr.read() == ""


def test_a_reader_that_goes_away_ends_the_game_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as closed:
        result = subprocess.run(
            [sys.executable, "-m", "moral_envs.play", "--render", "ansi"],
            check=False,
            input=" " * 50,
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert (result.returncode, result.stderr) == (0, "")


def test_help_names_the_worlds() -> None:
    result = command("--help")
    assert result.returncode == 0
    for name in ("emergency_v0", "delivery_v0", "burning_warehouse_v0", "windy_wall_v0"):
        assert name in result.stdout.replace("\n", " ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--world", "nowhere_v0"], "--world nowhere_v0 is not a world; choose from"),
        (["--world", "noisy_constraint_v0"], "--world noisy_constraint_v0 has no grid to play on; choose"),
        (["--world", "moral/NoisyConstraint-v0"], "NoisyConstraint-v0 has no grid to play on; choose"),
        (["--world", "CartPole-v1"], "--world CartPole-v1 is not a world; choose from"),
        (["--seed", "one"], "--seed"),
        (["--seed", "-1"], "seed is -1; it must be at least 0"),
        (["--num-agents", "17"], "num_agents is 17; it must be 1 to 16"),
        (["--num-agents", "0"], "num_agents is 0; it must be 1 to 16"),
        (["--world", "windy_wall_v0", "--num-agents", "2"], "must be 1 to play windy_wall_v0"),
        (["--layout", "nowhere"], "layout is 'nowhere'"),
        (
            ["--world", "windy_wall_v0", "--layout", "pillars"],
            "--layout pillars: windy_wall_v0 has no layouts",
        ),
        (["--view-radius", "0"], "view_radius is 0"),
        (["--render", "rgb_array"], "--render"),
        (["--speed", "9"], "--speed"),
    ],
)
def test_a_wrong_argument_is_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert printed.err.startswith("python -m moral_envs.play: error: ")
    assert words in printed.err


def test_a_world_without_a_grid_cannot_be_played(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(play, "_modules", lambda: {"emergency_v0": emergency_v0, "table_v0": object()})
    with pytest.raises(SystemExit, match="2"):
        main(["--world", "table_v0"])
    assert "--world table_v0 has no grid to play on; choose from emergency_v0\n" in capsys.readouterr().err


@pytest.mark.parametrize("cause", ["no pygame", "no screen"])
def test_a_window_that_cannot_open_is_one_line(
    cause: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if cause == "no pygame":
        monkeypatch.setitem(sys.modules, "pygame", None)
        words = 'pip install "moral-envs[human]"'
    else:
        pygame = pytest.importorskip("pygame")
        monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")
        monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
        pygame.display.init()
        monkeypatch.delenv("SDL_VIDEODRIVER")
        words = "needs a screen"
    assert main([]) == 1
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.endswith("or play in the terminal with --render ansi\n")
    assert printed.count("\n") == 1
