"""Starting and ending a live session: the training process, the server and the link to it."""

from __future__ import annotations

import contextlib
import importlib
import os
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from moral_algorithms.storage import StorageError, has_fields, read_json, write_json

if TYPE_CHECKING:
    from starlette.applications import Starlette

DEFAULT_PORT = 8765
"""Where the server listens if it is told nothing and the port is free."""

_VERSION = 1
# Seconds that training gets to end by itself.
_GRACE = 10.0


@dataclass(frozen=True)
class Serving:
    """Where and to whom the page is served."""

    host: str = "127.0.0.1"
    """Address that the server listens on; only this machine reaches the default."""
    port: int | None = None
    """Port; without it the one of the session that is resumed, or 8765, or a free one."""
    allow_host: tuple[str, ...] = ()
    """Further names, as HOST or HOST:PORT, under which browsers may reach the server."""

    def __post_init__(self) -> None:
        if self.port is not None and not 0 <= self.port < 2**16:
            raise ValueError(f"port is {self.port}; it must be 0 to 65535")

    def hosts(self, port: int) -> frozenset[str]:
        """Known values of the Host header."""
        own = ("127.0.0.1", "localhost", "[::1]", self.host)
        named = (host if ":" in host.rpartition("]")[2] else f"{host}:{port}" for host in self.allow_host)
        return frozenset((*(f"{name}:{port}" for name in own), *named))


class Training:
    """A training process, which ends with this one however that happens.

    Parameters
    ----------
    run
        The run directory, prepared.
    """

    def __init__(self, run: Path) -> None:
        command = [sys.executable, "-m", "moral_algorithms.live.training", str(run)]
        try:
            # A session of its own, so that Ctrl-C reaches this process alone, which then ends it in order.
            with (run / "live" / "training.log").open("ab") as log:
                self._process = subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=log,
                    start_new_session=True,
                )
        except OSError as error:
            raise StorageError(f"cannot start training: {error.strerror}") from error
        self.log = run / "live" / "training.log"

    def state(self) -> str:
        """Tell whether it is running, has stopped at its end, or has failed."""
        status = self._process.poll()
        return "running" if status is None else "stopped" if status == 0 else "failed"

    def wait(self) -> str:
        """Wait for its end; returns stopped or failed."""
        self._process.wait()
        return self.state()

    def failure(self) -> str:
        """Tell the last line of what it said, without what a command begins an error with."""
        with contextlib.suppress(OSError):
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            if lines:
                return lines[-1].removeprefix("moral: error: ")
        return "training ended without a word"

    def end(self) -> None:
        """End it, if it has not ended."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_GRACE)
        finally:
            # Also if Ctrl-C is pressed again meanwhile: what is then told of the run must stay true.
            self._process.kill()
            self._process.wait()


@contextmanager
def training(run: Path, announce: Callable[[str], None]) -> Iterator[Training]:
    """Train in another process until the block ends.

    Parameters
    ----------
    run
        The run directory, prepared.
    announce
        Told how it has ended, when it does so by itself.
    """
    process = Training(run)
    ending = threading.Event()

    def watch() -> None:
        state = process.wait()
        if not ending.is_set():
            stopped = f"Training has ended; the agent is in {run}"
            announce(stopped if state == "stopped" else f"Training has failed: {process.failure()}")

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield process
    finally:
        ending.set()
        process.end()
        watcher.join()


def require_web() -> None:
    """Raise a ValueError if what a server needs is not installed."""
    try:
        for name in ("starlette", "uvicorn"):
            importlib.import_module(name)
    except ImportError as error:
        raise ValueError("the page needs a server: pip install 'moral-algorithms[live]'") from error


def serve(
    folder: Path,
    serving: Serving,
    make_app: Callable[[str, int, frozenset[str]], Starlette],
    announce: Callable[[str], None],
) -> None:
    """Serve a page until interrupted.

    Parameters
    ----------
    folder
        Where token and port are kept, readable by their owner alone: a page that is open finds the server
        again after a restart.
    serving
        Where and to whom.
    make_app
        Makes the application from token, port and known hosts.
    announce
        Told the link, once the port is open.

    Raises
    ------
    StorageError
        If the token cannot be kept, or the port cannot be opened.
    KeyboardInterrupt
        When interrupted.
    """
    import uvicorn

    token, known_port = _read_access(folder)
    with contextlib.closing(_open_port(serving, known_port)) as listening:
        port = listening.getsockname()[1]
        _write_access(folder, token, port)
        app = make_app(token, port, serving.hosts(port))
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            date_header=False,
            ws="none",
            lifespan="on",
            timeout_graceful_shutdown=1,
        )

        class Server(uvicorn.Server):
            async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
                # It waits for what is still being sent, and pages hold their streams of events open for ever.
                app.state.feed.close()
                await super().shutdown(sockets)

        name = f"[{serving.host}]" if ":" in serving.host else serving.host
        announce(f"http://{name}:{port}/?token={token}")
        Server(config).run(sockets=[listening])


def require_open(serving: Serving) -> None:
    """Raise a StorageError if a page cannot be served where it is to be."""
    _open_port(serving, None).close()


def _open_port(serving: Serving, known: int | None) -> socket.socket:
    """Listen on the port that is asked for; where none is, on a likely one or else a free one."""
    if serving.port is not None:
        ports = [serving.port]
    else:
        ports = [*([] if known is None else [known]), DEFAULT_PORT, 0]
    family = socket.AF_INET6 if ":" in serving.host else socket.AF_INET
    for port in ports:
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((serving.host, port))
            listening.listen(128)
        except OSError as error:
            listening.close()
            if port == ports[-1]:
                raise StorageError(f"cannot listen on {serving.host}:{port}: {error.strerror}") from error
        else:
            return listening
    raise AssertionError("the last port ends the loop")


def _read_access(folder: Path) -> tuple[str, int | None]:
    path = folder / "access.json"
    if not path.exists():
        return secrets.token_urlsafe(24), None
    access = read_json(path)
    types = {"version": int, "token": str, "port": int}
    if not (has_fields(access, types) and access["version"] == _VERSION and 0 < access["port"] < 2**16):
        raise StorageError(f"{path} is damaged; remove it, and the session gets a new link")
    return access["token"], access["port"]


def _write_access(folder: Path, token: str, port: int) -> None:
    before = os.umask(0o077)
    try:
        write_json(folder / "access.json", {"version": _VERSION, "token": token, "port": port})
    finally:
        os.umask(before)
