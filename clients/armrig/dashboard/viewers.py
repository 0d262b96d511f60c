"""Those who watch: each has a bounded row of messages, and who does not read is dropped."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

from armrig_core.errors import OperationError

MOST_VIEWERS = 64
"""At one door."""
_MOST_WAITING = 250  # messages: the past, and five seconds at 30 Hz


class TooManyViewersError(OperationError):
    """There are as many viewers as are allowed."""


class Viewer:
    """One who watches."""

    def __init__(self, drop: Callable[[], None]) -> None:
        """Take what ends his connection at once: to write to him would wait."""
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue(_MOST_WAITING)
        self._drop = drop
        self.is_dropped = False
        """He did not read what was sent to him."""

    def offer(self, message: bytes) -> None:
        """Have a message sent, or drop him where as many wait as may."""
        try:
            self._waiting.put_nowait(message)
        except asyncio.QueueFull:
            self.is_dropped = True
            self._drop()

    async def messages(self) -> AsyncIterator[bytes]:
        """Give his messages until he is dropped, or the server ends."""
        while not self.is_dropped and (message := await self._waiting.get()) is not None:
            yield message

    def end(self) -> None:
        """End the stream after what waits."""
        self.is_dropped = self._waiting.full()
        if not self.is_dropped:
            self._waiting.put_nowait(None)


class Viewers:
    """All who watch at one door."""

    def __init__(self) -> None:
        """Begin with nobody."""
        self._viewers: set[Viewer] = set()
        self.dropped = 0
        """How many were dropped."""

    def __len__(self) -> int:
        """Return how many watch."""
        return len(self._viewers)

    def add(self, viewer: Viewer) -> None:
        """Take one more.

        Raises
        ------
        TooManyViewersError
            As many as are allowed watch already.
        """
        if len(self) >= MOST_VIEWERS:
            raise TooManyViewersError(f"{MOST_VIEWERS} watch already: close a page")
        self._viewers.add(viewer)

    def remove(self, viewer: Viewer) -> None:
        """Take one away who has left."""
        self._viewers.discard(viewer)

    def send(self, message: bytes) -> None:
        """Send one message to all."""
        for viewer in [*self._viewers]:
            viewer.offer(message)
            if viewer.is_dropped:
                self._viewers.discard(viewer)
                self.dropped += 1

    def end(self) -> None:
        """End all streams."""
        for viewer in self._viewers:
            viewer.end()
        self._viewers.clear()
