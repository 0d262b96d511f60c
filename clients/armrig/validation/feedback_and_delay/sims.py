"""Sims' test for feedback: a test whether future input helps to explain the output."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log10

import numpy as np
from armrig_core.errors import InputError
from numpy.lib.stride_tricks import sliding_window_view

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import orthonormal, triangle
from armrig.numerics.polynomial import Array, apply_filter
from armrig.numerics.quantities import plural
from armrig.numerics.rounding import rounding_std
from armrig.numerics.stretches import stretches

FUTURE = 5
"""Number of samples of u that are tested: u(t) … u(t + 4)."""
_LAGS_PER_DECADE = 15  # past samples p for each decade of N
_MOST_LAGS = 60
_LEAST_LAGS = 4
_FORGETTING = (0.0, 1 / 3, 1.0)  # p (1 - l_j) for the forgetting factors l_j of the sums w_j
_ROWS_PER_PARAMETER = 5  # with fewer rows the F distribution does not hold
_MIN_U_REST = 1e-10  # share of u's power that the past must leave unexplained
_BLOCK = 4096  # rows that are held in memory at a time


class CannotTellError(InputError):
    """The data do not decide between feedback and open loop."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sims:
    """The F-test of y on future u."""

    p_value: float
    """p value of the hypothesis that u(t), u(t + 1), … do not help to explain y(t), given the
    past."""
    p_later: float
    """p value of the hypothesis that u(t + 1), … do not help to explain y(t), given the past and
    u(t)."""
    F: float
    """Ratio of (RSS_0 - RSS)/q to RSS/(N - d), with d regressors. RSS is the residual sum of
    squares, and RSS_0 the sum without the q future inputs."""
    q: int
    """Degrees of freedom of the numerator."""
    degrees: int
    """Degrees of freedom of the denominator."""
    p: int
    """Number of past samples of y, and of u, in the regression."""
    explained: float
    """Reduction of the variance of y by future u, as a share (0 to 1) of the variance that the past
    does not explain."""
    lags: Array
    """Lags -(q - 1) … p of the coefficients; at 0 and below, u is applied after y is read."""
    coefficients: Array
    """Coefficients of u(t - lag)."""
    std: Array
    """Standard deviations of the coefficients."""
    N: int
    """Number of rows used."""


def sims(data: Dataset) -> Sims:
    """Test whether future input helps to explain y.

    The regression is ::

        y(t) = c + a_1 y(t-1) + … + a_p y(t-p) + b_1 u(t-1) + … + b_p u(t-p)
                 + g_1 w_1(t-p) + g_2 w_2(t-p) + g_3 w_3(t-p)
                 + f_0 u(t) + … + f_4 u(t+4) + e(t)
        w_j(t) = l_j w_j(t-1) + u(t-1),     l = 1, 1 - 1/(3 p), 1 - 1/p

    with one constant c for each experiment. The hypothesis H0 is f_0 = … = f_4 = 0. y(t) is read
    before u(t) is applied, so in open loop u(t), u(t + 1), … do not depend on e(t). In closed loop
    u(t) contains the noise of y(t). The test makes no assumption on how u was generated. In
    contrast, a PRBS, a held input and a low-pass input look like feedback in Granger's test, which
    assumes a model of u's own past.

    p = 15 lg N, at most 60. The sums w represent the input before the last p samples; without them
    future u would take over the effect of this input. y's past has more lags than the plant has
    poles, so the F distribution also holds if y integrates: see [2] and [3].

    A row whose y(t) is missing is left out. A missing past y is interpolated linearly between its
    neighbours. Neither neighbour is later than y(t), so the interpolation contains no effect of
    future u. No row extends over the end of an experiment or over a gap longer than p/2.

    Raises
    ------
    CannotTellError
        u follows from its past (a constant, a sine, a sum of a few sines), or y follows from the
        past (no noise).
    ValueError
        There are too few samples.

    References
    ----------
    .. [1] C. A. Sims, American Economic Review 62 (1972) 540-552. J. Geweke, R. Meese, W. Dent, J.
    Econometrics 21 (1983) 161-194, add the past of y to the regressors.
    .. [2] C. A. Sims, J. H. Stock, M. W. Watson, Econometrica 58 (1990) 113-144.
    .. [3] H. Y. Toda, T. Yamamoto, J. Econometrics 66 (1995) 225-250.
    """
    p = _lags(data)
    constants = len(data.starts)
    d = constants + 2 * p + len(_FORGETTING)
    R, N = _factor(data, constants, p)
    degrees = N - d - FUTURE
    _require_information(R, constants, d, degrees)
    floor = N * rounding_std(data.y) ** 2
    rss_0, rss_1 = (float(np.sum(R[k:, -1] ** 2)) for k in (d, d + 1))
    if rss_0 <= floor:
        raise CannotTellError(
            "y follows from the past without noise, but feedback is visible only by noise"
        )
    # A rest below the floor is rounding. No later lag explains a part of it.
    rss, rss_1 = max(float(R[-1, -1] ** 2), floor), max(rss_1, floor)
    F = (rss_0 - rss) / FUTURE / max(rss / degrees, 1e-300)
    F_later = (rss_1 - rss) / (FUTURE - 1) / max(rss / degrees, 1e-300)
    basis = orthonormal(R[:, :-1])
    by_lag = np.r_[d + FUTURE - 1 : d - 1 : -1, constants + p : constants + 2 * p]
    variance = rss / degrees * np.sum(basis.W**2, axis=1)
    return Sims(
        p_value=_tail(F, FUTURE, degrees),
        p_later=_tail(F_later, FUTURE - 1, degrees),
        F=F,
        q=FUTURE,
        degrees=degrees,
        p=p,
        explained=1 - rss / rss_0,
        lags=np.arange(1 - FUTURE, p + 1),
        coefficients=basis.coefficients(R[:, -1])[by_lag],
        std=np.sqrt(variance[by_lag]),
        N=N,
    )


