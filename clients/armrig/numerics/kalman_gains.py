"""Gains of the Kalman filter of a model in innovations form, for data with missing outputs.

The model is x(t+1) = A x + B u + K e, y = C x + D u + e, with the covariance Lambda of e. P(t) is
the covariance of the state, given the outputs measured before t. The index o marks the outputs
measured at t ::

    S(t) = C_o P(t) C_o^T + Lambda_oo,    G(t) = (A P(t) C_o^T + K Lambda_o) inv(S(t))
    P(t+1) = F P(t) F^T + (K - G(t)) Lambda (K - G(t))^T,    F = A - G(t) C_o

P(0) is 0, because the initial state is estimated. While all outputs are measured, P decays to 0 and
G to K. For complete data they are 0 and K from the start.

The N steps are divided into blocks of about sqrt(N)/2 steps, which are computed in parallel, first
with P = 0 at their start. A block with the transition matrix Phi and the information W about its
first state then maps P to Phi P inv(1 + W P) Phi^T plus its result for P = 0. From this the actual
P at the start of each block follows, and the blocks are computed again.

References
----------
.. [1] R. H. Jones, Technometrics 22 (1980) 389-395 (missing observations).
.. [2] S. Särkkä, Á. F. García-Fernández, IEEE Trans. Automatic Control 66 (2021) 299-306 (blocks).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import Array

_LOST_SHARE = 1e-12  # share of S that is added if S has lost its digits
_MIN_EIGENVALUE = 1e-150  # of inv(S), if P has lost all of its digits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KalmanGains:
    """Gains and variances at each of the N samples."""

    gain: Array
    """G (N, n, ny), 0 in the columns of missing outputs."""
    transition: Array
    """F (N, n, n)."""
    white: Array
    """Inverse Cholesky factor U of S, (N, ny, ny), 0 for missing outputs."""
    log_det: float
    """Sum of log det(S inv(Lambda_oo)) over the samples."""
    P: Array
    """Covariance of the state (N, n, n)."""
    C: Array
    """Matrix of the outputs (ny, n)."""
    K: Array
    """Gain for complete data (n, ny)."""
    Lambda: Array
    """Covariance of e (ny, ny)."""
    rows: Array
    """Mask (N, ny), False where an output is missing."""

    def derivatives(
        self, A: Array, C: Array, K: Array, nu: Array, z: Array
    ) -> tuple[Array, Array, Array]:
        """Return dG nu (N, p, n), dU nu (N, p, ny) and the derivatives of `log_det` (p,).

        A (p, n, n), C (p, ny, n) and K (p, n, ny) are the derivatives of the matrices with respect
        to p parameters. nu (N, ny) are the innovations, and z is U nu. Because G minimises P(t+1),
        dP(t+1) is F dP F^T plus the derivative of the other factors at a fixed G.
        """
        (p, n, _), ny, N = A.shape, C.shape[1], len(nu)
        A, C, K = (M.transpose(1, 0, 2) for M in (A, C, K))  # the parameters are the second axis
        blocks = _Blocks.of(N)
        split = blocks.split
        F, G, P, U = map(split, (self.transition, self.gain, self.P, self.white))
        marks, nu, z = map(split, (self.rows, nu, z))
        last = blocks.count - 1

        def change(k: int) -> tuple[Array, Array]:
            """Return dC_o (b, ny, p, n) and dA - G dC_o (b, n, p, n) at step k of each block."""
            dC_o = marks[:, k, :, None, None] * C
            return dC_o, A - _left(G[:, k], dC_o)

        def advance(k: int, dP: Array, by: Array) -> Array:
            """Return dP (b, n, p, n) after step k of each block, with `by` = dA - G dC_o."""
            back = F[:, k].swapaxes(1, 2)
            lost = self.Lambda @ (self.K - G[:, k]).swapaxes(1, 2)
            half = _right(by, P[:, k] @ back) + _right(K, lost)
            by_P = _right(_left(F[:, k], dP), back)
            return np.asarray(half + half.transpose(0, 3, 2, 1) + by_P)

        ends, Phi = np.zeros((last + 1, n, p, n)), np.tile(np.eye(n), (last + 1, 1, 1))
        for k in range(blocks.length):
            ends, Phi = advance(k, ends, change(k)[1]), F[:, k] @ Phi
        dP = np.zeros_like(ends)
        for j in range(last):
            now, back = Phi[j : j + 1], Phi[j : j + 1].swapaxes(1, 2)
            dP[j + 1] = ends[j] + _right(_left(now, dP[j : j + 1]), back)[0]
        by_gain, by_white, by_log = np.zeros((N, p, n)), np.zeros((N, p, ny)), np.zeros(p)
        for k in range(blocks.length):
            at = blocks.times(k)
            dC_o, by = change(k)
            Cm, u = marks[:, k, :, None] * self.C, U[:, k]
            V, back = P[:, k] @ Cm.swapaxes(1, 2), u.swapaxes(1, 2)
            both = _right(dP, Cm.swapaxes(1, 2)) + _right(dC_o, P[:, k]).transpose(0, 3, 2, 1)
            dG = _right(by, V) + _left(F[:, k], both)
            dG = _right(dG + _right(K, self.Lambda * marks[:, k, None]), back @ u)
            dS = _right(_left(u, _left(Cm, both) + _right(dC_o, V)), back).transpose(0, 2, 1, 3)
            by_gain[at] = np.einsum("bipj,bj->bpi", dG, nu[:, k])[: at.size]
            half = np.tril(dS, -1) + 0.5 * np.eye(ny) * dS
            by_white[at] = -np.einsum("bpij,bj->bpi", half, z[:, k])[: at.size]
            by_log += np.einsum("bpii->p", dS[: at.size])
            dP = advance(k, dP, by)
        return by_gain, by_white, by_log


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def kalman_gains(A: Array, C: Array, K: Array, Lambda: Array, rows: Array) -> KalmanGains:
    """Return the gains for the outputs marked in `rows` (N, ny).

    If the covariances of an unstable model exceed the range of numbers, the results are NaN.
    """
    (N, ny), n = rows.shape, len(A)
    codes = rows @ (1 << np.arange(ny))
    unique, which = np.unique(np.append(codes, (1 << ny) - 1), return_inverse=True)
    marks = (unique[:, None] >> np.arange(ny) & 1).astype(np.float64)
    C_o = C * marks[:, :, None]
    R = Lambda * marks[:, :, None] * marks[:, None] + np.eye(ny) * (1 - marks[:, None])
    part = Lambda * marks[:, None]
    at_rest = part @ np.linalg.inv(R)
    G0 = K @ at_rest
    Abar = A - G0 @ C_o
    blocks = _Blocks.of(N)
    filled = np.full(blocks.count * blocks.length, which[-1])
    filled[:N] = which[:-1]
    kind = filled.reshape(blocks.count, blocks.length)

    def step(k: int, P: Array) -> tuple[Array, Array, Array, Array]:
        """Return inv(S), G and F at step k of all blocks, and P after it."""
        at = kind[:, k]
        V = P @ C_o[at].swapaxes(1, 2)
        inverse = _inverse(C_o[at] @ V + R[at])
        gain = G0[at] + Abar[at] @ V @ inverse
        F = A - gain @ C_o[at]
        lost = K - gain
        # This form keeps P positive semidefinite.
        return inverse, gain, F, F @ P @ F.swapaxes(1, 2) + lost @ Lambda @ lost.swapaxes(1, 2)

    P = np.zeros((blocks.count, n, n))
    Phi, W = P + np.eye(n), P.copy()
    for k in range(blocks.length):
        inverse, _, F, P = step(k, P)
        seen = C_o[kind[:, k]] @ Phi
        W += seen.swapaxes(1, 2) @ inverse @ seen
        Phi = F @ Phi
    start = np.zeros_like(P)
    for j in range(blocks.count - 1):
        after = Phi[j] @ _add_information(start[j], W[j]) @ Phi[j].T
        start[j + 1] = P[j] + 0.5 * (after + after.T)
    P, grid = start, (blocks.count, blocks.length)
    every = [np.zeros((*grid, *shape)) for shape in ((n, n), (ny, ny), (n, ny), (n, n))]
    for k in range(blocks.length):
        matrices = P, *step(k, P)
        for at_all, at_k in zip(every, matrices, strict=False):
            at_all[:, k] = at_k
        P = matrices[-1]
    P, inverse, gain, F = (x.reshape(-1, *x.shape[2:])[:N] for x in every)
    which = which[:-1]
    white = _upwards(inverse)
    at_rest_log = np.linalg.slogdet(R)[1][which].sum()
    log_det = -2 * np.log(np.diagonal(white, axis1=1, axis2=2)).sum() - at_rest_log
    return KalmanGains(
        gain=gain,
        transition=F,
        white=white * marks[which][:, :, None] * marks[which][:, None],
        log_det=float(log_det),
        P=P,
        C=C,
        K=K,
        Lambda=Lambda,
        rows=rows,
    )


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Division of N samples into `count` blocks of `length` samples, the last one filled up."""

    N: int
    count: int
    length: int

    @classmethod
    def of(cls, N: int) -> _Blocks:
        length = isqrt(N) // 2 + 1
        return cls(N, N // length + 1, length)

    def split(self, x: Array) -> Array:
        """Return x (N, …) as (count, length, …), filled up with zeros."""
        padded = np.zeros((self.count * self.length, *x.shape[1:]))
        padded[: self.N] = x
        return padded.reshape(self.count, self.length, *x.shape[1:])

    def times(self, k: int) -> NDArray[np.int_]:
        """Return the samples at step k of the blocks; the last blocks may have none."""
        t = np.arange(self.count) * self.length + k
        return t[t < self.N]


def _left(M: Array, X: Array) -> Array:
    """Return M X over the first axis of X: M (b, k, n), X (b, n, p, m) or (n, p, m)."""
    *b, n, p, m = X.shape
    return np.asarray(M @ X.reshape(*b, n, p * m)).reshape(len(M), -1, p, m)


def _right(X: Array, M: Array) -> Array:
    """Return X M over the last axis of X: X (b, k, p, n) or (k, p, n), M (b, n, m)."""
    *b, k, p, n = X.shape
    return np.asarray(X.reshape(*b, k * p, n) @ M).reshape(len(M), k, p, -1)


def _add_information(P: Array, W: Array) -> Array:
    """Return inv(1 + P W) P for a small covariance P and the information W."""
    try:
        return np.asarray(np.linalg.solve(np.eye(len(P)) + P @ W, P))
    except np.linalg.LinAlgError:  # P is so large that the 1 is lost
        values, axes = np.linalg.eigh(P)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(root @ np.linalg.pinv(np.eye(len(P)) + root.T @ W @ root) @ root.T)


def _upwards(inverse: Array) -> Array:
    """Return U with U^T U = inv(S), (N, ny, ny): the inverse Cholesky factor of S."""
    if inverse.shape[1] == 1:
        return np.sqrt(np.maximum(inverse, _MIN_EIGENVALUE))
    # The Cholesky factor of inv(S) from the last row upwards is the transpose of U.
    turned = inverse[:, ::-1, ::-1]
    if not np.isfinite(turned).all():
        return np.full(turned.shape, np.nan)
    try:
        factor = np.linalg.cholesky(turned)
    except np.linalg.LinAlgError:  # as in `_inverse`
        values, axes = np.linalg.eigh(turned)
        root = axes * np.sqrt(np.maximum(values, _MIN_EIGENVALUE))[:, None]
        R = np.asarray(np.linalg.qr(root.swapaxes(1, 2), mode="r"))
        signs = np.where(np.diagonal(R, axis1=1, axis2=2) < 0, -1.0, 1.0)
        factor = (R * signs[:, :, None]).swapaxes(1, 2)
    return np.asarray(factor[:, ::-1, ::-1].swapaxes(1, 2))


def _inverse(S: Array) -> Array:
    """Return the inverse of positive definite matrices (b, ny, ny)."""
    if S.shape[1] == 1:
        return 1 / S
    try:
        return np.asarray(np.linalg.inv(S))
    except np.linalg.LinAlgError:  # P is so large, after a long gap of an unstable model
        size = np.abs(S).max(axis=(1, 2), keepdims=True)
        return np.asarray(np.linalg.inv(S + _LOST_SHARE * size * np.eye(S.shape[1])))
