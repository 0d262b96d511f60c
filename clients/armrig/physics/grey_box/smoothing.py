"""Velocity and acceleration from sampled angles, by a smoothing kernel without phase lag.

The kernel is the bell g(t) = c (1 - (t/T)²)^8, |t| < T, with the standard deviation
s = T / sqrt(19). Smoothed derivatives are convolutions with derivatives of the kernel::

    y_f = g * y,    y_f' = g' * y,    y_f'' = g'' * y,    u_f = g * u  (exact for a held input)

A linear equation between y', y'' and u also holds between the smoothed signals. The smoothing
causes no phase lag and needs no differences of noisy samples. At the ends of the bell g, g' and g''
are 0, so that sums over samples are close to the integrals.

The module also tests whether residuals are white noise on the output, coloured by the kernel.
White noise v that is smoothed by a kernel h and decimated by m becomes e, with the autocorrelation
rho ::

    e(i) = sum of h(k) v(i m - k),    rho(j) = sum of h(k) h(k + j m) / sum of h(k)²

Bartlett's formula gives the covariance of the sample autocorrelations r_j of n values of e ::

    n cov(r_j, r_k) = sum over l = 1, 2, … of b_j(l) b_k(l),
    b_j(l) = rho(l + j) + rho(l - j) - 2 rho(j) rho(l)

References
----------
.. [1] P. J. Brockwell, R. A. Davis, *Time Series: Theory and Methods*, 2nd ed., 1991, section 7.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from armrig.data.columns import Vector
from armrig.data.dataset import Dataset
from armrig.numerics.whiteness import autocovariance, default_lags, joined, portmanteau_p_value

_BELL = Polynomial([1.0, 0.0, -1.0]) ** 8
_REACH = 19**0.5  # ratio T / s
MIN_WIDTH = 1.25
"""Least s of the kernel, in samples; from this s on, sums equal integrals to about 1e-6."""
_MIN_FFT_SAMPLES = 500  # kernels of this length or longer are convolved by FFT
_MIN_PAIR_SHARE = 0.5  # least number of pairs at a lag, as a share of the pairs at lag 0
# Least standard deviation of the used linear combinations of the r_j, as a share of the largest.
# Bartlett's formula is the first term of an expansion. For combinations below this limit, the
# second term is as large. With them, a test at the 1 % level rejects 2.5 % of true hypotheses.
_MIN_DEVIATION_SHARE = 0.2
_MIN_SPEED_SHARE = 0.05  # share of the rms speed; below it, the sign is not trusted
_STOP_WIDTHS = 2.0  # longest time to a stop at the rms acceleration, in widths of the kernel

SMOOTHED_NOISE = "test of smoothed noise"


def reach(s: float, Ts: float) -> int:
    """Return the number of samples that a kernel of standard deviation s uses on each side."""
    return int(np.ceil(_REACH * s / Ts))


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothed:
    """Smoothed signals of one experiment; NaN where the kernel needs samples that are missing."""

    velocity: Vector
    """Velocity (N,), in y's unit per s."""
    acceleration: Vector
    """Acceleration (N,), in y's unit per s²."""
    u: Vector
    """Input (N,), in u's unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kernels:
    """Convolution kernels, (2 reach + 1,) each."""

    first: Vector
    """Kernel of the velocity."""
    second: Vector
    """Kernel of the acceleration."""
    held: Vector
    """Kernel of the input, which is held between samples."""


def kernels(s: float, Ts: float) -> Kernels:
    """Return the kernels for a standard deviation s and the sampling time Ts, both in seconds."""
    T, m = _REACH * s, reach(s, Ts)
    x = np.clip(Ts * np.arange(-m, m + 2) / T, -1.0, 1.0)
    area = _BELL.integ()
    c = area(1.0) - area(-1.0)
    held = np.diff(area(np.clip(x - Ts / T, -1.0, 1.0))) / c
    t = T * x[:-1]
    first = _BELL.deriv()(x[:-1]) * Ts / (c * T**2)
    second = _BELL.deriv(2)(x[:-1]) * Ts / (c * T**3)
    # Make the kernels exact for constants and lines: an angle of many radians must cause no error
    # as large as the noise of 1 mrad.
    first /= -(first @ t)
    second -= second.mean()
    return Kernels(first=first, second=second, held=held)


def smoothed(data: Dataset, s: float) -> Smoothed:
    """Return smoothed signals of one experiment for a kernel of standard deviation s seconds."""
    k = kernels(s, data.Ts)
    y = np.where(data.valid, data.y, 0.0)
    there = _through((~data.valid).astype(np.float64), np.ones_like(k.first)) < 0.5
    velocity, acceleration, u = (
        np.where(there, _through(x, kernel), np.nan)
        for x, kernel in ((y, k.first), (y, k.second), (data.u, k.held))
    )
    return Smoothed(velocity=velocity, acceleration=acceleration, u=u)


def _through(x: Vector, kernel: Vector) -> Vector:
    """Return sum_m kernel(m) x(i - m), NaN if the window is not inside the signal."""
    whole = np.full(x.size, np.nan)
    m = kernel.size // 2
    if x.size >= kernel.size:
        convolve = np.convolve if kernel.size < _MIN_FFT_SAMPLES else oaconvolve
        whole[m : x.size - m] = convolve(x, kernel, mode="valid")
    return whole


def near_standstill(part: Dataset, s: float) -> NDArray[np.bool_]:
    """Return a mask of the windows that contain an instant at which the chassis may be at rest."""
    # A narrower kernel is used, because the wide kernel would hide short stops.
    width = max(s / 4, MIN_WIDTH * part.Ts)
    v = smoothed(part, width).velocity
    # The chassis may stop for less than the kernel's width, and turn between two samples.
    within = _STOP_WIDTHS * width * _effective(smoothed(part, s).acceleration)
    least = max(_MIN_SPEED_SHARE * _effective(v), within)
    turns = np.append(v[:-1] * v[1:] < 0, False)
    slow = ((np.abs(v) < least) | turns).astype(np.float64)
    m = reach(s, part.Ts) + reach(width, part.Ts)
    return np.asarray(np.convolve(slow, np.ones(2 * m + 1))[m:][: part.N] > 0.5)


def _effective(x: Vector) -> float:
    known = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def smoothed_noise_p_value(residuals: Sequence[Vector], h: Vector, m: int) -> float:
    """Return the p value of the hypothesis that residuals are smoothed white noise.

    A lag has enough pairs of known residuals if it has at least half as many pairs as lag 0. All
    lags before the first lag without enough pairs are used. If no lag is left, the result is NaN.

    The statistic has the mean of chi-squared but a larger variance, because all r_j are divided by
    the same R(0). `portmanteau_p_value` needs the number N of white residuals that would give R(0)
    the same relative uncertainty. From n residuals, N = n / sum of rho(j)² over all j.

    The residuals of each experiment are NaN where they are not known. h is the kernel of the noise,
    and m is the decimation, the number of samples per residual.
    """
    L = default_lags(sum(int(np.count_nonzero(np.isfinite(e))) for e in residuals))
    R, pairs = autocovariance(joined(residuals, L), L)
    # Bartlett's formula is for values without gaps; it does not hold if many pairs are missing.
    L = int(np.argmax(np.append(pairs < _MIN_PAIR_SHARE * pairs[0], True))) - 1
    if L < 1 or not R[0] > 0:
        return float("nan")
    R, pairs = R[: L + 1], pairs[: L + 1]
    half = np.correlate(h, h, "full")[h.size - 1 :: m] / (h @ h)
    reach = L + half.size
    rho = np.zeros(2 * (reach + L) + 1)
    at = reach + L  # index of lag 0
    rho[at : at + half.size] = half
    rho[at - half.size + 1 : at + 1] = half[::-1]
    j, lag = np.arange(1, L + 1)[:, None], np.arange(1, reach + 1)
    b = rho[at + lag + j] + rho[at + lag - j] - 2 * rho[at + j] * rho[at + lag]
    U, deviation, _ = np.linalg.svd(b, full_matrices=False)
    off = np.sqrt(pairs[1:]) * (R[1:] / R[0] - rho[at + 1 : at + L + 1])
    seen = deviation > _MIN_DEVIATION_SHARE * deviation[0]
    z = (U.T @ off)[seen] / deviation[seen]
    as_white = pairs[0] / (2 * float(half @ half) - 1)
    return portmanteau_p_value(float(z @ z), int(np.count_nonzero(seen)), as_white)
