"""Interface of the loop to its environment: the real daemon, a test or the simulator."""

from __future__ import annotations

from typing import Protocol

from armrig_daemon.decisions.state import Event


class Ports(Protocol):
    """Clock, line and pipes of a loop."""

    @property
    def margin_ns(self) -> int:
        """Time before a deadline at which `wait` ends and `sleep_until` begins, in ns."""

    @property
    def collections(self) -> int:
        """Number of garbage collections; each collection stalls the loop."""

    def now_ns(self) -> int:
        """Return the monotonic time."""

    def sleep_until(self, deadline_ns: int) -> int:
        """Wait until the deadline, as exactly as possible; return the current time."""

    def wait(self, until_ns: int) -> list[Event]:
        """Return events as soon as one arrives, or an empty list at `until_ns`."""

    def write(self, data: bytes) -> Event | None:
        """Send bytes to the device; return a failure as an event."""

    def put(self, text: bytes) -> bool:
        """Pass one record to the service without waiting; return False if the pipe is full."""

    def tidy(self) -> None:
        """Perform lengthy work that can wait until the end of a run."""
