"""A clock that a sleep does not stop; detection of a sleep, or of a stop of this program."""

from __future__ import annotations

import time

MIN_STANDSTILL_S = 8.0
"""Shortest standstill that is reported, in s; no regular wait of a program is so long."""


class Standstill:
    """Detector of a standstill; the program must call `look` every few seconds."""

    def __init__(self) -> None:
        self._last_s = _times_s()

    def look(self) -> str:
        """Return a sentence if the program stood still since the last call; otherwise ""."""
        before_s, self._last_s = self._last_s, _times_s()
        gap_s, awake_s = (now - then for now, then in zip(self._last_s, before_s, strict=True))
        if gap_s <= MIN_STANDSTILL_S:
            return ""
        if awake_s < gap_s / 2:
            return f"this computer slept for {gap_s:.0f} s"
        return f"this computer slept, or this program was stopped, for {gap_s:.0f} s"


def boot_ns() -> int:
    """Return a time in ns that continues during a sleep, if this system has such a clock."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic_ns() if clock is None else time.clock_gettime_ns(clock)


def _times_s() -> tuple[float, float]:
    """Return two times in s: the first continues during a sleep, if this system has its clock."""
    return boot_ns() / 1e9, time.monotonic()
