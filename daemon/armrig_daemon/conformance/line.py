"""Interface of a line to a device, and a line in virtual time to an emulated device or board."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from armrig_daemon.emulator.uno import AnyDevice

_NS_PER_MS = 1_000_000


class Line(Protocol):
    """A line to a device, in both directions."""

    def send(self, data: bytes) -> None:
        """Put all bytes on the line."""

    def receive(self, within_ms: float) -> bytes:
        """Return the received bytes as soon as any have arrived; b"" after `within_ms`."""

    def reopen(self, after_ms: float) -> None:
        """Close the port, and open it `after_ms` later; this resets some devices."""

    def now_ns(self) -> int:
        """Return a monotonic time in ns; it is used only to limit waits."""


class VirtualLine:
    """A line to a device in virtual time; the line adds no delays."""

    def __init__(self, device: AnyDevice, *, resets: bool = True) -> None:
        """Start at power-on; if `resets` is True, the opening of the port resets the device."""
        self.device = device
        self._resets = resets
        self._now_ns = 0
        self._due: deque[tuple[int, bytes]] = deque()

    def send(self, data: bytes) -> None:
        """Put bytes on the wire."""
        self.device.receive(self._now_ns, data)

    def receive(self, within_ms: float) -> bytes:
        """Advance until a frame arrives, at most by `within_ms`; return the frame."""
        end_ns = self._now_ns + round(within_ms * _NS_PER_MS)
        while True:
            if self._due and self._due[0][0] <= self._now_ns:
                return self._due.popleft()[1]
            if self._now_ns >= end_ns:
                return b""
            limit_ns = min(end_ns, self._due[0][0]) if self._due else end_ns
            self._now_ns, frames = self.device.advance_until(limit_ns)
            self._due.extend(frames)

    def reopen(self, after_ms: float) -> None:
        """Advance by `after_ms`, then reopen the port; frames on the line are lost."""
        self._now_ns += round(after_ms * _NS_PER_MS)
        self.device.advance(self._now_ns)
        self._due.clear()
        if self._resets:
            self.device.reset(self._now_ns)

    def now_ns(self) -> int:
        """Return the virtual time, in ns."""
        return self._now_ns
