"""How far the answer to a step rises above its final value."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

SHARE = 1 / 3
"""Of the time since the step, on either side: what is fitted at once."""
CENTRES = 120
QUIET = 0.03
"""Deviation over the final value above which a fit is passed over: the largest of loud ones is
noise."""
DEGREE = 2  # of the answer in each stretch; an integral's is one higher
LEAST = 4  # samples a coefficient


def overshoot(y: Vector, k: NDArray[np.int_], gain: float, *, integrated: bool) -> Vector:
    """Return the largest value over the final one, less 1, and its standard deviation, (2,).

    The largest of a noisy answer is that of its noise. So a parabola is fitted by least squares to
    each stretch from 2/3 to 4/3 of a time since the step (of an angle a cubic, whose slope is the
    rate), and the largest of their middles is taken: at a peak a stretch holds a third of a period.

    Parameters
    ----------
    y : Vector
        Answer to a unit step, (n,), NaN where it is missing; the angle's, where the rate is meant.
    k : array of int
        Samples from the step on, (n,).
    gain : float
        Final value of the answer; with `integrated` of the rate, a sample.
    integrated : bool
        y is the integral of what is meant.

    Returns
    -------
    Vector
        0 where nothing is above the final value; (NaN, NaN) where all stretches are too short or
        too loud.
    """
    known = np.isfinite(y)
    k, y = k[known], y[known] / gain
    degree, order = DEGREE + integrated, int(integrated)
    best = np.full(2, np.nan)
    for centre in np.geomspace(LEAST, max(LEAST, 2 * k[-1] / 3), CENTRES):
        half = SHARE * centre
        near = np.abs(k - centre) <= half
        free = int(np.count_nonzero(near)) - degree - 1
        if free < (LEAST - 1) * (degree + 1):
            continue
        X = np.vander((k[near] - centre) / half, degree + 1, increasing=True)
        theta = np.linalg.lstsq(X, y[near])[0]
        variance = float(np.sum((y[near] - X @ theta) ** 2)) / free
        scale = half if integrated else 1.0
        std = float(np.sqrt(variance * np.linalg.inv(X.T @ X)[order, order])) / scale
        value = float(theta[order]) / scale - 1
        if std < QUIET and not value <= best[0]:  # the first is not less than NaN
            best = np.array([value, std])
    return np.array([max(best[0], 0.0), best[1]]) if np.isfinite(best[0]) else best
