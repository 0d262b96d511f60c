"""Gram matrix of all windows of a signal, from correlations and from the two ends of the signal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dpotrf

from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array

# Least share of a column that the earlier columns do not explain. The normal equations contain the
# square of this share, 1e-10, with rounding errors of about 1e-16. A variance then has about five
# correct digits, and an estimate about two.
_MIN_COLUMN_REST = 1e-5
_MIN_DISPLACEMENT_RATIO = 8  # with more windows than 8 times their length, the recursion is faster


def gram_of_windows(parts: Sequence[Sequence[Array]], length: int, m: int = 2) -> Array:
    """Return the Gram matrix of the windows of m signals after the column means are subtracted.

    The shape of the Gram matrix is (m length, m length).

    Row t of the matrix of windows contains the samples t … t + length - 1 of the first signal. The
    same samples of the second signal follow, and so on. Let x and z be two signals. Then entry
    (i, j) of their block is the sum of x(t + i) z(t + j) over the n windows. A recursion computes
    this sum ::

        G(i + 1, j + 1) = G(i, j) + x(n + i) z(n + j) - x(i) z(j)

    The first row and column of each block are computed as correlations of x and z. The recursion
    needs m² n length multiplications. A product of the matrix of windows with itself would need
    (m length)² n multiplications.

    Parameters
    ----------
    parts : sequence of sequences of ndarray
        The m signals of each part, for example (u, y), of at least `length` samples.
    m : int, default 2
        Number of signals.

    References
    ----------
    .. [1] T. Kailath, S.-Y. Kung, M. Morf, J. Math. Anal. Appl. 68 (1979) 395-407 (displacement
       rank).
    """
    G, total, N = np.zeros((m, length, m, length)), np.zeros((m, length)), 0
    for part in parts:
        x = np.stack(part)
        n = x.shape[1] - length + 1
        if n < _MIN_DISPLACEMENT_RATIO * length:
            M = np.lib.stride_tricks.sliding_window_view(x, n, axis=1).reshape(m * length, n)
            G += (M @ M.T).reshape(G.shape)
            total += M.sum(axis=1).reshape(total.shape)
        else:
            G += _by_displacement(x, length)
            inner = x[:, length - 1 : n].sum(axis=1)
            total += inner[:, None] + _ends(x, length)
        N += n
    whole, s = G.reshape(m * length, m * length), total.ravel()
    return np.asarray(whole - np.outer(s, s) / max(N, 1))


def _ends(x: Array, length: int) -> Array:
    """Return the sum of x(i) … x(length - 2) and x(n) … x(n + i - 1) for each i, (m, length).

    The sum of the sample number i over all n windows also contains x(length - 1) … x(n - 1), for
    every i.
    """
    before = np.cumsum(x[:, : length - 1][:, ::-1], axis=1)[:, ::-1]
    after = np.cumsum(x[:, x.shape[1] - length + 1 :], axis=1)
    none = np.zeros((x.shape[0], 1))
    return np.asarray(np.hstack([before, none]) + np.hstack([none, after]))


def _by_displacement(x: Array, length: int) -> Array:
    """Return the Gram matrix of the windows of m signals x (m, N), (m, length, m, length)."""
    m, n = x.shape[0], x.shape[1] - length + 1
    first = np.array([[np.correlate(z, v[:n]) for z in x] for v in x])
    G = np.empty((m, length, m, length))
    G[:, 0] = first
    G[:, :, :, 0] = first.transpose(1, 2, 0)
    late, early = x[:, n : n + length - 1], x[:, : length - 1]
    change = np.einsum("ai,bj->aibj", late, late) - np.einsum("ai,bj->aibj", early, early)
    for i in range(length - 1):
        G[:, i + 1, :, 1:] = G[:, i, :, :-1] + change[:, i]
    return G


def least_squares_by_gram(rows: Array, y: Array) -> Array:
    """Return x (d,) that minimises |y - x M| for the rows of M (d, N), by the normal equations.

    A second step corrects the rounding errors of the first step. If M M^T has too few correct
    digits, M itself is decomposed by QR. Equations with NaN in y are left out.

    References
    ----------
    .. [1] Å. Björck, *Numerical Methods for Least Squares Problems*, 1996, section 6.6
       (corrected semi-normal equations).
    """
    known = np.isfinite(y)
    M, y = (rows, y) if known.all() else (rows[:, known], y[known])
    R = cholesky_factor(M @ M.T)
    if R is None:
        return orthonormal(M.T).coefficients(y)
    x = np.zeros(len(M))
    for _ in range(2):
        x += np.linalg.solve(R, np.linalg.solve(R.T, M @ (y - x @ M)))
    return x


def cholesky_factor(G: Array) -> Array | None:
    """Return the upper triangular R of R^T R = G, or None if G has too few correct digits."""
    scale = np.sqrt(np.diag(G))
    if not (scale > 0).all():
        return None
    R, failed = dpotrf(G / np.outer(scale, scale), clean=True)
    if failed or np.diag(R).min() < _MIN_COLUMN_REST:
        return None
    return np.asarray(R * scale)
