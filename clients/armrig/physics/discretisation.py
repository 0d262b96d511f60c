"""A state space in continuous time as the transfer function of its samples."""

from __future__ import annotations

import numpy as np
from armrig_core.arm import zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def transfer(A: Matrix, B: Matrix, c: Vector, Ts: float) -> tuple[Vector, Vector]:
    """Return B(q) and F(q) from u, held over Ts, to y = c x, exactly sampled.

    F is the characteristic polynomial of Phi = exp(A Ts), and B the first n + 1 coefficients of
    F times the pulse response 0, c Gamma, c Phi Gamma, ….

    Parameters
    ----------
    A : ndarray (n, n)
        x' = A x + B u.
    B : ndarray (n, 1)
        Of the same.
    c : ndarray (n,)
        Row of the output; there is no direct term.
    Ts : float
        Sampling time in s.

    Returns
    -------
    (ndarray, ndarray)
        Coefficients in q^-1, both (n + 1,): B begins with 0, F with 1.
    """
    Phi, Gamma = zero_order_hold(A, B, Ts)
    F = np.real(np.poly(Phi))
    pulse, x = [0.0], Gamma[:, 0]
    for _ in range(Phi.shape[0]):
        pulse.append(float(c @ x))
        x = Phi @ x
    # scipy's ss2tf takes B from a difference of two characteristic polynomials: at 1 kHz, where B
    # is small beside F, five digits are lost in it.
    return np.convolve(pulse, F)[: F.size], F
