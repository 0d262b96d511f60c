"""Filter of a model in innovations form: its states and innovations, and their derivatives.

The filter is x(t+1) = A x + B u + G(t) nu, nu = y - C x - D u, as `armrig.models.predictor`
explains. G is K for complete data, and the gain of the Kalman filter if an output is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armrig.models.state_space import StateSpace
from armrig.numerics.covariance import whitening
from armrig.numerics.kalman_gains import KalmanGains, kalman_gains
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion, varying_recursion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InnovationsFilter:
    """Filter from u and y of one experiment to the innovations nu."""

    system: StateSpace
    rows: Array
    """Mask (N, ny), False where an output is missing."""
    white: Array
    """Matrices U (N, ny, ny): U nu has the covariance 1; 0 for missing outputs."""
    noisy: Array
    """Mask (n,) of the states that e reaches."""
    gains: KalmanGains | None
    """Gains of the Kalman filter of these states; None if the gain is K."""

    @property
    def log_det(self) -> float:
        """Sum of the log determinants of the variances of nu, divided by those of e."""
        return 0.0 if self.gains is None else self.gains.log_det

    def states(self, u: Array, y: Array, x0: Array) -> Array:
        """Return x (N, m, n) for m signals u (N, m, nu) and y (N, m, ny), and states x0 (m, n)."""
        return self._state_response(u @ self.system.B.T, y - u @ self.system.D.T, x0)

    def _state_response(self, w: Array, left: Array, x0: Array) -> Array:
        """Return x (N, m, n) of x(t+1) = (A - G C) x + w + G left."""
        s, noisy = self.system, self.noisy
        if self.gains is None:
            return recursion(s.A - s.K @ s.C, w + left @ s.K.T, x0)[:-1]
        x, gain, still = np.empty(w.shape), self.gains.gain.swapaxes(1, 2), ~noisy
        if still.any():
            Phi = s.A[np.ix_(still, still)]
            x[:, :, still] = recursion(Phi, w[:, :, still], x0[:, still])[:-1]
        x_still = x[:, :, still]
        w = w[:, :, noisy] + x_still @ s.A[np.ix_(noisy, still)].T
        w = w + (left - x_still @ s.C[:, still].T) @ gain
        x[:, :, noisy] = varying_recursion(self.gains.transition, w, x0[:, noisy])[:-1]
        return x

    def innovations(self, x: Array, u: Array, y: Array) -> Array:
        """Return nu (N, m, ny), 0 where an output is missing."""
        return np.asarray((y - self.outputs(x, u)) * self.rows[:, None])

    def outputs(self, x: Array, u: Array) -> Array:
        """Return C x + D u."""
        return np.asarray(x @ self.system.C.T + u @ self.system.D.T)

    def whiten(self, nu: Array) -> Array:
        """Return U nu (N, m, ny)."""
        return np.asarray(nu @ self.white.swapaxes(1, 2))

    def derivatives(
        self, by: dict[str, Array], x: Array, u: Array, nu: Array
    ) -> tuple[Array, Array]:
        """Return the derivatives of U nu, (N, p, ny), and of `log_det`, (p,).

        `by` has the derivatives of A, B, C, D and K with respect to p parameters, such as (p, n, n)
        for A. The state x (N, n) belongs to the signal u (N, nu), and nu (N, ny) are its errors.
        """
        A, B, C, D, K = (by[name] for name in "ABCDK")
        p = len(A)
        at_once, w = _products(C, x) + _products(D, u), _products(A, x) + _products(B, u)
        by_white, by_log = np.zeros(at_once.shape), np.zeros(p)
        if self.gains is None:
            w += _products(K, nu)
        else:
            z, noisy = self.whiten(nu[:, None])[:, 0], np.flatnonzero(self.noisy)
            by_gain, by_white, by_log = self.gains.derivatives(
                A[:, noisy][:, :, noisy], C[:, :, noisy], K[:, noisy], nu, z
            )
            w[:, :, noisy] += by_gain
        moved = self._state_response(w, -at_once, np.zeros((p, len(self.system.A))))
        return by_white - self.whiten(at_once + moved @ self.system.C.T), by_log


def _products(M: Array, x: Array) -> Array:
    """Return M_k x(t), (N, p, n), of p matrices M (p, n, m) and a signal x (N, m)."""
    return np.asarray(np.tensordot(x, M, axes=(1, 2)))


def innovations_filter(system: StateSpace, Lambda: Array, rows: Array) -> InnovationsFilter:
    """Return the filter for outputs measured at `rows` (N, ny) and the covariance of e."""
    A, C, K = system.A, system.C, system.K
    gains, noisy = None, np.asarray(K.any(axis=1))
    for _ in range(system.order):  # a chain of delays of u, for example, has no noise
        noisy = np.asarray(noisy | (A[:, noisy] != 0).any(axis=1))
    if K.any() and not rows.all():
        gains = kalman_gains(A[np.ix_(noisy, noisy)], C[:, noisy], K[noisy], Lambda, rows)
    white = whitening(Lambda, rows) if gains is None else gains.white
    return InnovationsFilter(system=system, rows=rows, white=white, noisy=noisy, gains=gains)
