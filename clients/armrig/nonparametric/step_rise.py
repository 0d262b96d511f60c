"""The rise of a step response: a smoothing spline from the step's edge on, with deviations.

The samples are smoothed by the discrete spline z that minimises::

    sum_known (y - z)² + lambda |D^d z|²

averaged over lambda by its restricted likelihood. Where samples are missing the smoothness carries
on, and the deviation grows. It begins at the edge, at rest, so that the kink there is no cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from armrig.numerics.step_times import linear_crossing, rise_time

Vector = NDArray[np.float64]

_ROUNDS = 2  # the part that lambda comes from depends on the crossing, which depends on lambda
_FIRST = 256  # samples of the first part; twice as many where the level is not reached in them
_WIDE = 3  # lambda comes from so many times the time of the crossing
_LEAST = 12  # samples to estimate lambda from
_LOG_LAMBDA = (-6.0, 27.0)  # beyond that the equations are singular to working precision
_CERTAIN = 1e4  # weight of the first value, which is 0: all of the record before says so
_UNLIKELY = 0.02  # likelihood, over the largest one, of a lambda that does not count
_MULTIPLES = (1, -1, 2, -2)  # of the deviation: in a gap its band is no straight one
_BLOCK = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rise:
    """The beginning of a step response, smoothed, and when it reaches a level."""

    t: Vector
    """Times in s from the step's edge, (n,)."""
    y: Vector
    """Smoothed response, (n,); of an integrating output its rate."""
    std: Vector
    """Standard deviation of `y`, (n,)."""
    crossing: float
    """When the level is reached, in s."""
    crossing_std: float
    """Its standard deviation, the largest that makes y ± std and y ± 2 std reach the level."""


