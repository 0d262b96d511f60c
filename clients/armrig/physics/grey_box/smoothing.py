"""Position, velocity and acceleration from sampled angles, by a zero-phase smoothing kernel.

With the bell g(t) = c (1 - (t/T)²)^8, |t| < T, of standard deviation s = T / sqrt(19) the smoothed
derivatives are those of the kernel::

    y_f = g * y,    y_f' = g' * y,    y_f'' = g'' * y,    u_f = g * u  (exact for a held input)

so that whatever linear equation holds between y', y'' and u also holds between the smoothed ones,
without phase lag and without differences of noisy numbers. The bell ends smoothly, so that sums
over samples are as good as integrals, and nothing is cut off that would differ between g, g', g''.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from armrig.data.dataset import Dataset

Vector = NDArray[np.float64]

_BELL = Polynomial([1.0, 0.0, -1.0]) ** 8
_REACH = 19**0.5  # T / s
LEAST_WIDTH = 1.25
"""Least s in samples: sums over samples then equal integrals to 1e-6 or so."""
_LONG = 500  # samples; a longer kernel is applied by FFT, which is faster then


def reach(s: float, Ts: float) -> int:
    """Return how many samples to either side a kernel of standard deviation s sees."""
    return int(np.ceil(_REACH * s / Ts))


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothed:
    """One experiment after the kernel, NaN where its window meets an end or a missing sample."""

    velocity: Vector
    """(N,), in y's unit per s."""
    acceleration: Vector
    """(N,), in y's unit per s²."""
    u: Vector
    """(N,), in u's unit."""
    reach: int
    """Samples that the kernel sees to either side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kernels:
    """What a signal is convolved with, (2 reach + 1,) each."""

    first: Vector
    """Gives the smoothed velocity."""
    second: Vector
    """Gives the smoothed acceleration."""
    held: Vector
    """Smooths a held input."""
    reach: int
    """Samples to either side."""


def kernels(s: float, Ts: float) -> Kernels:
    """Return the kernels of standard deviation s for the sampling time Ts, both in s."""
    T, m = _REACH * s, reach(s, Ts)
    x = np.clip(Ts * np.arange(-m, m + 2) / T, -1.0, 1.0)
    area = _BELL.integ()
    c = area(1.0) - area(-1.0)
    held = np.diff(area(np.clip(x - Ts / T, -1.0, 1.0))) / c
    t = T * x[:-1]
    first = _BELL.deriv()(x[:-1]) * Ts / (c * T**2)
    second = _BELL.deriv(2)(x[:-1]) * Ts / (c * T**3)
    # Exact on constants and lines: a turn is 6 rad, the noise 1 mrad.
    first /= -(first @ t)
    second -= second.mean()
    return Kernels(first=first, second=second, held=held, reach=m)


def smoothed(data: Dataset, s: float) -> Smoothed:
    """Return the smoothed signals of one experiment for a kernel of standard deviation s, in s."""
    k = kernels(s, data.Ts)
    y = np.where(data.valid, data.y, 0.0)
    there = _through((~data.valid).astype(np.float64), np.ones_like(k.first)) < 0.5
    velocity, acceleration, u = (
        np.where(there, _through(x, kernel), np.nan)
        for x, kernel in ((y, k.first), (y, k.second), (data.u, k.held))
    )
    return Smoothed(velocity=velocity, acceleration=acceleration, u=u, reach=k.reach)


def _through(x: Vector, kernel: Vector) -> Vector:
    """Return sum_m kernel(m) x(i - m), NaN where the window does not lie inside."""
    whole = np.full(x.size, np.nan)
    m = kernel.size // 2
    if x.size >= kernel.size:
        convolve = np.convolve if kernel.size < _LONG else oaconvolve
        whole[m : x.size - m] = convolve(x, kernel, mode="valid")
    return whole
