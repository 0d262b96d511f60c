"""Whether residuals are white noise of the output as a smoothing kernel has coloured it.

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

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.whiteness import autocovariance, default_lags, joined, portmanteau_p_value

Vector = NDArray[np.float64]

_ENOUGH = 0.5  # share of the values that have a partner at a lag
# Share of the largest deviation below which a direction is left out: in those the next term of the
# expansion that Bartlett's formula begins is as large, and raises 1 % to 2.5.
_SEEN = 0.2

SMOOTHED_NOISE = "test of smoothed noise"


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
