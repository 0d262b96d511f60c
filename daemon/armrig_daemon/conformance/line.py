"""What the suite needs of the way to a device; port, emulator and simulated board bring theirs."""

from __future__ import annotations

from typing import Protocol


class Line(Protocol):
    """Bytes to a device and from it."""

    def send(self, data: bytes) -> None:
        """Put bytes on the line, all of them."""

    def receive(self, within_ms: float) -> bytes:
        """Return what has come, as soon as anything has; nothing where `within_ms` pass before."""

    def reopen(self, after_ms: float) -> None:
        """Close the port, and open it again `after_ms` later; that resets some devices."""

    def now_ns(self) -> int:
        """Return a clock that goes on, in ns; it bounds waits, and judges no device."""
