"""Interface of a line to a device: a serial port, an emulated device or a simulated board."""

from __future__ import annotations

from typing import Protocol


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
