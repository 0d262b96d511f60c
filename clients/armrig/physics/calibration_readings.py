"""Raw samples from which a calibration is estimated, and their form as a gzipped CSV."""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from dataclasses import dataclass
from io import StringIO
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.calibration import MeasuredValue
from armrig_core.telemetry.channels import CHANNELS
from numpy.typing import NDArray

from armrig.data.columns import Vector

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


MOST_ROWS = 50_000
"""Largest number of rows of the gzipped CSV; with this number, it has less than 1 MiB."""
_COUNTS = tuple(channel.counts_field for channel in CHANNELS)
_HEADING = ",".join(("recording", "t_device_us", "u_v", *_COUNTS))
RAIL_COUNTS = 64
"""Width of each rail, in counts: 1/1024 of the converter's range (PROTOCOL.md, section 7)."""
FULL_COUNTS = 65536
_HARMONICS = np.arange(1.0, 101.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings:
    """Raw readings of the samples that arrived."""

    t: Vector
    """Times of `first` on the device's clock, in s from the first reading, (N,)."""
    u: Vector
    """Voltages of the codes that the device held from `t` on, in V, (N,)."""
    first: Vector
    """Counts of the first channel's potentiometer, (N,)."""
    second: Vector
    """Counts of the second channel's potentiometer, (N,)."""

    def __post_init__(self) -> None:
        """Refuse empty columns, and columns of different lengths."""
        sizes = {column.size for column in (self.t, self.u, self.first, self.second)}
        if len(sizes) != 1 or 0 in sizes:
            counts = ", ".join(map(str, sorted(sizes)))
            raise InputError(
                f"columns of {counts} samples: all four must have the same number, and at least 1"
            )

    @property
    def N(self) -> int:
        """Number of samples."""
        return int(self.t.size)


def readings_of(source: Recording | Readings) -> Readings:
    """Return the raw readings of a recording."""
    if isinstance(source, Readings):
        return source
    samples = source.samples
    if not samples.size:
        raise InputError(f"{source.path}: contains no samples: record again")
    t_us = samples["t_device_us"].astype(np.int64)
    return Readings(
        t=np.asarray((t_us - t_us[0]) * 1e-6, dtype=np.float64),
        u=samples["u_applied_v"].astype(np.float64),
        first=samples[_COUNTS[0]].astype(np.float64),
        second=samples[_COUNTS[1]].astype(np.float64),
    )


def compress_readings(sources: Mapping[str, Recording | Readings]) -> bytes:
    """Return the readings as a gzipped CSV; equal readings give equal bytes.

    Raises InputError if there are more than `MOST_ROWS` rows.
    """
    out = StringIO()
    out.write(_HEADING + "\n")
    rows = 0
    for name, source in sources.items():
        readings = readings_of(source)
        rows += readings.N
        if rows > MOST_ROWS:
            raise InputError(
                f"more than {MOST_ROWS} samples: shorten the runs, or take a longer --Ts"
            )
        t_us = np.rint(readings.t * 1e6).astype(np.int64)
        columns = (t_us, readings.u, readings.first, readings.second)
        for t, u, first, second in zip(*(c.tolist() for c in columns), strict=True):
            out.write(f"{name},{t},{u!r},{first:.0f},{second:.0f}\n")
    return gzip.compress(out.getvalue().encode(), mtime=0)


def resolution(*counts: Vector) -> int:
    """Return the converter's step in counts, the greatest common divisor of the readings."""
    return max(1, int(np.gcd.reduce(np.concatenate(counts).astype(np.int64))))


def rounding_variance(step: float, noise: float) -> float:
    """Return the variance that rounding adds to a mean of infinitely many readings.

    The error of rounding a constant voltage is periodic in the voltage. Noise before the rounding
    reduces the mean error. Let the voltage be uniformly distributed over a step, and let sigma be
    the standard deviation of the noise. The variance of the mean error is then::

        step² / (2 pi²) · sum over k >= 1 of exp(-(2 pi k sigma / step)²) / k²

    Without noise, this variance is step² / 12. With a noise of half a step or more, this variance
    is almost 0. The step of the converter and the deviation `noise` are in counts.

    References
    ----------
    .. [1] B. Widrow and I. Kollár, *Quantization Noise*, 2008, chapter 19 (dither).
    """
    terms = np.exp(-((2 * pi * _HARMONICS * noise / step) ** 2)) / _HARMONICS**2
    return float(step**2 / (2 * pi**2) * terms.sum())


def mean_reading(counts: Vector, step: float, noise: float) -> MeasuredValue:
    """Return the mean of readings at rest; its standard deviation includes the rounding."""
    variance = np.var(counts, ddof=1) / counts.size + rounding_variance(step, noise)
    return MeasuredValue(value=float(counts.mean()), std=sqrt(float(variance)))


def spread(counts: Vector, step: float) -> MeasuredValue:
    """Return the standard deviation of N readings at rest, and the standard error of this estimate.

    The estimated variance s² has the variance (m_4 - s⁴) / N, with m_4 the fourth central moment.
    If the noise is small compared with the step, few or no readings differ. The standard deviation
    of s² therefore contains the term step² / N, the effect of a single reading that differs by one
    step.
    """
    N = counts.size
    deviations = counts - counts.mean()
    variance = float(np.var(counts, ddof=1))
    of_moments = max(float(np.mean(deviations**4)) - variance**2, 0.0) / N
    of_variance = sqrt(of_moments + (step**2 / N) ** 2)
    s = sqrt(variance)
    return MeasuredValue(value=s, std=of_variance / (s + sqrt(variance + of_variance)))


def noise_before_rounding(variance: float, step: float) -> float:
    """Return the noise's standard deviation from a variance that includes rounding (step² / 12)."""
    return sqrt(max(variance - step**2 / 12, 0.0))


def at_rail(counts: Vector) -> NDArray[np.bool_]:
    """Return a mask of the readings that are at an end of the converter's range."""
    return np.asarray((counts < RAIL_COUNTS) | (counts >= FULL_COUNTS - RAIL_COUNTS))
