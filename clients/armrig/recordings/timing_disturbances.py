"""What disturbed the timing of a recording, from the reports that the daemon made each second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan
from typing import TYPE_CHECKING

from armrig.recordings.daemon_reports import DeviceClock, Timing

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbances:
    """What the host did meanwhile, and how the device's clock ran."""

    seconds: int
    """Reports in the recording, one a second."""
    collections: int
    """Garbage collections of the loop, from the first report to the last."""
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


def disturbances(recording: Recording) -> Disturbances:
    """Return what disturbed the timing of a recording."""
    timing, last = recording.timing, recording.clock[-1] if recording.clock else _UNKNOWN
    pressures = [t.cpu_pressure_percent for t in timing if not isnan(t.cpu_pressure_percent)]
    return Disturbances(
        seconds=len(timing),
        collections=timing[-1].collections - timing[0].collections if timing else 0,
        cpu_pressure_percent=max(pressures, default=nan),
        run_queue=max((t.run_queue for t in timing), default=-1),
        round_trip_us=max(_round_trips(timing), default=nan),
        drift_ppm=last.drift_ppm,
        drift_std_ppm=last.drift_std_ppm,
        offset_std_us=last.offset_std_ns / 1e3,
    )


_UNKNOWN = DeviceClock(
    t=nan, offset_ns=0, offset_std_ns=nan, drift_ppm=nan, drift_std_ppm=nan, bound_ns=nan
)


def _round_trips(timing: Sequence[Timing]) -> list[float]:
    return [t.link_round_trip_us.max for t in timing if t.link_round_trip_us.n]


def disturbance_rows(found: Disturbances) -> list[tuple[str, str]]:
    """Return what was found as rows of a name and a sentence; none where nothing was reported."""
    rows = []
    if found.seconds:
        parts = [f"{found.collections or 'no'} garbage collections of the loop"]
        if not isnan(found.cpu_pressure_percent):
            parts.append(
                f"processor wanted by others up to {found.cpu_pressure_percent:.0f} % of a second"
            )
        if found.run_queue >= 0:
            parts.append(f"at most {found.run_queue} tasks runnable")
        if not isnan(found.round_trip_us):
            parts.append(f"longest round trip {found.round_trip_us / 1e3:.2f} ms")
        rows.append(("disturbances", ", ".join(parts)))
    if not isnan(found.drift_ppm):
        way = "slow" if found.drift_ppm > 0 else "fast"
        rows.append(
            (
                "device clock",
                f"{abs(found.drift_ppm):.1f} ± {found.drift_std_ppm:.1f} ppm {way} against the "
                f"host's; offset known to ± {found.offset_std_us:.1f} µs",
            )
        )
    return rows
