"""What disturbed the timing of a recording, from the reports that the daemon made each second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan
from typing import TYPE_CHECKING

from armrig_core.emulator_stall import held_up_ms

from armrig.numerics.quantities import NBSP, fixed
from armrig.recordings.daemon_reports import DeviceClock, Timing

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbances:
    """What the host did meanwhile, and how the device's clock ran."""

    seconds: int
    """Reports in the recording, one a second."""
    collections: int
    """Garbage collections of the loop, from the first report to the last; -1: unknown."""
    cpu_pressure_percent: float
    """Share of the worst second in which some task waited for a processor; NaN: unknown."""
    run_queue: int
    """Most tasks that were runnable; -1: unknown."""
    round_trip_us: float
    """Longest round trip to the device, in µs; NaN: none was reported."""
    drift_ppm: float
    """How slow the device's clock is, in parts per million, as known at the end; NaN: unknown."""
    drift_std_ppm: float
    """Standard deviation of the drift, in parts per million."""
    offset_std_us: float
    """Standard deviation of the offset between the clocks at the end, in µs."""
    held_up_ms: int = 0
    """How long the clock of an emulated rig stood still as its machine stalled, in ms."""

    def texts(self) -> dict[str, str]:
        """Return in words what was reported, by its name; nothing where nothing was."""
        found = {}
        if self.seconds and self.collections >= 0:
            found["garbage collections of the loop"] = str(self.collections)
        if not isnan(self.cpu_pressure_percent):
            share = f"{self.cpu_pressure_percent:.0f}{NBSP}%"
            found["processor wanted by others, worst second"] = share
        if self.run_queue >= 0:
            found["most tasks runnable"] = str(self.run_queue)
        if not isnan(self.round_trip_us):
            found["longest round trip"] = f"{self.round_trip_us / 1e3:.2f}{NBSP}ms"
        if not isnan(self.drift_ppm):
            drift = f"{fixed(self.drift_ppm, 1)} ± {self.drift_std_ppm:.1f}{NBSP}ppm"
            found["device's clock slow by"] = drift
            found["device's clock known to"] = f"± {self.offset_std_us:.1f}{NBSP}µs"
        if self.held_up_ms:
            found["emulator held up"] = f"{self.held_up_ms}{NBSP}ms"
        return found


def disturbances(recording: Recording) -> Disturbances:
    """Return what disturbed the timing of a recording."""
    timing, last = recording.timing, recording.clock[-1] if recording.clock else _UNKNOWN
    counted = [t.collections for t in timing if t.collections >= 0]
    collections = counted[-1] - counted[0] if counted else -1 if timing else 0
    pressures = [t.cpu_pressure_percent for t in timing if not isnan(t.cpu_pressure_percent)]
    return Disturbances(
        seconds=len(timing),
        collections=collections,
        cpu_pressure_percent=max(pressures, default=nan),
        run_queue=max((t.run_queue for t in timing), default=-1),
        round_trip_us=max(_round_trips(timing), default=nan),
        drift_ppm=last.drift_ppm,
        drift_std_ppm=last.drift_std_ppm,
        offset_std_us=last.offset_std_ns / 1e3,
        held_up_ms=sum(held_up_ms(event.message) for event in recording.events),
    )


_UNKNOWN = DeviceClock(
    t=nan, offset_ns=0, offset_std_ns=nan, drift_ppm=nan, drift_std_ppm=nan, bound_ns=nan
)


def _round_trips(timing: Sequence[Timing]) -> list[float]:
    return [t.link_round_trip_us.max for t in timing if t.link_round_trip_us.n]