def step_rise(
    y: Vector, level: float, Ts: float, *, integrates: bool, least_variance: float = 0.0
) -> Rise:
    """Return the smoothed rise up to a level.

    Parameters
    ----------
    y : ndarray, shape (N,)
        Response from the last sample before the answer on, 0 there; NaN where it is not known.
        Of an integrating output its angle, of which the rate reaches the level.
    level : float
        What is to be reached, more than 0.
    Ts : float
        Sampling time, in s.
    integrates : bool
        The rate of y is looked at, halfway between the samples.
    least_variance : float, default 0
        Least variance of the noise in y.

    Raises
    ------
    ValueError
        The level is never reached.

    References
    ----------
    .. [1] P. H. C. Eilers, "A perfect smoother", Analytical Chemistry 75 (2003) 3631-3636.
    .. [2] C. F. Ansley and R. Kohn, "Estimation, filtering, and smoothing in state space models
       with incompletely specified initial conditions", Annals of Statistics 13 (1985) 1286-1316.
    """
    n = min(_FIRST, y.size)
    part = _Part.of(y[:n], level, Ts, least_variance, integrates=integrates)
    while part.reached < 0 and n < y.size:
        n = min(2 * n, y.size)
        part = _Part.of(y[:n], level, Ts, least_variance, integrates=integrates)
    if part.reached < 0:
        msg = "the answer never reaches 63 % of its final value; hold u longer"
        raise ValueError(msg)
    # Long after the rise y is smoother than on it: what lies there must not choose lambda.
    for _ in range(_ROUNDS):
        n = min(max(_WIDE * (part.reached + 1), _LEAST), y.size)
        shorter = _Part.of(y[:n], level, Ts, least_variance, integrates=integrates)
        if shorter.reached < 0:
            break
        part = shorter
    response, std = part.y, part.deviations(Ts, integrates=integrates)
    t: Vector = Ts * (np.arange(response.size, dtype=np.float64) + 0.5 * integrates)
    linear = linear_crossing(t, response, level)
    edges = np.array([linear_crossing(t, response + m * std, level) for m in _MULTIPLES])
    widths = np.abs(np.where(np.isnan(edges), t[-1], edges) - linear) / np.abs(_MULTIPLES)
    return Rise(
        t=t,
        y=response,
        std=std,
        crossing=rise_time(part.z, Ts, integrated=integrates, share=level),
        crossing_std=float(widths.max()),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """The splines of the first samples that are likely, and what they make of the response.

    Of a short rise in noise lambda is hardly known, and the most likely one alone would be too
    sure of itself.
    """

    splines: list[_Spline]
    shares: Vector
    """Likelihood of each, 1 in all."""
    z: Vector
    """Their mean, (n,); 0 at the edge."""
    y: Vector
    """Their mean response, (n,)."""
    reached: int
    """First sample that reaches the level; -1 for none."""

    @classmethod
    def of(
        cls, y: Vector, level: float, Ts: float, least_variance: float, *, integrates: bool
    ) -> _Part:
        """Smooth y (n,) with every lambda."""
        order = 3 if integrates else 2
        highest = min(_LOG_LAMBDA[1], 2 * order * np.log(y.size))
        every = [
            _spline(y, order, x, least_variance) for x in np.arange(_LOG_LAMBDA[0], highest, 1.0)
        ]
        criterion = np.array([s.criterion for s in every])
        weight = np.exp(-0.5 * (criterion - criterion.min()))
        likely = weight > _UNLIKELY
        splines = [s for s, here in zip(every, likely, strict=True) if here]
        shares = weight[likely] / np.sum(weight[likely])
        z = shares @ np.array([s.z for s in splines])
        mean = _response(z, Ts, integrates=integrates)
        at = np.flatnonzero(mean >= level)
        reached = int(at[0]) if at.size else -1
        return cls(splines=splines, shares=shares, z=z, y=mean, reached=reached)

    def deviations(self, Ts: float, *, integrates: bool) -> Vector:
        """Return the standard deviations of the mean response."""
        each = np.array([_response(s.z, Ts, integrates=integrates) for s in self.splines])
        variances = np.array([s.variances(Ts, integrates=integrates) for s in self.splines])
        return np.asarray(np.sqrt(self.shares @ (variances + (each - self.y) ** 2)))


def _response(z: Vector, Ts: float, *, integrates: bool) -> Vector:
    return np.diff(z) / Ts if integrates else z


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Spline:
    """The spline of one stretch with its lambda."""

    z: Vector
    """(N,)."""
    factor: Vector
    """Banded Cholesky factor of W + lambda P."""
    variance: float
    """Of the noise."""
    criterion: float
    """-2 log of the restricted likelihood, but for a constant."""

    def variances(self, Ts: float, *, integrates: bool) -> Vector:
        """Return the variances of the response, a block of samples at a time."""
        n = self.z.size
        last = n - integrates
        var = np.empty(last)
        for a in range(0, last, _BLOCK):
            i = np.arange(a, min(a + _BLOCK, last))
            c = np.zeros((n, i.size))
            if integrates:
                c[i + 1, i - a], c[i, i - a] = 1 / Ts, -1 / Ts
            else:
                c[i, i - a] = 1.0
            var[i] = np.sum(c * cho_solve_banded((self.factor, False), c), axis=0)
        return np.asarray(self.variance * np.maximum(var, 0.0))


def _spline(y: Vector, order: int, log_lambda: float, least_variance: float) -> _Spline:
    """Smooth y (N,), NaN where it is not known.

    What a converter rounds looks smooth where y moves slowly, and would pass for signal: the noise
    has at least `least_variance`.
    """
    known = np.isfinite(y)
    weight = known.astype(np.float64)
    weight[0] = _CERTAIN
    data, freedom = np.nan_to_num(y), max(int(np.count_nonzero(known)) - 1, 1)
    A = np.exp(log_lambda) * _penalty(y.size, order)
    A[-1] += weight
    factor = cholesky_banded(A)
    z = cho_solve_banded((factor, False), weight * data)
    squares = float(np.sum(weight * data * (data - z)))
    variance = max(squares / freedom, least_variance, 1e-300)
    # What the penalty does not touch has one dimension, the height at the edge.
    log_det = 2 * float(np.sum(np.log(factor[-1]))) - (y.size - 1) * log_lambda
    criterion = log_det + freedom * np.log(variance) + squares / variance
    return _Spline(z=z, factor=factor, variance=variance, criterion=criterion)


def _penalty(n: int, order: int) -> Vector:
    """Return D^T D of the differences of an order, in upper banded form (order + 1, n).

    For d = 3 with a row more: the rate is 0 at the edge, for a parabola from there.
    """
    rows = [([(-1) ** (order - j) * comb(order, j) for j in range(order + 1)], n - order)]
    if order == 3:
        rows.append(([-3, 4, -1], 1))
    banded = np.zeros((order + 1, n))
    for row, count in rows:
        for a, left in enumerate(row):
            for b in range(a, len(row)):
                banded[order - (b - a), b : b + count] += left * row[b]
    return banded
