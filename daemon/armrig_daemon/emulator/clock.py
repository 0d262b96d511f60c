"""The device's clock, with the error of its oscillator, and the timer of scheduled mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armrig_daemon.emulator.settings import EmulatorSettings

_NS_PER_S: Final = 1_000_000_000
U32: Final = 0xFFFF_FFFF


@dataclass(frozen=True, slots=True)
class EmulatedClock:
    """Conversion between the caller's time and device time, in integers."""

    reset_ns: int
    """Caller's time at which the clock began at 0."""
    second_ns: int = _NS_PER_S
    """Caller's time in which the clock counts one second, in ns; above 1e9 if the clock is slow."""

    def device_ns(self, now_ns: int) -> int:
        """Return the device time at the caller's time `now_ns`, in whole ns."""
        return (now_ns - self.reset_ns) * _NS_PER_S // self.second_ns

    def instant(self, device_ns: int) -> int:
        """Return the first ns of the caller's time at which the clock shows `device_ns`."""
        return self.reset_ns - (-device_ns * self.second_ns // _NS_PER_S)

    def after(self, now_ns: int, dt_ns: int) -> int:
        """Return the caller's time at which `dt_ns` of device time have passed since `now_ns`."""
        # This is `instant(device_ns(now_ns) + dt_ns)`; calls would cost time at each step.
        end_ns = (now_ns - self.reset_ns) * _NS_PER_S // self.second_ns + dt_ns
        return self.reset_ns - (-end_ns * self.second_ns // _NS_PER_S)


def clock_at_reset(settings: EmulatorSettings, now_ns: int) -> EmulatedClock:
    """Return the clock of a device that is reset at `now_ns`."""
    return EmulatedClock(now_ns, _NS_PER_S + round(settings.clock_ppm * 1000))


def microseconds(device_ns: int) -> int:
    """Return device time in µs as it is on the wire, where it wraps at 2^32."""
    return device_ns // 1000 & U32


@dataclass(slots=True, kw_only=True)
class Timer:
    """Ticks at device times t_0 + k Ts, each computed from k, so that no errors accumulate."""

    first_ns: int
    """Time t_0 at which the conversion of channel 0 in sample 0 is triggered."""
    period_ns: int
    """Sampling time Ts."""
    lead_ns: int
    """Time from a sample's first trigger to the trigger of its last conversion of channel 0."""
    hold_ns: int
    """Time from the trigger of channel 0 to the latch of u."""
    k_stop: int
    """Number of samples to take; 0 for a run without an end."""
    k: int = 0
    """Index of the next sample; it does not wrap."""

    @property
    def ends(self) -> bool:
        """True if all samples were taken, so that the end of the run is due next."""
        return 0 < self.k_stop <= self.k

    @property
    def due_ns(self) -> int:
        """Time of the first conversion of sample k, or of the end of the run."""
        tick_ns = self.first_ns + self.k * self.period_ns
        # The run ends at the time of the next latch, so that the last input is held for a whole Ts.
        return tick_ns + self.hold_ns if self.ends else tick_ns - self.lead_ns
