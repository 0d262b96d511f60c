"""Recently published messages, kept in bounded memory for clients that missed messages.

zenoh's own cache (its advanced publisher) is not used: see
docs/decisions/missed-messages-are-requested-from-the-daemon.md.
"""

from __future__ import annotations

from armrig_core.telemetry.history import REPLY_LIMIT, encode_past

MOST_BYTES = 2 << 20
"""Largest size of the kept messages, in B: 24 105 samples of 87 B, 24 s at 1 kHz."""


class History:
    """Messages by their numbers; one thread may add messages while another thread reads."""

    def __init__(self, life: bytes, most_bytes: int = MOST_BYTES) -> None:
        """Create an empty history.

        Parameters
        ----------
        life : bytes
            16 B that identify this start of a daemon.
        """
        self._life, self._most = life, most_bytes
        self._kept: dict[int, tuple[str, bytes]] = {}
        self._first = self._end = self._size = 0

    def add(self, stream: str, data: bytes) -> None:
        """Keep a message, and drop the oldest messages beyond the limit."""
        self._kept[self._end] = (stream, data)
        self._end += 1
        self._size += len(data)
        while self._size > self._most:
            _, oldest = self._kept.pop(self._first)
            self._first += 1
            self._size -= len(oldest)

    def reply(self, first: int, clock_offset_ns: int) -> bytes:
        """Return an answer with the messages from number `first` on, as many as fit into it."""
        number = first = min(max(first, self._first), self._end)
        messages: list[tuple[str, bytes]] = []
        size = 0
        # Another thread may drop the oldest message at this moment, in `add`.
        while size < REPLY_LIMIT and (message := self._kept.get(number)) is not None:
            messages.append(message)
            size += len(message[1])
            number += 1
        return encode_past(self._life, first, clock_offset_ns, messages)
