"""A potentiometer that stands still: its mean reading, its noise, the converter's step."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from armrig_core.calibration import Figure
from numpy.typing import NDArray

Vector = NDArray[np.float64]

RAIL_COUNTS = 64
"""The lowest and the highest 1/1024 of 65536 are rails (PROTOCOL.md, section 7)."""
FULL_COUNTS = 65536
_HARMONICS = np.arange(1.0, 101.0)


def resolution(*counts: Vector) -> int:
    """Return the converter's step in counts: what all the readings are multiples of."""
    return max(1, int(np.gcd.reduce(np.concatenate(counts).astype(np.int64))))


def rounding_variance(step: float, noise: float) -> float:
    """Return the variance of a mean reading about the true voltage, after endless averaging.

    A converter that rounds shows a constant voltage with an error that is periodic in the voltage;
    noise before the rounding smooths it. For a voltage anywhere in a step, noise of standard
    deviation sigma leaves::

        step² / (2 pi²) · sum over k >= 1 of exp(-(2 pi k sigma / step)²) / k²

    which is step² / 12 without noise, and nothing from half a step of noise on.

    Parameters
    ----------
    step, noise : float
        The converter's step and the noise's standard deviation before the rounding, in counts.

    References
    ----------
    .. [1] B. Widrow and I. Kollár, *Quantization Noise*, 2008, chapter 19 (dither).
    """
    terms = np.exp(-((2 * pi * _HARMONICS * noise / step) ** 2)) / _HARMONICS**2
    return float(step**2 / (2 * pi**2) * terms.sum())


def mean_reading(counts: Vector, step: float, noise: float) -> Figure:
    """Return the mean of readings at rest, with the converter's rounding in its deviation."""
    variance = np.var(counts, ddof=1) / counts.size + rounding_variance(step, noise)
    return Figure(value=float(counts.mean()), std=sqrt(float(variance)))


def spread(counts: Vector, step: float) -> Figure:
    """Return the standard deviation of N readings at rest, and its own.

    The variance s² has itself the variance (m_4 - s⁴) / N, m_4 the fourth central moment. Where
    the noise is small beside the step, that rests on the few readings that differ, if there are
    any; so one reading more or less, a step away, is allowed for: step² / N in s².
    """
    N = counts.size
    deviations = counts - counts.mean()
    variance = float(np.var(counts, ddof=1))
    of_moments = max(float(np.mean(deviations**4)) - variance**2, 0.0) / N
    of_variance = sqrt(of_moments + (step**2 / N) ** 2)
    s = sqrt(variance)
    return Figure(value=s, std=of_variance / (s + sqrt(variance + of_variance)))


def noise_before_rounding(variance: float, step: float) -> float:
    """Return the noise's standard deviation where rounding added step² / 12 to its variance."""
    return sqrt(max(variance - step**2 / 12, 0.0))


def at_rail(counts: Vector) -> NDArray[np.bool_]:
    """Return which readings are at an end of the converter's range."""
    return np.asarray((counts < RAIL_COUNTS) | (counts >= FULL_COUNTS - RAIL_COUNTS))
