"""Least squares by an orthonormal basis, or by a Gram matrix that has enough correct digits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqp3, dgeqrf, dorgqr, dpotrf

from armrig.numerics.polynomial import Array

RANK_TOLERANCE = 1e-12
"""Share of the largest diagonal entry of R; columns with a smaller entry count as dependent."""
_NO_NORM = 1e-100  # the square of a smaller number underflows
_LAPACK_BLOCK_COLUMNS = 64  # columns that LAPACK decomposes at once


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """Orthonormal basis of the columns of a matrix M (N, d) of rank r."""

    Q: Array
    """Orthonormal columns (N, r)."""
    R: Array
    """Triangular factor (r, r) of the independent columns of M, each divided by its `scale`."""
    kept: NDArray[np.int_]
    """Indices (r,) of the independent columns of M."""
    scale: Array
    """Norms (r,) of the independent columns of M."""
    d: int
    """Number of columns of M."""

    @property
    def W(self) -> Array:
        """Matrix (d, r): W Q^T y are the least-squares coefficients of y, and W W^T is (M^T M)^-1.

        The matrix is computed when it is needed, because a search often needs Q alone.
        """
        W = np.zeros((self.d, self.rank))
        W[self.kept] = upper_inverse(self.R) / self.scale[:, None]
        return W

    @property
    def rank(self) -> int:
        """Number of independent columns."""
        return int(self.Q.shape[1])

    def coefficients(self, y: Array) -> Array:
        """Return x that minimises |y - M x|; the coefficient of a dependent column is 0."""
        return np.asarray(self.W @ (self.Q.T @ y))

    def without(self, y: Array) -> Array:
        """Return y minus its projection on the columns of M."""
        return np.asarray(y - self.Q @ (self.Q.T @ y))

    def spread(self, rows: NDArray[np.bool_]) -> Basis:
        """Return the basis of a matrix with M in the rows of a mask and zeros in all other rows."""
        Q = np.zeros((rows.size, self.rank))
        Q[rows] = self.Q
        return replace(self, Q=Q)


def column_norms(M: Array) -> Array:
    """Return the Euclidean norm of each column."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->j", M, M)))


def orthonormal(M: Array, tolerance: float = RANK_TOLERANCE) -> Basis:
    """Return a basis of the columns of M (N, d), by QR with the columns scaled and pivoted.

    Scaling makes the rank independent of units. The method is QR, because the normal equations
    square the condition number of M. `tolerance` is the relative error of M.
    """
    Q, R, kept, scale = _decompose(M, tolerance)
    return Basis(Q=Q, R=R, kept=kept, scale=scale, d=M.shape[1])


def least_squares(M: Array, Y: Array) -> Array:
    """Return the least X (d, m) that minimises |Y - M X|, with each column of M scaled to norm 1.

    Dependent columns share their coefficient. A coefficient of 0 for one of them would depend on
    the order of the pivots, and this order on rounding errors.
    """
    Q, R, kept, scale = _decompose(M)
    X = np.zeros((M.shape[1], Y.shape[1]))
    if not kept.size:
        return X
    norms = column_norms(M)
    used = np.flatnonzero(norms > _NO_NORM)
    # dtrtrs is not used, because OpenBLAS starts its threads for dtrtrs.
    if kept.size == used.size:
        X[kept] = np.linalg.solve(R, Q.T @ Y) / scale[:, None]
        return X
    rows = np.linalg.qr((Q.T @ (M[:, used] / norms[used])).T)
    X[used] = rows.Q @ np.linalg.solve(rows.R.T, Q.T @ Y) / norms[used, None]
    return X


def without_span(M: Array, Y: Array) -> Array:
    """Return Y (N, m) minus its projection on the columns of M."""
    Q, *_ = _decompose(M)
    return np.asarray(Y - Q @ (Q.T @ Y))


def _decompose(
    M: Array, tolerance: float = RANK_TOLERANCE
) -> tuple[Array, Array, NDArray[np.int_], Array]:
    """Return Q and R of the independent columns, their indices and their scales."""
    scale = column_norms(M)
    used = np.flatnonzero(scale > _NO_NORM)
    if used.size == 0 or M.shape[0] == 0:
        none = np.zeros(0)
        return np.zeros((M.shape[0], 0)), np.zeros((0, 0)), np.zeros(0, dtype=np.int_), none
    columns = M if used.size == M.shape[1] else M[:, used]
    # The quotient is a new array in Fortran order, which LAPACK can overwrite without a copy.
    Q, R, order = _qr_with_pivots(np.divide(columns, scale[used], order="F"))
    diagonal = np.abs(np.diag(R))
    r = int(np.count_nonzero(diagonal > tolerance * diagonal[0]))
    kept = used[order[:r]]
    return Q[:, :r], R[:r, :r], kept, scale[kept]


def _qr_with_pivots(M: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """Return Q, R and the order of the columns in half of the time of SciPy's qr; overwrite M."""
    n, k = M.shape[1], min(M.shape)
    factored, order, tau, _, _ = dgeqp3(M, lwork=_LAPACK_BLOCK_COLUMNS * (n + 1), overwrite_a=1)
    R = np.triu(factored[:k])
    Q, _, _ = dorgqr(factored[:, :k], tau, lwork=_LAPACK_BLOCK_COLUMNS * k, overwrite_a=1)
    return Q, R, order - 1


@lru_cache
def upper_ones(k: int, n: int) -> Array:
    """Return ones on and above the diagonal, (k, n), by which a product is faster than np.triu."""
    return np.triu(np.ones((k, n)))


def upper_inverse(R: Array) -> Array:
    """Return the inverse of a small upper triangular R (n, n) by back substitution.

    LAPACK is not used: OpenBLAS starts its threads even for a small R. On a busy machine a call
    then takes milliseconds, a thousand times as long as the computation.
    """
    X = np.eye(R.shape[0])
    for i in range(R.shape[0] - 1, -1, -1):
        X[i] = (X[i] - R[i, i + 1 :] @ X[i + 1 :]) / R[i, i]
    return X


def triangle(blocks: Iterable[Array], width: int) -> Array:
    """Return R (width, width) of M = Q R, with M given as blocks of rows (n_i, width).

    R^T R equals M^T M, but M^T M is never computed. If M has fewer rows than columns, the last rows
    of R are 0. The memory does not grow with the number of blocks.
    """
    R = np.zeros((0, width))
    for block in blocks:
        if not block.size:
            continue
        stack = np.asfortranarray(np.vstack([R, block]))
        R = dgeqrf(stack, lwork=_LAPACK_BLOCK_COLUMNS * width, overwrite_a=True)[0][:width]
        R = R * upper_ones(*R.shape)
    return np.vstack([R, np.zeros((width - R.shape[0], width))])


# Least share of a column that the earlier columns do not explain. The normal equations contain the
# square of this share, 1e-10, with rounding errors of about 1e-16. A variance then has about five
# correct digits, and an estimate about two.
_MIN_COLUMN_REST = 1e-5


def cholesky_factor(G: Array) -> Array | None:
    """Return the upper triangular R of R^T R = G, or None if G has too few correct digits."""
    scale = np.sqrt(np.diag(G))
    if not (scale > 0).all():
        return None
    R, failed = dpotrf(G / np.outer(scale, scale), clean=True)
    if failed or np.diag(R).min() < _MIN_COLUMN_REST:
        return None
    return np.asarray(R * scale)
