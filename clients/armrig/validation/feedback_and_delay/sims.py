"""Sims' test: whether the input still to come tells of the output what the past does not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log10

import numpy as np
from armrig_core.errors import InputError
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered
from armrig.numerics.stretches import stretches

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

FUTURE = 5
"""Samples of u that are tested: u(t) … u(t + 4)."""
_LAGS_PER_DECADE = 15  # of N
_MOST_LAGS = 60
_LEAST_LAGS = 4
_SLOW = (0.0, 1 / 3, 1.0)  # the sums of older input forget this share of themselves in p samples
_ROWS_PER_PARAMETER = 5  # fewer and the F distribution is a wish
_NOTHING = 1e-10  # share of u's power below which its past says all of it
_NOISELESS = 1e-20  # share of y's power below which its past says all of it
_BLOCK = 4096  # rows that are held in memory at a time


class CannotTellError(InputError):
    """The data could be recorded with or without feedback."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sims:
    """The F-test of y on future u."""

    p_value: float
    """Of the hypothesis that u(t), u(t + 1), … say nothing of y(t) that the past does not."""
    p_later: float
    """Of the same for u(t + 1), … alone, u(t) taken for a part of the past."""
    F: float
    """(RSS_0 - RSS)/q over RSS/(N - d), q future inputs among d regressors."""
    q: int
    """Numerator's degrees of freedom."""
    degrees: int
    """Denominator's."""
    p: int
    """Past samples of y and of u in the regression."""
    explained: float
    """Share of what the past leaves of y that future u explains, 0 to 1."""
    lags: NDArray[np.int_]
    """-(q - 1) … p, of the coefficients; at 0 and below, u comes after y."""
    coefficients: Vector
    """Of u(t - lag)."""
    std: Vector
    """Their standard deviations."""
    N: int
    """Rows used."""


