"""Polynomials in q^-1, and derivatives of a filtered signal with respect to the coefficients.

Coefficient k belongs to q^-k, so [1, -0.5] is 1 - 0.5 q^-1. With y = B/P u the derivatives are
filtered signals. Each polynomial needs only one filter, since its derivatives are shifts of one
signal::

    dy/db_k = q^-k u / P,    dy/dp_k = -q^-k y / P

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 10.3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import copysign, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# The values are usually real. They are complex if a test checks a derivative by a complex step.
Array = NDArray[Any]
Complex = NDArray[np.complex128]

_CIRCLE_TOLERANCE = 1e-7  # distance from the circle up to which a root counts as on the circle


def monic(coefficients: Array) -> Array:
    """Return 1 and then the coefficients (n,) of q^-1 … q^-n, (n + 1,)."""
    p = np.empty(coefficients.size + 1, dtype=coefficients.dtype)
    p[0], p[1:] = 1.0, coefficients
    return p


def apply_filter(numerator: ArrayLike, denominator: ArrayLike, x: Array) -> Array:
    """Return x (N,) filtered by numerator/denominator, from rest."""
    import scipy.signal

    if x.ndim == np.size(denominator) == 1:  # lfilter would take three times as long
        return np.asarray(np.convolve(x, np.asarray(numerator))[: x.size] / denominator)
    return np.asarray(scipy.signal.lfilter(numerator, denominator, x))


def continue_output(A: Array, B: Array, u: Array, y: Array) -> Array:
    """Return the course of A x = sum of B_j u_j (N,) that begins like y; an infinite x is 0."""
    from scipy.signal import lfilter, lfiltic

    first = np.nan_to_num(y[: A.size - 1])
    drive = np.sum([apply_filter(b, [1.0], v) for b, v in zip(B, u.T, strict=True)], axis=0)
    with np.errstate(over="ignore", invalid="ignore"):  # the model may be unstable
        later, _ = lfilter([1.0], A, drive[first.size :], zi=lfiltic([1.0], A, first[::-1]))
    return np.asarray(np.nan_to_num(np.concatenate([first, later]), posinf=0.0, neginf=0.0))


def impulse(denominator: ArrayLike, N: int) -> Array:
    """Return the first N samples of the impulse response of 1/denominator."""
    pulse = np.zeros(N)
    pulse[0] = 1.0
    return apply_filter([1.0], denominator, pulse)


def lag_columns(x: Array, lags: Sequence[int]) -> Array:
    """Return an array (N, len(lags)) with q^-lags[j] x in column j, 0 before the first sample."""
    columns = np.zeros((x.size, len(lags)), dtype=x.dtype, order="F")
    for j, lag in enumerate(lags):
        if lag < x.size:
            columns[lag:, j] = x[: x.size - lag]
    return columns


def shift_into(columns: Array, x: Array, first: int = 1) -> None:
    """Write q^-first x, q^-(first + 1) x … into the columns (N, n); x has at most N samples."""
    N, n = columns.shape
    for k in range(n):
        columns[first + k : first + k + x.size, k] = x[: max(N - first - k, 0)]


def evaluate(p: ArrayLike, q_inverse: Array) -> Array:
    """Return the values of the polynomial at q^-1 = q_inverse, for example exp(-i omega Ts)."""
    return np.asarray(np.polyval(np.atleast_1d(p)[::-1], q_inverse))


def roots(p: ArrayLike) -> Array:
    """Return the roots in q, not in q^-1: [1, -0.5] has the root 0.5."""
    return np.asarray(np.roots(np.atleast_1d(p)))


def without_integrator(F: Array) -> Array:
    """Return F / (1 - q^-1) for an F with a root at 1."""
    return np.asarray(np.cumsum(F)[:-1])


def summation(omega: Array, Ts: float) -> Complex:
    """Return Ts / (1 - exp(-i omega Ts)), the response from (y(t) - y(t-1))/Ts to y; inf at 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(omega == 0, np.inf, Ts / (1 - np.exp(-1j * omega * Ts)))


def stable(p: ArrayLike, radius: float = 1.0) -> bool:
    """Return whether the modulus of all roots is smaller than `radius`.

    The method is the step-down recursion of Schur and Cohn. The recursion takes a fifth of the time
    of computing the roots. The time matters, because each step of a search calls this function.
    """
    a = p if isinstance(p, list) else np.atleast_1d(p).tolist()
    if radius != 1.0:
        a = [x / radius**k for k, x in enumerate(a)]
    while len(a) > 1:
        k = a[-1] / a[0] if a[0] else np.inf
        if not abs(k) < 1.0:
            return False
        a = [x - k * y for x, y in zip(a[:-1], a[:0:-1], strict=True)]
    return True


def reflect_roots(p: ArrayLike, radius: float = 0.999) -> Array:
    """Return p with each root z outside the unit circle moved to its reflection 1/z*.

    A root that was on or outside the circle may still have a modulus above `radius` after the
    reflection. Such a root is moved to the modulus `radius`.
    """
    p = np.atleast_1d(p)
    if stable(p, 1.0 - _CIRCLE_TOLERANCE):
        return np.asarray(p / p[0])
    return with_roots_inside(roots(p), radius)


