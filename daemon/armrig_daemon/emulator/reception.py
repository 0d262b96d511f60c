"""The bytes on the wire to the device, and their decoding."""

from __future__ import annotations

from collections import deque

from armrig_protocol import decoder
from armrig_protocol.decoder import Received

from armrig_daemon.emulator.firmware import NEVER
from armrig_daemon.emulator.uart import arrivals, wire_ns


class Reception:
    """A wire to the device that transmits one byte at a time, and the decoder at its end."""

    def __init__(self, now_ns: int, baud: int) -> None:
        """Create an empty wire; with baud 0, bytes take no time."""
        self._baud = baud
        self._free_ns = now_ns
        self._pieces: deque[tuple[int, bytes]] = deque()
        self._pending = b""
        self.first_ns = NEVER
        """Time at which the next piece arrives; NEVER if the wire is empty."""
        self._peeked: tuple[bytes, list[Received]] | None = None

    def put(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire; they follow the bytes that are already on the wire."""
        pieces = arrivals(self._free_ns, now_ns, data, self._baud)
        if pieces:
            self._pieces.extend(pieces)
            self._free_ns = pieces[-1][0]
            self.first_ns = self._pieces[0][0]

    def backlog_ns(self, now_ns: int) -> int:
        """Return the time for which the wire is still busy, in ns."""
        return max(0, self._free_ns - now_ns)

    def second_ns(self) -> int:
        """Return the arrival time of the second piece on the wire; NEVER if there is none."""
        return self._pieces[1][0] if len(self._pieces) > 1 else NEVER

    def first(self) -> bytes:
        """Return the bytes of the next piece."""
        return self._pieces[0][1]

    def peek(self) -> list[Received]:
        """Return the messages in the next piece before it arrives."""
        if self._peeked is None:
            self._peeked = decoder.feed(self._pending, self._pieces[0][1])
        return self._peeked[1]

    def pop(self) -> list[Received]:
        """Remove the next piece, which has arrived, and return the messages in it."""
        _, piece = self._pieces.popleft()
        self._pending, received = self._peeked or decoder.feed(self._pending, piece)
        self._peeked = None
        self.first_ns = self._pieces[0][0] if self._pieces else NEVER
        return received

    def forget(self, now_ns: int) -> None:
        """Discard the bytes that have arrived, including the bytes of an incomplete frame."""
        self._pending, self._peeked = b"", None
        byte_ns = wire_ns(1, self._baud)
        if self._pieces and byte_ns:
            end_ns, data = self._pieces[0]
            left = -((now_ns - end_ns) // byte_ns)
            self._pieces[0] = (end_ns, data[-left:])
