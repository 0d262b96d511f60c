"""The device's clock: it starts at reset, and is wrong by what its oscillator is wrong by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armrig_daemon.emulator.settings import EmulatorSettings

_BILLION: Final = 1_000_000_000
U32: Final = 0xFFFF_FFFF


@dataclass(frozen=True, slots=True)
class Clock:
    """Device time over given time, in integers, so that no second of it is ever lost."""

    reset_ns: int
    """Given time at which it began with 0."""
    second_ns: int = _BILLION
    """Given time in which it counts a second; more is a slow oscillator."""

    def device_ns(self, now_ns: int) -> int:
        """Return what it shows, in whole ns."""
        return (now_ns - self.reset_ns) * _BILLION // self.second_ns

    def instant(self, device_ns: int) -> int:
        """Return the first ns of given time at which it shows `device_ns`."""
        return self.reset_ns - (-device_ns * self.second_ns // _BILLION)

    def after(self, now_ns: int, dt_ns: int) -> int:
        """Return when `dt_ns` of device time will have passed since `now_ns`."""
        # `instant` of `device_ns` and dt, in one: each frame and each act passes here.
        end_ns = (now_ns - self.reset_ns) * _BILLION // self.second_ns + dt_ns
        return self.reset_ns - (-end_ns * self.second_ns // _BILLION)


def started(settings: EmulatorSettings, now_ns: int) -> Clock:
    """Return the clock of a device that is reset now."""
    return Clock(now_ns, _BILLION + round(settings.clock_ppm * 1000))


def microseconds(device_ns: int) -> int:
    """Return device time as the wire carries it; it wraps at 2^32."""
    return device_ns // 1000 & U32
