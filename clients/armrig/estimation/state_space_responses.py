"""Predictor of a state-space model, and its responses, for data with missing outputs, too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import (
    free_responses,
    outputs,
    recursion,
    responses,
    varying_recursion,
)

_EIGENVALUE_TOLERANCE = 1e-10  # singular value of 1 - Abar that shows the eigenvalue 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaledExperiment:
    """Scaled signals of one experiment."""

    u: Array
    """Inputs (N, nu)."""
    y: Array
    """Outputs (N, ny), 0 where an output is missing."""
    rows: Array
    """Mask (N, ny), False where an output is missing."""
    weights: Array
    """Whitening matrices (N, ny, ny)."""
    gains: Array | None = None
    """Gains (N, n, ny) of a Kalman filter for missing outputs, 0 for a missing output. None if the
    predictor takes the error of a missing output as 0."""

    def gains_of(self, K: Array) -> Array:
        """Return the gain at each instant, (N, n, ny)."""
        return K * self.rows[:, None, :] if self.gains is None else self.gains


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictor:
    """Predictor of scaled signals: x(t+1) = Abar x + Bbar u + K y, yhat = C x + D u."""

    Abar: Array
    """Matrix A - K C (n, n)."""
    Bbar: Array
    """Matrix B - K D (n, nu)."""
    C: Array
    """Matrix of the outputs (ny, n)."""
    D: Array
    """Direct term (ny, nu)."""
    K: Array
    """Gain K for complete data (n, ny)."""
    x0: tuple[Array, ...]
    """State at the start of each experiment, (n,)."""
    levels: tuple[Array, ...] = ()
    """Coefficients of the `offsets` of each experiment; () without offsets."""

    def predicted(self, part: ScaledExperiment, i: int) -> Array:
        """Return yhat (N, ny) of experiment i; the error of a missing output is 0."""
        w, v, N = part.u @ self.Bbar.T, part.u @ self.D.T, len(part.u)
        if part.rows.all() or not self.K.any():
            if self.levels:
                v = v + np.tensordot(self.levels[i], offsets(self.Abar, self.C, N), axes=1).T
            fed = w + part.y @ self.K.T
            return np.asarray(outputs(self.Abar, self.C, fed, self.x0[i]) + v)
        v = v + self.levels[i] if self.levels else v
        w = w + (part.gains_of(self.K) @ part.y[:, :, None])[:, :, 0]
        return responses_with_gaps(part, self, w[:, None], v[:, None], self.x0[i][None])[:, 0]

    @property
    def A(self) -> Array:
        """Transition matrix (n, n) of the innovations form."""
        return np.asarray(self.Abar + self.K @ self.C)

    @property
    def B(self) -> Array:
        """Matrix of the inputs (n, nu) of the innovations form."""
        return np.asarray(self.Bbar + self.K @ self.D)

    def simulated(self, u: Array, e: Array, x0: Array) -> Array:
        """Return the outputs (N, ny) for given inputs, errors and initial state."""
        w = u @ self.Bbar.T + (u @ self.D.T + e) @ self.K.T
        x = recursion(self.A, w, x0)[:-1]
        return np.asarray(x @ self.C.T + u @ self.D.T + e)

    def impulses(self, length: int) -> Array:
        """Return the impulse responses from u and e, of `length` samples each, as a vector."""
        A, x, samples = self.A, np.hstack([self.B, self.K]), [self.D.ravel()]
        for _ in range(length):
            samples.append((self.C @ x).ravel())
            x = A @ x
        return np.concatenate(samples)

    def balance(self) -> Predictor:
        """Return this predictor in the coordinates of `output_normal`."""
        T, inverse = _balancing(self.Abar, self.C)
        return Predictor(
            Abar=T @ self.Abar @ inverse,
            Bbar=T @ self.Bbar,
            C=self.C @ inverse,
            D=self.D,
            K=T @ self.K,
            x0=tuple(T @ x for x in self.x0),
        )


def state_responses(
    signals: Array, Abar: Array, C: Array, *, direct: Array | None
) -> tuple[Array, Array]:
    """Return the outputs (k, ny, N) due to each entry of B and D, and to each initial state.

    The entries of B, for the inputs `signals`, are ordered by signal; those of D by output. D is
    for the inputs `direct`; None means that there is no D.
    """
    (N, m), (ny, n) = signals.shape, C.shape
    driven = responses(Abar, C, signals).reshape(m * n, ny, N)
    if direct is not None:
        at_once = np.zeros((ny, direct.shape[1], ny, N))
        at_once[range(ny), :, range(ny)] = direct.T
        driven = np.concatenate([driven, at_once.reshape(-1, ny, N)])
    return driven, free_responses(Abar, C, N)


def offsets(Abar: Array, C: Array, N: int) -> Array:
    """Return the responses (k, ny, N) to offsets of u and y: constants, and a ramp for a pole at 1.

    For one output the response of this pole to the initial state replaces the constant.
    """
    ny, n = C.shape
    _, s, V = np.linalg.svd(np.eye(n) - Abar)
    levels = np.broadcast_to(np.eye(ny)[:, :, None], (ny, ny, N))
    if s[-1] > _EIGENVALUE_TOLERANCE:
        return levels
    ramp = (C @ V[-1])[None, :, None] * np.arange(1.0, N + 1)
    return ramp if ny == 1 else np.concatenate([levels, ramp])


def entries(signals: Array, n: int, direct: Array | None, ny: int) -> tuple[Array, Array]:
    """Return the arguments w (k, N, n) and at_once (k, N, ny) of `held_responses` for B and D."""
    N, m = signals.shape
    of_B = np.zeros((m, n, N, n))
    of_B[:, range(n), :, range(n)] = signals.T
    nu = 0 if direct is None else direct.shape[1]
    of_D = np.zeros((ny, nu, N, ny))
    if direct is not None:
        of_D[range(ny), :, :, range(ny)] = direct.T
    return (
        np.concatenate([of_B.reshape(-1, N, n), np.zeros((ny * nu, N, n))]),
        np.concatenate([np.zeros((m * n, N, ny)), of_D.reshape(-1, N, ny)]),
    )


def responses_with_gaps(
    part: ScaledExperiment, at: Predictor, w: Array, at_once: Array, x0: Array | None = None
) -> Array:
    """Return responses (N, k, ny) of the predictor if outputs are missing.

    K(t) is the gain at t, in which a column is 0 if the output is missing ::

        x(t+1) = (Abar + (K - K(t)) C) x(t) + w(t) + (K - K(t)) v(t),    C x(t) + v(t)

    w (N, k, n) are right-hand sides. `at_once` (N, k, ny) are the parts v of the outputs that do
    not depend on the state. The initial states x0 (k, n) are 0 by default.
    """
    lost = at.K - part.gains_of(at.K)
    w = w + at_once @ lost.swapaxes(1, 2)
    x0 = np.zeros(w.shape[1:]) if x0 is None else x0
    x = varying_recursion(at.Abar + lost @ at.C, w, x0)[:-1]
    return np.asarray(x @ at.C.T + at_once)


def free_responses_with_gaps(part: ScaledExperiment, at: Predictor, *, level: bool) -> Array:
    """Return the `held_responses` (k, ny, N) to the initial state, and to constants (`level`)."""
    (n, ny), N = at.K.shape, len(part.u)
    k = n + ny * level
    at_once = np.zeros((N, k, ny))
    at_once[:, n:] = np.eye(ny)[: k - n]
    free = responses_with_gaps(part, at, np.zeros((N, k, n)), at_once, np.eye(k, n))
    return np.asarray(free.transpose(1, 2, 0))


def output_normal(A: Array, C: Array) -> tuple[Array, Array]:
    """Return A and C in coordinates with A^T A + C^T C = 1, which are suitable for a search."""
    T, inverse = _balancing(A, C)
    return T @ A @ inverse, C @ inverse


def _balancing(A: Array, C: Array) -> tuple[Array, Array]:
    """Return the change of coordinates that `output_normal` applies, and its inverse."""
    gramian = solve_discrete_lyapunov(A.T, C.T @ C)
    values, axes = np.linalg.eigh((gramian + gramian.T) / 2)
    root = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    return (axes * root).T, axes / root
