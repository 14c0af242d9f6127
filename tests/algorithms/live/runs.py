"""Run directories with questions in them, without a training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from starlette.testclient import TestClient

from moral_algorithms.answers import AskedQuery
from moral_algorithms.learners.beside_people import write_status
from moral_algorithms.live.frames import start
from moral_algorithms.live.playing import Plays
from moral_algorithms.live.server import make_app
from moral_algorithms.live.session import LiveSession
from moral_algorithms.preferences import Query
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import RunDirectory, append_line
from tests.algorithms.tiny import EMERGENCY

WORLD = EMERGENCY.build()
TOKEN = "a-token-of-sufficient-length"
HOST = "127.0.0.1:8765"


def random_replay(seed: int) -> Replay:
    rng = np.random.default_rng(seed)
    actions = rng.integers(WORLD.num_actions, size=(WORLD.horizon, 1)).astype(np.uint8)
    return Replay(int(rng.integers(2**63)), actions)


def query(number: int, **changes: Any) -> AskedQuery:
    """A query about two random episodes, whose counters are the true ones."""
    episodes = random_replay(2 * number), random_replay(2 * number + 1)
    objectives = []
    for episode in episodes:
        engine = start(WORLD, episode.stream)
        for actions in episode.actions:
            engine.step(actions[None])
        objectives.append(engine.objectives[0, 0])
    pair = Query(np.array(objectives) * [0.1, 1.0], np.array(objectives))
    values: dict[str, Any] = {
        "number": number,
        "posterior": 0,
        "env_steps": 64,
        "pair": pair,
        "expected": 0.1,
    }
    return AskedQuery(**{**values, "episodes": episodes, **changes})


def prepare(run: Path, opened: int = 3, posted: int = 4, queries: int = 5) -> Path:
    """A run in which some queries are posted and the first of them are open."""
    run.mkdir(exist_ok=True)
    directory = RunDirectory(run)
    directory.write_config({"kind": "train", "world": EMERGENCY.to_json(), "moral": {"queries": queries}})
    folder = QueryFolder(run)
    folder.prepare()
    for number in range(posted):
        folder.post(query(number))
    folder.write_open({number: 0.5 - 0.1 * number for number in range(opened)})
    weights = {"extinguish": 0.25, "save": 0.75}
    for rollout in range(1, 4):
        line = {"env_steps": 64 * rollout, "queries": 0, "weights": weights}
        append_line(directory.metrics, {**line, "objectives": {"goal_time": 1.0, "people_saved": 0.5}})
    set_phase(run, "training")
    return run


def set_phase(run: Path, phase: str) -> None:
    values = {
        "progress": 0.1,
        "env_steps": 192,
        "components": ["extinguish", "save"],
        "weights": [0.25, 0.75],
    }
    more = {"samples": [[0.2, 0.8]], "answers": 0, "objectives": [1.0, 0.5], "advice": None}
    write_status(run, phase, {**values, **more, "episode": random_replay(99).to_json()})


@contextmanager
def client(
    session: LiveSession | None = None, plays: Plays | None = None, enter: bool = True
) -> Iterator[TestClient]:
    """Somebody in a browser, who has followed the link."""
    app = make_app(TOKEN, 8765, frozenset({HOST}), session, plays)
    with TestClient(app, base_url=f"http://{HOST}", follow_redirects=False) as browser:
        if enter:
            assert browser.get("/", params={"token": TOKEN}).status_code == 303
        yield browser


def answer(key: str, preference: str = "first", seconds: float = 1.5) -> dict[str, Any]:
    """The body of an answer."""
    return {"preference": preference, "seconds": seconds, "key": key}
