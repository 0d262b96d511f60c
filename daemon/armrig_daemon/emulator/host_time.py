"""The time that an emulated device is given: the host's, or less than that where the host stalls.

A device that is emulated stands still while nobody lets its process run. Given the host's time it
would wake up in a hurry: its watchdog has tripped on a silence in which it could not listen. Given
the time in which it could act, its clock stops meanwhile, and so does the arm. The watchdog is as
long as before by that clock.
"""

from __future__ import annotations

from typing import Final

STALL_NS: Final = 10_000_000
"""What a process may be late without a word, in ns; so much of a stall passes for the device."""
LOOK_NS: Final = 10_000_000
"""How long it waits at most without a look at the clock: nobody sees a stall inside of a wait."""


class HostTime:
    """The device's share of the monotonic time; told of each reading of that, in order."""

    def __init__(self, now_ns: int, *, tolerates_stalls: bool) -> None:
        """Begin with the monotonic time; without tolerance it is given as it is."""
        self._tolerates_stalls = tolerates_stalls
        self._read_ns = now_ns
        self.held_up_ns = 0
        """What was taken off so far."""

    def given_ns(self, now_ns: int, due_ns: int = 0) -> int:
        """Return the time to be given to the device.

        Parameters
        ----------
        now_ns : int
            Monotonic time, just read.
        due_ns : int
            Given time until which the process meant to wait since the last reading, in ns.
        """
        late_ns = now_ns - max(self._read_ns, self.monotonic_ns(due_ns))
        self._read_ns = now_ns
        if self._tolerates_stalls and late_ns > STALL_NS:
            self.held_up_ns += late_ns - STALL_NS
        return now_ns - self.held_up_ns

    def look_ns(self, due_ns: int) -> int:
        """Return the given time to wait until, where nothing is to be done before `due_ns`."""
        if not self._tolerates_stalls:
            return due_ns
        return min(due_ns, self._read_ns - self.held_up_ns + LOOK_NS)

    def monotonic_ns(self, given_ns: int) -> int:
        """Return when a given time will be, or was since the last stall."""
        return given_ns + self.held_up_ns
