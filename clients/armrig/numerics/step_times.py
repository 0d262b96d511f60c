"""The times by which an answer to a step is told, each defined here alone.

Of an answer y(t) with the final value 1 and the dead time L::

    63 % time        the first t with y(t) = 1 - 1/e, less L
    equivalent time  the integral of 1 - y(t), less L: how far the integral of y lags its ramp
    slowest pole     1/min |Re s|, the time in which the mode that lasts longest falls to 1/e

Of a first-order system all three are its time constant; of any other they differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

SHARE = 1 - 1 / np.e


def rise_time(y: Vector, Ts: float, *, integrated: bool = False, share: float = SHARE) -> float:
    """Return when an answer first reaches a share of its final value, in s; NaN where it never is.

    Between the samples the answer is a cubic spline: a straight line would be late by up to
    Ts²/8 y''/y'.

    Parameters
    ----------
    y : ndarray, shape (N,)
        The answer over its final value, from the sample on after which the input acts.
    integrated : bool
        `y` is the integral of the answer, such as an angle whose rate is looked at.
    """
    from scipy.interpolate import CubicSpline, PPoly

    if y.size < 2 or not np.isfinite(y).all():
        return float("nan")
    t = Ts * np.arange(y.size)
    # An integral begins at rest; what the answer itself begins with is not known.
    ends = ((1, 0.0), "not-a-knot") if integrated and y.size > 2 else "not-a-knot"
    curve = CubicSpline(t, y, bc_type=ends)
    answer = curve.derivative() if integrated else curve
    if float(answer(0.0)) >= share:
        return 0.0
    # Up to the first sample that is there: to solve all pieces takes as long as all else.
    there = np.flatnonzero(answer.c[-1] >= share)
    if there.size:
        answer = PPoly(answer.c[:, : there[0] + 1], answer.x[: there[0] + 2])
    reached = answer.solve(share, extrapolate=False)
    reached = reached[np.isfinite(reached)]
    return float(reached[0]) if reached.size else float("nan")


def linear_crossing(t: Vector, y: Vector, level: float) -> float:
    """Return when samples first reach a level, by straight lines from (0, 0) on; NaN for never."""
    reached = np.flatnonzero(y >= level)
    if reached.size == 0:
        return float("nan")
    i = int(reached[0])
    if i == 0:
        return float(t[0] * level / y[0])
    return float(t[i - 1] + (t[i] - t[i - 1]) * (level - y[i - 1]) / (y[i] - y[i - 1]))


def ramp_lag(t: Vector, y: Vector) -> float:
    """Return where the straight line through samples of a ramp meets 0: its equivalent time."""
    slope, level = np.polyfit(t, y, 1)
    return float(-level / slope) if slope else float("nan")


def mean_lag(B: Vector, F: Vector) -> float:
    """Return sum k g(k) / sum g(k) of the impulse response g of B(q)/F(q), in samples.

    The sum over all k >= 0 of 1 - y(k), y its step response over the gain.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (np.arange(p.size) @ p / np.sum(p) for p in (B, F))
    return float(first - second)


def slowest_time(decay: ArrayLike) -> float:
    """Return 1/min |Re s| of poles by their real parts, in s; NaN without poles or for Re s >= 0.

    Parameters
    ----------
    decay : array_like, shape (n,)
        Re s, in 1/s; the integrator's left out.
    """
    slowest = float(np.max(np.asarray(decay, dtype=np.float64), initial=-np.inf))
    return -1 / slowest if np.isfinite(slowest) and slowest < 0 else float("nan")
