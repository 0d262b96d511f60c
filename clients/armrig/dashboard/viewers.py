"""Viewers of one listening socket, each with a bounded queue.

A viewer that does not receive its messages is dropped.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

from armrig_core.errors import OperationError

MOST_VIEWERS = 64
"""Largest number of viewers of one listening socket."""
_MAX_WAITING = 250  # messages: the history, and the new data of five seconds at 30 Hz


class TooManyViewersError(OperationError):
    """The largest number of viewers is reached."""


class Viewer:
    """Queue of messages for one viewer."""

    def __init__(self, drop: Callable[[], None]) -> None:
        """Store the function `drop`, which closes the connection and discards queued data."""
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue(_MAX_WAITING)
        self._drop = drop
        self.is_dropped = False
        """True if the viewer did not read its messages."""

    def offer(self, message: bytes) -> None:
        """Queue a message, or drop the viewer if the queue is full."""
        try:
            self._waiting.put_nowait(message)
        except asyncio.QueueFull:
            self.is_dropped = True
            self._drop()

    async def messages(self) -> AsyncIterator[bytes]:
        """Yield the messages until the viewer is dropped or the server ends."""
        while not self.is_dropped and (message := await self._waiting.get()) is not None:
            yield message

    def end(self) -> None:
        """End the stream after the queued messages."""
        self.is_dropped = self._waiting.full()
        if not self.is_dropped:
            self._waiting.put_nowait(None)


class Viewers:
    """All viewers of one listening socket."""

    def __init__(self) -> None:
        """Begin without viewers."""
        self._viewers: set[Viewer] = set()
        self.dropped = 0
        """Number of dropped viewers."""

    def __len__(self) -> int:
        """Return the number of viewers."""
        return len(self._viewers)

    def add(self, viewer: Viewer) -> None:
        """Add a viewer.

        Raises
        ------
        TooManyViewersError
            The largest number of viewers is reached.
        """
        if len(self) >= MOST_VIEWERS:
            raise TooManyViewersError(f"{MOST_VIEWERS} pages are open already: close one")
        self._viewers.add(viewer)

    def remove(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        self._viewers.discard(viewer)

    def send(self, message: bytes) -> None:
        """Send one message to all viewers."""
        for viewer in [*self._viewers]:
            viewer.offer(message)
            if viewer.is_dropped:
                self._viewers.discard(viewer)
                self.dropped += 1

    def end(self) -> None:
        """End the streams of all viewers."""
        for viewer in self._viewers:
            viewer.end()
        self._viewers.clear()
