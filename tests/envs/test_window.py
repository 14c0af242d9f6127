"""The window shows what happens by itself, and can go away at any time."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from moral_envs import delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.engine import Engine
from moral_envs.panel import Panel
from moral_envs.rendering import draw_rgb
from moral_envs.streams import spawn_streams
from moral_envs.window import Window

pygame = pytest.importorskip("pygame")

FACES = ("single_env", "parallel_env", "env")


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def open_face(module: Any, face: str, **arguments: Any) -> Any:
    env = getattr(module, face)(render_mode="human", **arguments)
    env.metadata["render_fps"] = 0
    return env


def act(env: Any, action: int) -> None:
    """Let every agent do the same, on any face."""
    if hasattr(env, "agent_selection"):
        for _ in range(len(env.possible_agents)):
            env.step(action)
    elif hasattr(env, "possible_agents"):
        env.step(dict.fromkeys(env.agents, action))
    else:
        env.step(action)


def engine_of(env: Any) -> Engine:
    found: Engine = (env.parallel if hasattr(env, "parallel") else env).engine
    return found


def pixels() -> NDArray[np.uint8]:
    """What is on the screen, (height, width, 3)."""
    surface = pygame.display.get_surface()
    width, height = surface.get_size()
    return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(height, width, 3)


def tile_on_screen(engine: Engine) -> int:
    """Size at which the grid on the screen shows the engine's state; 0 if it does not."""
    screen = pixels()
    planes, agents = engine.world_planes()[0], engine.agent_cells[0]
    for tile in range(8, 97):
        picture = draw_rgb(engine.world, planes, agents, tile, engine.view_radius)
        part = screen[16 : 16 + picture.shape[0], 16 : 16 + picture.shape[1]]
        if part.shape == picture.shape and (part == picture).all():
            return tile
    return 0


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize("module", [emergency_v0, delivery_v0, windy_wall_v0])
def test_every_face_shows_itself_and_its_render_returns_nothing(module: Any, face: str) -> None:
    env = open_face(module, face)
    assert pygame.display.get_surface() is None
    env.reset(seed=0)
    assert tile_on_screen(engine_of(env)) >= 24
    assert pygame.display.get_caption()[0] == module.__name__.rpartition(".")[2]
    for action in (0, 1, 2, 3):
        act(env, action)
        assert tile_on_screen(engine_of(env)) >= 24
    shown = pixels()
    assert env.render() is None
    np.testing.assert_array_equal(pixels(), shown)
    env.close()
    assert pygame.display.get_surface() is None


@pytest.mark.parametrize("arguments", [{"num_agents": 16}, {"num_agents": 4, "view_radius": 2}])
def test_several_agents_and_their_views_are_shown(arguments: Any) -> None:
    env = open_face(delivery_v0, "parallel_env", **arguments)
    env.reset(seed=0)
    act(env, 6)
    assert tile_on_screen(env.engine) >= 16


def test_gymnasium_makes_it() -> None:
    env = gymnasium.make("moral/Emergency-v0", render_mode="human")
    env.unwrapped.metadata["render_fps"] = 0
    env.reset(seed=0)
    env.step(4)
    assert tile_on_screen(env.unwrapped.engine)  # type: ignore[attr-defined]
    env.close()


def test_a_batch_has_no_window() -> None:
    with pytest.raises(
        ValueError, match=r"^render_mode is 'human'; it must be None or one of .*'rgb_array'\)$"
    ):
        emergency_v0.vector_env(2, render_mode="human")
    assert "human" not in emergency_v0.vector_env(2).metadata["render_modes"]
    assert "human" not in emergency_v0.vector_env.metadata["render_modes"]  # type: ignore[attr-defined]