def with_roots_inside(z: Array, radius: float = 0.999) -> Array:
    """Return the polynomial with the roots z (n,), moved inside as in `reflect_roots`."""
    magnitude = np.abs(z)
    inside = np.where(magnitude > 1.0, 1.0 / np.maximum(magnitude, 1.0), magnitude)
    shrink = np.minimum(inside, radius) / np.where(magnitude > 0, magnitude, 1.0)
    return of_roots(np.where(magnitude >= 1.0 - _CIRCLE_TOLERANCE, z * shrink, z))


def of_roots(z: Array) -> Array:
    """Return the real monic polynomial with the roots z (n,), in less time than np.poly."""
    p: list[complex] = [1.0]
    for root in z.tolist():
        p = [a - root * b for a, b in zip([*p, 0.0], [0.0, *p], strict=True)]
    return np.real(p)


def reduce_order(p: ArrayLike) -> Iterator[Array]:
    """Yield the monic polynomials of order n - 1 whose modes are nearest to the modes of p.

    p (n + 1,) is real, n >= 1. Each polynomial either omits one real root of p, or has one real
    root in place of a complex pair. The modulus of this real root is the modulus of the pair.
    """
    z = roots(p)
    for i in np.flatnonzero(z.imag >= 0):
        kept = np.delete(z, i)
        if z[i].imag > 0:
            kept[np.argmin(np.abs(kept - np.conj(z[i])))] = np.copysign(np.abs(z[i]), z[i].real)
        yield of_roots(kept)


EDGE_MODULUS = 1 - 1e-7
"""Largest modulus of a root in a search. The distance from 1 is the error of a computed double
root."""
INSIDE_MODULUS = 1 - 1e-5
"""Modulus below which a root is not at the edge, also with rounding."""
_EDGE_TOLERANCE = 1e-9
_MIN_LEFT_SHARE = 0.1  # share of the distance to the circle that remains after a step
_PAIR_ANGLE = 1e-3  # angle, in rad, of the pair that replaces two real roots at the edge


def move_to_edge(p: Array, previous: Array) -> Array:
    """Return p with each root outside the unit circle moved radially into the circle.

    A step covers at most nine tenths of the distance from the outermost root of `previous` to the
    circle. A search that reaches the edge in a single step often ends in a poor minimum there. Two
    real roots at the edge become a complex pair, because two real roots could not separate along
    the circle.
    """
    z = _few_roots(p)
    size = np.abs(z)
    if size.max() <= EDGE_MODULUS:
        return p
    farthest = min(EDGE_MODULUS, 1 - _MIN_LEFT_SHARE * (1 - np.abs(_few_roots(previous)).max()))
    z = z * np.minimum(1.0, farthest / np.maximum(size, farthest))
    for side in (1, -1) if farthest >= EDGE_MODULUS - _EDGE_TOLERANCE else ():
        at = np.flatnonzero((z.imag == 0) & (side * z.real >= EDGE_MODULUS - _EDGE_TOLERANCE))
        if at.size >= 2:
            z = z.astype(np.complex128)
            z[at[:2]] = side * EDGE_MODULUS * np.exp([1j * _PAIR_ANGLE, -1j * _PAIR_ANGLE])
    return of_roots(z)


def _few_roots(p: Array) -> Array:
    """Return the roots of a monic p in less time than `roots`, of p up to order 2 by a formula."""
    if p.size > 3:
        from scipy.linalg.lapack import dgeev

        if not np.isfinite(p).all():
            raise np.linalg.LinAlgError("a coefficient is not finite")
        companion = np.eye(p.size - 1, k=-1)
        companion[0] = -p[1:]
        real, imaginary, *_ = dgeev(companion, compute_vl=0, compute_vr=0)
        return np.asarray(real + 1j * imaginary if imaginary.any() else real)
    if p.size < 3:
        return np.asarray(-p[1:])
    _, b, c = p.tolist()
    half, square = -b / 2, b * b / 4 - c
    if square < 0:
        return np.array([complex(half, sqrt(-square)), complex(half, -sqrt(-square))])
    larger = half + copysign(sqrt(square), half)
    return np.array([larger, c / larger if larger else 0.0])


def outward_normals(p: Array) -> Array:
    """Return the unit gradient of |z| for each of the k roots z at the edge.

    The gradient is with respect to the coefficients of p.

    From p(r) = 0 follows dr = -sum_k r^(n - k) dp_k / p'(r). The modulus increases by the component
    of dr along r. A complex pair has one row in the result (k, n), with n coefficients after the
    leading 1.
    """
    z = _few_roots(p)
    n = z.size
    rows = []
    for i in np.flatnonzero((np.abs(z) >= EDGE_MODULUS - _EDGE_TOLERANCE) & (z.imag >= 0)):
        slope = np.prod(z[i] - np.delete(z, i))
        if slope != 0:
            row = -np.real(np.conj(z[i]) * z[i] ** np.arange(n - 1, -1, -1) / slope)
            rows.append(row / np.linalg.norm(row))
    return np.array(rows).reshape(len(rows), n)


def by_numerator(u: Array, P: Array, lags: Sequence[int]) -> Array:
    """Return the derivatives of B/P u with respect to the b at `lags`, (N, len(lags))."""
    return lag_columns(apply_filter([1.0], P, u), lags)


def by_denominator(y: Array, P: Array, n: int) -> Array:
    """Return the derivatives of y = B/P u with respect to p_1 … p_n, (N, n)."""
    return -lag_columns(apply_filter([1.0], P, y), range(1, n + 1))
