"""Connections of the server, of which there are so many and no more.

uvicorn closes a connection that is idle after an answer, and none that never asks; whoever opened a
thousand would leave no room for a stop. The oldest that asks nothing gives way, or else the oldest
that does not read its answer: for that no token is needed.
"""

from __future__ import annotations

import asyncio
import socket
from itertools import chain
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

_UNSENT = 16_384  # B, of ours and again of the kernel's
MOST = 200
"""Connections at once."""

Address = tuple[str, int]


class Connections:
    """The connections of one server, oldest first."""

    def __init__(self) -> None:
        """Begin with none."""
        self._open: dict[Address, BoundedProtocol] = {}

    def add(self, address: Address, protocol: BoundedProtocol) -> None:
        """Take one more; the oldest that asks nothing, or does not read, gives way, else this."""
        self._open[address] = protocol
        if len(self._open) > MOST:
            others = [(a, p) for a, p in self._open.items() if a != address]
            idle = (a for a, p in others if not p.is_asked)
            unread = (a for a, p in others if p.is_unread)
            self.abort(next(chain(idle, unread), address))

    def remove(self, address: Address) -> None:
        """Forget one that is closed."""
        self._open.pop(address, None)

    def abort(self, address: Address) -> None:
        """Close one at once, whatever waits to be written to it."""
        protocol = self._open.pop(address, None)
        if protocol is not None:
            protocol.transport.abort()

    def end(self) -> None:
        """Close all that are left."""
        for address in [*self._open]:
            self.abort(address)

    def protocol(self) -> type[BoundedProtocol]:
        """Return the class of protocol that uvicorn is to make for each connection."""
        return type("_Bounded", (BoundedProtocol,), {"all_open": self})


class BoundedProtocol(H11Protocol):
    """uvicorn's protocol, counted."""

    all_open: Connections
    """Where it is counted."""
    _address: Address | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count it."""
        super().connection_made(transport)
        # The kernel would keep megabytes for who does not read: minutes of messages.
        transport.set_write_buffer_limits(high=_UNSENT)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT)
        peer: Any = transport.get_extra_info("peername")
        self._address = (str(peer[0]), int(peer[1])) if peer else None
        if self._address is not None:
            self.all_open.add(self._address, self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it no more."""
        if self._address is not None:
            self.all_open.remove(self._address)
        super().connection_lost(exc)

    @property
    def is_asked(self) -> bool:
        """Whether a question has come whole, and is being answered."""
        cycle = self.cycle
        return cycle is not None and not cycle.more_body and not cycle.response_complete

    @property
    def is_unread(self) -> bool:
        """Whether an answer waits because the one before is not read."""
        return bool(self.flow.write_paused)
