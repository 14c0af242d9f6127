"""A server in place of `moral live`: it speaks the protocol, and the tests say what goes on behind it."""

from __future__ import annotations

import json
import queue
import re
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

import numpy as np

from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import ACTION_NAMES, World

Json = dict[str, Any]

POLICY = (
    "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
_STATIC = files("moral_algorithms.live") / "static"
_SILENCE = 0.2
_MOVES = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])


def describe_world(world: World) -> Json:
    """The protocol's WORLD."""
    fixture = world.fixture
    return {
        "name": world.name,
        "height": world.height,
        "width": world.width,
        "horizon": world.horizon,
        "actions": list(ACTION_NAMES),
        "kinds": [{"name": k.name, "pattern": k.pattern, "symbol": k.symbol} for k in world.objects],
        "fixture": fixture and {"name": fixture.name, "pattern": fixture.pattern, "symbol": fixture.symbol},
        "objectives": list(world.objective_names),
    }


class Game:
    """One episode, step by step, and what the protocol says of it."""

    def __init__(self, world: World, seed: int) -> None:
        self.world = world
        self.engine = Engine(world, 1)
        self.engine.seed(spawn_streams(seed, 1))
        self.engine.reset()
        self.agent = [self.cell]
        self.actions: list[int] = []
        self.counters = [self.engine.objectives[0, 0].tolist()]
        self.events: list[Json] = []
        self.things = [{**thing, "from": 0, "gone": None} for thing in self.present]

    @property
    def cell(self) -> list[int]:
        cell: list[int] = self.engine.agent_cells[0, 0].tolist()
        return cell

    @property
    def present(self) -> list[Json]:
        planes = self.engine.world_planes()[0, 2:]
        return [
            {"kind": kind.name, "cell": cell}
            for kind, plane in zip(self.world.objects, planes, strict=False)
            for cell in np.argwhere(plane).tolist()
        ]

    @property
    def walls(self) -> list[str]:
        return ["".join(map(str, row)) for row in self.engine.world_planes()[0, 0].tolist()]

    @property
    def fixture(self) -> list[int] | None:
        if self.world.fixture is None:
            return None
        cell: list[int] = np.argwhere(self.engine.world_planes()[0, -1])[0].tolist()
        return cell

    @property
    def step(self) -> int:
        return len(self.actions)

    @property
    def over(self) -> bool:
        return self.step == self.world.horizon

    def act(self, action: int) -> None:
        self.engine.step(np.array([action]))
        self.actions.append(action)
        self.agent.append(self.cell)
        row = self.engine.objectives[0, 0].tolist()
        present = self.present
        place = self.cell
        for thing in self.things:
            if thing["gone"] is None and {"kind": thing["kind"], "cell": thing["cell"]} not in present:
                thing["gone"] = self.step
                place = thing["cell"]
        for name, before, after in zip(self.world.objective_names, self.counters[-1], row, strict=True):
            if after > before:
                stands = self.world.fixture is not None and name == self.world.fixture.on_stand.objective
                cell = self.cell if stands else place
                self.events.append({"step": self.step, "objective": name, "cell": cell})
        self.counters.append(row)

    def wander(self, wanted: Sequence[str], then_wait: bool = True) -> None:
        """Go to the nearest of the wanted kinds, act on it, go on; at last to the fixture."""
        while not self.over:
            targets = [thing["cell"] for thing in self.present if thing["kind"] in wanted]
            home = targets == []
            if home and self.fixture is not None:
                targets = [self.fixture]
            if not targets:
                self.act(4)
                continue
            offsets = np.array(targets) - self.cell
            near = offsets[np.abs(offsets).sum(axis=1).argmin()]
            if not near.any():
                self.act(4 if home and then_wait else 0)
            elif not home and np.abs(near).sum() == 1:
                self.act(5 + int((near == _MOVES).all(axis=1).argmax()))
            else:
                axis = int(np.abs(near).argmax())
                self.act(2 * axis + int(near[axis] > 0))

    def episode(self, hidden: bool = False) -> Json:
        """The protocol's EPISODE; hidden, as in the review of a demonstration."""
        return {
            "steps": self.step,
            "walls": self.walls,
            "fixture": self.fixture,
            "agent": self.agent,
            "actions": self.actions,
            "things": self.things,
            "events": [] if hidden else self.events,
            "counters": [] if hidden else self.counters,
        }

    def play(self, name: str) -> Json:
        """The protocol's PLAY."""
        return {
            "play": name,
            "step": self.step,
            "horizon": self.world.horizon,
            "over": self.over,
            "walls": self.walls,
            "fixture": self.fixture,
            "agent": self.cell,
            "things": self.present,
        }


