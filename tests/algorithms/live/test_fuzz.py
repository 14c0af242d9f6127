"""Whatever is asked, the server answers, never with an error of its own, and its record stays whole."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient

from moral_algorithms.answers import read_answers
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.live.playing import Plays
from moral_algorithms.live.session import LiveSession
from tests.algorithms.live.runs import HOST, TOKEN, WORLD, client, prepare
from tests.algorithms.tiny import EMERGENCY

EXAMPLES, REQUESTS = 85, 12  # in each of two modes

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=5,
)
KEYS = st.sampled_from([f"key-number-{number}" for number in range(12)]) | st.text(max_size=70)
NUMBERS = st.integers(-1, 6).map(str) | st.integers().map(str) | st.text(max_size=6)
NAMES = st.sampled_from(["", "..", "page.js", "index.html", "\x00"]) | st.text(max_size=12)


def mutated(body: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    """The right fields with right or wrong values, and sometimes one too few or too many."""
    values = {name: st.just(value) | JSON for name, value in body.items()}
    extra = st.dictionaries(st.sampled_from(["who", "", *body]), JSON, max_size=1)
    return st.builds(lambda right, more: {**right, **more}, st.fixed_dictionaries(values), extra)


BODIES = st.one_of(
    st.builds(
        lambda preference, seconds, key: {"preference": preference, "seconds": seconds, "key": key},
        st.sampled_from(["first", "second", "equal", "cannot_tell", "both"]),
        st.floats() | st.integers(),
        KEYS,
    ),
    st.builds(lambda key: {"key": key}, KEYS),
    st.just({}),
    st.builds(lambda action, step: {"action": action, "step": step}, st.integers(-2, 10), st.integers(-1, 9)),
    mutated({"preference": "first", "seconds": 1.0, "key": "key-number-0"}),
    JSON,
).map(lambda body: json.dumps(body).encode()) | st.binary(max_size=40)


def paths(play: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.one_of(
        st.sampled_from(["/", "/api/state", "/api/episode", "/api/stop", "/api/consent", "/api/plays"]),
        st.builds(lambda number, end: f"/api/queries/{number}{end}", NUMBERS, st.sampled_from(ENDS)),
        st.builds(lambda name, end: f"/api/plays/{name}{end}", play | NAMES, st.sampled_from(PLAY_ENDS)),
        st.builds(lambda name: f"/static/{name}", NAMES),
        st.text(max_size=20).map(lambda text: f"/{text}"),
    ).filter(lambda path: not path.startswith("/api/events"))


ENDS = ["", "/answer", "/undo", "/", "/nothing"]
PLAY_ENDS = ["", "/step", "/keep", "/discard", "/episode"]

HEADERS = st.fixed_dictionaries(
    {},
    optional={
        "content-type": st.sampled_from(
            ["application/json", "application/json; charset=utf-8", "text/plain"]
        ),
        "origin": st.sampled_from([f"http://{HOST}", "http://evil.example", "null", "://"]),
        "cookie": st.sampled_from([f"moral_8765={TOKEN}", "moral_8765=", "=;="]),
    },
)
CHAOS = st.tuples(st.sampled_from(["GET", "POST", "POST", "POST", "PUT", "HEAD"]), HEADERS, BODIES)


def sensible(path: str, **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Request]:
    """Requests that a page might send, but in an order in which it would not, and some malformed."""
    body = st.fixed_dictionaries(fields).map(lambda body: json.dumps(body).encode())
    return st.tuples(st.just(path), st.tuples(st.just("POST"), st.just({}), body))


Request = tuple[str, tuple[str, dict[str, str], bytes]]
KEY = st.integers(0, 40).map("key-number-{}".format)


def questions() -> st.SearchStrategy[Request]:
    said = st.sampled_from(["first", "second", "equal", "cannot_tell", "both"])
    numbers = st.integers(0, 4)
    return st.one_of(
        sensible("/api/consent", key=KEY),
        numbers.flatmap(
            lambda n: sensible(f"/api/queries/{n}/answer", preference=said, seconds=st.floats(0, 9), key=KEY)
        ),
        numbers.flatmap(lambda n: sensible(f"/api/queries/{n}/undo", key=KEY)),
    )


def playing(names: st.SearchStrategy[str]) -> st.SearchStrategy[Request]:
    # No new plays: they would push those that are known out of memory.
    steps = st.integers(0, 8)
    return st.one_of(
        names.flatmap(lambda n: sensible(f"/api/plays/{n}/step", action=steps | st.just(99), step=steps)),
        names.flatmap(lambda n: sensible(f"/api/plays/{n}/keep")),
        sensible("/api/plays/none/discard"),
    )


def ask(browser: TestClient, path: str, method: str, headers: dict[str, str], body: bytes) -> int:
    """Send a request and return its status."""
    encoded = {name: value.encode("latin-1") for name, value in headers.items()}
    if method == "POST":
        encoded.setdefault("content-type", b"application/json")
    response = browser.request(method, as_sent(path), headers=encoded, content=body)
    assert response.status_code < 500, (method, path, headers, body, response.text)
    if response.status_code == 401 and response.headers["content-type"].startswith("text/html"):
        # What a person who opens the page without its link is told.
        assert (method, response.url.path) == ("GET", "/")
    elif response.status_code >= 400 and method != "HEAD":
        error = response.json()
        assert isinstance(error["error"], str)
        assert "\n" not in error["detail"]
    return response.status_code


def as_sent(path: str) -> str:
    """What a client would send for a path: percent-encoded UTF-8, but for what is encoded already."""
    return quote(path.encode("utf-8", "replace"), safe="/%-._~")


@pytest.mark.parametrize("mode", ["answer", "demonstrate"])
def test_no_request_makes_the_server_fail(tmp_path: Path, mode: str) -> None:
    run = prepare(tmp_path / "run", queries=10**6)
    session = LiveSession(run, "ada", "Do you agree?") if mode == "answer" else None
    plays = None if mode == "answer" else Plays(EMERGENCY, tmp_path / "d.npz", 3, "Play.")
    statuses: Counter[int] = Counter()
    with client(session, plays) as browser:
        names = st.just("none")
        if plays is not None:
            known = [plays.begin()["play"] for _ in range(3)]
            names = st.sampled_from(known)
            for step in range(WORLD.horizon):
                plays.step(known[0], 4, step)
        right = questions() if plays is None else playing(names)
        requests = st.lists(right | st.tuples(paths(names), CHAOS), min_size=REQUESTS, max_size=REQUESTS)

        @given(requests)
        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            database=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        )
        def send(requests: list[Request]) -> None:
            for path, (method, headers, body) in requests:
                statuses[ask(browser, path, method, headers, body)] += 1

        send()
    assert statuses.total() >= 1000
    assert {200, 400, 404, 409} <= statuses.keys()
    if session is not None:
        # Every line is whole, no query has two answers that stand, no key counts twice.
        answers = read_answers(run / "queries.jsonl")
        assert answers.notices
        assert len(answers.standing) + len(answers.undone) >= 3
    else:
        assert Demonstrations.load(tmp_path / "d.npz", EMERGENCY).num_episodes == 1
