"""How regularly a recording was sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.stretches import longest

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.recordings.recording import Recording

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Percentiles of a time, in µs."""

    n: int
    """How many there were."""
    p50: float
    p90: float
    p99: float
    p999: float
    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingStatistics:
    """Sampling time and jitter of one recording."""

    Ts_us: float
    """Sampling time asked for, in µs."""
    mean_us: float
    """Mean interval between samples on the device's clock, in µs."""
    std_us: float
    """Standard deviation of the interval, in µs."""
    least_us: float
    """Shortest interval, in µs."""
    greatest_us: float
    """Longest interval between samples that follow each other, in µs."""
    jitter: Spread
    """|interval - Ts| on the device's clock, in µs."""
    lateness: Spread
    """When the host asked (exchange) or had it (scheduled), less when it was due, in µs."""
    samples: int
    """Samples that came."""
    missing: int
    """Samples that did not."""
    longest_gap: int
    """Most samples missing in a row, those before the first and after the last that came too."""


def intervals_us(recording: Recording) -> Vector:
    """Return the times between samples that follow each other, on the device's clock, in µs."""
    samples = recording.samples
    t = np.diff(samples["t_device_us"].astype(np.int64)).astype(np.float64)
    return np.asarray(t[np.diff(samples["k"].astype(np.int64)) == 1])


def jitter_us(recording: Recording) -> Vector:
    """Return |interval - Ts| of each interval, in µs."""
    return np.abs(intervals_us(recording) - recording.Ts * 1e6)


def lateness_us(recording: Recording) -> Vector:
    """Return how late the host asked for each sample, or had it where the device paced, in µs."""
    samples = recording.samples
    return np.asarray((samples["t_host_ns"] - samples["t_sched_ns"]) / 1e3)


def sampling_statistics(recording: Recording) -> SamplingStatistics:
    """Return sampling time and jitter of a recording.

    Parameters
    ----------
    recording : Recording
        Its intervals count where neither sample is missing.

    Returns
    -------
    SamplingStatistics
        Times in µs, NaN where there are too few samples, and counts of samples.
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
    """Return what the jitter can have done to an angle: it is read at another time than k Ts.

    Standard deviation of the interval times the rate that 99 % of the data stay below, in the
    data's unit.
    """
    return timing.std_us * 1e-6 * fastest_rate(data)


def fastest_rate(data: Dataset) -> float:
    """Return the rate of y that 99 % of its differences stay below, in y's unit per s."""
    return float(np.nanpercentile(np.abs(np.diff(data.y)) / data.Ts, 99))


def _spread(x: Vector) -> Spread:
    if not x.size:
        return Spread(n=0, p50=np.nan, p90=np.nan, p99=np.nan, p999=np.nan, max=np.nan)
    p50, p90, p99, p999 = (float(v) for v in np.percentile(x, (50, 90, 99, 99.9)))
    return Spread(n=x.size, p50=p50, p90=p90, p99=p99, p999=p999, max=float(x.max()))
