"""Position, velocity and acceleration from sampled angles, by a zero-phase smoothing kernel.

With the bell g(t) = c (1 - (t/T)²)^8, |t| < T, of standard deviation s = T / sqrt(19) the smoothed
derivatives are those of the kernel::

    y_f = g * y,    y_f' = g' * y,    y_f'' = g'' * y,    u_f = g * u  (exact for a held input)

so that whatever linear equation holds between y', y'' and u also holds between the smoothed ones,
without phase lag and without differences of noisy numbers. The bell ends smoothly, so that sums
over samples are as good as integrals, and nothing is cut off that would differ between g, g', g''.

Whether residuals are white noise of the output as a smoothing kernel has coloured it.

Smoothed and thinned out, white noise v has the autocorrelation of its kernel h, in steps of m ::

    e(i) = sum of h(k) v(i m - k),    rho(j) = sum of h(k) h(k + j m) / sum of h(k)²

and the sample autocorrelation of n such values is off by as much as Bartlett's formula says ::

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

from armrig.data.dataset import Dataset
from armrig.numerics.whiteness import autocovariance, default_lags, joined, portmanteau_p_value

Vector = NDArray[np.float64]

_BELL = Polynomial([1.0, 0.0, -1.0]) ** 8
_REACH = 19**0.5  # T / s
LEAST_WIDTH = 1.25
"""Least s in samples: sums over samples then equal integrals to 1e-6 or so."""
_LONG = 500  # samples; a longer kernel is applied by FFT, which is faster then
_ENOUGH = 0.5  # share of the values that have a partner at a lag
# Share of the largest deviation below which a direction is left out: in those the next term of the
# expansion that Bartlett's formula begins is as large, and raises 1 % to 2.5.
_SEEN = 0.2
_SLOW = 0.05  # share of the effective speed below which its sign is not trusted
_STOPS = 2.0  # widths of the kernel in which it is taken to stop, at its effective acceleration

SMOOTHED_NOISE = "test of smoothed noise"


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


def near_standstill(part: Dataset, s: float, reach: int) -> NDArray[np.bool_]:
    """Return where the kernel's window touches an instant at which the chassis may stand still."""
    # A narrower kernel, or the short stops would be smoothed away.
    width = max(s / 4, LEAST_WIDTH * part.Ts)
    fine = smoothed(part, width)
    v = fine.velocity
    # It may stop for less than the kernel's width, and turn between two samples.
    within = _STOPS * width * _effective(smoothed(part, s).acceleration)
    least = max(_SLOW * _effective(v), within)
    turns = np.append(v[:-1] * v[1:] < 0, False)
    slow = ((np.abs(v) < least) | turns).astype(np.float64)
    window = np.ones(2 * (reach + fine.reach) + 1)
    return np.asarray(np.convolve(slow, window)[reach + fine.reach :][: part.N] > 0.5)


def _effective(x: Vector) -> float:
    known = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def smoothed_noise_p_value(residuals: Sequence[Vector], h: Vector, m: int) -> float:
    """Return the p value of residuals (NaN where there are none) that are such noise.

    Lags at which fewer than half of the values have a partner are left out; NaN if all are.

    The statistic has the mean of chi-squared, but a larger variance, since all r_j are divided by
    the same R(0). It is taken as `portmanteau_p_value` takes one of so many white values as have
    an R(0) as uncertain: n / sum of rho(j)² over all j.
    """
    L = default_lags(sum(int(np.count_nonzero(np.isfinite(e))) for e in residuals))
    R, pairs = autocovariance(joined(residuals, L), L)
    # Bartlett's formula is for values in a row: where many lags meet gaps it does not hold.
    L = int(np.argmax(np.append(pairs < _ENOUGH * pairs[0], True))) - 1
    if L < 1 or not R[0] > 0:
        return float("nan")
    R, pairs = R[: L + 1], pairs[: L + 1]
    half = np.correlate(h, h, "full")[h.size - 1 :: m] / (h @ h)
    reach = L + half.size
    rho = np.zeros(2 * (reach + L) + 1)
    at = reach + L  # where lag 0 stands
    rho[at : at + half.size] = half
    rho[at - half.size + 1 : at + 1] = half[::-1]
    j, lag = np.arange(1, L + 1)[:, None], np.arange(1, reach + 1)
    b = rho[at + lag + j] + rho[at + lag - j] - 2 * rho[at + j] * rho[at + lag]
    U, deviation, _ = np.linalg.svd(b, full_matrices=False)
    off = np.sqrt(pairs[1:]) * (R[1:] / R[0] - rho[at + 1 : at + L + 1])
    seen = deviation > _SEEN * deviation[0]
    z = (U.T @ off)[seen] / deviation[seen]
    as_white = pairs[0] / (2 * float(half @ half) - 1)
    return portmanteau_p_value(float(z @ z), int(np.count_nonzero(seen)), as_white)
