"""A device to which time is given as the suite's line: all of it in virtual time."""

from __future__ import annotations

from collections import deque
from typing import Protocol

_MS = 1_000_000


class TimedDevice(Protocol):
    """A device to which time is given, and that the opening of its port may reset."""

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to it."""

    def advance(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Let time pass; return frames, each with its last byte's departure."""

    def advance_until(self, limit_ns: int) -> tuple[int, list[tuple[int, bytes]]]:
        """Let time pass up to `limit_ns` or to a frame; return the time that it is then, and it."""

    def reset(self, now_ns: int) -> None:
        """Reset the processor; what is on the wires is lost."""


class VirtualLine:
    """A device at the end of a line that takes no time of its own."""

    def __init__(self, device: TimedDevice, *, resets: bool = True) -> None:
        """Begin when it is switched on; `resets` has the opening of the port reset it."""
        self.device = device
        self._resets = resets
        self._now_ns = 0
        self._due: deque[tuple[int, bytes]] = deque()

    def send(self, data: bytes) -> None:
        """Put bytes on the wire."""
        self.device.receive(self._now_ns, data)

    def receive(self, within_ms: float) -> bytes:
        """Let time pass until a frame has come, or for `within_ms`."""
        end_ns = self._now_ns + round(within_ms * _MS)
        while True:
            if self._due and self._due[0][0] <= self._now_ns:
                return self._due.popleft()[1]
            if self._now_ns >= end_ns:
                return b""
            limit_ns = min(end_ns, self._due[0][0]) if self._due else end_ns
            self._now_ns, frames = self.device.advance_until(limit_ns)
            self._due.extend(frames)

    def reopen(self, after_ms: float) -> None:
        """Let time pass; what was on its way is lost."""
        self._now_ns += round(after_ms * _MS)
        self.device.advance(self._now_ns)
        self._due.clear()
        if self._resets:
            self.device.reset(self._now_ns)

    def now_ns(self) -> int:
        """Return the time that has passed."""
        return self._now_ns
