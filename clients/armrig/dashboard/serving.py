"""The server: its sockets, its threads, its end."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import uvicorn
from starlette.routing import Route

from armrig.dashboard.app import RigRoutes, application
from armrig.dashboard.connections import Connections
from armrig.dashboard.driver import Driver
from armrig.dashboard.feed import Feed
from armrig.dashboard.guard import Guard
from armrig.dashboard.listener import Listener
from armrig.dashboard.recording_routes import RecordingRoutes
from armrig.dashboard.share import PORT as SHARED_PORT
from armrig.dashboard.share import Certificate, certificate
from armrig.dashboard.stream import Stream
from armrig.rig.session import RigError

HOST = "127.0.0.1"
PORT = 8807
_FILES = 16_384
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
    share: str | None = None
    """Address of this machine at which who has the other token may watch and stop."""
    share_port: int | None = None
    """There; 8808 where it is left out, or a free one if that is taken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """Where a dashboard is."""

    url: str
    """Of the page, with the token that may command."""
    shared_url: str = ""
    """For visitors, with the token that may watch and stop."""
    fingerprint: str = ""
    """SHA-256 of the certificate there."""


@contextmanager
def dashboard(settings: Settings) -> Iterator[Served]:
    """Serve a dashboard until the block ends; a run of its own is then stopped.

    Raises
    ------
    RigError
        The port is taken.
    MissingPackageError
        It is to be shared, and what makes certificates is not installed.
    """
    _allow_many_files()
    feed = Feed()
    driver = Driver(rig=settings.rig, connect=settings.connect)
    stream = Stream(feed, driver)
    live, recorded = RigRoutes(feed, driver, stream), RecordingRoutes(feed, settings.rig)
    listener = Listener(
        feed, rig=settings.rig, connect=settings.connect, found=driver.be_ready_to_stop
    )
    with ExitStack() as open_files:
        own = _Door(_listening(HOST, PORT, settings.port), names=(HOST, "localhost"))
        servers = [own.server([*live.commanding(), *recorded.routes()], live, may_command=True)]
        served = Served(url=own.url)
        if settings.share is not None:
            made = open_files.enter_context(certificate(settings.share))
            taken = _listening(settings.share, SHARED_PORT, settings.share_port)
            door = _Door(taken, names=(settings.share,), certificate=made)
            servers.append(door.server([], live, may_command=False))
            served = replace(served, shared_url=door.url, fingerprint=made.fingerprint)
        thread = _ServerThread(servers, stream)
        listener.start()
        try:
            thread.begin()
            yield served
        finally:
            driver.end()
            recorded.end()
            thread.end()
            listener.end()


class _Door:
    """A socket, the names by which it is reached, and the token that opens it."""

    def __init__(
        self,
        listening: socket.socket,
        *,
        names: tuple[str, ...],
        certificate: Certificate | None = None,
    ) -> None:
        self._listening, self._certificate = listening, certificate
        self._token = secrets.token_urlsafe(24)
        scheme, port = "https" if certificate else "http", listening.getsockname()[1]
        self._origins = [f"{scheme}://{name}:{port}" for name in names]

    @property
    def url(self) -> str:
        """Where the page is; the token stands behind the #, which no browser sends."""
        return f"{self._origins[0]}/#token={self._token}"

    def server(self, more: list[Route], live: RigRoutes, *, may_command: bool) -> _Server:
        """Return the server of who may watch and stop, and of `more`."""
        connections = Connections()
        app = application([*live.watching(connections, may_command=may_command), *more])
        guard = Guard(app, origins=self._origins, token=self._token)
        config = uvicorn.Config(guard, http=connections.protocol(), **_QUIET)
        if self._certificate is not None:
            config.ssl_certfile = str(self._certificate.certificate)
            config.ssl_keyfile = str(self._certificate.key)
        return _Server(config, self._listening)


def _allow_many_files() -> None:
    """Have more files than connections: else those would leave none for a stop."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _FILES if hard == resource.RLIM_INFINITY else min(_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


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


def _listening(host: str, usual: int, port: int | None) -> socket.socket:
    """Return a socket that listens at an address."""
    for tried in (usual, 0) if port is None else (port,):
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, tried))
        except OSError as err:
            listening.close()
            if port is None and tried:
                continue
            msg = f"port {tried} of {host}: {err.strerror}; take another --port"
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
