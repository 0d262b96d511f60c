"""Exact sampling of B(s)/F(s) with a delay, for an input that is held or a straight line.

The state of 1/F in companion form follows x(k+1) = Phi x(k) + sum of G_l u(k - l), with one G for
each sample of u that acts within a sampling interval. Times are in samples, and s in 1/sample.
With Faddeev's matrices M_0 = I, M_i = Phi M_(i-1) + f_i I the sampled polynomials are ::

    F = 1 + f_1 q^-1 + …,   B = sum over i and l of M_i G_l q^-(i+1+l)

References
----------
.. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, sections 2.3
   and 2.6.
.. [2] A. H. Al-Mohy, N. J. Higham, SIAM J. Matrix Anal. Appl. 30 (2009) 1639-1657 (the derivative
   of the matrix exponential).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from armrig.numerics.polynomial import Array

Hold = Literal["zoh", "foh"]

_TAYLOR_NORM = 0.5  # 1-norm of A up to which the Taylor polynomial is exact to rounding
_TAYLOR_DEGREE = 14
_WHOLE_TOLERANCE = 1e-9  # samples; a delay so near to a whole number of samples is that number


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledSystem:
    """Polynomials in q^-1 of a sampled system, and their derivatives by f and the delay.

    B is linear in the numerator: for the numerator sum of b_p s^p the sampled B is `B @ b`.
    """

    F: Array
    """Denominator (n + 1,), beginning with 1."""
    B: Array
    """Sampled s^p/F(s) for p = 0 … n - 1, (L, n), from lag `nk` on."""
    nk: int
    """Lag of the first row of B."""
    F_by_f: Array
    """Derivatives of F by f_1 … f_n of the denominator in s, (n + 1, n)."""
    B_by_f: Array
    """Derivatives of B, (L, n, n)."""
    B_by_delay: Array
    """Derivatives of B by the delay, (L, n)."""


def sample_system(
    f: Array, delay: float, hold: Hold = "zoh", *, fraction: bool = False
) -> SampledSystem:
    """Return the sampled s^p/F(s) exp(-delay s) for F = s^n + f_1 s^(n-1) + … + f_n.

    Parameters
    ----------
    f : ndarray (n,)
        Coefficients of F, with s in 1/sample.
    delay : float
        Delay in samples, >= 0.
    hold : {"zoh", "foh"}, default "zoh"
        The input is constant between two samples, or a straight line.
    fraction : bool, default False
        If True, B has the rows of a delay that is no whole number of samples, for any delay.
    """
    n = f.size
    whole_delay = int(np.floor(delay + _WHOLE_TOLERANCE))
    tau = max(delay - whole_delay, 0.0)
    tau = 0.0 if tau < _WHOLE_TOLERANCE else tau
    size = n + (1 if hold == "zoh" else 2)
    A = np.eye(size, k=1)
    A[n - 1, :n] = -f[::-1]
    full, full_by_f = _exponential(A, n)
    Phi, Phi_by_f = full[:n, :n], full_by_f[:, :n, :n]
    part, part_by_f = (full, full_by_f) if tau == 0 else _exponential(A * (1 - tau), n, 1 - tau)
    G, G_by_f, G_by_delay = _weights(
        (full, full_by_f), (part, part_by_f), tau, n, fraction=fraction or tau > 0, hold=hold
    )
    F = np.real(np.poly(np.linalg.eigvals(Phi)))
    M, M_by_f, F_by_f = _faddeev(Phi, Phi_by_f, F)
    lags = G.shape[0]
    B, B_by_delay = np.zeros((2, n + lags - 1, n))
    B_by_f = np.zeros((n + lags - 1, n, n))
    for i in range(n):
        at = slice(i, i + lags)
        B[at] += G @ M[i].T
        B_by_delay[at] += G_by_delay @ M[i].T
        B_by_f[at] += np.einsum("kpq,lq->lpk", M_by_f[i], G)
        B_by_f[at] += np.einsum("pq,klq->lpk", M[i], G_by_f)
    return SampledSystem(
        F=F,
        B=B,
        nk=whole_delay + int(hold == "zoh"),
        F_by_f=F_by_f,
        B_by_f=B_by_f,
        B_by_delay=B_by_delay,
    )


def _exponential(A: Array, n: int, time: float = 1.0) -> tuple[Array, Array]:
    """Return expm(A), and its derivatives (n, …) by f_1 … f_n, which A contains times `time`."""
    # The derivative in the direction E follows the scaled and squared Taylor polynomial. The linear
    # solver of scipy's expm_frechet starts threads, which take ten times longer on a busy machine.
    norm = float(np.max(np.sum(np.abs(A), axis=0)))
    squarings = max(int(np.ceil(np.log2(max(norm, 1e-300) / _TAYLOR_NORM))), 0)
    A, size = A / 2.0**squarings, A.shape[0]
    E = np.zeros((n, size, size))
    E[np.arange(n), n - 1, n - 1 - np.arange(n)] = -time / 2.0**squarings
    term, by_term = np.eye(size), np.zeros_like(E)
    X, by_X = term.copy(), by_term.copy()
    for k in range(1, _TAYLOR_DEGREE + 1):
        by_term = (E @ term + A @ by_term) / k
        term = A @ term / k
        X, by_X = X + term, by_X + by_term
    for _ in range(squarings):
        by_X = X @ by_X + by_X @ X
        X = X @ X
    return X, by_X


def _weights(
    full: tuple[Array, Array],
    part: tuple[Array, Array],
    tau: float,
    n: int,
    *,
    fraction: bool,
    hold: Hold,
) -> tuple[Array, Array, Array]:
    """Return G (L, n), from the latest sample of u on, and its derivatives by f and the delay."""
    # A held input acts on x(k+1) by Gamma(1 - tau) u(k) + (Gamma(1) - Gamma(1 - tau)) u(k - 1).
    # The weights of a straight line follow from the response R to a ramp and the sum Gamma(1).
    Gamma = [np.concatenate([x[0][None, :n, n], x[1][:, :n, n]]) for x in (full, part)]
    of_b = part[0][:n, n - 1]  # Phi(1 - tau) b is the derivative of Gamma
    none = np.zeros(n)
    if hold == "zoh":
        rows = [Gamma[1], Gamma[0] - Gamma[1]]
        by_delay = [-of_b, of_b]
    else:
        R = [np.concatenate([x[0][None, :n, n + 1], x[1][:, :n, n + 1]]) for x in (full, part)]
        last = R[1] - R[0] + tau * Gamma[0]
        rows = [R[1], Gamma[0] - R[1] - last, last]
        slope = Gamma[0][0] - Gamma[1][0]
        by_delay = [-Gamma[1][0], Gamma[1][0] - slope, slope]
    if not fraction:
        rows, by_delay = rows[:-1], [none] * (len(rows) - 1)
    both = np.stack(rows)
    return both[:, 0], both[:, 1:].transpose(1, 0, 2), np.stack(by_delay)


def _faddeev(Phi: Array, Phi_by_f: Array, F: Array) -> tuple[list[Array], list[Array], Array]:
    """Return M_i, their derivatives (n, n, n) by f, and the derivatives of F (n + 1, n)."""
    n = F.size - 1
    identity = np.eye(n)
    M, M_by_f = [identity], [np.zeros((n, n, n))]
    F_by_f = np.zeros((n + 1, n))
    for i in range(1, n + 1):
        F_by_f[i] = -np.einsum("pq,kqp->k", M[-1], Phi_by_f)
        if i < n:
            M_by_f.append(Phi_by_f @ M[-1] + Phi @ M_by_f[-1] + F_by_f[i][:, None, None] * identity)
            M.append(Phi @ M[-1] + F[i] * identity)
    return M, M_by_f, F_by_f
