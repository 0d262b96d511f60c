"""Granger's test: whether the past output helps to predict the input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import column_norms, orthonormal
from armrig.numerics.regressors import complete, past

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

MOST_LAGS = 10
_ROWS_PER_PARAMETER = 5  # fewer and the F distribution is a wish
_PREDICTABLE = 1e-10  # share of u's power below which its own past says all of it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Granger:
    """The F-test of u on past y."""

    p_value: float
    """Of the hypothesis that past y does not help to predict u."""
    F: float
    """(RSS_0 - RSS)/q over RSS/(N - d), q past y's among d regressors."""
    lags: int
    """Of u and of y each, chosen by BIC."""
    q: int
    """Numerator's degrees of freedom."""
    degrees: int
    """Denominator's."""
    gain: Vector
    """Coefficients of y(t - 1) … y(t - lags), in u's unit per y's."""
    explained: float
    """Share of what u's own past leaves of u that past y explains, 0 to 1."""
    N: int
    """Rows used."""


def granger(data: Dataset, most_lags: int = MOST_LAGS) -> Granger:
    """Test whether past y helps to predict u.

    The regression is ::

        u(t) = c + a_1 u(t-1) + … + a_p u(t-p) + g_1 y(t-1) + … + g_p y(t-p) + e(t)

    with c of each experiment, H0: g_1 = … = g_p = 0, and p by BIC on rows common to all p. y is in
    levels: its difference would throw away what a controller of the angle feeds back. There is no
    trend, which would stand in for an angle that turns at a steady rate. Without one the F
    distribution holds for an angle too, since its largest part is the ramp that u's mean makes.

    Raises
    ------
    ValueError
        There are too few rows without a hole, or u is known from its own past (a sine).

    References
    ----------
    .. [1] C. W. J. Granger, Econometrica 37 (1969) 424-438.
    .. [2] C. A. Sims, J. H. Stock, M. W. Watson, Econometrica 58 (1990) 113-144 (integrated
       regressors), case with drift.
    """
    rows, target = _rows(data, most_lags)
    p = _by_bic(rows, target, most_lags, len(data.starts))
    rows, target = _rows(data, p)
    own = np.hstack([rows[:, : len(data.starts)], rows[:, len(data.starts) :: 2]])
    alone, both = (
        orthonormal(own),
        orthonormal(np.hstack([own, rows[:, len(data.starts) + 1 :: 2]])),
    )
    q, degrees = both.rank - alone.rank, target.size - both.rank
    without, with_ = alone.without(target), both.without(target)
    rss_0, rss = float(without @ without), float(with_ @ with_)
    if rss_0 <= _PREDICTABLE * float(np.sum((target - target.mean()) ** 2)) or q == 0:
        msg = "u follows from its own past (a constant, a sine, a sum of few): whether y has any "
        msg += "part in it cannot be told; record with a telegraph, a PRBS or noise"
        raise ValueError(msg)
    F = (rss_0 - rss) / q / max(rss / degrees, 1e-300)
    return Granger(
        p_value=_tail(F, q, degrees),
        F=F,
        lags=p,
        q=q,
        degrees=degrees,
        gain=both.coefficients(target)[own.shape[1] :],
        explained=1 - rss / rss_0,
        N=target.size,
    )


def _tail(F: float, q: int, degrees: int) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(q, degrees, max(F, 0.0)))


def _rows(data: Dataset, p: int) -> tuple[Matrix, Vector]:
    """Return [1 of each experiment, u(t-1) y(t-1) u(t-2) y(t-2) …] and u(t), complete rows only."""
    count = len(data.starts)
    blocks, targets = [], []
    for i, part in enumerate(data.experiments()):
        level = float(np.mean(part.y[part.valid])) if part.valid.any() else 0.0
        pairs = np.empty((part.N, 2 * p))
        pairs[:, ::2] = past(part.u, range(1, p + 1))
        pairs[:, 1::2] = past(part.y - level, range(1, p + 1))
        used = complete(pairs)
        constants = np.zeros((part.N, count))
        constants[:, i] = 1.0
        blocks.append(np.hstack([constants, pairs])[used])
        targets.append(part.u[used])
    rows, target = np.vstack(blocks), np.concatenate(targets)
    needed = _ROWS_PER_PARAMETER * rows.shape[1]
    if target.size < needed:
        msg = f"{data.N - data.missing} samples came, {target.size} of them with {p} samples "
        msg += f"without a hole before them; the test for feedback needs {needed} such: record "
        msg += f"longer (at least {needed + p} samples), or lose fewer"
        raise ValueError(msg)
    return rows, target


def _by_bic(rows: Matrix, target: Vector, most: int, constants: int) -> int:
    """Return p of least N ln RSS + d ln N; one QR holds all of them, columns in order of lag."""
    scale = column_norms(rows)
    M = np.column_stack([rows / np.where(scale > 0, scale, 1.0), target])
    R: Matrix = np.asarray(np.linalg.qr(M, mode="r"))
    left = np.cumsum(R[::-1, -1] ** 2)[::-1]  # left[d] is the RSS of the first d columns
    N = target.size
    d = constants + 2 * np.arange(1, most + 1)
    bic = N * np.log(np.maximum(left[d], 1e-300)) + d * np.log(N)
    return int(np.argmin(bic)) + 1
