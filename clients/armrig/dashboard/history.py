"""The past as messages, encoded in a thread, once for all who wait for it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from armrig.dashboard.bins import Rows, as_lists
from armrig.dashboard.messages import event

PAUSE_S = 0.25
"""From one encoding to the next, at least: to connect again and again costs no more."""
_PIECE = 500  # rows in a message


class History:
    """Shares one encoding of the past between all who come while it waits to begin."""

    def __init__(self, rows: Callable[[], Rows]) -> None:
        """Take what gives the rows of the past."""
        self._rows = rows
        self._next: asyncio.Task[list[bytes]] | None = None
        self._began_s = -PAUSE_S

    async def messages(self) -> list[bytes]:
        """Return the messages of a past that was read after this call."""
        if self._next is None:
            self._next = asyncio.create_task(self._encoded())
        return await asyncio.shield(self._next)  # who leaves takes it from nobody

    async def _encoded(self) -> list[bytes]:
        await asyncio.sleep(self._began_s + PAUSE_S - time.monotonic())
        # Whoever comes from here on gets the next: this one may lack rows just before him.
        self._began_s, self._next = time.monotonic(), None
        return await asyncio.to_thread(lambda: encoded(self._rows()))


def encoded(rows: Rows) -> list[bytes]:
    """Return rows as messages, and one that says that these are all."""
    pieces = (rows[i : i + _PIECE] for i in range(0, rows.shape[0], _PIECE))
    return [*(event("past", as_lists(piece)) for piece in pieces), event("whole", {})]
