"""Server of a dashboard: its sockets, rights, threads and shutdown."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import uvicorn
from armrig_core.access.daemon_lock import living_daemon
from armrig_core.commands.commands import StatusReport
from armrig_core.process.open_files import raise_limit
from armrig_core.rig.description import path_of, read_description
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from armrig.dashboard.app import RigRoutes, application, value
from armrig.dashboard.driver import CommandSender
from armrig.dashboard.feed import Feed
from armrig.dashboard.guard import Connections, Guard, Pass
from armrig.dashboard.model_routes import ModelRoutes
from armrig.dashboard.recording_routes import RecordingRoutes
from armrig.dashboard.share import PORT as SHARED_PORT
from armrig.dashboard.share import Certificate, certificate
from armrig.dashboard.stream import Stream
from armrig.rig.client import Rig
from armrig.rig.remote_source import RemoteSource
from armrig.rig.session import NoReplyError, RigError, default_endpoint, open_session
from armrig.rig.telemetry_stream import decode

HOST = "127.0.0.1"
PORT = 8807
_ONCE_S = 60.0  # time within which the browser must open the page
_START_S = 20.0
_MAX_QUEUED = 4096  # above the limit, a client sends its first packet again only after 1 s
_SWITCH_S = 0.0005  # longest time for which a thread holds the interpreter while a stop waits
_ENDS_S = 2
QUIET: dict[str, Any] = {
    "log_config": None,
    "log_level": "error",  # no warnings: anybody can cause them with bytes that are not HTTP
    "access_log": False,
    "lifespan": "off",
    "ws": "none",
    "server_header": False,
    "date_header": False,
    "proxy_headers": False,
    "timeout_graceful_shutdown": _ENDS_S,
    "timeout_keep_alive": 30,
    "h11_max_incomplete_event_size": 16_384,
    "backlog": 16,  # connections that asyncio accepts before it serves the others
}
"""Settings of uvicorn: no output, no server header, and a short wait at the end."""
_LOOK_S = 0.025
_STATUS_S = 0.5
_SILENT_S = 2.0  # after this time plus 2 Ts without a sample, the listener connects again
_RETRY_S = 0.3
_MAX_PIECES = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class DashboardSettings:
    """Rig and addresses of a dashboard."""

    rig: str = "1"
    """Id of the rig."""
    connect: str | None = None
    """Endpoint of the rig's daemon; if None, the default of `armrig.Rig`."""
    command: str = "armrig dashboard"
    """Command that has started the server, for a person who must start it again."""
    starts_daemon: bool = False
    """True if `command` also starts the daemon of the rig."""
    rig_file: Path | None = None
    """Description that `command` gave to the daemon, with the file of its model on this machine."""
    port: int | None = None
    """Port on 127.0.0.1; if None, 8807, or any free port if 8807 is in use."""
    share: str | None = None
    """Address of this machine for visitors, who may only watch and stop."""
    share_port: int | None = None
    """Port for visitors; if None, 8808, or any free port if 8808 is in use."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """Addresses of a running dashboard."""

    url: str
    """URL of the page, with the token for all commands."""
    browser_url: str
    """URL with which a browser is started; the URL is valid once, and only for a minute."""
    shared_url: str = ""
    """URL for visitors, whose token permits only watching and stopping; "" without `share`."""
    fingerprint: str = ""
    """SHA-256 of the certificate for visitors; "" without `share`."""


@contextmanager
def dashboard(settings: DashboardSettings) -> Iterator[Served]:
    """Serve a dashboard until the block ends; the end of the block stops a run of the dashboard.

    Raises RigError if another program uses the port. Raises MissingPackageError if the package for
    the certificate of `share` is not installed.
    """
    raise_limit()  # above the limit of connections, so that a stop can be sent
    sys.setswitchinterval(_SWITCH_S)
    feed = Feed(read_description(path_of(settings.rig_file)) if settings.rig_file else None)
    driver = CommandSender(rig=settings.rig, connect=settings.connect)
    recorded, models = RecordingRoutes(feed, settings.rig), ModelRoutes(feed, settings.rig)
    listener = FeedListener(
        feed,
        rig=settings.rig,
        connect=settings.connect,
        found=driver.be_ready_to_stop,
        restart=settings.command if settings.starts_daemon else "",
    )
    with ExitStack() as open_files:
        own = _Door(_listening(HOST, PORT, settings.port), names=(HOST, "localhost"))
        stream = Stream(feed, driver, may_command=True, command=settings.command)
        live = RigRoutes(feed, driver, stream)
        threads = [
            own.served([*live.commanding(), *recorded.routes(), *models.routes()], live, stream)
        ]
        served = Served(url=own.url, browser_url=own.browser_url)
        if settings.share is not None:
            made = open_files.enter_context(certificate(settings.share))
            taken = _listening(settings.share, SHARED_PORT, settings.share_port)
            door = _Door(taken, names=(settings.share,), certificate=made)
            stream = Stream(feed, driver, may_command=False, command=settings.command)
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
            models.end()
            for thread in threads:
                thread.end()
            listener.end()


class _Door:
    """A listening socket, the names of its addresses, and the token for its routes."""

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
        """URL of the page; the token follows the #, because browsers do not send this part."""
        return f"{self._origins[0]}/#token={self._token}"

    @property
    def browser_url(self) -> str:
        """URL of the page, with a code that the page exchanges for the token."""
        return f"{self._origins[0]}/#once={self._code}"

    def served(self, more: list[Route], live: RigRoutes, stream: Stream) -> ServerThread:
        """Return a server's thread; its routes are `more` and the routes to watch and to stop."""
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


