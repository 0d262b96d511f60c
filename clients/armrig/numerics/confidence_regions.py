"""Where an answer lies with 95 %: by its derivative, or by draws where that is poor.

By first order (Gauss's approximation) an answer f(theta) is normal, of variance f'^T P f'. Draws of
theta say whether that holds: where they put an edge of the range elsewhere by more than a quarter
of its half-width, or more than 10 % or less than 2.5 % of them outside the region in the plane, the
linearisation is called poor and what the draws say takes its place. Where fewer than 100 of them
count, nothing is known.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 9.6 and 13.

Draws of roots, those that are real apart from those in pairs, and where 95 % of either lie.

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
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]
Method = Literal["linearised", "sampled"]

LEVEL = 0.95
HALF_WIDTH = 1.959964  # two-sided 95 % quantile of the normal distribution
RADIUS = float(np.sqrt(-2 * np.log(1 - LEVEL)))  # the same of two degrees of freedom
EDGE = 0.25
"""Largest difference of an edge, in linearised half-widths, that is not called poor."""
OUTSIDE = (0.025, 0.10)
"""Share of draws outside the linearised region in the plane that is not called poor."""
FEWEST = 100  # draws, below which nothing can be said of 2.5 %


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Band:
    """The 95 % range of one or of many real numbers, each for itself."""

    low: Vector
    """Lower edges, (n,)."""
    high: Vector
    """Upper edges, (n,)."""
    method: Method
    """How all of them were found."""

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Tell which x (n,) are inside."""
        x = np.asarray(x, dtype=np.float64)
        return np.asarray((self.low <= x) & (x <= self.high))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """Where a root lies with 95 %: an interval, an ellipse, or what the draws make of it."""

    centre: complex
    """The estimate."""
    method: Method
    """How the region was found."""
    interval: tuple[float, float] | None = None
    """Of a root that is real, or may be."""
    covariance: Matrix
    """Of real and imaginary part, linearised, (2, 2)."""
    densest: HighestDensityRegion | None = None
    """Of a root that is one of a pair, or may be, where the draws decide."""
    draws: RootDraws | None = None
    """The draws, where they decide."""

    def contains(self, z: complex) -> bool:
        """Tell whether z is inside: of the interval where it is real, if there is one."""
        if abs(z.imag) < REAL and self.interval is not None:
            return self.interval[0] <= z.real <= self.interval[1]
        if self.densest is not None:
            return bool(self.densest.excess(np.array([z]))[0] <= 1)
        if self.interval is not None:
            return False
        return bool(_distance(np.array([z - self.centre]), self.covariance)[0] <= RADIUS)

    def border(self) -> Vector | None:
        """Return the ellipse, (2, m), or None where the region is none."""
        if self.interval is not None or self.densest is not None:
            return None
        value, vector = np.linalg.eigh(self.covariance)
        radii = RADIUS * np.sqrt(np.maximum(value, 0.0))
        angle = np.linspace(0, 2 * np.pi, 73)
        around = vector @ (radii[:, None] * np.array([np.cos(angle), np.sin(angle)]))
        return np.asarray(around + np.array([[self.centre.real], [self.centre.imag]]))


def linearised_band(value: ArrayLike, std: ArrayLike, *, least: float = -np.inf) -> Band:
    """Return value ± 1.96 std, but nothing below `least`."""
    value = np.asarray(value, dtype=np.float64)
    width = HALF_WIDTH * np.asarray(std, dtype=np.float64)
    return Band(low=np.maximum(value - width, least), high=value + width, method="linearised")


def sampled_band(samples: Matrix) -> Band:
    """Return the 2.5 and 97.5 % quantiles of draws (m, n), or (m,)."""
    with np.errstate(invalid="ignore"):
        low, high = np.quantile(samples, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=0)
    return Band(low=low, high=high, method="sampled")