def test_the_panel_has_rewards_returns_and_counters() -> None:
    engine = Engine(emergency_v0.world(num_people=1), num_agents=2)
    engine.seed(spawn_streams(0, 1))
    engine.reset()
    panel = Panel(engine)
    engine.step([[4, 4]])
    assert not engine.objectives.any()
    panel.add(np.array([[0.1, 0], [0, 1]], dtype=np.float32))
    panel.add(np.array([[0.1, 0], [0, -1.25]], dtype=np.float32))
    assert panel.steps == "step 1 of 75"
    assert panel.text.splitlines() == [
        "                    0      1",
        "reward of the last step",
        "  extinguish     +0.1      0",
        "  save              0  -1.25",
        "return so far",
        "  extinguish      0.2      0",
        "  save              0  -0.25",
        "objectives so far",
        "  goal_time         0      0",
        "  people_saved      0      0",
    ]
    assert panel.totals == ("extinguish 0.2, save -0.25", "goal_time 0, people_saved 0")
    # Small amounts are shown, and amounts that cancel leave nothing.
    panel.reset()
    for amount in (0.125, 0.004, -0.004):
        panel.add(np.array([[amount, 0.1], [0, -0.1]], dtype=np.float32))
    assert "-0.004" in panel.text
    assert panel.totals[0] == "extinguish 0.125, save 0"
    panel.reset()
    assert panel.totals[0] == "extinguish 0, save 0"


def test_the_panel_follows_the_episode() -> None:
    """Steps that leave the grid as it is still change what stands beside it."""
    env = open_face(emergency_v0, "single_env", num_people=0)
    env.reset(seed=0)
    looks = [pixels()]
    for _ in range(2):
        env.step(4)
        looks.append(pixels())
    assert (looks[0] != looks[1]).any()
    assert (looks[1] != looks[2]).any()
    env.reset(seed=0)
    np.testing.assert_array_equal(pixels(), looks[0])


def test_the_window_adds_up_what_the_steps_pay() -> None:
    env = open_face(delivery_v0, "parallel_env", num_agents=3, team_reward=True)
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    total = np.zeros((3, 4))
    for _ in range(50):
        _, rewards, _, _, _ = env.step({agent: int(rng.integers(9)) for agent in env.agents})
        total += np.stack(list(rewards.values()))
    assert total.any()
    np.testing.assert_allclose(env.window.panel.returns, total)
    env.reset()
    assert not env.window.panel.returns.any()


@pytest.mark.parametrize("size", [(400, 300), (1600, 900), (500, 900), (2000, 300)])
def test_the_grid_is_as_large_as_the_window_allows(size: tuple[int, int]) -> None:
    env = open_face(delivery_v0, "single_env")
    env.reset(seed=0)
    pygame.display.set_mode(size, pygame.RESIZABLE)
    env.render()
    tile = tile_on_screen(env.engine)
    assert tile * 16 >= 0.45 * min(size)


@pytest.mark.parametrize("size", [(10, 10), (130, 600)])
def test_a_window_that_is_too_small_shows_a_part(size: tuple[int, int]) -> None:
    env = open_face(delivery_v0, "single_env")
    env.reset(seed=0)
    pygame.display.set_mode(size, pygame.RESIZABLE)
    env.render()
    assert pygame.display.get_surface().get_size() == size


@pytest.mark.parametrize("face", FACES)
def test_a_window_closed_by_hand_stays_closed_and_nothing_else_changes(face: str) -> None:
    env, other = open_face(emergency_v0, face), getattr(emergency_v0, face)()
    for one in (env, other):
        one.reset(seed=0)
    window = (env.parallel if face == "env" else env).window
    assert not window.dismissed
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for action in (3, 1, 3):
        act(env, action)
        act(other, action)
        assert pygame.display.get_surface() is None
    assert window.dismissed
    np.testing.assert_array_equal(engine_of(env).world_planes(), engine_of(other).world_planes())
    assert env.render() is None
    env.reset(seed=1)
    assert pygame.display.get_surface() is None
    env.close()
    env.close()


def test_a_window_that_was_closed_by_the_program_opens_again() -> None:
    env = open_face(emergency_v0, "single_env")
    env.close()
    env.reset(seed=0)
    env.close()
    assert pygame.display.get_surface() is None
    env.reset(seed=0)
    assert tile_on_screen(env.engine)


