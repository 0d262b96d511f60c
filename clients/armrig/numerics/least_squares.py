"""Least squares through an orthonormal basis, never through the normal equations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.linalg.lapack import dgeqp3, dorgqr

from armrig.numerics.polynomial import Array

# Below this share of the largest one, a direction of the scaled columns is rounding noise.
RANK_TOLERANCE = 1e-12
_BLOCK = 64  # columns that LAPACK takes at once


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """Orthonormal basis of the columns of a matrix M (N, d) of rank r."""

    Q: Array
    """(N, r), orthonormal."""
    W: Array
    """(d, r): W Q^T y are the least-squares coefficients of y, W W^T is (M^T M)^-1."""

    @property
    def rank(self) -> int:
        """Number of independent columns."""
        return int(self.Q.shape[1])

    def coefficients(self, y: Array) -> Array:
        """Return x of least |y - M x|; a column that depends on the others gets zero."""
        return np.asarray(self.W @ (self.Q.T @ y))

    def without(self, y: Array) -> Array:
        """Return y less its projection on the columns of M."""
        return np.asarray(y - self.Q @ (self.Q.T @ y))

    def spread(self, rows: NDArray[np.bool_]) -> Basis:
        """Return the basis of the matrix with M in these of its rows and zeros in the others."""
        Q = np.zeros((rows.size, self.rank))
        Q[rows] = self.Q
        return Basis(Q=Q, W=self.W)


def column_norms(M: Array) -> Array:
    """Return the Euclidean norm of each column."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->j", M, M)))


def orthonormal(M: Array) -> Basis:
    """Return a basis of the columns of M (N, d), by QR with the columns scaled and pivoted.

    Scaling makes the rank independent of units. QR, not the normal equations: squaring M
    squares its condition number.
    """
    Q, R, kept, scale = _decomposed(M)
    W = np.zeros((M.shape[1], kept.size))
    W[kept] = upper_inverse(R) / scale[:, None]
    return Basis(Q=Q, W=W)


def least_squares(M: Array, Y: Array) -> Array:
    """Return X (d, m) of least |Y - M X|, as a basis of M does, without the inverse of its R."""
    Q, R, kept, scale = _decomposed(M)
    X = np.zeros((M.shape[1], Y.shape[1]))
    if kept.size:
        # Not dtrtrs: OpenBLAS wakes its threads for it, too. Pivoting leaves a triangle as it is.
        X[kept] = np.linalg.solve(R, Q.T @ Y) / scale[:, None]
    return X


def without_span(M: Array, Y: Array) -> Array:
    """Return Y (N, m) less its projection on the columns of M."""
    Q, *_ = _decomposed(M)
    return np.asarray(Y - Q @ (Q.T @ Y))


def _decomposed(M: Array) -> tuple[Array, Array, NDArray[np.int_], Array]:
    """Return Q and R of the independent columns, which they are, and what each was divided by."""
    scale = column_norms(M)
    used = np.flatnonzero(scale > 1e-100)  # the square of less underflows
    if used.size == 0 or M.shape[0] == 0:
        none = np.zeros(0)
        return np.zeros((M.shape[0], 0)), np.zeros((0, 0)), np.zeros(0, dtype=np.int_), none
    whole = M if used.size == M.shape[1] else M[:, used]
    # In LAPACK's order, and its own to overwrite: nothing is copied again.
    Q, R, order = _pivoted_qr(np.divide(whole, scale[used], order="F"))
    diagonal = np.abs(np.diag(R))
    r = int(np.count_nonzero(diagonal > RANK_TOLERANCE * diagonal[0]))
    kept = used[order[:r]]
    return Q[:, :r], R[:r, :r], kept, scale[kept]


def _pivoted_qr(M: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """Return Q, R and the order of the columns, as SciPy's qr does at twice the cost; M is lost."""
    n, k = M.shape[1], min(M.shape)
    factored, order, tau, _, _ = dgeqp3(M, lwork=_BLOCK * (n + 1), overwrite_a=1)
    R = np.triu(factored[:k])
    Q, _, _ = dorgqr(factored[:, :k], tau, lwork=_BLOCK * k, overwrite_a=1)
    return Q, R, order - 1


def upper_inverse(R: Array) -> Array:
    """Return the inverse of a small upper triangular R (n, n) by back substitution.

    Not LAPACK's: OpenBLAS wakes its threads for it however small R is, which on a busy machine
    costs milliseconds a call, a thousand times the work.
    """
    X = np.eye(R.shape[0])
    for i in range(R.shape[0] - 1, -1, -1):
        X[i] = (X[i] - R[i, i + 1 :] @ X[i + 1 :]) / R[i, i]
    return X


# The triangle R of a tall matrix, block of rows by block, so that length costs no memory.


def triangle(blocks: Iterable[Array], width: int) -> Array:
    """Return R (width, width) of Q R = M, for an M given as blocks of rows (n_i, width).

    R^T R is M^T M without having been squared; with fewer rows than columns the last rows are 0.
    """
    R = np.zeros((0, width))
    for block in blocks:
        R = qr(np.vstack([R, block]), mode="r", check_finite=False)[0][:width]
    return np.vstack([R, np.zeros((width - R.shape[0], width))])
