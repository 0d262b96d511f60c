"""All states of x(k+1) = Phi x(k) + w(k) at once."""

from __future__ import annotations

from math import isqrt

import numpy as np

from armrig.numerics.polynomial import Array


def recursion(Phi: Array, w: Array, x0: Array) -> Array:
    """Return x(0) … x(N) of x(k+1) = Phi x(k) + w(k), for one right-hand side or several.

    The N steps are cut into blocks of about sqrt(N). All blocks run beside each other from zero,
    and then each gets what its true start adds: some 2 sqrt(N) operations on whole arrays in place
    of N small ones. Unlike a transfer function this loses no digits where poles lie close together
    (those of the arm at 1 kHz all lie near 1), and it needs no eigenvectors.

    Parameters
    ----------
    Phi : ndarray, shape (n, n)
        Transition matrix.
    w : ndarray, shape (N, n) or (N, m, n)
        Inputs of the states, N >= 0; the m right-hand sides do not touch each other.
    x0 : ndarray, shape (n,) or (m, n)
        First state.

    Returns
    -------
    ndarray, shape (N + 1, n) or (N + 1, m, n)
        States; where Phi is unstable enough they overflow to inf and nan, without a warning.
    """
    N, n = w.shape[0], Phi.shape[0]
    shape = (N + 1, *w.shape[1:])
    m = w[0].size // n if N else x0.size // n
    length = isqrt(N) + 1
    blocks = N // length + 1
    kind = np.result_type(Phi, w, x0, np.float64)
    padded = np.zeros((blocks * length, m, n), dtype=kind)
    padded[:N] = w.reshape(N, m, n)
    inputs = padded.reshape(blocks, length, m, n)
    from_zero = np.zeros((length + 1, blocks * m, n), dtype=kind)
    powers = np.empty((length + 1, n, n), dtype=kind)
    powers[0] = np.eye(n)
    starts = np.empty((blocks, m, n), dtype=kind)
    starts[0] = x0
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(length):
            from_zero[k + 1] = from_zero[k] @ Phi.T + inputs[:, k].reshape(-1, n)
            powers[k + 1] = Phi @ powers[k]
        ends = from_zero[length].reshape(blocks, m, n)
        for j in range(blocks - 1):
            starts[j + 1] = starts[j] @ powers[length].T + ends[j]
        by_start = starts.reshape(-1, n) @ powers[:length].reshape(-1, n).T
        x = by_start.reshape(blocks, m, length, n).transpose(0, 2, 1, 3)
        x = x + from_zero[:length].reshape(length, blocks, m, n).transpose(1, 0, 2, 3)
    return x.reshape(blocks * length, m, n)[: N + 1].reshape(shape)
