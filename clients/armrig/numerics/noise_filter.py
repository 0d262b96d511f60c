"""Innovations of noise v = C/D e with missing samples, by a Kalman filter.

The noise has the state-space model ::

    x(t+1) = Phi x(t) + K e(t),    v(t) = x_1(t) + e(t)

Phi is the companion matrix of D in observer form, and K is c - d. Without missing samples the
filter is D/C. After a missing sample the state is uncertain, and the variance of the innovation is
larger than the variance of e.

References
----------
.. [1] R. H. Jones, Technometrics 22 (1980) 389-395.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from armrig.numerics.polynomial import Array
from armrig.numerics.stretches import Mask, stretches

_SETTLED_VARIANCE = 1e-14  # largest variance of the state that counts as 0, divided by var e
_COMPLEX_STEP = 1e-20


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFilter:
    """Filter from the noise v to its innovations, which are scaled to the variance of e.

    Each innovation is divided by the square root of s(t), its variance over the variance of e. The
    state before the first sample is unknown. `columns` returns the responses to this state.
    """

    C: Array
    """Coefficients of C (nc + 1,), beginning with 1."""
    D: Array
    """Coefficients of D (nd + 1,), beginning with 1."""
    rows: Mask
    """Mask (N,), False where v is missing."""

    @property
    def memory(self) -> int:
        """Dimension of the state."""
        return max(self.C.size, self.D.size) - 1

    def columns(self, M: Array) -> tuple[Array, Array, float]:
        """Return the filtered M, the responses to the initial state, and the sum of log s(t).

        Returns
        -------
        ndarray, shape (N, k)
            M filtered from the state 0; 0 in rows in which v is missing.
        ndarray, shape (N, memory)
            Response of the innovations to each state before the first sample.
        float
            Sum of log s(t) over the measured samples.
        """
        r, k = self.memory, M.shape[1]
        if r == 0:
            return np.where(self.rows[:, None], M, 0.0), np.zeros((M.shape[0], 0)), 0.0
        whole = np.hstack([M, np.zeros((M.shape[0], r))])
        x0 = np.hstack([np.zeros((r, k)), np.eye(r)])
        e, s = _innovations(self.C[None], self.D[None], self.rows, whole, x0)
        return e[0, :, :k], e[0, :, k:], float(np.sum(np.log(s[0].real)))

    def derivatives(self, v: Array, x0: Array) -> tuple[Array, Array]:
        """Return the derivatives of the scaled innovations of v (N,), and of the sum of log s(t).

        The derivatives are with respect to (c, d): shapes (N, nc + nd) and (nc + nd,). The
        derivatives are computed by a complex step, which has no truncation error.

        Parameters
        ----------
        x0 : ndarray (memory,)
            State before the first sample.
        """
        nc, nd = self.C.size - 1, self.D.size - 1
        if nc + nd == 0:
            return np.zeros((v.size, 0)), np.zeros(0)
        steps = 1j * _COMPLEX_STEP * np.eye(nc + nd)
        C = np.pad(steps[:, :nc], ((0, 0), (1, 0))) + self.C
        D = np.pad(steps[:, nc:], ((0, 0), (1, 0))) + self.D
        e, s = _innovations(C, D, self.rows, v[:, None], x0[:, None])
        by_scale = np.sum(np.log(s), axis=1).imag / _COMPLEX_STEP
        return e[:, :, 0].imag.T / _COMPLEX_STEP, by_scale


def _innovations(C: Array, D: Array, rows: Mask, M: Array, x0: Array) -> tuple[Array, Array]:
    """Return the scaled innovations (m, N, k) of m filters, and s(t) at the measured samples."""
    r = max(C.shape[1], D.shape[1]) - 1
    c = np.pad(C[:, 1:], ((0, 0), (0, r - C.shape[1] + 1)))
    d = np.pad(D[:, 1:], ((0, 0), (0, r - D.shape[1] + 1)))
    Phi = np.eye(r, k=1) - d[:, :, None] * np.eye(1, r)
    K = c - d
    noise = K[:, :, None] * K[:, None, :]
    m, (N, k) = C.shape[0], M.shape
    e = np.zeros((m, N, k), dtype=Phi.dtype)
    s = np.ones((m, N), dtype=Phi.dtype)
    X = np.repeat(x0[None].astype(Phi.dtype), m, axis=0)
    P = np.zeros((m, r, r), dtype=Phi.dtype)
    t = 0
    ends = {part.start: part.stop for part in stretches(rows)}
    stop = 0
    while t < N:
        stop = ends.get(t, stop)
        if not rows[t]:
            X = Phi @ X
            P = Phi @ P @ Phi.transpose(0, 2, 1) + noise
            t += 1
        elif _settled(P):
            e[:, t:stop], X = _steady(M[t:stop], X, c, d)
            t = stop
        else:
            s[:, t] = P[:, 0, 0] + 1.0
            gain = ((Phi @ P[:, :, :1])[:, :, 0] + K) / s[:, t, None]
            nu = M[t] - X[:, 0]
            X = Phi @ X + gain[:, :, None] * nu[:, None, :]
            P = Phi @ P @ Phi.transpose(0, 2, 1) + noise
            P -= s[:, t, None, None] * gain[:, :, None] * gain[:, None, :]
            e[:, t] = nu / np.sqrt(s[:, t, None])
            t += 1
    return e, s[:, rows]


def _settled(P: Array) -> bool:
    if np.iscomplexobj(P) and np.max(np.abs(P.imag)) > _SETTLED_VARIANCE * _COMPLEX_STEP:
        return False
    return bool(np.max(np.abs(P.real)) <= _SETTLED_VARIANCE)


def _steady(M: Array, X: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """Return the innovations (m, n, k) of rows without a gap, and the states after the last row.

    The state of `scipy.signal.lfilter` is minus the state of the noise model.
    """
    e = np.empty((X.shape[0], *M.shape), dtype=X.dtype)
    after = np.empty_like(X)
    for i in range(X.shape[0]):
        above, below = np.append(1.0, d[i]), np.append(1.0, c[i])
        e[i], end = lfilter(above, below, M, axis=0, zi=-X[i])
        after[i] = -end
    return e, after
