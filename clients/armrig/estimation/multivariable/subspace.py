"""Poles of a state-space model with several signals, by projections and by long regressions.

References
----------
.. [1] P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996, chapters
   4 and 5.
.. [2] M. Jansson, "Subspace identification and ARX modeling", Proc. 13th IFAC Symp. on System
   Identification (2003) (states from a long ARX model).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from armrig.models.structure_table import Weights
from armrig.numerics.gram import cholesky_factor, gram_of_windows
from armrig.numerics.least_squares import least_squares, triangle, without_span
from armrig.numerics.polynomial import Array, lagged
from armrig.numerics.stretches import stretches

_BLOCK_ROWS = 2048

Signals = Sequence[tuple[Array, Array]]
"""Inputs (N, nu) and outputs (N, ny) of each stretch of complete data."""


def complete_stretches(
    parts: Sequence[tuple[Array, Array]], length: int
) -> list[tuple[Array, Array]]:
    """Return u and y of each stretch of at least `length` samples without a missing output."""
    return [
        (u[s], y[s])
        for u, y in parts
        for s in stretches(np.asarray(np.isfinite(y).all(axis=1)))
        if s.stop - s.start >= length
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Projected:
    """Future outputs projected on the past, for given future inputs."""

    R: Array
    """Triangular factor of [1 U_f U_p Y_p Y_f], without the constant."""
    H: Array
    """Matrix H in Y_f = H W_p + L U_f + noise."""
    U: Array
    """Left singular vectors, multiplied by the inverse of the left weight matrix."""
    singular_values: Array
    """Singular values of the weighted projection."""
    horizon: int
    """Number of past and of future samples."""
    nu: int
    """Number of inputs."""
    ny: int
    """Number of outputs."""
    N: int
    """Number of windows."""

    def columns(self, *names: str) -> Array:
        """Return the indices of the columns "uf", "up", "yp" or "yf" in R, ordered by instant."""
        i, nu, ny = self.horizon, self.nu, self.ny
        widths = {"uf": i * nu, "up": i * nu, "yp": i * ny, "yf": i * ny}
        begins = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
        return np.concatenate([begins[n] + np.arange(widths[n]) for n in names])


def projected(signals: Signals, horizon: int, weights: Weights) -> Projected:
    """Return the singular value decomposition of the weighted projection."""
    i = horizon
    (u, y), *_ = signals
    nu, ny = u.shape[1], y.shape[1]
    R = _factor(signals, i)
    N = sum(v.shape[0] - 2 * i + 1 for _, v in signals)
    f, p = i * nu, i * (nu + ny)
    R12, R22 = R[:f, f : f + p], R[f : f + p, f : f + p]
    R23, R33 = R[f : f + p, f + p :], R[f + p :, f + p :]
    H = least_squares(R22, R23).T
    if weights == "cva":
        _, values, V = np.linalg.svd(np.vstack([R23, R33]), full_matrices=False)
        root = np.maximum(values, 1e-12 * values[0])
        U, sigma, _ = np.linalg.svd((V @ R23.T) / root[:, None], full_matrices=False)
        U = V.T @ (root[:, None] * U)
    elif weights == "moesp":
        U, sigma, _ = np.linalg.svd(R23.T, full_matrices=False)
    else:
        U, sigma, _ = np.linalg.svd(H @ np.hstack([R12.T, R22.T]), full_matrices=False)
    return Projected(R=R, H=H, U=U, singular_values=sigma, horizon=i, nu=nu, ny=ny, N=N)


def _factor(signals: Signals, i: int) -> Array:
    """Return the triangular factor of [U_f U_p Y_p Y_f] after the means are subtracted.

    The factor is the Cholesky factor of the Gram matrix of the windows. If the squares in the Gram
    matrix lose too many digits, the factor is computed by a QR decomposition of the windows.
    """
    (u, y), *_ = signals
    nu, ny = u.shape[1], y.shape[1]
    whole = np.vstack([np.hstack(part) for part in signals])
    centred = [[*(np.hstack(part) - whole.mean(axis=0)).T] for part in signals]
    at = np.arange((nu + ny) * 2 * i).reshape(nu + ny, 2 * i).T  # instant after instant
    order = np.concatenate([at[i:, :nu], at[:i, :nu], at[:i, nu:], at[i:, nu:]], axis=None)
    R = cholesky_factor(gram_of_windows(centred, 2 * i, nu + ny)[np.ix_(order, order)])
    return triangle(_windows(signals, i), 1 + order.size)[1:, 1:] if R is None else R


def _windows(signals: Signals, i: int) -> list[Array]:
    """Return blocks of rows [1, future u, past u, past y, future y]."""
    blocks = []
    for u, y in signals:
        count = y.shape[0] - 2 * i + 1
        for begin in range(0, count, _BLOCK_ROWS):
            rows = np.arange(begin, min(begin + _BLOCK_ROWS, count))[:, None]
            past, future = rows + np.arange(i), rows + np.arange(i, 2 * i)
            parts = [
                x[at].reshape(rows.size, -1)
                for x, at in ((u, future), (u, past), (y, past), (y, future))
            ]
            blocks.append(np.hstack([np.ones((rows.size, 1)), *parts]))
    return blocks


def realised(found: Projected, order: int) -> tuple[Array, Array, Array]:
    """Return A, C and K for `order` states; K is 0 if there is no steady Kalman filter."""
    n, ny, w = order, found.ny, found
    Gamma = found.U[:, :n] * np.sqrt(found.singular_values[:n])
    shift = np.linalg.pinv(Gamma[:-ny])
    A, C = shift @ Gamma[ny:], Gamma[:ny]
    uf, yf = w.columns("uf"), w.columns("yf")
    X = w.R[:, w.columns("up", "yp")] @ np.linalg.lstsq(Gamma, found.H, rcond=None)[0].T
    later = np.concatenate([w.columns("up"), uf[: w.nu], w.columns("yp"), yf[:ny]])
    known = w.R[:, np.concatenate([uf[w.nu :], later])]
    coefficients = least_squares(known, w.R[:, yf[ny:]])
    ahead = w.R[:, later] @ coefficients[uf.size - w.nu :]
    left = np.column_stack([ahead @ shift.T, w.R[:, yf[:ny]]])
    rho = without_span(np.hstack([X, w.R[:, uf]]), left)
    covariance = rho.T @ rho / max(w.N - n - uf.size, 1)
    return A, C, _gain(A, C, covariance)


def _gain(A: Array, C: Array, covariance: Array) -> Array:
    n = A.shape[0]
    Q, S, R = covariance[:n, :n], covariance[:n, n:], covariance[n:, n:]
    try:
        P = solve_discrete_are(A.T, C.T, Q, R, s=S)
        K = np.linalg.solve(C @ P @ C.T + R, C @ P @ A.T + S.T).T
    except (LinAlgError, ValueError):
        return np.zeros((n, C.shape[0]))
    return np.asarray(K)


def long_regression(signals: Signals, lags: int, *, direct: bool) -> Array:
    """Return the coefficients (lags, ny, nu + ny) of past u and y in a regression of y."""
    blocks, right = [], []
    for u, y in signals:
        s = np.hstack([u, y])
        columns = [np.ones((y.shape[0], 1))] + ([u] if direct else [])
        columns += [
            np.column_stack([lagged(x, [k])[:, 0] for x in s.T]) for k in range(1, lags + 1)
        ]
        blocks.append(np.hstack(columns)[lags:])
        right.append(y[lags:])
    (u, y), *_ = signals
    theta = least_squares(np.vstack(blocks), np.vstack(right))
    rest = theta[1 + (u.shape[1] if direct else 0) :]
    return rest.reshape(lags, u.shape[1] + y.shape[1], y.shape[1]).transpose(0, 2, 1)


def from_impulses(impulses: Array, order: int, weights: Array | None = None) -> tuple[Array, Array]:
    """Return A and C of the impulse response (k, ny, m), from its Hankel matrix (Ho and Kalman).

    Parameters
    ----------
    weights : ndarray (m,), optional
        Root-mean-square value of each input. With these weights the Hankel matrix has the unit of
        the output.
    """
    k, ny, m = impulses.shape
    w = np.ones(m) if weights is None else weights
    r = (k + 1) // 2
    H = np.block([[impulses[a + b] * w for b in range(k - r + 1)] for a in range(r)])
    U, s, _ = np.linalg.svd(H, full_matrices=False)
    Gamma = U[:, :order] * np.sqrt(s[:order])
    return np.linalg.pinv(Gamma[:-ny]) @ Gamma[ny:], Gamma[:ny]
