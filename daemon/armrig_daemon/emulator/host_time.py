"""Emulation time, the time that an emulated device receives: the host's time without stalls.

An emulated device receives nothing while its process is stalled. If the device's clock continued
during the stall, its watchdog would trip after the stall. Therefore the device's clock and the arm
stop during a stall. By the device's clock, the watchdog trips after the same time as without a
stall.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

STALL_NS: Final = 10_000_000
"""Largest lateness, in ns, that is not a stall: the device's clock continues during this time."""
LOOK_NS: Final = 10_000_000
"""Longest wait between two readings of the clock, in ns; a stall within a wait is not detected."""
_REPORT_INTERVAL_NS: Final = 1_000_000_000
"""Shortest time between two reports of stalls, in ns."""


class HostTime:
    """Conversion of monotonic time to emulation time; it needs all clock readings, in order."""

    def __init__(self, now_ns: int, *, tolerates_stalls: bool) -> None:
        """Start at `now_ns`; if stalls are not tolerated, emulation time is monotonic time."""
        self._tolerates_stalls = tolerates_stalls
        self._read_ns = now_ns
        self.held_up_ns = 0
        """Sum of the stalls so far, in ns; emulation time is monotonic time minus this sum."""

    def emulation_ns(self, now_ns: int, due_ns: int = 0) -> int:
        """Return the emulation time, which the caller passes to the device.

        `now_ns` is the current monotonic time. `due_ns` is the emulation time, in ns, until which
        the process intended to wait at the last call.
        """
        late_ns = now_ns - max(self._read_ns, self.monotonic_ns(due_ns))
        self._read_ns = now_ns
        if self._tolerates_stalls and late_ns > STALL_NS:
            self.held_up_ns += late_ns - STALL_NS
        return now_ns - self.held_up_ns

    def look_ns(self, due_ns: int) -> int:
        """Return the emulation time at which the clock must be read next, at latest `due_ns`."""
        if not self._tolerates_stalls:
            return due_ns
        return min(due_ns, self._read_ns - self.held_up_ns + LOOK_NS)

    def monotonic_ns(self, emulation_ns: int) -> int:
        """Return the monotonic time of an emulation time that is later than the last stall."""
        return emulation_ns + self.held_up_ns


class StallReports:
    """Reports of stalls, each with the length of the stalls since the report before."""

    def __init__(self, report: Callable[[int], None]) -> None:
        """Call `report` with the length of the new stalls, in ns."""
        self._report = report
        self._reported_ns = 0
        self._next_ns = 0

    def update(self, held_up_ns: int, now_ns: int) -> None:
        """Report new stalls, if the last report is old enough.

        `held_up_ns` is the sum of all stalls so far, in ns, and `now_ns` the emulation time.
        """
        if held_up_ns > self._reported_ns and now_ns >= self._next_ns:
            self._report(held_up_ns - self._reported_ns)
            self._reported_ns, self._next_ns = held_up_ns, now_ns + _REPORT_INTERVAL_NS
