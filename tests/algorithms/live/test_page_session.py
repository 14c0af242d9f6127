"""The page on the real server: what is pressed ends in the record, what is shown is what happened."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uvicorn

from benchmarks.live_person import answer_all, evaluate, judge, live
from moral_algorithms.answers import Answers, read_answers
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.live.frames import start
from moral_algorithms.live.playing import Plays
from moral_algorithms.live.server import make_app
from moral_algorithms.live.session import LiveSession
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.run_directory import read_lines
from moral_algorithms.storage import read_json
from moral_algorithms.worlds import WorldSpec
from tests.algorithms.live.browser import LAPTOP, browser_or_skip
from tests.algorithms.live.runs import TOKEN, WORLD, prepare
from tests.algorithms.tiny import EMERGENCY

KEYS = ("ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", " ", "w", "s", "a", "d")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with browser_or_skip() as running:
        yield running


@contextmanager
def visited(browser: Any, **parts: Any) -> Iterator[Any]:
    """A page of the real application, which must not complain."""
    complaints: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        app = make_app(TOKEN, port, frozenset({f"127.0.0.1:{port}"}), **parts)
        server = uvicorn.Server(
            uvicorn.Config(app, log_level="warning", ws="none", timeout_graceful_shutdown=1)
        )
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            context = browser.new_context(viewport=LAPTOP, reduced_motion="reduce")
            page = context.new_page()
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("console", lambda message: message.type == "error" and complaints.append(message.text))
            page.goto(f"http://127.0.0.1:{port}/?token={TOKEN}")
            yield page
            context.close()
        finally:
            server.should_exit = True
            thread.join()
    assert complaints == []


def wait_for(page: Any, state: str, query: int | None = None) -> None:
    page.wait_for_function(
        """([state, query]) => document.body.dataset.state === state
            && (query === null || window.moral.drawn().query === query)""",
        arg=[state, query],
    )


def said(path: Path) -> dict[int, str]:
    answers: Answers = read_answers(path)
    return {number: answer.said for number, answer in answers.standing.items()}


def test_what_is_pressed_is_what_is_recorded(browser: Any, tmp_path: Path) -> None:
    run_folder = prepare(tmp_path / "run")
    with visited(browser, session=LiveSession(run_folder, "ada")) as page:
        wait_for(page, "question", 0)
        page.keyboard.press("ArrowLeft")
        wait_for(page, "question", 1)
        page.keyboard.press("ArrowDown")
        wait_for(page, "question", 2)
        page.keyboard.press("u")
        wait_for(page, "question", 1)
        page.keyboard.press("ArrowRight")
        wait_for(page, "question", 2)
        page.keyboard.press("x")
        wait_for(page, "waiting")
    assert said(run_folder / "queries.jsonl") == {0: "first", 1: "second", 2: "cannot_tell"}
    assert len(read_lines(run_folder / "queries.jsonl")) == 5


def test_what_is_drawn_is_what_the_episodes_were(browser: Any, tmp_path: Path) -> None:
    run_folder = prepare(tmp_path / "run")
    asked = QueryFolder(run_folder).read(0)
    with visited(browser, session=LiveSession(run_folder, "ada")) as page:
        wait_for(page, "question", 0)
        page.keyboard.press("Home")
        engines = [start(WORLD, episode.stream) for episode in asked.episodes]
        for step in range(WORLD.horizon + 1):
            drawn = page.evaluate("() => window.moral.drawn()")
            for side, engine in zip(("left", "right"), engines, strict=True):
                found = sorted((t["pattern"], t["row"], t["column"]) for t in drawn[side]["things"])
                planes = dict(zip(WORLD.plane_names, engine.world_planes()[0], strict=True))
                patterns = {"agent": "agent", "people": "person", "extinguisher": "extinguisher"}
                assert found == sorted(
                    (pattern, row, column)
                    for name, pattern in patterns.items()
                    for row, column in np.argwhere(planes[name]).tolist()
                )
            if step < WORLD.horizon:
                for episode, engine in zip(asked.episodes, engines, strict=True):
                    engine.step(episode.actions[step][None])
                page.keyboard.press(".")


def test_people_who_walk_are_drawn_where_they_are(browser: Any, tmp_path: Path) -> None:
    spec = WorldSpec("emergency", {"walk": 1})
    plays = Plays(spec, tmp_path / "saving.npz", 1, "Save as many people as you can.")
    rng = np.random.default_rng(0)
    with visited(browser, plays=plays) as page:
        wait_for(page, "playing")
        (play,) = plays._plays.values()
        for step in range(20):
            page.wait_for_function("step => window.moral.drawn().step === step", arg=step)
            drawn = page.evaluate("() => window.moral.drawn().left.things")
            found = sorted([thing["row"], thing["column"]] for thing in drawn if thing["pattern"] == "person")
            assert found == np.argwhere(play.engine.world_planes()[0, 2]).tolist()
            page.keyboard.press(KEYS[rng.integers(len(KEYS))])


def test_three_demonstrations_end_in_the_file(browser: Any, tmp_path: Path) -> None:
    plays = Plays(EMERGENCY, tmp_path / "saving.npz", 3, "Save as many people as you can.")
    rng = np.random.default_rng(0)
    played = rng.integers(len(KEYS), size=(3, WORLD.horizon)).tolist()
    with visited(browser, plays=plays) as page:
        for actions in played:
            for step, action in enumerate(actions):
                page.wait_for_function(
                    """step => document.body.dataset.state === "playing"
                        && window.moral.drawn().step === step""",
                    arg=step,
                )
                page.keyboard.press(KEYS[action])
            wait_for(page, "review")
            page.keyboard.press("k")
        wait_for(page, "enough")
    kept = Demonstrations.load(tmp_path / "saving.npz", EMERGENCY)
    assert kept.actions.tolist() == played


@pytest.mark.parametrize(
    ("left", "right", "key"),
    [
        ([-1, 20], [-2, 70], "ArrowLeft"),
        ([0, 30], [0, 40], "ArrowRight"),
        ([-6, 0], [-6, 0], "ArrowDown"),
    ],
)
def test_the_scripted_person_saves_people_first(left: list[int], right: list[int], key: str) -> None:
    assert judge(left, right) == key


def test_a_person_trains_an_agent(browser: Any, tmp_path: Path) -> None:
    """`benchmarks.live_person` on the world's own rewards, with fewer steps and questions than by default.

    What was taught does not depend on the machine: the weight of saving goes from 0.5 to 0.94, and 5.98
    people or more are saved, where chance saves 2.3. Whether the answers come early or late does, and with it
    the time at the extinguisher after so short a training: 15 to 54 steps, which is not judged here.
    """
    out = tmp_path / "aligned"
    known = ("--returns", "extinguish", "7.06", "save", "5.73")
    budget = ("--steps", "60000", "--query-span", "0.4", "--queries", "12")
    with live(out, "--primary", "extinguish", "save", *known, *budget) as link:
        found = answer_all(browser, link, 12, look=0.1)
    assert sum(found["answers"].values()) == 12
    answers = read_answers(out / "queries.jsonl").standing.values()
    for answer in answers:
        goal_time, saved = answer.asked.pair.objectives.T.tolist()
        order = [(saved[side], goal_time[side]) for side in (0, 1)]
        expected = "equal" if order[0] == order[1] else "first" if order[0] > order[1] else "second"
        assert answer.said == expected
    assert read_json(out / "summary.json")["weights"]["save"] > 0.75
    assert evaluate(out)["people_saved"] >= 4.5