def band(
    value: ArrayLike, std: ArrayLike, samples: Matrix | None, *, least: float = -np.inf
) -> Band:
    """Return the 95 % range of each value (n,): linearised, or by draws where that is poor.

    It is poor where an edge by the draws is more than a quarter of 1.96 std elsewhere at any of
    the values; all of them are then by the draws.

    Parameters
    ----------
    samples : array (m, n) or None
        The values by draws of theta; None keeps the linearisation.
    least : float, optional
        What no value can be below: 0 for a magnitude.
    """
    linear = linearised_band(value, std, least=least)
    if samples is None:
        return linear
    if samples.shape[0] < FEWEST:
        unknown = np.full_like(linear.low, np.nan)
        return Band(low=unknown, high=unknown, method="sampled")
    sampled = sampled_band(samples)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.maximum(np.abs(sampled.low - linear.low), np.abs(sampled.high - linear.high))
        apart = apart / (HALF_WIDTH * np.asarray(std, dtype=np.float64))
    return sampled if np.any(apart[np.isfinite(apart)] > EDGE) else linear


def regions(
    centres: Complex, covariances: NDArray[np.float64], draws: Complex | None
) -> list[Region]:
    """Return the 95 % region of each root (n,) of one polynomial.

    Parameters
    ----------
    covariances : array (n, 2, 2)
        Of real and imaginary part, linearised.
    draws : array (m, n) or None
        The roots of draws of the polynomial, in any order; None keeps the linearisation.
    """
    of_roots = [None] * centres.size if draws is None else root_draws(centres, draws)
    return [
        chosen_region(complex(z), P, points)
        for z, P, points in zip(centres, covariances, of_roots, strict=True)
    ]


def linearised_region(z: complex, P: Matrix) -> Region:
    """Return the ellipse (dz^T P^-1 dz <= 5.99), or of a real root z ± 1.96 std."""
    interval = None
    if _is_real(z):
        width = HALF_WIDTH * float(np.sqrt(max(P[0, 0], 0.0)))
        interval = (z.real - width, z.real + width)
    return Region(centre=z, method="linearised", covariance=P, interval=interval)


def sampled_region(z: complex, P: Matrix, draws: RootDraws) -> Region:
    """Return the densest 95 % of the draws in pairs, and the quantiles of those that are real.

    Of a kind that fewer than 0.5 % are of there is none.
    """
    least = RARE * draws.upper.size
    interval = None
    if draws.reals.size > least:
        x = sampled_band(draws.reals)
        interval = (float(x.low), float(x.high))
    return Region(
        centre=z,
        method="sampled",
        covariance=P,
        interval=interval,
        densest=highest_density_region(draws.pairs) if draws.pairs.size > max(least, 2) else None,
        draws=draws,
    )


def chosen_region(z: complex, P: Matrix, draws: RootDraws | None) -> Region:
    """Return the linearised region, or the sampled one where the draws call that poor."""
    linear = linearised_region(z, P)
    if draws is None or not (np.isfinite(P).all() and P.any()):
        return linear
    if draws.upper.size < FEWEST:
        unknown = (np.nan, np.nan) if _is_real(z) else None
        nothing = np.full((2, 2), np.nan)
        return Region(centre=z, method="sampled", covariance=nothing, interval=unknown)
    if linear.interval is None:
        beside = draws.upper - complex(z.real, abs(z.imag))
        outside = float(np.mean(_distance(beside, _folded(z, P)) > RADIUS))
        return linear if OUTSIDE[0] <= outside <= OUTSIDE[1] else sampled_region(z, P, draws)
    sampled = sampled_region(z, P, draws)
    if sampled.interval is None or sampled.densest is not None:
        return sampled
    width = linear.interval[1] - z.real
    apart = np.abs(np.subtract(sampled.interval, linear.interval)).max()
    return sampled if apart > EDGE * width else linear


def _is_real(z: complex) -> bool:
    return abs(z.imag) < REAL


def _folded(z: complex, P: Matrix) -> Matrix:
    """Return the covariance of the root's partner in the upper half plane."""
    turn = np.diag([1.0, -1.0 if z.imag < 0 else 1.0])
    return np.asarray(turn @ P @ turn)


def _distance(z: Complex, P: Matrix) -> Vector:
    """Return Mahalanobis's distance of each z (n,) from 0."""
    plane = np.stack([z.real, z.imag])
    with np.errstate(divide="ignore", invalid="ignore"):
        try:
            return np.asarray(np.sqrt(np.maximum((plane * np.linalg.solve(P, plane)).sum(0), 0.0)))
        except np.linalg.LinAlgError:
            return np.full(z.size, np.inf)


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