def _listening(host: str, usual: int, port: int | None) -> socket.socket:
    """Return a socket that listens on `port`; if `port` is None, on the usual or a free port."""
    for tried in (usual, 0) if port is None else (port,):
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, tried))
            listening.listen()  # another dashboard can also bind the port until one of them listens
        except OSError as err:
            listening.close()
            if port is None and tried:
                continue
            raise RigError(f"port {tried} of {host}: {err.strerror}; take another --port") from err
        return listening
    raise AssertionError


class Server(uvicorn.Server):
    """Server of uvicorn that leaves signals to the caller."""

    def __init__(
        self, config: uvicorn.Config, listening: socket.socket, connections: Connections
    ) -> None:
        super().__init__(config)
        self._listening, self._connections = listening, connections

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture no signals, because the command line ends the server."""
        yield

    def accept_many(self) -> None:
        """Let the kernel queue many connections; asyncio has set its own, short limit."""
        self._listening.listen(_MAX_QUEUED)

    async def run_here(self) -> None:
        """Serve until `should_exit` is True."""
        await self.serve([self._listening])
        # A client that does not read its last messages would keep its connection open.
        self._connections.end()
        await asyncio.sleep(0)  # asyncio closes the connections in the loop's next turn


class ServerThread:
    """Thread of one socket's server; requests at one socket do not delay the other socket."""

    def __init__(self, server: Server, stream: Stream) -> None:
        self._server, self._stream = server, stream
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), name="server", daemon=True
        )

    def begin(self) -> None:
        """Start the thread, and wait until the server listens."""
        # Without this level, asyncio prints a line when a client disconnects.
        logging.getLogger("asyncio").setLevel(logging.ERROR)
        self._thread.start()
        pause = threading.Event()
        for _ in range(int(_START_S / 0.01)):
            if self._server.started:
                self._server.accept_many()
                return
            pause.wait(0.01)
        raise RigError("the server does not start")

    def end(self) -> None:
        """End the thread, and wait for its end."""
        self._server.should_exit = True
        self._thread.join(_ENDS_S + 5.0)

    async def _serve(self) -> None:
        filling = asyncio.create_task(self._stream.fill())
        ending = asyncio.create_task(self._end_streams())
        try:
            await self._server.run_here()
        finally:
            for task in (filling, ending):
                task.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await task

    async def _end_streams(self) -> None:
        """End the streams before the server's end, because the server waits for them."""
        while not self._server.should_exit:
            await asyncio.sleep(0.05)
        self._stream.viewers.end()