def wandered(world: World, seed: int, wanted: Sequence[str]) -> Json:
    """The EPISODE of an agent that goes for some kinds of things: each is played once, and copied."""
    episode: Json = json.loads(_wander(world, seed, tuple(wanted)))
    return episode


@cache
def _wander(world: World, seed: int, wanted: tuple[str, ...]) -> str:
    game = Game(world, seed)
    game.wander(wanted)
    return json.dumps(game.episode())


class StandIn:
    """What the server says, and what it was told.

    Attributes
    ----------
    state
        The protocol's State; change it with :meth:`change`, which tells the pages.
    queries
        Episodes of each query, by number.
    answers
        What was posted and recorded, in order: the query's number and the body.
    stopped
        Whether a page asked to stop.
    refuse
        Status and code with which the next answer is refused.
    lose_reply
        Whether the reply to the next POST is lost on its way, after it was carried out.
    foreign
        Whether the page's token is that of another session.
    down
        Whether connections are refused, as while a server restarts.
    streams
        How many streams of events pages have begun.
    """

    def __init__(self, state: Json, queries: dict[int, list[Json]]) -> None:
        self.state = state
        self.queries = queries
        self.answers: list[tuple[int, Json]] = []
        self.standing: dict[int, str] = {}
        self.undone: list[int] = []
        self.keys: set[str] = set()
        self.stopped = False
        self.refuse: tuple[int, str] | None = None
        self.lose_reply = False
        self.late_reply: threading.Event | None = None
        self.foreign = False
        self.down = False
        self.streams = 0
        self.latest: Json | None = None
        self.games: dict[str, Game] = {}
        self.kept: list[Json] = []
        self.world: World | None = None
        self._listeners: list[queue.Queue[tuple[str, Any] | None]] = []
        self._lock = threading.Lock()
        self._revision = 0

    def change(self, **fields: Any) -> None:
        """Change fields of the state and send them."""
        with self._lock:
            if "queue" in fields:
                self._revision += 1
                fields["queue"] = {**fields["queue"], "session": "stand-in", "revision": self._revision}
            self.state.update(fields)
            for name, value in fields.items():
                for listener in self._listeners:
                    listener.put((name, value))

    def hang_up(self, down: bool) -> None:
        """Break all streams; while it is down, refuse new connections."""
        self.down = down
        with self._lock:
            for listener in self._listeners:
                listener.put(None)

    def events(self) -> Iterator[bytes]:
        """The stream of one page."""
        mine: queue.Queue[tuple[str, Any] | None] = queue.Queue()
        with self._lock:
            mine.put(("state", dict(self.state)))
            self._listeners.append(mine)
            self.streams += 1
        try:
            while True:
                try:
                    event = mine.get(timeout=_SILENCE)
                except queue.Empty:
                    yield b": still here\n\n"
                    continue
                if event is None:
                    return
                name, value = event
                yield f"event: {name}\ndata: {json.dumps(value)}\n\n".encode()
        finally:
            self._listeners.remove(mine)

    def get(self, path: str) -> tuple[int, Json]:
        """Answer a GET."""
        if path == "/api/state":
            return 200, self.state
        if path == "/api/episode":
            if self.latest is None:
                return 404, {"error": "unknown", "detail": "There is no episode yet."}
            return 200, {"env_steps": 256_000, "episode": self.latest}
        if match := re.fullmatch(r"/api/queries/(\d+)", path):
            return self._query(int(match[1]))
        if match := re.fullmatch(r"/api/plays/(\w+)(/episode)?", path):
            game = self.games.get(match[1])
            if game is None:
                return 404, {"error": "unknown", "detail": "There is no such play."}
            return 200, game.episode(hidden=True) if match[2] else game.play(match[1])
        return 404, {"error": "unknown", "detail": f"There is no {path}."}

    def _query(self, number: int) -> tuple[int, Json]:
        if number not in self.queries:
            return 404, {"error": "unknown", "detail": f"There is no query {number}."}
        is_open = any(entry["query"] == number for entry in self.state["queue"]["open"])
        answered = number in self.standing
        return 200, {
            "query": number,
            "posterior": 12,
            "expected": 0.04,
            "state": "answered" if answered else "open" if is_open else "retired",
            "episodes": self.queries[number],
        }

    def post(self, path: str, body: Json) -> tuple[int, Json]:
        """Answer a POST."""
        if match := re.fullmatch(r"/api/queries/(\d+)/(answer|undo)", path):
            return self._answer(int(match[1]), body, undo=match[2] == "undo")
        if path == "/api/stop":
            self.stopped = True
            self.change(status={**self.state["status"], "phase": "closing"})
            return 200, {"stopping": True}
        if path == "/api/consent":
            self.change(consent={**self.state["consent"], "given": True})
            return 200, {"given": True}
        if path == "/api/plays":
            assert self.world is not None
            name = f"play{len(self.games)}"
            self.games[name] = Game(self.world, len(self.games))
            return 200, self.games[name].play(name)
        if match := re.fullmatch(r"/api/plays/(\w+)/(step|keep|discard)", path):
            return self._play(match[1], match[2], body)
        return 404, {"error": "unknown", "detail": f"There is no {path}."}

    def _answer(self, number: int, body: Json, undo: bool) -> tuple[int, Json]:
        if self.refuse is not None:
            (status, code), self.refuse = self.refuse, None
            return status, {"error": code, "detail": f"It is refused: {code}."}
        duplicate = body["key"] in self.keys
        if not duplicate and not undo and number in self.standing:
            return 409, {"error": "answered", "detail": "It has an answer.", "query": number}
        if not duplicate:
            self.keys.add(body["key"])
            if undo:
                del self.standing[number]
                self.undone.append(number)
            else:
                self.standing[number] = body["preference"]
                self.answers.append((number, body))
            self._requeue(number, undo)
        return 200, {"recorded": True, "duplicate": duplicate, "queue": self.state["queue"]}

    def _requeue(self, number: int, undo: bool) -> None:
        last = next(reversed(self.standing), None)
        before = self.state["queue"]
        still = [entry for entry in before["open"] if entry["query"] != number]
        self.change(
            queue={
                "open": [{"query": number, "expected": 0.04}, *still] if undo else still,
                "answered": before["answered"] + (-1 if undo else 1),
                "queries": before["queries"],
                "last": None if last is None else {"query": last, "preference": self.standing[last]},
            }
        )

    def _play(self, name: str, verb: str, body: Json) -> tuple[int, Json]:
        game = self.games.get(name)
        if game is None:
            return 404, {"error": "unknown", "detail": "There is no such play."}
        if verb == "step":
            if body["step"] != game.step:
                return 409, {"error": "step", "detail": "Not the next step.", "play": game.play(name)}
            game.act(body["action"])
            return 200, game.play(name)
        del self.games[name]
        self.games[f"{name}gone"] = game
        if verb == "keep":
            self.kept.append(game.episode())
            demonstrations = {**self.state["demonstrations"], "kept": len(self.kept)}
            self.change(demonstrations=demonstrations)
        return 200, {"kept": len(self.kept), "duplicate": False}


