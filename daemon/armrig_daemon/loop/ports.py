"""What the loop needs of the world; the product, the tests and the simulator each bring theirs."""

from __future__ import annotations

from typing import Protocol

from armrig_daemon.decisions.state import Event


class Ports(Protocol):
    """Clock, line and pipes of one loop."""

    @property
    def margin_ns(self) -> int:
        """How long before a deadline `wait` ends and `sleep_until` begins, in ns."""

    @property
    def collections(self) -> int:
        """How often garbage was collected, each time a stall."""

    def now_ns(self) -> int:
        """Return the monotonic time."""

    def sleep_until(self, deadline_ns: int) -> int:
        """Return at the deadline, as exactly as can be, with the time it then is."""

    def wait(self, until_ns: int) -> list[Event]:
        """Return what came, as soon as anything has, or nothing at `until_ns`."""

    def write(self, data: bytes) -> Event | None:
        """Send bytes to the device; what went wrong is an event."""

    def put(self, text: bytes) -> bool:
        """Hand one record to the service without waiting; False where the pipe is full."""

    def tidy(self) -> None:
        """Do what costs time and can wait until no run goes on."""
