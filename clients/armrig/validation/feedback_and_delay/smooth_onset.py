"""Test of the first lag by the shape of the onset: at first, an angle is proportional to t²."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from armrig.data.dataset import Dataset
from armrig.estimation.polynomial_structures import oe

Progress = Callable[[int, int, str], object]
"""Function of the number of finished estimates, the number of all estimates, and the next lag."""
SURPRISING = 9.21  # 99 % point of chi-squared, two degrees of freedom
_MAX_DISTANCE_RATIO = 3.0  # largest sqrt(chi²) of a possible lag, in units of the least sqrt(chi²)
_POLES = 4  # number of poles of the arm
_MAX_EXTRA_LAGS = 4  # lags by which the range is extended at each end


def smooth_onsets(
    data: Dataset, first: int, last: int, *, integrator: bool, progress: Progress | None = None
) -> dict[int, float]:
    """Return chi-squared of the model with a smooth onset, for each first lag.

    OE models with different first lags k are compared. Their numerator is the product of (1 + q^-1)
    and a polynomial of three coefficients, so that the onset is smooth. The statistic is ::

        chi² = (N - d)(V_k - V_0)/V_0,      two degrees of freedom

    V_k is the loss of the model with the first lag k. V_0 is the least loss of all these models and
    of a model with a free numerator. The zero of a second-order onset tends to -1 as the sampling
    time tends to 0 [1]_. A first coefficient that is too small to see indicates a short sampling
    time, and therefore a zero near -1. The range first … last is extended at each end, by at most
    four lags, until chi² at that end exceeds its 1 % point.

    References
    ----------
    .. [1] K. J. Åström, P. Hagander, J. Sternby, "Zeros of sampled systems", Automatica 20 (1984)
       31-38.
    """
    averaged = _averaged(data)

    @cache
    def loss(k: int) -> float:
        if progress and k <= last:
            progress(k - first, last - first + 1, f"lag {k}")
        return oe(averaged, nb=_POLES - 1, nf=_POLES, nk=k, integrator=integrator).loss

    low, high = first, last
    best = min(range(low, high + 1), key=loss)
    free = oe(data, nb=_POLES, nf=_POLES, nk=best, integrator=integrator)
    degrees = free.N - free.parameters
    least = min(free.loss, loss(best))

    def misfit(k: int) -> float:
        return degrees * (loss(k) / least - 1) if least > 0 else 0.0

    while low > max(first - _MAX_EXTRA_LAGS, 0) and misfit(low) <= SURPRISING:
        low -= 1
    while high < last + _MAX_EXTRA_LAGS and misfit(high) <= SURPRISING:
        high += 1
    return {k: misfit(k) for k in range(low, high + 1)}


def possible(misfit: dict[int, float]) -> tuple[int, int]:
    """Return the least and the greatest lag at which the onset may begin, given the misfits.

    The best lag is possible. Each lag whose misfit is below the 1 % point of chi-squared is
    possible, too. A lag is also possible if the square root of its misfit is less than three times
    the square root of the least misfit. The square root of the misfit grows with the distance from
    the true onset. If the best lag is within a quarter sample of the true onset, this last rule
    therefore adds no lag.
    """
    least = min(misfit.values())
    bound = max(SURPRISING, least)
    lags = [
        k for k, chi2 in misfit.items() if chi2 <= bound or chi2 < _MAX_DISTANCE_RATIO**2 * least
    ]
    return min(lags), max(lags)


def _averaged(data: Dataset) -> Dataset:
    """Return the data with the input (u(t) + u(t - 1))/2, for the factor 1 + q^-1 of the model."""
    before = np.concatenate([data.u[:1], data.u[:-1]])
    starts = list(data.starts)
    before[starts] = data.u[starts]
    return data.replaced(u=(data.u + before) / 2, step=None)
