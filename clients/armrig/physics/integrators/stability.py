"""The largest step at which a method is absolutely stable on a given system.

For each eigenvalue lambda the roots of the stability polynomial pi(zeta; h lambda) must be inside
the unit circle. The reduction of Schur and Cohn converts this condition into conditions on the
signs of a few polynomials in h. A finite limit other than 0 is a root of one of these polynomials,
so that no scan over h is necessary.

References
----------
.. [1] J. J. H. Miller, J. Inst. Maths Applics 8 (1971) 397-406 (Schur's reduction).
.. [2] E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II*, 1996, section V.1.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.polynomial.polynomial import polymul, polysub
from numpy.typing import ArrayLike
from scipy.linalg import matrix_balance

from armrig.numerics.polynomial import Array
from armrig.physics.integrators.methods import Method, amplification, method_named
from armrig.physics.integrators.stepping import system

_EPS = float(np.finfo(np.float64).eps)
_CIRCLE_TOLERANCE = 1e-10  # largest |zeta| - 1 of a root that counts as on the circle


def stability_limit(A: ArrayLike, method: str = "forward_euler") -> float:
    """Return the largest step h in s at which the method is absolutely stable on x' = A x.

    The limit is a *largest* step. (The handout, assignment 4.1, asks for the "minimum step size
    that preserve the absolute stability", but every smaller step is stable as well.)

    Each eigenvalue has a limit, and the smallest limit is returned:

    - Re < 0: the limit of the method for this eigenvalue.
    - 0, with as many eigenvectors as its multiplicity: no limit, because every method keeps a
      constant solution constant. With fewer eigenvectors (a double integrator) A is unstable: the
      limit is 0.0.
    - imaginary: the exact solution is a steady oscillation. With the explicit methods the
      oscillation grows at any step: the limit is 0.0. With the trapezoidal rule the amplitude is
      constant: the limit is inf. With fewer eigenvectors than its multiplicity A is unstable: the
      limit is 0.0.
    - Re > 0: the exact solution grows, and the limit is 0.0, even if a method hides the growth.

    At the limit an error neither grows nor decays.

    Parameters
    ----------
    A : array_like, shape (nx, nx)
        System matrix, in 1/s.
    method : {"forward_euler", "ab2", "trapezoidal", "heun", "midpoint"}

    Raises
    ------
    ValueError
        A is not square or not finite, or the method is unknown.

    Examples
    --------
    >>> import armrig
    >>> A = armrig.physics.arm(armrig.physics.ArmParameters()).A
    >>> for method in ("forward_euler", "ab2", "heun", "trapezoidal"):
    ...     print(f"{method}: {armrig.physics.stability_limit(A, method):.3f} s")
    forward_euler: 0.045 s
    ab2: 0.027 s
    heun: 0.054 s
    trapezoidal: inf s
    """
    chosen = method_named(method)
    A_, *_ = system(A, np.zeros(np.shape(A)[0] if np.ndim(A) else 1))
    limits = [_along_ray(chosen, z) for z in counting_eigenvalues(A_)]
    return min(limits, default=inf)


def counting_eigenvalues(A: Array) -> Array:
    """Return the eigenvalues that limit the step; a real part that is rounding error becomes 0.

    An eigenvalue at 0 is not returned if it has as many independent eigenvectors as its
    multiplicity. If an eigenvalue with real part 0 has fewer eigenvectors, A is unstable, and the
    function returns only the number 1 as an unstable eigenvalue.
    """
    balanced, _ = matrix_balance(A)
    size = float(np.linalg.norm(balanced))
    values = np.linalg.eigvals(balanced).astype(np.complex128)
    rounding = 100 * A.shape[0] * _EPS * size
    marginal = np.abs(values.real) <= rounding
    values[marginal] = 1j * values[marginal].imag
    kept = []
    for z in values:
        # An m-fold eigenvalue with one eigenvector is computed as m values, eps^(1/m) apart.
        near = np.abs(values - z) <= 10 * np.sqrt(_EPS) * size
        count = int(np.count_nonzero(near))
        if z.real == 0 and count > 1 and _eigenvectors(balanced, z, size) < count:
            return np.array([1.0 + 0j])
        if abs(z) > rounding:
            kept.append(z)
    return np.array(kept, dtype=np.complex128)


def _eigenvectors(A: Array, z: complex, size: float) -> int:
    """Return the number of independent eigenvectors of A for the eigenvalue z."""
    spread = np.linalg.svd(A - z * np.eye(A.shape[0]), compute_uv=False)
    return int(np.count_nonzero(spread <= 100 * np.sqrt(_EPS) * size))


def _along_ray(method: Method, eigenvalue: complex) -> float:
    """Return the largest stable h for one eigenvalue that is not 0."""
    if eigenvalue.real > 0:
        return 0.0
    direction = eigenvalue / abs(eigenvalue)
    ends = [0.0, *_boundaries(method.stability_polynomial, direction)]
    for begin, end in zip(ends, [*ends[1:], inf], strict=True):
        inside = (begin + end) / 2 if end < inf else 2 * begin + 1
        if amplification(method, np.array(inside * direction)) > 1 + _CIRCLE_TOLERANCE:
            return float(begin / abs(eigenvalue))
    return inf


def _boundaries(pi: Array, direction: complex) -> list[float]:
    """Return all r > 0, rising, at which pi(zeta; r direction) may have a root |zeta| = 1."""
    # All roots of p of degree k are inside the unit circle if and only if |p_k|² > |p_0|² and all
    # roots of the reduction (conj(p_k) p - p_0 p*) / zeta are inside. p* has the conjugated
    # coefficients in reverse order. The coefficients here are polynomials in r.
    p = [row * direction ** np.arange(pi.shape[1]) for row in pi]
    radii: list[float] = []
    while len(p) > 1:
        edge = polysub(polymul(p[-1], np.conj(p[-1])), polymul(p[0], np.conj(p[0])))
        radii += _positive_roots(edge.real)
        p = [
            polysub(polymul(np.conj(p[-1]), low), polymul(p[0], np.conj(high)))
            for low, high in zip(p[1:], p[-2::-1], strict=True)
        ]
    return sorted(radii)


def _positive_roots(p: Array) -> list[float]:
    """Return the roots r > 0 of the real polynomial sum p_i r^i."""
    largest = float(np.abs(p).max(initial=0.0))
    p = np.where(np.abs(p) > 4 * _EPS * largest, p, 0.0)
    used = np.flatnonzero(p)
    if used.size < 2:
        return []
    r = np.roots(p[used[0] :][::-1])  # roots at 0 are no limit
    real = np.abs(r.imag) <= 1e-6 * np.abs(r)
    return [float(x) for x in r.real[real] if x > 0]
