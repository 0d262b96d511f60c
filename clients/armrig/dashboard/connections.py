"""Connections of the server, with a limit on their number.

uvicorn closes a connection that is idle after an answer. It does not close a connection that never
sends a request. A client with a thousand connections could therefore prevent a stop. Above the
limit, the server closes the oldest connection without a request. If every connection has sent a
request, the server closes the oldest connection whose client does not read its answer. Clients
without a token can open both kinds of connections.
"""

from __future__ import annotations

import asyncio
import socket
from itertools import chain
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

_UNSENT = 16_384  # B; limit of our own buffer, and also of the kernel's buffer
MOST = 200
"""Largest number of connections at the same time."""

Address = tuple[str, int]


class Connections:
    """The connections of one server, oldest first."""

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
        if len(self._open) > MOST:
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
