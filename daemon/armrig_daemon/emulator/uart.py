"""The device's UART: both directions of the line, ten bits per byte, one byte at a time."""

from __future__ import annotations

from collections import deque

from armrig_protocol import decoder, frame
from armrig_protocol.decoder import Received
from armrig_protocol.messages import Message, Pong

from armrig_daemon.emulator.firmware import NEVER, U16, Firmware

RING_BYTES = 256
BITS_PER_BYTE = 10  # 8N1: start bit, eight data bits, stop bit


def wire_ns(n_bytes: int, baud: int) -> int:
    """Return the time that `n_bytes` take on the wire, in ns; with baud 0, bytes take no time."""
    return n_bytes * BITS_PER_BYTE * 1_000_000_000 // baud if baud else 0


def departure_ns(free_ns: int, now_ns: int, n_bytes: int, baud: int) -> int:
    """Return the time at which `n_bytes` have been sent on a wire that is busy until `free_ns`."""
    return max(free_ns, now_ns) + wire_ns(n_bytes, baud)


def arrivals(free_ns: int, now_ns: int, data: bytes, baud: int) -> list[tuple[int, bytes]]:
    """Split `data` after each 00; return the arrival time and the bytes of each piece.

    The bytes after the last 00 are the last piece. A piece arrives when its last byte arrives.
    Earlier bytes occupy the wire until `free_ns`; `data` occupies the wire until the last returned
    time.
    """
    start_ns = max(free_ns, now_ns)
    pieces: list[tuple[int, bytes]] = []
    begin = 0
    while begin < len(data):
        end = data.find(0, begin) + 1 or len(data)
        pieces.append((start_ns + wire_ns(end, baud), data[begin:end]))
        begin = end
    return pieces


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


class Transmission:
    """A ring buffer of bytes, and the wire to which its bytes are sent."""

    def __init__(self, now_ns: int, baud: int) -> None:
        """Create an idle wire; with baud 0, bytes take no time."""
        self._baud = baud
        self._ring_ns = wire_ns(RING_BYTES, baud)
        self._free_ns = now_ns
        self._seq = 0
        self.sent: list[tuple[int, bytes]] = []
        """Frames sent since the last `pop_sent`, each with the time of its last byte."""

    def begin(self, t_ns: int) -> None:
        """Send a 00, as each sender does when it starts."""
        self._free_ns = departure_ns(self._free_ns, t_ns, 1, self._baud)
        self.sent.append((self._free_ns, b"\0"))

    def send(self, fw: Firmware, t_ns: int, messages: list[Message]) -> None:
        """Put numbered frames on the wire; drop frames for which the ring has no room."""
        for message in messages:
            if isinstance(message, Pong):
                message = message._replace(tx_us=fw.device_us(max(t_ns, self._free_ns)))
            # Like `_replace(seq=...)`, but three times as fast: this runs for each frame.
            numbered = tuple.__new__(type(message), (message[0], self._seq, *message[2:]))
            wire = frame.encode(numbered)
            self._seq = (self._seq + 1) & U16  # a dropped frame leaves a break in seq
            end_ns = departure_ns(self._free_ns, t_ns, len(wire), self._baud)
            if end_ns - t_ns > self._ring_ns:
                fw.count_dropped()
            else:
                self._free_ns = end_ns
                self.sent.append((end_ns, wire))

    def pop_sent(self) -> list[tuple[int, bytes]]:
        """Return the frames sent since the last call, each with the time of its last byte."""
        sent, self.sent = self.sent, []
        return sent
