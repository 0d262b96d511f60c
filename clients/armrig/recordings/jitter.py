"""Regularity of the sampling of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan
from typing import TYPE_CHECKING

import numpy as np

from armrig.data.columns import Vector
from armrig.numerics.quantities import NBSP, with_decimals
from armrig.numerics.stretches import longest
from armrig.recordings.daemon_reports import DeviceClock

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.recordings.recording import Recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Percentiles of a time, in µs."""

    n: int
    """Number of values."""
    p50: float
    p90: float
    p99: float
    p999: float
    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingStatistics:
    """Sampling time and jitter of one recording."""

    Ts_us: float
    """Requested sampling time, in µs."""
    mean_us: float
    """Mean interval between samples on the device's clock, in µs."""
    std_us: float
    """Standard deviation of the interval, in µs."""
    least_us: float
    """Shortest interval, in µs."""
    greatest_us: float
    """Longest interval between consecutive samples, in µs."""
    jitter: Spread
    """Percentiles of |interval - Ts| on the device's clock, in µs."""
    lateness: Spread
    """Percentiles of the lateness that `lateness_us` returns, in µs."""
    samples: int
    """Number of samples that arrived."""
    missing: int
    """Number of missing samples."""
    longest_gap: int
    """Largest number of consecutive missing samples, including the run's beginning and end."""


def intervals_us(recording: Recording) -> Vector:
    """Return the times between consecutive samples, on the device's clock, in µs."""
    samples = recording.samples
    t = np.diff(samples["t_device_us"].astype(np.int64)).astype(np.float64)
    return np.asarray(t[np.diff(samples["k"].astype(np.int64)) == 1])


def jitter_us(recording: Recording) -> Vector:
    """Return |interval - Ts| of each interval between consecutive samples, in µs."""
    return np.abs(intervals_us(recording) - recording.Ts * 1e6)


def lateness_us(recording: Recording) -> Vector:
    """Return the lateness of each sample, in µs.

    If the host paces the samples, the value is the lateness of the host's request. If the device
    paces the samples, the value is the lateness of the sample's arrival.
    """
    samples = recording.samples
    return np.asarray((samples["t_host_ns"] - samples["t_sched_ns"]) / 1e3)


def sampling_statistics(recording: Recording) -> SamplingStatistics:
    """Return sampling time and jitter of a recording.

    Parameters
    ----------
    recording : Recording
        Recording to examine; an interval is used if both of its samples arrived.

    Returns
    -------
    SamplingStatistics
        Times in µs, and numbers of samples. Times are NaN if there are too few samples.

    Examples
    --------
    >>> found = armrig.sampling_statistics(armrig.example_recording())
    >>> found.mean_us, found.std_us, found.missing
    (10000.0, 0.0, 0)
    """
    t = intervals_us(recording)
    some = t if t.size else np.full(1, np.nan)
    return SamplingStatistics(
        Ts_us=recording.Ts * 1e6,
        mean_us=float(some.mean()),
        std_us=float(some.std(ddof=1)) if t.size > 1 else float("nan"),
        least_us=float(some.min()),
        greatest_us=float(some.max()),
        jitter=_spread(jitter_us(recording)),
        lateness=_spread(lateness_us(recording)),
        samples=int(recording.samples.size),
        missing=recording.missing,
        longest_gap=longest(~recording.present),
    )


def angle_of_jitter(timing: SamplingStatistics, data: Dataset) -> float:
    """Return the error of an angle due to jitter of its sampling times.

    The error, in the unit of the data, is the product of the standard deviation of the interval and
    `fastest_rate`.
    """
    return timing.std_us * 1e-6 * fastest_rate(data)


def fastest_rate(data: Dataset) -> float:
    """Return the 99th percentile of the absolute rate of y, in y's unit per s."""
    return float(np.nanpercentile(np.abs(np.diff(data.y)) / data.Ts, 99))


def _spread(x: Vector) -> Spread:
    if not x.size:
        return Spread(n=0, p50=np.nan, p90=np.nan, p99=np.nan, p999=np.nan, max=np.nan)
    p50, p90, p99, p999 = (float(v) for v in np.percentile(x, (50, 90, 99, 99.9)))
    return Spread(n=x.size, p50=p50, p90=p90, p99=p99, p999=p999, max=float(x.max()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbances:
    """Load of the host, and drift of the device's clock, during a recording."""

    seconds: int
    """Number of reports in the recording, one per second."""
    collections: int
    """Number of garbage collections between the first report and the last; -1: unknown."""
    cpu_pressure_percent: float
    """Largest part of a second in which a task waited for a processor, in %; NaN: unknown."""
    run_queue: int
    """Largest number of runnable tasks; -1: unknown."""
    round_trip_us: float
    """Longest round trip to the device, in µs; NaN without a report."""
    drift_ppm: float
    """Drift at the end of the recording, in ppm; positive if the device's clock is slow."""
    drift_std_ppm: float
    """Standard deviation of the drift, in parts per million."""
    offset_std_us: float
    """Standard deviation of the offset between the clocks at the end, in µs."""
    held_up_ms: int = 0
    """Time for which an emulated rig's clock stopped because its computer stalled, in ms."""

    def texts(self) -> dict[str, str]:
        """Return the reported disturbances as text with units, by the name of the disturbance."""
        facts = {}
        if self.seconds and self.collections >= 0:
            facts["garbage collections of the loop"] = str(self.collections)
        if not isnan(self.cpu_pressure_percent):
            share = f"{self.cpu_pressure_percent:.0f}{NBSP}%"
            facts["processor wanted by others, worst second"] = share
        if self.run_queue >= 0:
            facts["most tasks runnable"] = str(self.run_queue)
        if not isnan(self.round_trip_us):
            facts["longest round trip"] = f"{self.round_trip_us / 1e3:.2f}{NBSP}ms"
        if not isnan(self.drift_ppm):
            drift = f"{with_decimals(self.drift_ppm, 1)} ± {self.drift_std_ppm:.1f}{NBSP}ppm"
            facts["device's clock slow by"] = drift
            facts["device's clock known to"] = f"± {self.offset_std_us:.1f}{NBSP}µs"
        if self.held_up_ms:
            facts["emulator held up"] = f"{self.held_up_ms}{NBSP}ms"
        return facts


def disturbances(recording: Recording) -> Disturbances:
    """Return the disturbances of a recording's timing."""
    timing, last = recording.timing, recording.clock[-1] if recording.clock else _UNKNOWN_CLOCK
    counted = [t.collections for t in timing if t.collections >= 0]
    collections = counted[-1] - counted[0] if counted else -1 if timing else 0
    trips = [t.link_round_trip_us.max for t in timing if t.link_round_trip_us.n]
    pressures = [t.cpu_pressure_percent for t in timing if not isnan(t.cpu_pressure_percent)]
    return Disturbances(
        seconds=len(timing),
        collections=collections,
        cpu_pressure_percent=max(pressures, default=nan),
        run_queue=max((t.run_queue for t in timing), default=-1),
        round_trip_us=max(trips, default=nan),
        drift_ppm=last.drift_ppm,
        drift_std_ppm=last.drift_std_ppm,
        offset_std_us=last.offset_std_ns / 1e3,
        held_up_ms=round(sum(event.emulator_stall_ns for event in recording.events) / 1e6),
    )


_UNKNOWN_CLOCK = DeviceClock(
    t=nan, offset_ns=0, offset_std_ns=nan, drift_ppm=nan, drift_std_ppm=nan, bound_ns=nan
)
