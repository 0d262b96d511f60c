"""The answer to a step, fitted by stretches: how far it overshoots, and when it has settled."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """The answer over its final value, from stretches of the record that are quiet enough."""

    k: Vector
    """Samples from the step on, in the middle of each stretch, (n,)."""
    y: Vector
    """Answer there over its final value, (n,)."""
    std: Vector
    """Standard deviation of `y`, (n,)."""

    def overshoot(self) -> tuple[float, float]:
        """Return the largest value over the final one, less 1, and its standard deviation.

        0 where nothing is above the final value; NaN where there is no quiet stretch.
        """
        if not self.k.size:
            return float("nan"), float("nan")
        best = int(np.argmax(self.y))
        return max(float(self.y[best]) - 1, 0.0), float(self.std[best])

    def settling(self, band: float) -> float:
        """Return from which sample on the answer stays within the band; 0 where it is never beyond.

        Beyond it is what two standard deviations do not explain.
        """
        off = np.abs(self.y - 1)
        beyond = np.flatnonzero(off > band + 2 * self.std)
        if not beyond.size:
            return 0.0
        last = int(beyond[-1])
        inside = last + np.flatnonzero(off[last:] <= band)[:1]
        if not inside.size:
            return float(self.k[-1])
        i = int(inside[0])
        return float(np.interp(band, [off[i], off[i - 1]], [self.k[i], self.k[i - 1]]))


def course(y: Vector, k: NDArray[np.int_], gain: float, *, integrated: bool) -> Course:
    """Return the answer to a step, fitted by stretches.

    The largest value of a noisy answer is that of its noise, and so is the last one beyond a band.
    So a parabola is fitted by least squares to each stretch from 2/3 to 4/3 of a time since the
    step (of an angle a cubic, whose slope is the rate): at a peak it holds a third of a period.

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
    Course
        Without stretches that are too short or too loud.
    """
    known = np.isfinite(y)
    k, y = k[known], y[known] / gain
    degree, order = DEGREE + integrated, int(integrated)
    found = []
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
        if std < QUIET:
            found.append((float(centre), float(theta[order]) / scale, std))
    columns = np.array(found).reshape(-1, 3).T
    return Course(k=columns[0], y=columns[1], std=columns[2])
