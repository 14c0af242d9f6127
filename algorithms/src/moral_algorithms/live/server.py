"""The server of a live session: docs/live-protocol.md, on Starlette."""

from __future__ import annotations

import asyncio
import hmac
import json
import math
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from functools import partial
from importlib import resources
from typing import Any

from anyio import to_thread
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from moral_algorithms.live.frames import describe_world
from moral_algorithms.live.playing import Plays
from moral_algorithms.live.session import LiveSession, Refusal
from moral_algorithms.storage import StorageError

PROTOCOL_VERSION = 1

MAX_BODY = 4096
"""Bytes of a request's body."""

# Files of the package that the page for those without the token needs; they tell nothing of a session.
_OPEN_PATHS = ("/static/page.css", "/static/icon.svg")
# Seconds between two looks at the run directory, and between two signs of life.
_LOOK = 0.1
_HEARTBEAT = 5.0
# Ends a stream of events, in place of one.
_END = ""
_KEY = re.compile(r"[A-Za-z0-9_-]{8,64}")
_NUMBER = re.compile(r"[0-9]{1,9}")
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; "
        "form-action 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}

Handler = Callable[[Request], Awaitable[Response]]
Part = Callable[[], Any]


def make_app(
    token: str,
    port: int,
    hosts: frozenset[str],
    session: LiveSession | None = None,
    plays: Plays | None = None,
    trainer: Callable[[], str] | None = None,
) -> Starlette:
    """Make the application.

    Parameters
    ----------
    token
        What the link must have.
    port
        Where it listens; part of the cookie's name.
    hosts
        The values of the Host header under which it is known, ports included.
    session
        The questions; None in a session of demonstrations.
    plays
        The demonstrations; None in a session of questions.
    trainer
        Tells how the training process is.
    """
    world = session.world if session is not None else plays.world if plays is not None else None
    assert world is not None, "there are neither questions nor demonstrations"
    parts: dict[str, Part] = {"trainer": trainer or (lambda: None)}
    if session is not None:
        parts |= {
            "consent": lambda: session.consent,
            "status": session.status,
            "queue": session.queue,
            "curves": session.curves,
        }
    if plays is not None:
        parts["demonstrations"] = plays.describe
    constant = {
        "version": PROTOCOL_VERSION,
        "mode": "demonstrate" if session is None else "answer",
        "run": str(plays.out if session is None and plays is not None else session.run if session else ""),
        "who": session.who if session is not None else "",
        "names": None if session is None else session.names,
        "world": describe_world(world),
    }
    nothing = dict.fromkeys(("consent", "trainer", "status", "queue", "curves", "demonstrations"))
    feed = Feed({**constant, **nothing}, parts)
    routes = [
        Route("/", _page, methods=["GET"]),
        Route("/static/{name}", _static, methods=["GET"]),
        Route("/api/state", partial(_state, feed), methods=["GET"]),
        Route("/api/events", partial(_events, feed), methods=["GET"]),
    ]
    if session is not None:
        routes += _question_routes(session)
    if plays is not None:
        routes += _play_routes(plays)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(feed.watch())
        yield
        watching.cancel()
        with suppress(asyncio.CancelledError):
            await watching

    app = Starlette(
        routes=routes,
        middleware=[Middleware(Guard, token=token, cookie=f"moral_{port}", hosts=hosts)],
        exception_handlers={
            HTTPException: _plain_error,
            Refusal: _refused,
            StorageError: _not_stored,
        },
        lifespan=lifespan,
    )
    app.state.feed = feed
    # A path with a slash too many is another path, and unknown.
    app.router.redirect_slashes = False
    return app


