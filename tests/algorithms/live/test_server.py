"""What the server grants, what it refuses, and that nothing is counted twice."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from moral_algorithms.answers import read_answers
from moral_algorithms.live.frames import start
from moral_algorithms.live.server import MAX_BODY, Feed
from moral_algorithms.live.session import LiveSession, hold_session
from moral_algorithms.run_directory import read_lines
from moral_algorithms.storage import StorageError
from tests.algorithms.full_disk import full_disk
from tests.algorithms.live.runs import (
    HOST,
    TOKEN,
    WORLD,
    answer,
    client,
    prepare,
    query,
    random_replay,
    set_phase,
)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return prepare(tmp_path / "run")


@pytest.fixture
def browser(run: Path) -> Iterator[TestClient]:
    with client(LiveSession(run, "ada")) as inside:
        yield inside


def recorded(run: Path) -> list[tuple[str, int]]:
    return [(line["record"], line["query"]) for line in read_lines(run / "queries.jsonl")]


def open_queries(response: Any) -> list[int]:
    return [entry["query"] for entry in response.json()["queue"]["open"]]


def test_the_state_says_how_everything_stands(browser: TestClient, run: Path) -> None:
    state = browser.get("/api/state").json()
    assert state["version"] == 1
    assert (state["mode"], state["run"], state["who"]) == ("answer", str(run), "ada")
    assert state["names"] == {}
    assert state["world"]["objectives"] == ["goal_time", "people_saved"]
    assert state["world"]["kinds"] == [{"name": "people", "pattern": "person", "symbol": "P"}]
    assert state["queue"]["open"][0] == {"query": 0, "expected": 0.5}
    assert (state["queue"]["answered"], state["queue"]["queries"]) == (0, 5)
    assert state["curves"]["env_steps"] == [64, 128, 192]
    assert state["curves"]["weights"][-1] == [0.25, 0.75]
    assert state["status"]["phase"] == "training"
    assert "episode" not in state["status"]
    assert (state["consent"], state["demonstrations"]) == (None, None)


def test_a_query_is_told_so_that_it_can_be_drawn(browser: TestClient) -> None:
    told = browser.get("/api/queries/2").json()
    asked = query(2)
    assert (told["query"], told["state"], told["expected"]) == (2, "open", 0.1)
    for episode, replay, objectives in zip(
        told["episodes"], asked.episodes, asked.pair.objectives, strict=True
    ):
        engine = start(WORLD, replay.stream)
        for step in range(WORLD.horizon + 1):
            if step:
                engine.step(replay.actions[step - 1][None])
            assert episode["agent"][step] == engine.agent_cells[0, 0].tolist()
            assert episode["counters"][step] == engine.objectives[0, 0].tolist()
            there = sorted(
                thing["cell"] for thing in episode["things"] if thing["gone"] is None or step < thing["gone"]
            )
            assert there == np.argwhere(engine.world_planes()[0, 2]).tolist()
        events = [event["objective"] for event in episode["events"]]
        assert [events.count(name) for name in WORLD.objective_names] == objectives.tolist()
        assert episode["fixture"] == [3, 3]
        assert episode["walls"] == ["11111", "10001", "10001", "10001", "11111"]
    assert (
        browser.get("/api/episode").json()["episode"]["actions"] == random_replay(99).actions[:, 0].tolist()
    )


def test_an_answer_is_on_the_disk_with_all_that_it_takes_to_learn_from_it(
    browser: TestClient, run: Path
) -> None:
    response = browser.post("/api/queries/1/answer", json=answer("key-number-1", "equal", 2))
    assert response.status_code == 200
    assert response.json()["duplicate"] is False
    assert open_queries(response) == [0, 2]
    assert response.json()["queue"]["last"] == {"query": 1, "preference": "equal"}
    (line,) = read_lines(run / "queries.jsonl")
    assert line.items() >= query(1).to_json().items()
    assert (line["preference"], line["seconds"], line["who"]) == ("equal", 2.0, "ada")
    assert line["when"].endswith("+00:00")


def test_cannot_tell_is_recorded_and_another_query_is_wanted(browser: TestClient, run: Path) -> None:
    response = browser.post("/api/queries/0/answer", json=answer("key-number-1", "cannot_tell"))
    assert response.json()["queue"]["answered"] == 0
    assert open_queries(response) == [1, 2]
    assert read_answers(run / "queries.jsonl").informative == []


def test_the_same_answer_sent_twice_counts_once(browser: TestClient, run: Path) -> None:
    first = browser.post("/api/queries/0/answer", json=answer("key-number-1"))
    again = browser.post("/api/queries/0/answer", json=answer("key-number-1"))
    assert (first.json()["duplicate"], again.json()["duplicate"]) == (False, True)
    assert recorded(run) == [("answer", 0)]
    browser.post("/api/queries/0/undo", json={"key": "key-number-2"})
    late = browser.post("/api/queries/0/answer", json=answer("key-number-1"))
    assert late.json()["duplicate"] is True
    assert recorded(run) == [("answer", 0), ("undo", 0)]


def test_two_browsers_and_double_clicks_the_first_answer_stands(run: Path) -> None:
    session = LiveSession(run, "ada")
    with client(session) as one, client(session) as other:
        one.post("/api/queries/0/answer", json=answer("key-number-1", "first"))
        refused = other.post("/api/queries/0/answer", json=answer("key-number-2", "second"))
        assert refused.status_code == 409
        assert refused.json().items() >= {"error": "answered", "query": 0, "preference": "first"}.items()
        assert other.get("/api/state").json()["queue"]["answered"] == 1
    assert recorded(run) == [("answer", 0)]


def test_an_undo_opens_the_query_again_and_counts_once(browser: TestClient, run: Path) -> None:
    browser.post("/api/queries/2/answer", json=answer("key-number-1"))
    undone = browser.post("/api/queries/2/undo", json={"key": "key-number-2"})
    assert open_queries(undone) == [2, 0, 1]
    assert (undone.json()["queue"]["answered"], undone.json()["queue"]["last"]) == (0, None)
    again = browser.post("/api/queries/2/undo", json={"key": "key-number-2"})
    assert again.json()["duplicate"] is True
    refused = browser.post("/api/queries/2/undo", json={"key": "key-number-3"})
    assert (refused.status_code, refused.json()["error"]) == (409, "not_answered")
    browser.post("/api/queries/2/answer", json=answer("key-number-4", "second"))
    assert recorded(run) == [("answer", 2), ("undo", 2), ("answer", 2)]
    (stands,) = read_answers(run / "queries.jsonl").standing.values()
    assert stands.said == "second"


def test_an_answer_to_a_retired_query_counts(browser: TestClient, run: Path) -> None:
    assert browser.get("/api/queries/3").json()["state"] == "retired"
    assert browser.post("/api/queries/3/answer", json=answer("key-number-1")).status_code == 200
    assert browser.get("/api/queries/3").json()["state"] == "answered"
    assert recorded(run) == [("answer", 3)]


def test_a_stale_tab_after_a_restart_goes_on(run: Path) -> None:
    with client(LiveSession(run, "ada")) as tab:
        tab.post("/api/queries/0/answer", json=answer("key-number-1"))
        cookies = dict(tab.cookies)
    # Killed while it wrote a line.
    with (run / "queries.jsonl").open("ab") as file:
        file.write(b'{"version": 1, "rec')
    with client(LiveSession(run, "ada"), enter=False) as tab:
        tab.cookies.update(cookies)
        assert tab.get("/api/state").json()["queue"]["answered"] == 1
        repeated = tab.post("/api/queries/0/answer", json=answer("key-number-1"))
        assert repeated.json()["duplicate"] is True
        assert tab.post("/api/queries/1/answer", json=answer("key-number-2")).status_code == 200
    assert recorded(run) == [("answer", 0), ("answer", 1)]


def test_nothing_is_taken_after_the_end(browser: TestClient, run: Path) -> None:
    set_phase(run, "finished")
    refused = browser.post("/api/queries/0/answer", json=answer("key-number-1"))
    assert (refused.status_code, refused.json()["error"]) == (409, "finished")
    assert not (run / "queries.jsonl").exists()


def test_a_full_disk_records_nothing_and_the_answer_can_be_sent_again(browser: TestClient, run: Path) -> None:
    with full_disk(0):
        refused = browser.post("/api/queries/0/answer", json=answer("key-number-1"))
    assert (refused.status_code, refused.json()["error"]) == (503, "storage")
    assert browser.get("/api/state").json()["queue"]["answered"] == 0
    assert browser.post("/api/queries/0/answer", json=answer("key-number-1")).status_code == 200
    assert recorded(run) == [("answer", 0)]


def test_a_stop_is_asked_for_once(browser: TestClient, run: Path) -> None:
    assert [browser.post("/api/stop", json={}).json() for _ in range(2)] == [{"stopping": True}] * 2
    assert (run / "live" / "stop.json").exists()
    assert browser.get("/api/state").json()["queue"]["stopping"] is True


def test_a_notice_comes_before_the_first_answer(run: Path) -> None:
    session = LiveSession(run, "ada", "I take part freely.")
    with client(session) as browser:
        expected = {"text": "I take part freely.", "given": False}
        assert browser.get("/api/state").json()["consent"] == expected
        refused = browser.post("/api/queries/0/answer", json=answer("key-number-1"))
        assert (refused.status_code, refused.json()["error"]) == (403, "consent")
        for key in ("key-number-2", "key-number-3"):
            assert browser.post("/api/consent", json={"key": key}).json() == {"given": True}
        assert browser.post("/api/queries/0/answer", json=answer("key-number-1")).status_code == 200
    assert [line["record"] for line in read_lines(run / "queries.jsonl")] == ["consent", "answer"]
    # Another text is another notice.
    assert LiveSession(run, "ada", "Something else.").consent == {"text": "Something else.", "given": False}


def test_one_process_at_a_time_takes_answers(run: Path) -> None:
    with (
        hold_session(run),
        pytest.raises(StorageError, match="has a live session already"),
        hold_session(run),
    ):
        pass


def test_events_begin_with_the_state(run: Path) -> None:
    session = LiveSession(run, "ada")
    feed = Feed({"version": 1}, {"queue": session.queue, "status": session.status})

    async def listen() -> list[str]:
        listening = feed.listen()
        events = [await anext(listening)]
        # What changes before the first look is told as well.
        session.answer(0, "first", 1.0, "key-number-1")
        watching = asyncio.create_task(feed.watch())
        events += [await anext(listening), await anext(listening)]
        set_phase(run, "closing")
        events.append(await anext(listening))
        watching.cancel()
        await listening.aclose()  # type: ignore[attr-defined]
        return events

    state, queue, before, status = asyncio.run(listen())
    assert state.startswith("event: state\ndata: ")
    assert json.loads(state.splitlines()[1][6:])["queue"]["answered"] == 0
    assert queue.startswith("event: queue\n")
    assert json.loads(queue.splitlines()[1][6:])["answered"] == 1
    for event, phase in ((before, "training"), (status, "closing")):
        assert event.startswith("event: status\n")
        assert json.loads(event.splitlines()[1][6:])["phase"] == phase


def test_what_is_told_of_the_queue_is_in_order(run: Path) -> None:
    session = LiveSession(run, "ada")
    first, same = session.queue(), session.queue()
    after = session.answer(0, "first", 1.0, "key-number-1")["queue"]
    back = session.undo(0, "key-number-2")["queue"]
    assert same == first
    assert first["revision"] < after["revision"] < back["revision"]
    assert first["session"] == after["session"] != LiveSession(run, "ada").queue()["session"]


# Who may ask.


def test_nothing_is_served_without_the_token(run: Path) -> None:
    with client(LiveSession(run, "ada"), enter=False) as stranger:
        for path in ("/static/page.js", "/static/index.html", "/api/state", "/api/events", "/nowhere"):
            refused = stranger.get(path)
            assert (refused.status_code, refused.json()["error"]) == (401, "token"), path
        assert stranger.post("/api/stop", json={}).status_code == 401
        assert stranger.get("/", params={"token": "wrong"}).status_code == 401
        assert stranger.get("/", params={"token": "wröng"}).status_code == 401
        stranger.cookies["moral_8765"] = "wrong"
        assert stranger.get("/api/state").status_code == 401
    assert not (run / "live" / "stop.json").exists()


@pytest.mark.parametrize("query", [{}, {"token": "wrong"}, {"token": ""}])
def test_who_comes_without_the_link_is_told_what_to_do(run: Path, query: dict[str, str]) -> None:
    with client(LiveSession(run, "ada"), enter=False) as stranger:
        refused = stranger.get("/", params=query)
        assert (refused.status_code, refused.headers["content-type"]) == (401, "text/html; charset=utf-8")
        assert "link that the terminal shows" in refused.text
        assert not any(secret in refused.text for secret in (TOKEN, str(run), "ada", "8765"))
        assert "set-cookie" not in refused.headers
        # Nothing but its own style sheet and icon is needed to show it, and nothing else is to be had.
        links = re.findall(r'(?:href|src)="([^"]+)"', refused.text)
        assert set(links) == {"static/page.css", "static/icon.svg"}
        assert {stranger.get(f"/{link}").status_code for link in links} == {200}
        assert stranger.post("/", json={}).json()["error"] == "token"


def test_the_link_sets_a_cookie_that_no_script_and_no_other_site_can_use(run: Path) -> None:
    with client(LiveSession(run, "ada"), enter=False) as browser:
        response = browser.get("/", params={"token": TOKEN})
        assert (response.status_code, response.headers["location"]) == (303, "/")
        cookie = response.headers["set-cookie"].lower()
        assert cookie.startswith("moral_8765=")
        assert "httponly" in cookie
        assert "samesite=strict" in cookie


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8765", "127.0.0.1:8766", "127.0.0.1", "", "localhost.evil.example:8765"],
)
def test_a_foreign_host_is_refused(browser: TestClient, host: str) -> None:
    refused = browser.get("/api/state", headers={"host": host})
    assert (refused.status_code, refused.json()["error"]) == (421, "host")


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://" + HOST + ".evil"]
)
def test_a_foreign_origin_is_refused(browser: TestClient, run: Path, origin: str) -> None:
    refused = browser.post("/api/queries/0/answer", json=answer("key-number-1"), headers={"origin": origin})
    assert (refused.status_code, refused.json()["error"]) == (403, "origin")
    assert not (run / "queries.jsonl").exists()
    own = {"origin": f"http://{HOST}"}
    assert browser.post("/api/queries/0/answer", json=answer("key-number-1"), headers=own).status_code == 200


def test_bodies_are_small_and_json(browser: TestClient) -> None:
    path = "/api/queries/0/answer"
    large = browser.post(path, content=b"x" * (MAX_BODY + 1), headers={"content-type": "application/json"})
    assert (large.status_code, large.json()["error"]) == (413, "large")
    form = browser.post(path, data={"preference": "first"})
    assert (form.status_code, form.json()["error"]) == (415, "type")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"[]",
        b"{",
        b"[" * 4000,
        b'{"preference": "first", "seconds": NaN, "key": "key-number-1"}',
        b'{"preference": "first", "seconds": 1e999, "key": "key-number-1"}',
        b'{"preference": "first", "seconds": -1, "key": "key-number-1"}',
        b'{"preference": "first", "seconds": true, "key": "key-number-1"}',
        b'{"preference": "both", "seconds": 1, "key": "key-number-1"}',
        b'{"preference": "first", "seconds": 1, "key": "short"}',
        b'{"preference": "first", "seconds": 1, "key": "key number 1"}',
        b'{"preference": "first", "seconds": 1}',
        b'{"preference": "first", "seconds": 1, "key": "key-number-1", "who": "eve"}',
    ],
)
def test_a_malformed_answer_is_refused(browser: TestClient, run: Path, body: bytes) -> None:
    refused = browser.post(
        "/api/queries/0/answer", content=body, headers={"content-type": "application/json"}
    )
    assert (refused.status_code, refused.json()["error"]) == (400, "malformed")
    assert not (run / "queries.jsonl").exists()


@pytest.mark.parametrize(
    "path",
    [
        "/static/../server.py",
        "/static/..%2fserver.py",
        "/static/%2e%2e/%2e%2e/answers.py",
        "/static//etc/passwd",
        "/static/__init__.py",
        "/static/",
        "/api/queries/77",
        "/api/queries/-1",
        "/api/queries/..%2fopen",
        "/api/queries/" + "9" * 5000,
        "/config.json",
        "/api/plays/x",
    ],
)
def test_nothing_else_is_served(browser: TestClient, path: str) -> None:
    refused = browser.get(path)
    assert (refused.status_code, refused.json()["error"]) == (404, "unknown")


def test_methods_are_those_of_the_protocol(browser: TestClient) -> None:
    for method, path in (("POST", "/api/state"), ("DELETE", "/api/queries/0"), ("GET", "/api/stop")):
        headers = {"content-type": "application/json"}
        refused = browser.request(method, path, headers=headers)
        assert (refused.status_code, refused.json()["error"]) == (405, "method")


@pytest.mark.parametrize("enter", [True, False])
def test_every_response_forbids_what_comes_from_elsewhere(run: Path, enter: bool) -> None:
    with client(LiveSession(run, "ada"), enter=enter) as browser:
        responses = [browser.get(path) for path in ("/", "/api/state", "/nowhere")]
    for headers in (response.headers for response in responses):
        assert headers["cache-control"] == "no-store"
        assert "default-src 'self'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
