"""The frames on their way to the host: numbered, one after the other, dropped where too many."""

from __future__ import annotations

from armrig_protocol import frame
from armrig_protocol.messages import Message, Pong

from armrig_daemon.emulator.firmware import U16, Firmware
from armrig_daemon.emulator.uart import departure_ns, wire_ns

RING_BYTES = 256


class Transmission:
    """A ring of bytes and the wire behind it."""

    def __init__(self, now_ns: int, baud: int) -> None:
        """Begin with an idle wire; baud 0 is one that takes no time."""
        self._baud = baud
        self._ring_ns = wire_ns(RING_BYTES, baud)
        self._free_ns = now_ns
        self._seq = 0
        self.sent: list[tuple[int, bytes]] = []
        """What was sent since the last `pop_sent`, each with its last byte's departure."""

    def begin(self, t_ns: int) -> None:
        """Send the 00 that a sender begins with."""
        self._free_ns = departure_ns(self._free_ns, t_ns, 1, self._baud)
        self.sent.append((self._free_ns, b"\0"))

    def send(self, fw: Firmware, t_ns: int, messages: list[Message]) -> None:
        """Put frames on the wire, numbered; drop what finds no room in the ring."""
        for message in messages:
            if isinstance(message, Pong):
                message = message._replace(tx_us=fw.device_us(max(t_ns, self._free_ns)))
            # As `_replace(seq=...)`, at a third of its time: each frame passes here.
            numbered = tuple.__new__(type(message), (message[0], self._seq, *message[2:]))
            wire = frame.encode(numbered)
            self._seq = (self._seq + 1) & U16  # a frame that is dropped leaves a break in seq
            end_ns = departure_ns(self._free_ns, t_ns, len(wire), self._baud)
            if end_ns - t_ns > self._ring_ns:
                fw.count_dropped()
            else:
                self._free_ns = end_ns
                self.sent.append((end_ns, wire))

    def pop_sent(self) -> list[tuple[int, bytes]]:
        """Return what was sent since the last call, each with its last byte's departure."""
        sent, self.sent = self.sent, []
        return sent
