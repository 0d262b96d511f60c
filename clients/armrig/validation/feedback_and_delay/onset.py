"""The lag at which u acts first, and the lags that the data cannot tell from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np

from armrig.data.dataset import Dataset
from armrig.estimation.oe import oe
from armrig.models.fit import Fit

LEVEL = 0.01
SECOND_ORDER = frozenset({"theta_1", "alpha"})
"""Outputs whose second derivative is what a step of the voltage changes first."""
_FIRST_SHARE = 1 / 3  # of the answer to a pulse at its second lag: t²/2 held, 1 : 3 : 5 …
_PLAIN = 10.0  # size in σ from which on no coefficient is overlooked
_PLAIN_P = 1e-23  # the same as a p value
_STRIDE = 3  # lags, down from the one that begins the search
_NEAR = 3.0  # times as far from the best lag, in samples, is no neighbour
SURPRISING = 9.21  # 99 % point of chi-squared, two degrees of freedom


@dataclass(frozen=True, slots=True, kw_only=True)
class Before:
    """Whether u would be seen if it acted at the lag before the first that was shown."""

    k: int
    """The lag."""
    found: float
    """Answer to a pulse at lag k, in σ."""
    predicted: float
    """What it would be if u acted from k on, in σ, told by the answer at k + 1."""
    p_value: float
    """Of the hypothesis that u acts from k on: one-sided, found against predicted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Onset:
    """Where u acts first, as far as the data tell."""

    first: int
    """The least lag that is not ruled out."""
    last: int
    """The greatest."""
    p_values: dict[int, float]
    """By lag: of the hypothesis that u does not act there, nor before."""
    before: Before | None
    """None where u acts at lag 0."""
    misfit: dict[int, float]
    """By first lag of a smooth onset: (N - d)(V - V_0)/V_0, chi-squared with two degrees of
    freedom where it is the right one; empty where the coefficients tell enough."""


class Candidates:
    """The OE models that take part, each estimated once."""

    def __init__(self, data: Dataset, *, nb: int, nf: int, integrator: bool) -> None:
        """Take data and orders; nothing is estimated yet."""
        self._data, self._nb, self._nf, self._integrator = data, nb, nf, integrator
        self._known: dict[tuple[int, int, bool], Fit] = {}

    @cached_property
    def _averaged(self) -> Dataset:
        """Return the data with (u(t) + u(t - 1))/2 for u: the factor 1 + q^-1 of a smooth rig."""
        before = np.concatenate([self._data.u[:1], self._data.u[:-1]])
        starts = list(self._data.starts)
        before[starts] = self._data.u[starts]
        return self._data.replaced(u=(self._data.u + before) / 2, step=None)

    @property
    def may_be_smooth(self) -> bool:
        """The output is an angle, and one coefficient less leaves one."""
        return self._data.output in SECOND_ORDER and self._nb > 1

    def model(self, k: int, more: int = 0) -> Fit:
        """Return the OE model that begins at lag k, with `more` coefficients more."""
        return self._fit(k, self._nb + more, smooth=False)

    def smooth(self, k: int) -> Fit:
        """Return the model whose numerator is 1 + q^-1 times one of nb - 1, beginning at lag k."""
        return self._fit(k, self._nb - 1, smooth=True)

    def _fit(self, k: int, nb: int, *, smooth: bool) -> Fit:
        if (k, nb, smooth) not in self._known:
            data = self._averaged if smooth else self._data
            self._known[k, nb, smooth] = oe(
                data, nb=nb, nf=self._nf, nk=k, integrator=self._integrator
            )
        return self._known[k, nb, smooth]

    def not_acting(self, k: int) -> float:
        """Return p of the hypothesis that u acts at lag k + 1 or later."""
        return _nested(self.model(k + 1), self.model(k, 1), 1)

    def before(self, k: int) -> Before:
        """Test whether u acts at lag k already, whose own coefficient was not shown."""
        from scipy.special import ndtr

        whole = self.model(k, 1)
        b, f = whole.slice_of("b").start, whole.slice_of("f").start
        f_1 = float(whole.F[1]) if whole.F.size > 1 else 0.0
        # The answers to a pulse at k and k + 1 are b_1 and b_2 - f_1 b_1.
        answers = float(whole.B[k]), float(whole.B[k + 1] - f_1 * whole.B[k])
        slopes = np.zeros((2, whole.theta.size))
        slopes[0, b], slopes[1, b : b + 2] = 1.0, (-f_1, 1.0)
        if whole.F.size > 1:
            slopes[1, f] = -whole.B[k]
        share = _FIRST_SHARE if self._nf > 1 else 1.0
        lacking = slopes[0] - share * slopes[1]
        variance, spread = (
            max(float(v @ whole.trusted_covariance @ v), 1e-300) for v in (slopes[0], lacking)
        )
        sign = 1.0 if answers[1] >= 0 else -1.0
        return Before(
            k=k,
            found=sign * answers[0] / sqrt(variance),
            predicted=share * abs(answers[1]) / sqrt(variance),
            p_value=float(ndtr(sign * (answers[0] - share * answers[1]) / sqrt(spread))),
        )


