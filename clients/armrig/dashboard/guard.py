"""Access to the server: a limit of connections, and control by Host, Origin and a token.

Answers have headers that restrict the browser.
"""

from __future__ import annotations

import asyncio
import hmac
import socket
import time
from collections.abc import Collection, Mapping
from itertools import chain
from typing import Any

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_BODY = 8 << 20
"""Longest body of a request, in B; the CSV file of an input may have 100 000 rows and more."""
_BODY_S = 20.0  # longest time until the body is complete
_CONTENT = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", _CONTENT.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
"""Headers of each answer: only the page's own scripts run, and no other page can embed the page."""
_UNSENT = 16_384  # B; limit of our own buffer, and also of the kernel's buffer
MOST_CONNECTIONS = 200
"""Largest number of connections at the same time."""
Address = tuple[str, int]


class Refusal(Exception):  # noqa: N818  # an answer, not a fault
    """Refusal of a request; the message is the reason in one line."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


class Pass:
    """A one-time code that gives access to one path.

    Other users can read the command line that starts a browser. The command line therefore contains
    this code and not the token. The page exchanges the code for the token.
    """

    PATH = "/api/token"

    def __init__(self, code: str, *, until_s: float) -> None:
        """Store the code, and the monotonic time in s until which the code is valid."""
        self._code, self._until_s = code.encode(), until_s

    def opens(self, given: bytes) -> bool:
        """Return True if the code is right and not expired; the code is then used up."""
        is_it = hmac.compare_digest(given, self._code) and time.monotonic() < self._until_s
        if is_it:
            self._until_s = 0.0
        return is_it


class Guard:
    """Filter that forwards only the requests of the dashboard's own page to an application."""

    def __init__(
        self, app: ASGIApp, *, origins: Collection[str], token: str, once: Pass | None = None
    ) -> None:
        """Guard an application.

        The origins are addresses of the page, such as http://127.0.0.1:8807. A request with another
        Host is refused. Otherwise a foreign page could make its own name an alias of this machine
        (DNS rebinding). Each request below /api/ must contain the token in `Authorization: Bearer`;
        the request for the token contains the code `once` instead.
        """
        self._app = app
        self._origins = frozenset(origins)
        self._hosts = frozenset(origin.partition("://")[2] for origin in origins)
        self._token, self._once = token.encode(), once

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a request to the application, or answer it with a refusal."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # no websocket is served
            await send({"type": "websocket.close", "code": 1008})
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *HEADERS]
            await send(message)

        try:
            self._check(scope)
            if scope["method"] == "POST":
                receive = _replayed(await _body(scope, receive), receive)
        except Refusal as why:
            # The rest of the body is not read.
            answer = JSONResponse({"error": str(why)}, why.status, {"connection": "close"})
            await answer(scope, receive, with_headers)
            return
        await self._app(scope, receive, with_headers)

    def _check(self, scope: Scope) -> None:
        headers = _headers(scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self._hosts:
            where = " and ".join(sorted(self._origins))
            raise Refusal(403, f"Host {host[:80]!r}: the dashboard is at {where}")
        if origin is not None and origin not in self._origins:
            raise Refusal(
                403, f"Origin {origin[:80]!r}: only the dashboard's own page may send requests"
            )
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            raise Refusal(403, "another page asks: only the dashboard's own page may send requests")
        if scope["method"] not in ("GET", "HEAD", "POST"):
            raise Refusal(405, f"{scope['method'][:20]}: GET and POST are allowed")
        if not scope["path"].startswith("/api/"):
            if scope["method"] == "POST":  # without a token, no body is read
                raise Refusal(405, "POST: the page's files are for GET")
            return
        kind, _, given = headers.get("authorization", "").partition(" ")
        # Bytes are compared, so that a token with characters outside ASCII is refused.
        is_his = kind == "Bearer" and self._opens(scope["path"], given.encode("latin-1"))
        if not is_his:
            raise Refusal(
                403,
                "the token is missing or wrong: open the address in the dashboard's terminal",
            )

    def _opens(self, path: str, given: bytes) -> bool:
        if path == Pass.PATH:
            return self._once is not None and self._once.opens(given)
        return hmac.compare_digest(given, self._token)


def _headers(scope: Scope) -> Mapping[str, str]:
    """Return the headers by name; refuse a request that repeats an important header."""
    found: dict[str, str] = {}
    for raw, value in scope["headers"]:
        name = raw.decode("latin-1").lower()
        if name in found and name in ("host", "origin", "authorization", "content-length"):
            raise Refusal(400, f"{name} came twice")
        found[name] = value.decode("latin-1")
    return found


async def _body(scope: Scope, receive: Receive) -> bytes:
    """Return the body of a request; refuse a body that is too long or too slow."""
    told = _headers(scope).get("content-length", "0")
    too_long = Refusal(413, f"the body is too long: at most {MOST_BODY} B are accepted")
    if not told.isdecimal() or int(told) > MOST_BODY:
        raise too_long
    parts: list[bytes] = []
    try:
        async with asyncio.timeout(_BODY_S):
            more = True
            while more:
                message = await receive()
                if message["type"] == "http.disconnect":
                    raise Refusal(400, "the body is incomplete")
                parts.append(message.get("body", b""))
                more = message.get("more_body", False)
                if sum(map(len, parts)) > MOST_BODY:
                    raise too_long
    except TimeoutError as err:
        raise Refusal(408, f"the body did not arrive within {_BODY_S:g} s") from err
    return b"".join(parts)


def _replayed(body: bytes, receive: Receive) -> Receive:
    """Return a receiver that first returns the given body, then receives other messages."""
    waiting: list[Any] = [{"type": "http.request", "body": body, "more_body": False}]

    async def next_message() -> Message:
        return waiting.pop() if waiting else await receive()

    return next_message


class Connections:
    """The connections of one server, oldest first.

    uvicorn closes a connection that is idle after an answer. It does not close a connection that
    never sends a request. A client with a thousand connections could therefore prevent a stop.
    Clients without a token can open both kinds of connections.
    """

    def __init__(self) -> None:
        """Begin without connections."""
        self._open: dict[Address, BoundedProtocol] = {}

    def add(self, address: Address, protocol: BoundedProtocol) -> None:
        """Add a connection; above the limit, close one connection.

        The oldest connection without a request is closed. If every connection has a request, the
        oldest connection with an unread answer is closed. Without an unread answer, the new
        connection is closed.
        """
        self._open[address] = protocol
        if len(self._open) > MOST_CONNECTIONS:
            # Generators: with a flood of connections, the first is usually the one to close.
            idle = (a for a, p in self._open.items() if a != address and not p.is_asked)
            unread = (a for a, p in self._open.items() if a != address and p.is_unread)
            self.abort(next(chain(idle, unread), address))

    def remove(self, address: Address) -> None:
        """Remove a closed connection."""
        self._open.pop(address, None)

    def abort(self, address: Address) -> None:
        """Close a connection at once, even if it has unsent data."""
        protocol = self._open.pop(address, None)
        if protocol is not None:
            protocol.transport.abort()

    def end(self) -> None:
        """Close all connections."""
        for address in [*self._open]:
            self.abort(address)

    def protocol(self) -> type[BoundedProtocol]:
        """Return the protocol class, of which uvicorn creates an instance for each connection."""
        return type("_Bounded", (BoundedProtocol,), {"all_open": self})


class BoundedProtocol(H11Protocol):
    """Protocol of uvicorn that counts its connections."""

    all_open: Connections
    """All connections of the server."""
    _address: Address | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count the new connection, and limit its buffers."""
        super().connection_made(transport)
        # The kernel would buffer megabytes, minutes of messages, for a client that does not read.
        transport.set_write_buffer_limits(high=_UNSENT)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT)
        peer: Any = transport.get_extra_info("peername")
        self._address = (str(peer[0]), int(peer[1])) if peer else None
        if self._address is not None:
            self.all_open.add(self._address, self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the closed connection from the count."""
        if self._address is not None:
            self.all_open.remove(self._address)
        super().connection_lost(exc)

    @property
    def is_asked(self) -> bool:
        """True if the server is answering a complete request."""
        cycle = self.cycle
        return cycle is not None and not cycle.more_body and not cycle.response_complete

    @property
    def is_unread(self) -> bool:
        """True if an answer is blocked because the client does not read it."""
        return bool(self.flow.write_paused)