def _tail(F: float, q: int, degrees: int) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(q, degrees, max(F, 0.0)))


def _lags(data: Dataset) -> int:
    """Return p = 15 lg N, or a smaller p if there are too few rows for so many parameters."""
    there, fixed = data.N - data.missing, len(data.starts) + len(_FORGETTING) + FUTURE
    affordable = (there // _ROWS_PER_PARAMETER - fixed) // 2
    p = min(round(_LAGS_PER_DECADE * log10(max(there, 1))), _MOST_LAGS, affordable)
    if p < _LEAST_LAGS:
        needed = _ROWS_PER_PARAMETER * (2 * _LEAST_LAGS + fixed)
        msg = f"the test for feedback needs at least {plural(needed, 'sample')}, got {there}: "
        raise InputError(msg + "record longer, or lose fewer samples")
    return p


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _GaplessPiece:
    """Samples of one experiment without a long gap; missing y are interpolated."""

    u: Array
    sums: Array
    y: Array
    valid: Array
    experiment: int
    p: int

    def rows(self, constants: int) -> Iterator[Array]:
        """Yield rows [constants, past y, past u, sums, future u, y(t)], in blocks."""
        past_y = sliding_window_view(self.y, self.p + 1)
        u = sliding_window_view(self.u, self.p + FUTURE)
        for begin in range(0, u.shape[0], _BLOCK):
            part = slice(begin, min(begin + _BLOCK, u.shape[0]))
            used = self.valid[self.p :][part]
            y_, u_, sums = past_y[part][used], u[part][used], self.sums[self.p :][part][used]
            indicators = np.zeros((y_.shape[0], constants))
            indicators[:, self.experiment] = 1.0
            past_u, future = u_[:, : self.p][:, ::-1], u_[:, self.p :]
            yield np.hstack([indicators, y_[:, -2::-1], past_u, sums, future, y_[:, -1:]])


def _pieces(data: Dataset, p: int) -> Iterator[_GaplessPiece]:
    """Yield the samples between long gaps, with missing y interpolated."""
    for i, part in enumerate(data.experiments()):
        near = np.ones(part.N, dtype=bool)
        for gap in stretches(~part.valid):
            near[gap] = gap.start > 0 and gap.stop < part.N and gap.stop - gap.start <= p // 2
        sums = _sums(part.u, p)
        level = float(np.mean(part.y[part.valid])) if part.valid.any() else 0.0
        for s in stretches(near):
            u, y, valid = part.u[s], part.y[s] - level, part.valid[s]
            if y.size < p + FUTURE:
                continue
            y[~valid] = np.interp(np.flatnonzero(~valid), np.flatnonzero(valid), y[valid])
            yield _GaplessPiece(u=u, sums=sums[s], y=y, valid=valid, experiment=i, p=p)


def _sums(u: Array, p: int) -> Array:
    """Return three sums of the input more than p samples ago, w_1(t - p) … w_3(t - p), (N, 3)."""
    before = np.append(np.zeros(p + 1), u - u.mean())[: u.size]
    return np.column_stack(
        [apply_filter([1.0], [1.0, slow / p - 1.0], before) for slow in _FORGETTING]
    )


def _factor(data: Dataset, constants: int, p: int) -> tuple[Array, int]:
    """Return R of the QR factorisation of all rows, and the number of rows."""
    D = constants + 2 * p + len(_FORGETTING) + FUTURE + 1
    pieces = list(_pieces(data, p))
    N = sum(int(piece.valid[p : piece.u.size - FUTURE + 1].sum()) for piece in pieces)
    return triangle((block for piece in pieces for block in piece.rows(constants)), D), N


def _require_information(R: Array, constants: int, d: int, degrees: int) -> None:
    """Refuse data with too few samples, and data whose u follows from its past."""
    if degrees < d:
        raise InputError(
            f"the test for feedback needs {plural(2 * d + FUTURE, 'sample')} with a complete past, "
            f"got {degrees + d + FUTURE}: record longer, or lose fewer samples"
        )
    left, power = R[d, d] ** 2, float(np.sum(R[constants:, d] ** 2))
    if left <= _MIN_U_REST * power:
        raise CannotTellError(
            "u follows from its own past (a constant, a sine, few sines), which hides any effect "
            "of y on u: record with a telegraph, a PRBS or noise"
        )