class Guard:
    """Lets in only who has the token, under a known host and from a page of this server.

    Parameters
    ----------
    app
        What is guarded.
    token
        The token.
    cookie
        Name of the cookie that holds it.
    hosts
        Known values of the Host header.
    """

    def __init__(self, app: ASGIApp, token: str, cookie: str, hosts: frozenset[str]) -> None:
        self._app = app
        self._token = token
        self._cookie = cookie
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request and pass it on, or answer it with an error."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers[name] = value
            await send(message)

        request = Request(scope, receive)
        response = self._refuse(request)
        if response is None and request.method == "POST":
            body = await _read_body(request)
            if body is None:
                response = _error(413, "large", f"the body has more than {MAX_BODY} bytes")
            else:
                scope["state"] = {**scope.get("state", {}), "body": body}
        await (response or self._app)(scope, receive, send_with_headers)

    def _refuse(self, request: Request) -> Response | None:
        headers = Headers(scope=request.scope)
        if headers.getlist("host") != [host for host in headers.getlist("host")[:1] if host in self._hosts]:
            return _error(421, "host", "this server is not known under that name")
        if len(headers.getlist("host")) != 1:
            return _error(421, "host", "a request names one host")
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2] not in self._hosts:
            return _error(403, "origin", "the request comes from another site")
        offered = request.query_params.get("token")
        path = request.url.path if request.method == "GET" else ""
        if path == "/" and offered is not None:
            if not self._is_token(offered):
                return _asset("closed.html", 401)
            redirect = RedirectResponse("/", status_code=303)
            redirect.set_cookie(self._cookie, self._token, httponly=True, samesite="strict", path="/")
            return redirect
        if path not in _OPEN_PATHS and not self._is_token(request.cookies.get(self._cookie, "")):
            # A person opens the page, programs everything else.
            if path == "/":
                return _asset("closed.html", 401)
            return _error(401, "token", "open the link that was printed when the session started")
        if request.method == "POST":
            kind = headers.get("content-type", "").partition(";")[0].strip().lower()
            if kind != "application/json":
                return _error(415, "type", "the body must be application/json")
        return None

    def _is_token(self, offered: str) -> bool:
        return hmac.compare_digest(offered.encode("utf-8", "replace"), self._token.encode())


class Feed:
    """What the state holds, and who is told when it changes.

    Parameters
    ----------
    constant
        What never changes.
    parts
        Functions that find what changes, by name.
    """

    def __init__(self, constant: Mapping[str, Any], parts: Mapping[str, Part]) -> None:
        self._constant = constant
        self._parts = parts
        self._last: dict[str, str] = {}
        self._listeners: set[asyncio.Queue[str]] = set()

    def state(self) -> dict[str, Any]:
        """Find how everything stands now."""
        return {**self._constant, **{name: part() for name, part in self._parts.items()}}

    async def watch(self) -> None:
        """Tell listeners of changes until cancelled."""
        while True:
            if self._listeners:
                for event in await to_thread.run_sync(self._changes):
                    for listener in self._listeners:
                        # Who does not listen any more is dropped when its connection is.
                        with suppress(asyncio.QueueFull):
                            listener.put_nowait(event)
            await asyncio.sleep(_LOOK)

    def _changes(self) -> list[str]:
        events = []
        for name, part in self._parts.items():
            try:
                content = json.dumps(part())
            except StorageError:
                # Half a restart away from being readable again; the next look will tell.
                continue
            # The first look tells everything: the state that a listener has may be older.
            if self._last.get(name) != content:
                events.append(f"event: {name}\ndata: {content}\n\n")
                self._last[name] = content
        return events

    def close(self) -> None:
        """End what every listener hears."""
        for listener in self._listeners:
            with suppress(asyncio.QueueFull):
                listener.put_nowait(_END)

    async def listen(self) -> AsyncIterator[str]:
        """Yield the whole state and then every change, as server-sent events."""
        queue: asyncio.Queue[str] = asyncio.Queue(maxsize=1000)
        self._listeners.add(queue)
        try:
            yield f"event: state\ndata: {json.dumps(await to_thread.run_sync(self.state))}\n\n"
            while True:
                try:
                    event = await asyncio.wait_for(queue.get(), _HEARTBEAT)
                except asyncio.TimeoutError:
                    event = ": alive\n\n"
                if event == _END:
                    return
                yield event
        finally:
            self._listeners.discard(queue)


def _question_routes(session: LiveSession) -> list[Route]:
    async def query(request: Request) -> Response:
        return await _in_thread(session.query, _number(request))

    async def answer(request: Request) -> Response:
        fields = _fields(request, preference=str, seconds=float, key=str)
        seconds = fields["seconds"]
        if not (math.isfinite(seconds) and 0 <= seconds <= 86_400):
            raise _malformed("seconds must be 0 to 86400")
        return await _in_thread(
            session.answer, _number(request), fields["preference"], seconds, fields["key"]
        )

    async def undo(request: Request) -> Response:
        return await _in_thread(session.undo, _number(request), _fields(request, key=str)["key"])

    async def episode(request: Request) -> Response:
        return await _in_thread(session.episode)

    async def stop(request: Request) -> Response:
        _fields(request)
        return await _in_thread(session.stop)

    async def consent(request: Request) -> Response:
        return await _in_thread(session.accept, _fields(request, key=str)["key"])

    return [
        Route("/api/queries/{number}", query, methods=["GET"]),
        Route("/api/queries/{number}/answer", answer, methods=["POST"]),
        Route("/api/queries/{number}/undo", undo, methods=["POST"]),
        Route("/api/episode", episode, methods=["GET"]),
        Route("/api/stop", stop, methods=["POST"]),
        Route("/api/consent", consent, methods=["POST"]),
    ]