@contextmanager
def serving(stand_in: StandIn) -> Iterator[str]:
    """Serve it, and yield the page's address."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            if stand_in.down:
                self.close_connection = True
            elif stand_in.foreign and self.path.startswith("/api"):
                self._reply(401, {"error": "token", "detail": "Another session."})
            elif self.path == "/api/events":
                self._stream()
            elif self.path.startswith("/api/"):
                self._reply(*stand_in.get(self.path))
            else:
                self._file("index.html" if self.path == "/" else self.path.removeprefix("/static/"))

        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            if stand_in.down:
                self.close_connection = True
                return
            reply = stand_in.post(self.path, body)
            if stand_in.lose_reply:
                stand_in.lose_reply = False
                self.close_connection = True
                stand_in.hang_up(down=False)
            else:
                if stand_in.late_reply is not None:
                    stand_in.late_reply.wait()
                self._reply(*reply)

        def _file(self, name: str) -> None:
            content = (_STATIC / name).read_bytes()
            self._send(200, f"{_TYPES[name.rsplit('.')[-1]]}; charset=utf-8", content)

        def _reply(self, status: int, body: Json) -> None:
            self._send(status, "application/json", json.dumps(body).encode())

        def _send(self, status: int, kind: str, content: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Security-Policy", POLICY)
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def _stream(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Connection", "close")
            self.end_headers()
            self.close_connection = True
            try:
                for part in stand_in.events():
                    self.wfile.write(part)
            except OSError:
                return  # The page has gone.

        def log_message(self, *arguments: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        stand_in.hang_up(down=True)
        server.shutdown()
        thread.join()
        server.server_close()
