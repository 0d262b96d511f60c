"""Polynomials whose roots may reach the unit circle and not cross it."""

from __future__ import annotations

import numpy as np

from armrig.numerics.polynomial import Array, roots

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