def onset(candidates: Candidates, start: int, end: int) -> Onset:
    """Return the lags at which u may act first.

    u acts at lag k where an OE model with b_k, b_k+1 … b_k+nb is significantly better than the one
    without b_k. The search goes down from `start` as long as lag k - 1 acts, or else up; of an
    angle it begins one lag past the smooth onset (see below) that fits best.

    That lag k - 1 is not significant does not say that u does not act there. Its coefficient may be
    too small to see: an angle answers to a step as t²/2, so to a pulse as 1 : 3 : 5 …. So lag k - 1
    is ruled out only if its coefficient is smaller, one-sided, than a rig that begins there would
    have it.

    Where that size is within 10 σ, or b_k or a later one is, and the output is an angle, the shape
    of the onset decides instead: models whose numerator is 1 + q^-1 times one of nb - 1, so without
    a coefficient of its own for the first sample, are compared over their first lag. A second-order
    onset puts a zero at -1 as the sampling time goes to 0 [1]_, and so wherever the first
    coefficient is too small to be seen. The root of the misfit grows with the distance from the
    true onset, so possible lags are those whose misfit is no surprise (1 %), the best, and those
    less than three times as far as the best: a lag is alone if it is right within a quarter sample.

    Parameters
    ----------
    candidates : Candidates
        Models by their first lag.
    start : int
        A lag at which u acts, as far as is known.
    end : int
        Where to give up.

    Raises
    ------
    ValueError
        u acts at no lag before `end` that can be seen.

    References
    ----------
    .. [1] K. J. Åström, P. Hagander, J. Sternby, "Zeros of sampled systems", Automatica 20 (1984)
       31-38.
    """
    p_values: dict[int, float] = {}

    def acts(k: int) -> bool:
        p_values[k] = candidates.not_acting(k)
        return p_values[k] < LEVEL

    k = _least(acts, start, end, candidates)
    before = candidates.before(k - 1) if k > 0 else None
    first = k if before is None or before.p_value < LEVEL else k - 1
    last, misfit = k, dict[int, float]()
    overlooked = before is not None and before.predicted < _PLAIN
    doubted = any(_PLAIN_P < p < LEVEL for p in p_values.values())
    if candidates.may_be_smooth and (overlooked or doubted):
        misfit = _misfits(candidates, k, end)
        possible = _possible(misfit)
        first, last = min(possible), max(possible)
    return Onset(
        first=first,
        last=last,
        p_values=dict(sorted(p_values.items())),
        before=before,
        misfit=misfit,
    )


def _misfits(candidates: Candidates, k: int, end: int) -> dict[int, float]:
    """Return chi-squared of smooth onsets about k: of the best, and on until it is a surprise."""
    best = _lowest(lambda j: candidates.smooth(j).loss, k, end)
    whole = min((candidates.model(j, 1) for j in (max(best - 1, 0), best)), key=lambda f: f.loss)
    degrees = whole.N - whole.parameters
    least = min(whole.loss, candidates.smooth(best).loss)

    def misfit(j: int) -> float:
        return degrees * (candidates.smooth(j).loss / least - 1) if least > 0 else 0.0

    low, high = max(best - 1, 0), best + 1
    while low > 0 and misfit(low) <= SURPRISING:
        low -= 1
    while high < end and misfit(high) <= SURPRISING:
        high += 1
    return {j: misfit(j) for j in range(low, high + 1)}


def _possible(misfit: dict[int, float]) -> list[int]:
    least = min(misfit.values())
    return [
        k for k, chi2 in misfit.items() if chi2 <= max(SURPRISING, least) or chi2 < _NEAR**2 * least
    ]


def _least(acts: Callable[[int], bool], start: int, end: int, candidates: Candidates) -> int:
    """Return the least lag that acts, going down from `start`, or else up.

    Far before the first lag that acts the test always rejects: models of this order do not reach
    the lags that follow. So a start that comes from noise is first led to where the onset is.
    """
    if candidates.may_be_smooth:
        start = min(_lowest(lambda j: candidates.smooth(j).loss, start, end) + 1, end - 1)
    k = start
    while k > 0 and acts(k - 1):
        k -= 1
    while k == start and not acts(k):
        start = k = k + 1
        if k >= end:
            msg = f"u acts at no lag up to {end - 1} that can be told from nothing; record longer, "
            msg += "or with a larger input"
            raise ValueError(msg)
    return k


def _lowest(loss: Callable[[int], float], k: int, end: int) -> int:
    """Return the lag of the lowest loss, downhill from k: in long steps first, then in short."""
    while k >= _STRIDE and loss(k - _STRIDE) < loss(k):
        k -= _STRIDE
    while (best := min(range(max(k - 1, 0), min(k + 1, end) + 1), key=loss)) != k:
        k = best
    return k


def _nested(small: Fit, large: Fit, more: int) -> float:
    """Return the p value of the `more` coefficients that the larger model has."""
    from scipy.special import fdtrc

    degrees = large.N - large.parameters
    gained = max(small.loss / large.loss - 1, 0.0) if large.loss > 0 else 0.0
    return float(fdtrc(more, degrees, degrees * gained / more))
