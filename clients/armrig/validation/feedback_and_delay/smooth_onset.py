"""The onset of an angle, which begins as t²/2: its shape tells where its first sample does not."""

from __future__ import annotations

from functools import cache

import numpy as np

from armrig.data.dataset import Dataset
from armrig.estimation.oe import oe

SURPRISING = 9.21  # 99 % point of chi-squared, two degrees of freedom
_NEAR = 3.0  # times as far from the best lag, in samples, is no neighbour
_POLES = 4  # the arm's
_FARTHEST = 4  # lags looked at beyond those that are asked about


def smooth_onsets(data: Dataset, first: int, last: int, *, integrator: bool) -> dict[int, float]:
    """Return by first lag how far the data are from a smooth onset there, as chi-squared.

    OE models whose numerator is 1 + q^-1 times one of three coefficients, so without one of its own
    for the first sample, are compared over their first lag ::

        chi² = (N - d)(V_k - V_0)/V_0,      two degrees of freedom

    with V_0 the least loss, of a free numerator too. A second-order onset puts a zero at -1 as the
    sampling time goes to 0 [1]_, and so wherever the first coefficient is too small to be seen.
    Lags are added at either end until chi² is a surprise there (1 %).

    References
    ----------
    .. [1] K. J. Åström, P. Hagander, J. Sternby, "Zeros of sampled systems", Automatica 20 (1984)
       31-38.
    """
    averaged = _averaged(data)

    @cache
    def loss(k: int) -> float:
        return oe(averaged, nb=_POLES - 1, nf=_POLES, nk=k, integrator=integrator).loss

    low, high = first, last
    best = min(range(low, high + 1), key=loss)
    free = oe(data, nb=_POLES, nf=_POLES, nk=best, integrator=integrator)
    degrees = free.N - free.parameters
    least = min(free.loss, loss(best))

    def misfit(k: int) -> float:
        return degrees * (loss(k) / least - 1) if least > 0 else 0.0

    while low > max(first - _FARTHEST, 0) and misfit(low) <= SURPRISING:
        low -= 1
    while high < last + _FARTHEST and misfit(high) <= SURPRISING:
        high += 1
    return {k: misfit(k) for k in range(low, high + 1)}


def possible(misfit: dict[int, float]) -> tuple[int, int]:
    """Return the least and the greatest lag that the onset may begin at.

    The root of the misfit grows with the distance from the true onset, so these are the lags whose
    misfit is no surprise, the best, and those less than three times as far as the best: a lag is
    alone if it is right within a quarter sample.
    """
    least = min(misfit.values())
    bound = max(SURPRISING, least)
    lags = [k for k, chi2 in misfit.items() if chi2 <= bound or chi2 < _NEAR**2 * least]
    return min(lags), max(lags)


def _averaged(data: Dataset) -> Dataset:
    """Return the data with (u(t) + u(t - 1))/2 for u: the factor 1 + q^-1 of a smooth rig."""
    before = np.concatenate([data.u[:1], data.u[:-1]])
    starts = list(data.starts)
    before[starts] = data.u[starts]
    return data.replaced(u=(data.u + before) / 2, step=None)
