"""The way through a router: opened as soon as there is one, and never waited for.

zenoh connects again by itself once it has been connected; until then a thread of ours tries.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh

from armrig_daemon.service.listener import Listener

AGAIN_S = 1.0
"""Between two attempts."""


class Uplink:
    """A listener at a router, once there is one."""

    def __init__(self, endpoint: str, open_way: Callable[[], Listener]) -> None:
        """Begin to try.

        Parameters
        ----------
        open_way : callable
            Returns the listener; raises zenoh.ZError where the router is not there.
        """
        self._endpoint, self._open_way = endpoint, open_way
        self._listener: Listener | None = None
        self._is_over = threading.Event()
        self._was_connected: bool | None = None
        self._thread = threading.Thread(target=self._connect, name="router", daemon=True)
        self._thread.start()

    def put(self, stream: str, data: bytes) -> None:
        """Publish, if there is a router; who was not heard is asked for the history."""
        if self._listener is not None:
            self._listener.put(stream, data)

    @property
    def has_router(self) -> bool:
        """Whether there is a router now."""
        return self._listener is not None and self._listener.has_router

    def look(self) -> tuple[str, str] | None:
        """Return a level and a line where the router has come or gone since the last look."""
        connected = self.has_router
        if connected is self._was_connected:
            return None
        self._was_connected = connected
        if connected:
            return "info", f"[access] connected to the router {self._endpoint}"
        return "warning", (
            f"[access] no connection to the router {self._endpoint}, tried again every "
            f"{AGAIN_S:g} s or so; see that `armrig router` runs there, with a certificate for "
            "that name and of the same authority"
        )

    def close(self) -> None:
        """Close; one that is just being opened closes itself."""
        self._is_over.set()
        if self._listener is not None:
            self._listener.close()

    def _connect(self) -> None:
        while not self._is_over.is_set():
            try:
                listener = self._open_way()
            except zenoh.ZError:
                self._is_over.wait(AGAIN_S)
                continue
            self._listener = listener
            if self._is_over.is_set():
                listener.close()
            return