def sims(data: Dataset) -> Sims:
    """Test whether the input still to come helps to explain y.

    The regression is ::

        y(t) = c + a_1 y(t-1) + … + a_p y(t-p) + b_1 u(t-1) + … + b_p u(t-p)
                 + g_1 w_1(t-p) + g_2 w_2(t-p) + g_3 w_3(t-p)
                 + f_0 u(t) + … + f_4 u(t+4) + e(t)
        w_j(t) = l_j w_j(t-1) + u(t-1),     l = 1, 1 - 1/(3 p), 1 - 1/p

    with c of each experiment and H0: f = 0. y(t) is read before u(t) is applied, so in open loop
    no u from t on can know of e(t), whatever u is: the test supposes nothing of how u was made.
    (Granger's test, of u on past y, supposes that u's own past is modelled; a PRBS or a held or
    low-pass input then passes for feedback.) In closed loop the noise in y(t) is in u(t).

    p = 15 lg N, at most 60, and the sums w stand for the input before that: what is cut off of
    the past is what a future u could tell of in open loop. As y's past has more lags than the
    plant has poles, the F distribution holds where y integrates, too: see [2] and [3].

    A missing y(t) costs its own row. In the rows after it a line between its neighbours stands for
    it, of which the later is y(t) at most: no future u comes in by it. Nothing is carried over an
    experiment's end, nor over a gap longer than p/2.

    Time and memory are linear in N, memory beyond u and y constant: R of the QR factorisation is
    made block by block.

    Raises
    ------
    CannotTellError
        u follows from the past (a constant, a sine, a sum of few), or y does (no noise).
    ValueError
        There are too few samples.

    References
    ----------
    .. [1] C. A. Sims, American Economic Review 62 (1972) 540-552; with y's own past as
       J. Geweke, R. Meese, W. Dent, J. Econometrics 21 (1983) 161-194.
    .. [2] C. A. Sims, J. H. Stock, M. W. Watson, Econometrica 58 (1990) 113-144.
    .. [3] H. Y. Toda, T. Yamamoto, J. Econometrics 66 (1995) 225-250.
    """
    p = _lags(data)
    constants = len(data.starts)
    d = constants + 2 * p + len(_SLOW)
    R, N = _factor(data, constants, p)
    degrees = N - d - FUTURE
    _require_information(R, constants, d, degrees)
    rss_0, rss_1 = (float(np.sum(R[k:, -1] ** 2)) for k in (d, d + 1))
    rss = float(R[-1, -1] ** 2)
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
    """Return p = 15 lg N, or fewer where there are not enough rows for so many parameters."""
    there, fixed = data.N - data.missing, len(data.starts) + len(_SLOW) + FUTURE
    affordable = (there // _ROWS_PER_PARAMETER - fixed) // 2
    p = min(round(_LAGS_PER_DECADE * log10(max(there, 1))), _MOST_LAGS, affordable)
    if p < _LEAST_LAGS:
        needed = _ROWS_PER_PARAMETER * (2 * _LEAST_LAGS + fixed)
        msg = f"{there} samples came; the test for feedback needs at least {needed}: "
        raise InputError(msg + "record longer, or lose fewer")
    return p


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Piece:
    """Samples of one experiment without a long gap; y has a line where it is missing."""

    u: Vector
    sums: Array
    y: Vector
    valid: Mask
    experiment: int
    p: int

    def rows(self, constants: int) -> Iterator[Array]:
        """Yield [1 of each experiment, past y, past u, sums, future u, y(t)] in blocks of rows."""
        past_y, u = (
            sliding_window_view(self.y, self.p + 1),
            sliding_window_view(self.u, self.p + FUTURE),
        )
        for begin in range(0, u.shape[0], _BLOCK):
            part = slice(begin, min(begin + _BLOCK, u.shape[0]))
            used = self.valid[self.p :][part]
            y_, u_, sums = past_y[part][used], u[part][used], self.sums[self.p :][part][used]
            one = np.zeros((y_.shape[0], constants))
            one[:, self.experiment] = 1.0
            past_u, future = u_[:, : self.p][:, ::-1], u_[:, self.p :]
            yield np.hstack([one, y_[:, -2::-1], past_u, sums, future, y_[:, -1:]])


def _pieces(data: Dataset, p: int) -> Iterator[_Piece]:
    """Return what lies between long gaps, a line in place of what is missing."""
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
            yield _Piece(u=u, sums=sums[s], y=y, valid=valid, experiment=i, p=p)


def _sums(u: Vector, p: int) -> Array:
    """Return w_1(t - p) … (N, 3): sums of the input more than p samples ago, slowly forgotten."""
    before = np.append(np.zeros(p + 1), u - u.mean())[: u.size]
    return np.column_stack([filtered([1.0], [1.0, slow / p - 1.0], before) for slow in _SLOW])


def _factor(data: Dataset, constants: int, p: int) -> tuple[Array, int]:
    """Return R of the QR factorisation of all rows, and their number."""
    D = constants + 2 * p + len(_SLOW) + FUTURE + 1
    R, N = np.zeros((D, D)), 0
    for piece in _pieces(data, p):
        for block in piece.rows(constants):
            R = np.asarray(np.linalg.qr(np.vstack([R, block]), mode="r"))
            N += block.shape[0]
    return R, N


def _require_information(R: Array, constants: int, d: int, degrees: int) -> None:
    """Refuse data of which nothing is left to test."""
    if degrees < d:
        raise InputError(
            f"{degrees + d + FUTURE} samples have their past beside them; the test for feedback "
            f"needs {2 * d + FUTURE}: record longer, or lose fewer"
        )
    left, power = R[d, d] ** 2, float(np.sum(R[constants:, d] ** 2))
    if left <= _NOTHING * power:
        raise CannotTellError(
            "u follows from its own past (a constant, a sine, a sum of few), so whether y has "
            "a part in it cannot be told: record with a telegraph, a PRBS or noise"
        )
    left, power = float(np.sum(R[d:, -1] ** 2)), float(np.sum(R[constants:, -1] ** 2))
    if left <= _NOISELESS * power:
        raise CannotTellError(
            "y follows from the past without any noise, and feedback shows by nothing else"
        )