def test_two_windows_take_turns() -> None:
    one, other = open_face(emergency_v0, "single_env"), open_face(delivery_v0, "single_env")
    never_shown = open_face(emergency_v0, "single_env")
    for env in (one, other, one):
        env.reset(seed=0)
        assert tile_on_screen(env.engine)
    never_shown.close()
    assert pygame.display.get_surface() is not None
    other.close()
    one.step(0)
    assert tile_on_screen(one.engine)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_an_environment_with_an_open_window_can_be_copied(duplicate: Any) -> None:
    env = open_face(delivery_v0, "single_env")
    env.reset(seed=0)
    env.step(3)
    twin = duplicate(env)
    for one in (env, twin):
        one.step(1)
        assert tile_on_screen(one.engine)
    np.testing.assert_array_equal(env.engine.world_planes(), twin.engine.world_planes())
    assert twin.window.panel.engine is twin.engine


def test_steps_wait_for_each_other_as_render_fps_says(monkeypatch: pytest.MonkeyPatch) -> None:
    now, waited = [100.0], []

    def sleep(seconds: float) -> None:
        waited.append(round(seconds, 6))
        now[0] += seconds

    monkeypatch.setattr("moral_envs.window.time.monotonic", lambda: now[0])
    monkeypatch.setattr("moral_envs.window.time.sleep", sleep)
    env = emergency_v0.single_env(render_mode="human")
    env.metadata["render_fps"] = 4
    env.reset(seed=0)
    for _ in range(3):
        env.step(4)
        now[0] += 0.05
    now[0] += 10
    env.step(4)
    assert waited == [0.0, 0.2, 0.2, 0.0]


@pytest.mark.parametrize("face", FACES)
def test_without_pygame_an_error_says_how_to_get_it(face: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r'"human".*pip install "moral-envs\[human\]"'):
        getattr(emergency_v0, face)(render_mode="human")
    env = getattr(emergency_v0, face)(render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (256, 256, 3)


@pytest.mark.parametrize("driver", ["none", "offscreen"])
def test_without_a_screen_there_is_an_error(driver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise pygame.error("No available video device")

    if driver == "none":
        monkeypatch.setattr(pygame.display, "init", fail)
    else:
        monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")
        pygame.display.init()
        monkeypatch.delenv("SDL_VIDEODRIVER")
    env = emergency_v0.single_env(render_mode="human")
    with pytest.raises(RuntimeError, match=r'^render_mode is "human", which needs a screen'):
        env.reset(seed=0)


def test_pygame_is_imported_for_a_window_alone() -> None:
    code = (
        "import sys, moral_envs, moral_envs.play, moral_envs.window\n"
        "env = moral_envs.emergency_v0.single_env(render_mode='rgb_array')\n"
        "env.reset(seed=0); env.render()\n"
        "sys.exit('pygame' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_keys_have_names_and_those_that_change_others_are_left_out() -> None:
    engine = Engine(emergency_v0.world())
    engine.seed(spawn_streams(0, 1))
    window = Window(Panel(engine), {"render_fps": 0})
    window.show()
    for key, held in (
        (pygame.K_UP, 0),
        (pygame.K_LSHIFT, pygame.KMOD_LSHIFT),
        (pygame.K_LEFT, pygame.KMOD_LSHIFT),
        (pygame.K_w, 0),
        (pygame.K_SPACE, 0),
        (pygame.K_TAB, 0),
        (pygame.K_CAPSLOCK, 0),
        (pygame.K_F1, 0),
        (pygame.K_ESCAPE, 0),
    ):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key, mod=held, unicode=""))
    pygame.event.post(pygame.event.Event(pygame.KEYUP, key=pygame.K_q, mod=0))
    assert window.wait_for_keys(0) == ["up", "shift left", "w", "space", "tab", "f1", "escape"]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert window.wait_for_keys(0) == []
    assert window.dismissed


def test_a_window_of_somebody_else_will_do() -> None:
    """Whoever opened it, like Gymnasium's own worlds, may have no letters."""
    pygame.quit()
    pygame.display.init()
    pygame.display.set_mode((600, 400))
    env = open_face(emergency_v0, "single_env")
    env.reset(seed=0)
    env.step(0)
    assert len(np.unique(pixels().reshape(-1, 3), axis=0)) > 10
    env.close()
    # It is not ours to close.
    assert pygame.display.get_surface() is not None
