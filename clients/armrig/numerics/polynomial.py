"""Polynomials in q^-1: coefficient k stands beside q^-k, so [1, -0.5] is 1 - 0.5 q^-1.

Derivatives of a filtered signal with respect to the filter's coefficients.

With y = B/P u the derivatives are again filtered signals, one filter and then shifts::

    dy/db_k = q^-k u / P,    dy/dp_k = -q^-k y / P

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 10.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Real as a rule; complex where a derivative is checked by a complex step.
Array = NDArray[Any]
Complex = NDArray[np.complex128]

_BESIDE = 1e-7  # a root at 1 is computed a little beside it


def filtered(numerator: ArrayLike, denominator: ArrayLike, x: Array) -> Array:
    """Return numerator/denominator applied to x (N,), at rest before the first sample."""
    from scipy.signal import lfilter

    return np.asarray(lfilter(np.atleast_1d(numerator), np.atleast_1d(denominator), x))


def impulse(denominator: ArrayLike, N: int) -> Array:
    """Return the first N samples of the impulse response of 1/denominator."""
    pulse = np.zeros(N)
    pulse[0] = 1.0
    return filtered([1.0], denominator, pulse)


def lagged(x: Array, lags: Sequence[int]) -> Array:
    """Return (N, len(lags)): column j is q^-lags[j] x, zero before the first sample."""
    columns = np.zeros((x.size, len(lags)), dtype=x.dtype, order="F")
    for j, lag in enumerate(lags):
        if lag < x.size:
            columns[lag:, j] = x[: x.size - lag]
    return columns


def evaluate(p: ArrayLike, q_inverse: Array) -> Array:
    """Return the polynomial at the points q_inverse, for example exp(-i omega Ts)."""
    return np.asarray(np.polyval(np.atleast_1d(p)[::-1], q_inverse))


def roots(p: ArrayLike) -> Array:
    """Return the roots in q (not q^-1): [1, -0.5] has its root at 0.5."""
    return np.asarray(np.roots(np.atleast_1d(p)))


def without_integrator(F: Array) -> Array:
    """Return F / (1 - q^-1) for an F with a root at 1."""
    return np.asarray(np.cumsum(F)[:-1])


def summation(omega: Array, Ts: float) -> Complex:
    """Return Ts / (1 - exp(-i omega Ts)), from the rate (y(t) - y(t-1))/Ts to y; inf at 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(omega == 0, np.inf, Ts / (1 - np.exp(-1j * omega * Ts)))


def stable(p: ArrayLike) -> bool:
    """Tell whether all roots lie strictly inside the unit circle.

    The step-down recursion of Schur and Cohn: a fifth of the time that the roots take, and a
    search asks at each step.
    """
    a = np.atleast_1d(p).tolist()
    while len(a) > 1:
        k = a[-1] / a[0] if a[0] else np.inf
        if not abs(k) < 1.0:
            return False
        a = [x - k * y for x, y in zip(a[:-1], a[:0:-1], strict=True)]
    return True


def reflected(p: ArrayLike, radius: float = 0.999) -> Array:
    """Return p with each root outside the unit circle mirrored into it, for a start value.

    A root on the circle, or mirrored to nearer than `radius`, is drawn in to `radius`.
    """
    return with_roots_inside(roots(p), radius)


def with_roots_inside(z: Array, radius: float = 0.999) -> Array:
    """Return the polynomial with the roots z (n,), those that are not inside moved as there."""
    magnitude = np.abs(z)
    if not z.size or magnitude.max() < 1.0 - _BESIDE:
        return np.real(np.poly(z)) if z.size else np.ones(1)
    inside = np.where(magnitude > 1.0, 1.0 / np.maximum(magnitude, 1.0), magnitude)
    shrink = np.minimum(inside, radius) / np.where(magnitude > 0, magnitude, 1.0)
    return np.real(np.poly(np.where(magnitude >= 1.0 - _BESIDE, z * shrink, z)))


# Polynomials whose roots may reach the unit circle and not cross it.


EDGE = 1 - 1e-7  # modulus that no root exceeds; a double root is computed so far off
_ROUNDING = 1e-9
_LEFT = 0.1  # share of the way to the circle that a step leaves
_APART = 1e-3  # angle of two roots that reach the same point of the real axis


def drawn_to_edge(p: Array, previous: Array) -> Array:
    """Return p with each root outside the unit circle moved along its radius into it.

    At most nine tenths of the way from the outermost root of the polynomial before to the circle
    are gone at once: a single step to the edge often ends in a poor minimum there. Two real roots
    at the edge become a pair: two real ones could not leave each other along the circle.
    """
    z = roots(p)
    size = np.abs(z)
    if not z.size or size.max() <= EDGE:
        return p
    farthest = min(EDGE, 1 - _LEFT * (1 - np.abs(roots(previous)).max()))
    z = z * np.minimum(1.0, farthest / np.maximum(size, farthest))
    for side in (1, -1):
        at = np.flatnonzero((z.imag == 0) & (side * z.real >= EDGE - _ROUNDING))
        if at.size >= 2:
            z = z.astype(np.complex128)
            z[at[:2]] = side * EDGE * np.exp([1j * _APART, -1j * _APART])
    return np.real(np.poly(z))


def outward_normals(p: Array) -> Array:
    """Return for each root at the edge the unit gradient of its modulus by p's coefficients.

    From p(r) = 0 follows dr = -sum_k r^(n - k) dp_k / p'(r); the modulus grows by its part along r.
    Of a pair one is enough. Shape (k, n) for n coefficients after the leading one.
    """
    z = roots(p)
    n = z.size
    rows = []
    for i in np.flatnonzero((np.abs(z) >= EDGE - _ROUNDING) & (z.imag >= 0)):
        slope = np.prod(z[i] - np.delete(z, i))
        if slope != 0:
            row = -np.real(np.conj(z[i]) * z[i] ** np.arange(n - 1, -1, -1) / slope)
            rows.append(row / np.linalg.norm(row))
    return np.array(rows).reshape(len(rows), n)


def by_numerator(u: Array, P: Array, lags: Sequence[int]) -> Array:
    """Return (N, len(lags)), the derivatives of B/P u by the coefficients of B at `lags`."""
    return lagged(filtered([1.0], P, u), lags)


def by_denominator(y: Array, P: Array, n: int) -> Array:
    """Return (N, n), the derivatives of y = B/P u by the n coefficients of P after the 1."""
    return -lagged(filtered([1.0], P, y), range(1, n + 1))
