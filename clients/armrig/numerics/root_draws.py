"""Draws of roots, those that are real apart from those in pairs, and where 95 % of either lie.

Two roots that may be a conjugate pair or two real ones are no smooth function of the parameters,
but their mean and the square of half their difference are: a pair at x ± iy has x and -y². So the
region of the pairs is made in the plane of (x, -y²), where it does not fold at the real axis, and
the real draws have an interval of their own. Each holds 95 % of its kind, so that the two together
are not too small whichever the truth is.

References
----------
.. [1] D. O. Loftsgaarden, C. P. Quesenberry, Ann. Math. Statist. 36 (1965) 1049-1051 (density from
   the distance of the k-th neighbour).
.. [2] J. Lei, J. Robins, L. Wasserman, J. Amer. Statist. Assoc. 108 (2013) 278-287 (a region that
   holds the next draw with 95 %, whatever the distribution).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

REAL = 1e-9
"""Imaginary part below which a root is real."""
RARE = 0.005
"""Share of the draws of a root below which being real, or not, does not count."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RootDraws:
    """What the draws make of one root of the estimate."""

    pairs: Complex
    """Where it is one of a pair: the one above the real axis, (n,)."""
    reals: Vector
    """Where it is real, or the two that its pair has become, (m,)."""

    @property
    def upper(self) -> Complex:
        """All of them."""
        return np.concatenate([self.pairs, self.reals.astype(np.complex128)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HighestDensityRegion:
    """The densest 95 % of draws of a root that is one of a pair.

    A point is as strange as the distance to its k-th nearest draw, k = sqrt(n), is large; the limit
    is that which 95 % of the draws keep, each measured against the others.
    """

    points: Complex
    """The draws, above the real axis, (n,)."""
    scale: Matrix
    """What (x, -y²) is multiplied by before distances are taken, (2, 2)."""
    limit: float
    """Largest distance of a point inside."""
    tree: Any
    """scipy's k-d tree of the scaled draws."""

    def excess(self, z: Complex) -> Vector:
        """Return how strange each z (k,) is; 1 is the border."""
        distance, _ = self.tree.query(_plane(z) @ self.scale.T, k=[_neighbours(self.points.size)])
        return np.asarray(distance[:, 0] / self.limit)

    def inside(self) -> Complex:
        """Return the draws inside."""
        return np.asarray(self.points[self.excess(self.points) <= 1])


def highest_density_region(points: Complex) -> HighestDensityRegion:
    """Return the region of the densest 95 % of the points, three at least."""
    from scipy.spatial import cKDTree

    scale = _whitening(points)
    plane = _plane(points) @ scale.T
    tree = cKDTree(plane)
    # The nearest draw of a draw is itself.
    own, _ = tree.query(plane, k=[_neighbours(points.size) + 1])
    limit = float(np.quantile(own[:, 0], 0.95)) or 1e-12
    return HighestDensityRegion(points=points, scale=scale, limit=limit, tree=tree)


def root_draws(centres: Complex, roots: Complex) -> list[RootDraws]:
    """Return for each root of the estimate (n,) what became of it in the draws (m, n).

    In each draw the roots are told apart so that the sum of their distances from the estimate's is
    least. Where a pair has become two real roots, both count for either.
    """
    assigned = _assigned(centres, roots)
    found = []
    for i, z in enumerate(centres):
        own = assigned[:, i]
        real = np.abs(own.imag) < REAL
        pairs = own[~real].real + 1j * np.abs(own[~real].imag)
        reals = own[real].real
        if abs(z.imag) >= REAL:
            other = assigned[:, int(np.argmin(np.abs(centres - np.conj(z))))]
            reals = np.concatenate([reals, other[np.abs(other.imag) < REAL].real])
        found.append(RootDraws(pairs=pairs, reals=reals))
    return found


def _assigned(centres: Complex, roots: Complex) -> Complex:
    from scipy.optimize import linear_sum_assignment

    out = np.empty_like(roots)
    for i, row in enumerate(roots):
        of, at = linear_sum_assignment(np.abs(centres[:, None] - row[None, :]))
        out[i, of] = row[at]
    return out


def _plane(z: Complex) -> Matrix:
    return np.stack([z.real, -(z.imag**2)], axis=1)


def _neighbours(n: int) -> int:
    return max(1, round(float(np.sqrt(n))))


def _whitening(points: Complex) -> Matrix:
    """Return what makes the inner nine tenths of the draws about round."""
    plane = _plane(points)
    centre = np.median(plane, axis=0)
    spread = np.median(np.abs(plane - centre), axis=0)
    far = np.abs((plane - centre) / np.where(spread > 0, spread, 1.0)).max(axis=1)
    inner = np.cov(plane[far <= np.quantile(far, 0.9)].T)
    by = np.sqrt(np.maximum(np.diag(inner), 1e-30))
    value, vector = np.linalg.eigh(inner / np.outer(by, by))
    return np.asarray((vector / np.sqrt(np.maximum(value, 1e-6))).T / by)