def _play_routes(plays: Plays) -> list[Route]:
    async def begin(request: Request) -> Response:
        _fields(request)
        return await _in_thread(plays.begin)

    async def look(request: Request) -> Response:
        return await _in_thread(plays.look, request.path_params["name"])

    async def step(request: Request) -> Response:
        fields = _fields(request, action=int, step=int)
        return await _in_thread(plays.step, request.path_params["name"], fields["action"], fields["step"])

    async def review(request: Request) -> Response:
        return await _in_thread(plays.review, request.path_params["name"])

    async def keep(request: Request) -> Response:
        _fields(request)
        return await _in_thread(plays.keep, request.path_params["name"])

    async def discard(request: Request) -> Response:
        _fields(request)
        return await _in_thread(plays.discard, request.path_params["name"])

    return [
        Route("/api/plays", begin, methods=["POST"]),
        Route("/api/plays/{name}", look, methods=["GET"]),
        Route("/api/plays/{name}/step", step, methods=["POST"]),
        Route("/api/plays/{name}/episode", review, methods=["GET"]),
        Route("/api/plays/{name}/keep", keep, methods=["POST"]),
        Route("/api/plays/{name}/discard", discard, methods=["POST"]),
    ]


async def _page(request: Request) -> Response:
    return _asset("index.html")


async def _static(request: Request) -> Response:
    return _asset(request.path_params["name"])


def _asset(name: str, status: int = 200) -> Response:
    """Serve one of the files that lie in the package's folder; nothing outside it has such a name."""
    folder = resources.files("moral_algorithms.live") / "static"
    found = {file.name: file for file in folder.iterdir() if file.is_file()} if folder.is_dir() else {}
    suffix = name[name.rfind(".") :]
    if name not in found or suffix not in _TYPES:
        raise Refusal(404, "unknown", "there is no such file")
    return Response(found[name].read_bytes(), status, media_type=_TYPES[suffix])


async def _state(feed: Feed, request: Request) -> Response:
    return await _in_thread(feed.state)


async def _events(feed: Feed, request: Request) -> Response:
    return StreamingResponse(feed.listen(), media_type="text/event-stream")


async def _in_thread(function: Callable[..., Any], *arguments: Any) -> Response:
    return JSONResponse(await to_thread.run_sync(partial(function, *arguments)))


async def _read_body(request: Request) -> bytes | None:
    """Read a body; None if it is too large."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BODY:
            return None
    return body


def _fields(request: Request, **kinds: type) -> dict[str, Any]:
    """Read a JSON object with exactly these fields; an integer will do for a float."""
    try:
        body = json.loads(request.state.body)
    except (ValueError, RecursionError) as error:
        raise _malformed("the body is not JSON") from error
    if not isinstance(body, dict):
        raise _malformed("the body must be an object")
    if body.keys() != kinds.keys():
        raise _malformed(f"the body must have exactly the fields {sorted(kinds)}")
    for name, kind in kinds.items():
        if kind is float and type(body[name]) is int and abs(body[name]) < 2**53:
            body[name] = float(body[name])
        if type(body[name]) is not kind:
            raise _malformed(f"{name} must be of type {kind.__name__}")
    if "key" in kinds and not _KEY.fullmatch(body["key"]):
        raise _malformed("key must be 8 to 64 of A-Z, a-z, 0-9, _ and -")
    return body


def _number(request: Request) -> int:
    """Read a query's number out of the path."""
    number = request.path_params["number"]
    if not _NUMBER.fullmatch(number):
        raise Refusal(404, "unknown", "there is no such query")
    return int(number)


def _malformed(detail: str) -> Refusal:
    return Refusal(400, "malformed", detail)


def _error(status: int, code: str, detail: str) -> Response:
    return JSONResponse({"error": code, "detail": detail}, status_code=status)


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, Refusal)
    return JSONResponse(error.body, status_code=error.status)


async def _not_stored(request: Request, error: Exception) -> Response:
    return _error(503, "storage", str(error))


async def _plain_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = {404: "unknown", 405: "method"}.get(error.status_code, "malformed")
    return JSONResponse(
        {"error": code, "detail": str(error.detail)}, status_code=error.status_code, headers=error.headers
    )
