"""A dashboard from its sockets to its end: who listens, who may what, what is begun and ended."""

from __future__ import annotations

import resource
import secrets
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

import uvicorn
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from armrig.dashboard.app import RigRoutes, application, value
from armrig.dashboard.connections import Connections
from armrig.dashboard.driver import Driver
from armrig.dashboard.feed import Feed
from armrig.dashboard.guard import Guard, Pass
from armrig.dashboard.listener import Listener
from armrig.dashboard.recording_routes import RecordingRoutes
from armrig.dashboard.server_thread import QUIET, Server, ServerThread
from armrig.dashboard.share import PORT as SHARED_PORT
from armrig.dashboard.share import Certificate, certificate
from armrig.dashboard.stream import Stream
from armrig.dashboard.viewers import Viewers
from armrig.rig.session import RigError

HOST = "127.0.0.1"
PORT = 8807
_FILES = 16_384
_ONCE_S = 60.0  # in which a browser is started


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
    browser_url: str
    """The same for the program that opens a browser: it opens the page once, within a minute."""
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
    audience: list[Viewers] = []
    recorded = RecordingRoutes(feed, settings.rig)
    listener = Listener(
        feed, rig=settings.rig, connect=settings.connect, found=driver.be_ready_to_stop
    )
    with ExitStack() as open_files:
        own = _Door(_listening(HOST, PORT, settings.port), names=(HOST, "localhost"))
        stream = Stream(feed, driver, audience, may_command=True)
        live = RigRoutes(feed, driver, stream)
        threads = [own.served([*live.commanding(), *recorded.routes()], live, stream)]
        served = Served(url=own.url, browser_url=own.browser_url)
        if settings.share is not None:
            made = open_files.enter_context(certificate(settings.share))
            taken = _listening(settings.share, SHARED_PORT, settings.share_port)
            door = _Door(taken, names=(settings.share,), certificate=made)
            stream = Stream(feed, driver, audience, may_command=False)
            threads.append(door.served([], RigRoutes(feed, driver, stream), stream))
            served = replace(served, shared_url=door.url, fingerprint=made.fingerprint)
        listener.start()
        try:
            for thread in threads:
                thread.begin()
            yield served
        finally:
            driver.end()
            recorded.end()
            for thread in threads:
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
        self._token, self._code = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        scheme, port = "https" if certificate else "http", listening.getsockname()[1]
        self._origins = [f"{scheme}://{name}:{port}" for name in names]

    @property
    def url(self) -> str:
        """Where the page is; the token stands behind the #, which no browser sends."""
        return f"{self._origins[0]}/#token={self._token}"

    @property
    def browser_url(self) -> str:
        """Where the page is, with what it exchanges for the token."""
        return f"{self._origins[0]}/#once={self._code}"

    def served(self, more: list[Route], live: RigRoutes, stream: Stream) -> ServerThread:
        """Return what serves who may watch and stop, and `more`."""
        connections = Connections()
        routes = [*live.watching(connections), *more]
        once = None
        if stream.may_command:
            once = Pass(self._code, until_s=time.monotonic() + _ONCE_S)
            routes.append(Route(Pass.PATH, self._tell_token, methods=["POST"]))
        guard = Guard(application(routes), origins=self._origins, token=self._token, once=once)
        config = uvicorn.Config(guard, http=connections.protocol(), **QUIET)
        if self._certificate is not None:
            config.ssl_certfile = str(self._certificate.certificate)
            config.ssl_keyfile = str(self._certificate.key)
        return ServerThread(Server(config, self._listening, connections), stream)

    async def _tell_token(self, _: Request) -> Response:
        return value({"token": self._token})


def _allow_many_files() -> None:
    """Have more files than connections: else those would leave none for a stop."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _FILES if hard == resource.RLIM_INFINITY else min(_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def _listening(host: str, usual: int, port: int | None) -> socket.socket:
    """Return a socket that listens at an address."""
    for tried in (usual, 0) if port is None else (port,):
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, tried))
            listening.listen()  # a port that is only bound is another dashboard's, too, until then
        except OSError as err:
            listening.close()
            if port is None and tried:
                continue
            raise RigError(f"port {tried} of {host}: {err.strerror}; take another --port") from err
        return listening
    raise AssertionError
