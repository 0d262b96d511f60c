"""Times of a step response, with the same definitions for data, models and physics.

Three times characterise a response y(t) with the final value 1 and the dead time L.

The 63 % time is the first t with y(t) = 1 - 1/e, minus L. The equivalent time is the integral of 1
- y(t), minus L. The response to a ramp lags the ramp by the equivalent time plus L. The time of the
slowest pole is 1/min |Re s|. In this time the slowest mode decays to 1/e.

For a first-order system all three times equal the time constant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

SHARE = 1 - 1 / np.e
_MIN_LINE_SAMPLES = 4  # least number of samples for a line, with two degrees of freedom


def rise_time(y: Vector, Ts: float, *, integrated: bool = False) -> float:
    """Return the first time at which a response reaches 63 % of its final value, in s, or NaN.

    y (N,) is the response divided by its final value, from the last sample before the input acts.
    If `integrated` is True, y is the integral of the response, such as an angle instead of its
    rate. The function interpolates by a cubic spline. With linear interpolation the time would be
    late by up to Ts²/8 y''/y'.
    """
    from scipy.interpolate import CubicSpline, PPoly

    if y.size < 2 or not np.isfinite(y).all():
        return float("nan")
    t = Ts * np.arange(y.size)
    # The integral has the slope 0 at the first sample. The slope of the response itself is not
    # known there.
    ends = ((1, 0.0), "not-a-knot") if integrated and y.size > 2 else "not-a-knot"
    curve = CubicSpline(t, y, bc_type=ends)
    answer = curve.derivative() if integrated else curve
    if float(answer(0.0)) >= SHARE:
        return 0.0
    # Solve only up to the first sample above 63 %: to solve all pieces takes twice the time.
    there = np.flatnonzero(answer.c[-1] >= SHARE)
    if there.size:
        answer = PPoly(answer.c[:, : there[0] + 1], answer.x[: there[0] + 2])
    reached = answer.solve(SHARE, extrapolate=False)
    reached = reached[np.isfinite(reached)]
    return float(reached[0]) if reached.size else float("nan")


def linear_crossing(t: Vector, y: Vector, level: float) -> float:
    """Return the first time at which y, interpolated linearly from (0, 0), reaches a level."""
    reached = np.flatnonzero(y >= level)
    if reached.size == 0:
        return float("nan")
    i = int(reached[0])
    if i == 0:
        return float(t[0] * level / y[0])
    return float(t[i - 1] + (t[i] - t[i - 1]) * (level - y[i - 1]) / (y[i] - y[i - 1]))


def ramp_lag(t: Vector, y: Vector) -> float:
    """Fit a line to the samples of a ramp response; return the time at which the line is 0."""
    slope, level = np.polyfit(t, y, 1)
    return float(-level / slope) if slope else float("nan")


def mean_lag(B: Vector, F: Vector) -> float:
    """Return sum k g(k) / sum g(k) of the impulse response g of B(q)/F(q), in samples.

    The result equals the sum of 1 - y(k) over all k >= 0, where y is the step response divided by
    the gain.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (np.arange(p.size) @ p / np.sum(p) for p in (B, F))
    return float(first - second)


def slowest_time(decay: ArrayLike) -> float:
    """Return 1/min |Re s| of poles, in s; NaN if there is no pole or a real part is not negative.

    `decay` (n,) is Re s of the poles without the integrator, in 1/s.
    """
    slowest = float(np.max(np.asarray(decay, dtype=np.float64), initial=-np.inf))
    return -1 / slowest if np.isfinite(slowest) and slowest < 0 else float("nan")


def lag_of_angle(
    t: Vector, y: Vector, *, before: tuple[int, float], rounding: float
) -> tuple[float, float]:
    """Return the time by which an angle lags its final ramp, and its standard deviation, in s.

    t and y (n,) are the last third of the ramp. t is 0 at the step, and y is the angle minus the
    line that was fitted before the step, or NaN. `before` is the number of samples of this line and
    their duration in s. `rounding` is the quantisation step of the converter, in the unit of y; the
    mean of the quantisation error need not be zero.
    """
    measured = np.isfinite(y)
    t, y, n = t[measured], y[measured], int(np.count_nonzero(measured))
    if n < _MIN_LINE_SAMPLES:
        return float("nan"), float("nan")
    lag = ramp_lag(t, y)
    slope, level = np.polyfit(t, y, 1)
    variance = float(np.sum((y - level - slope * t) ** 2)) / (n - 2)
    spread = float(np.sum((t - t.mean()) ** 2))
    # Variance of both lines at their intersection, divided by the variance of a sample.
    shares = 1 / n + (lag - t.mean()) ** 2 / spread
    shares += (1 + 3 * (1 + 2 * lag / before[1]) ** 2) / before[0]
    return lag, float(np.sqrt(variance * shares + rounding**2 / 12) / abs(slope))


def area_above(t: Vector, y: Vector, std: float, gain_std: float) -> tuple[float, float]:
    """Return the area between a response and its final value 1, and the standard deviation, in s.

    y (n,) is the response at the times t, divided by its final value, from the step until the
    response has settled; NaN if missing. `std` and `gain_std` are the standard deviations of a
    sample and of the final value, both divided by the final value.
    """
    measured = np.isfinite(y)
    t, y = t[measured], y[measured]
    area = float(np.trapezoid(1 - y, t))
    widths = np.gradient(t) if t.size > 1 else np.zeros(t.size)
    area_std = std * float(np.linalg.norm(widths))
    return area, float(np.hypot(area_std, gain_std * (t[-1] - t[0])))
