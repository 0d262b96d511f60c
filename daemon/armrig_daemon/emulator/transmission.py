"""The wire to the host: frames are numbered, sent in order, and dropped if the ring is full."""

from __future__ import annotations

from armrig_protocol import frame
from armrig_protocol.messages import Message, Pong

from armrig_daemon.emulator.firmware import U16, Firmware
from armrig_daemon.emulator.uart import departure_ns, wire_ns

RING_BYTES = 256


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