class FeedListener:
    """Thread that receives the rig's messages and adds them to a feed."""

    def __init__(
        self,
        feed: Feed,
        *,
        rig: str,
        connect: str | None,
        found: Callable[[], None],
        restart: str = "",
    ) -> None:
        """Prepare to listen to a rig; `found` is called after each connection to the rig.

        `restart` is the command that starts a dead daemon; "" if the error of the client names it.
        """
        self._found, self._restart = found, restart
        self._feed = feed
        self._rig = rig
        self._connect = connect
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="listener", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """End the thread, and wait for its end."""
        self._ends.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._ends.is_set():
            try:
                with Rig(self._rig, connect=self._connect) as opened:
                    self._listen(opened)
            except (RigError, ValueError) as err:
                self._feed.trouble = self._trouble(err)
            self._ends.wait(_RETRY_S)

    def _trouble(self, err: Exception) -> str:
        """Return why there is no connection, and what a person does; short, for the page."""
        if not isinstance(err, NoReplyError):
            return str(err)
        if pid := living_daemon(self._connect or default_endpoint(self._rig)):
            return (
                f"the rig's daemon (process {pid}) does not answer: `kill -9 {pid}` ends it, then "
                "the device stops the motor"
            )
        if self._restart:
            return f"the rig's daemon has ended: start it in another terminal by `{self._restart}`"
        return str(err)

    def _listen(self, rig: Rig) -> None:
        """Listen until `end` is called, or until no sample arrives for `_SILENT_S` plus 2 Ts."""
        feed = self._feed
        with (
            rig.arrivals("sample") as samples,
            rig.arrivals("gap") as gaps,
            rig.arrivals("timing") as reports,
            rig.arrivals("state") as states,
            rig.arrivals("event") as events,
            rig.arrivals("control") as decisions,
        ):
            status = rig.status()
            feed.take_status(status)
            self._found()
            self._take_past()
            asked_s = heard_s = time.monotonic()
            while not self._ends.wait(_LOOK_S):
                feed.add_gaps(gaps())
                if came := samples():
                    feed.add_samples(came)
                    heard_s = time.monotonic()
                for report in reports():
                    feed.add_report(report)
                feed.add_events(events())
                now = time.monotonic()
                decided = decisions()  # before the states: those of the run have come then
                feed.add_states(fresh := states())
                feed.add_decisions(decided)
                if _changed(fresh, status) or now - asked_s >= _STATUS_S:
                    feed.take_status(status := rig.status())
                    asked_s = now
                feed.look_for_law()  # after the status, which names the recording of the run
                if now - heard_s > _SILENT_S + 2 * status.Ts:
                    return  # a session may outlive its daemon

    def _take_past(self) -> None:
        """Add the messages of the last minutes, which the daemon keeps."""
        takers: tuple[tuple[str, Callable[[list[Any]], None]], ...] = (
            ("gap", self._feed.add_gaps),
            ("state", self._feed.add_states),
            ("event", self._feed.add_events),
            ("sample", lambda samples: self._feed.add_samples(samples, live=False)),
            ("control", self._feed.add_decisions),
        )
        with open_session(self._connect, rig=self._rig) as session:
            source = RemoteSource(session, self._rig)
            for _ in range(_MAX_PIECES):
                piece = source.next_piece()
                if piece is None or self._ends.is_set():
                    return
                for name, take in takers:
                    take([decode(name, data) for kind, data in piece.past.messages if kind == name])
                if not piece.is_full:
                    return


def _changed(states: list[Any], status: StatusReport) -> bool:
    """Return True if a published state differs from the known status."""
    return any(
        (s.phase, s.owner, s.reason) != (status.phase, status.owner, status.reason) for s in states
    )
