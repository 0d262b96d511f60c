"""The equivalent time of a recorded answer to a step, which needs no sample of the rise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.step_times import ramp_lag

Vector = NDArray[np.float64]

_FEWEST = 4  # samples of a line with a scatter


def lag_of_angle(
    t: Vector, y: Vector, *, before: tuple[int, float], rounding: float
) -> tuple[float, float]:
    """Return by how much an angle lags the ramp that it ends up on, and its deviation, in s.

    Parameters
    ----------
    t, y : ndarray, shape (n,)
        Samples of the ramp's last third, from the step, less what was there before; NaN where it
        is not known.
    before : (int, float)
        How many samples before the step, over how long in s, gave the line that was taken away.
    rounding : float
        A step of the converter's, in y's unit. Where it beats with the samples it does not
        average out.
    """
    known = np.isfinite(y)
    t, y, n = t[known], y[known], int(np.count_nonzero(known))
    if n < _FEWEST:
        return float("nan"), float("nan")
    lag = ramp_lag(t, y)
    slope, level = np.polyfit(t, y, 1)
    variance = float(np.sum((y - level - slope * t) ** 2)) / (n - 2)
    spread = float(np.sum((t - t.mean()) ** 2))
    # Of both lines where they meet.
    shares = 1 / n + (lag - t.mean()) ** 2 / spread
    shares += (1 + 3 * (1 + 2 * lag / before[1]) ** 2) / before[0]
    return lag, float(np.sqrt(variance * shares + rounding**2 / 12) / abs(slope))


def area_above(t: Vector, y: Vector, std: float, gain_std: float) -> tuple[float, float]:
    """Return the area between an answer and its final value, 1, and its deviation, in s.

    Parameters
    ----------
    t, y : ndarray, shape (n,)
        The answer over its final value, from the step until it has settled; NaN where not known.
    std, gain_std : float
        Deviations of one sample, and of the final value, over it.
    """
    known = np.isfinite(y)
    t, y = t[known], y[known]
    area = float(np.trapezoid(1 - y, t))
    widths = np.gradient(t) if t.size > 1 else np.zeros(t.size)
    own = std * float(np.linalg.norm(widths))
    return area, float(np.hypot(own, gain_std * (t[-1] - t[0])))
