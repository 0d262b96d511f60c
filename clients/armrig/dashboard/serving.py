"""The server: its sockets, its threads, its end."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import uvicorn

from armrig.dashboard.app import RigRoutes, application
from armrig.dashboard.connections import Connections
from armrig.dashboard.driver import Driver
from armrig.dashboard.feed import Feed
from armrig.dashboard.guard import Guard
from armrig.dashboard.listener import Listener
from armrig.dashboard.recording_routes import RecordingRoutes
from armrig.dashboard.stream import Stream
from armrig.rig.session import RigError

HOST = "127.0.0.1"
PORT = 8807
_START_S = 20.0
_ENDS_S = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What a dashboard is of, and where it is."""

    rig: str = "1"
    """Id of the rig."""
    connect: str | None = None
    """Endpoint of its daemon; found as by `armrig.Rig` where it is left out."""
    port: int | None = None
    """On 127.0.0.1; 8807 where it is left out, or a free one if that is taken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """Where a dashboard is."""

    url: str
    """Of the page, with the token that may command."""


@contextmanager
def dashboard(settings: Settings) -> Iterator[Served]:
    """Serve a dashboard until the block ends; a run of its own is then stopped.

    Raises
    ------
    RigError
        The port is taken.
    """
    listening = _listening(settings.port)
    port, token = listening.getsockname()[1], secrets.token_urlsafe(24)
    feed = Feed()
    driver = Driver(rig=settings.rig, connect=settings.connect)
    stream = Stream(feed, driver)
    routes = RigRoutes(feed, driver, stream)
    recordings = RecordingRoutes(feed, settings.rig)
    connections = Connections()
    app = Guard(
        application(
            [
                *routes.watching(connections, may_command=True),
                *routes.commanding(),
                *recordings.routes(),
            ]
        ),
        origins=[f"http://{host}:{port}" for host in (HOST, "localhost")],
        token=token,
    )
    server = _Server(uvicorn.Config(app, http=connections.protocol(), **_QUIET), listening)
    listener = Listener(
        feed, rig=settings.rig, connect=settings.connect, found=driver.be_ready_to_stop
    )
    listener.start()
    thread = _ServerThread([server], stream)
    try:
        thread.begin()
        yield Served(url=f"http://{HOST}:{port}/#token={token}")
    finally:
        driver.end()
        recordings.end()
        thread.end()
        listener.end()


_QUIET: dict[str, Any] = {
    "log_config": None,
    "access_log": False,
    "lifespan": "off",
    "ws": "none",
    "server_header": False,
    "date_header": False,
    "proxy_headers": False,
    "timeout_graceful_shutdown": _ENDS_S,
    "timeout_keep_alive": 30,
    "h11_max_incomplete_event_size": 16_384,
}


def _listening(port: int | None) -> socket.socket:
    """Return a socket that listens on the loopback."""
    for tried in (PORT, 0) if port is None else (port,):
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, tried))
        except OSError as err:
            listening.close()
            if port is None and tried:
                continue
            msg = f"port {tried}: {err.strerror}; take another --port"
            raise RigError(msg) from err
        return listening
    raise AssertionError


class _Server(uvicorn.Server):
    """uvicorn's server, which leaves the signals to who calls."""

    def __init__(self, config: uvicorn.Config, listening: socket.socket) -> None:
        super().__init__(config)
        self._listening = listening

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none: the command line ends us."""
        yield

    async def run_here(self) -> None:
        """Serve until `should_exit`."""
        await self.serve([self._listening])


class _ServerThread:
    """The loop of all servers, in a thread: the caller's may wait for a terminal."""

    def __init__(self, servers: list[_Server], stream: Stream) -> None:
        self._servers, self._stream = servers, stream
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)

    def begin(self) -> None:
        """Begin, and wait until it listens."""
        self._thread.start()
        pause = threading.Event()
        for _ in range(int(_START_S / 0.01)):
            if all(s.started for s in self._servers):
                return
            pause.wait(0.01)
        msg = "the server does not start"
        raise RigError(msg)

    def end(self) -> None:
        """End, and wait for it."""
        for server in self._servers:
            server.should_exit = True
        self._thread.join(_ENDS_S + 5.0)

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        filling = asyncio.create_task(self._stream.fill())
        ending = asyncio.create_task(self._end_streams())
        try:
            await asyncio.gather(*(s.run_here() for s in self._servers))
        finally:
            for task in (filling, ending):
                task.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await task

    async def _end_streams(self) -> None:
        """End the streams as soon as a server is to end, which waits for them."""
        while not any(s.should_exit for s in self._servers):
            await asyncio.sleep(0.05)
        self._stream.viewers.end()
