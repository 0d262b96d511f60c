"""Connection to a router, opened as soon as the router answers; no other thread waits for it.

After the first connection, zenoh reconnects by itself. A thread of this module tries the first
connection.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh

from armrig_daemon.service.listener import Listener

RETRY_S = 1.0
"""Time between two attempts, in s."""


class Uplink:
    """Listener at a router, opened as soon as the router answers."""

    def __init__(self, endpoint: str, open_way: Callable[[], Listener]) -> None:
        """Start the attempts; `open_way` raises zenoh.ZError if the router does not answer."""
        self._endpoint, self._open_way = endpoint, open_way
        self._listener: Listener | None = None
        self._is_over = threading.Event()
        self._was_connected: bool | None = None
        self._thread = threading.Thread(target=self._connect, name="router", daemon=True)
        self._thread.start()

    def put(self, stream: str, data: bytes) -> None:
        """Publish if a router is connected; clients request missed messages from the history."""
        if self._listener is not None:
            self._listener.put(stream, data)

    @property
    def has_router(self) -> bool:
        """True while a router is connected."""
        return self._listener is not None and self._listener.has_router

    def look(self) -> tuple[str, str] | None:
        """Return a log level and a log line if the connection has changed since the last call."""
        connected = self.has_router
        if connected is self._was_connected:
            return None
        self._was_connected = connected
        if connected:
            return "info", f"[access] connected to the router {self._endpoint}"
        return "warning", (
            f"[access] no connection to the router {self._endpoint}, tried again about every "
            f"{RETRY_S:g} s; check that `armrig router` runs there, with a certificate for this "
            "name and of the same authority"
        )

    def close(self) -> None:
        """Close the connection; a listener that is being opened is closed after its opening."""
        self._is_over.set()
        if self._listener is not None:
            self._listener.close()

    def _connect(self) -> None:
        while not self._is_over.is_set():
            try:
                listener = self._open_way()
            except zenoh.ZError:
                self._is_over.wait(RETRY_S)
                continue
            self._listener = listener
            if self._is_over.is_set():
                listener.close()
            return
