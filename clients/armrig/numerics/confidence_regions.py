"""95 % regions of model properties: linearised, or from draws if the linearisation is poor.

To first order (Gauss's approximation) a property f(theta) is normally distributed with the variance
f'^T P f', where P is the covariance of theta. This approximation is checked by draws of theta. For
a range, the two edges are checked. The approximation is poor if an edge computed from the draws
differs from the linearised edge by more than a quarter of the half-width. For a region in the
plane, the approximation is poor if more than 10 % or less than 2.5 % of the draws are outside. If
the approximation is poor, the region is computed from the draws. With fewer than 100 valid draws
the region is unknown.

If two roots may be a conjugate pair or real, they are not smooth functions of the parameters. Their
mean and the square of half their difference are smooth. For a pair x ± iy these two values are x
and -y². Therefore the region of the pairs is computed in the plane of (x, -y²), in which the region
does not fold at the real axis. For the draws with real roots there is a separate interval. The
region contains 95 % of the pairs, and the interval contains 95 % of the real roots. The coverage is
therefore 95 % whether the true root is real or one of a pair.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 9.6 and 13.
.. [2] D. O. Loftsgaarden, C. P. Quesenberry, Ann. Math. Statist. 36 (1965) 1049-1051 (density from
   the distance of the k-th neighbour).
.. [3] J. Lei, J. Robins, L. Wasserman, J. Amer. Statist. Assoc. 108 (2013) 278-287 (a region that
   contains the next draw with a probability of 95 %, for any distribution).
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
RADIUS = float(np.sqrt(-2 * np.log(1 - LEVEL)))  # half axis of the 95 % ellipse, in σ
MAX_EDGE_SHIFT = 0.25
"""Largest distance between an edge computed from draws and the linearised edge, in half-widths of
the linearised range. If an edge is farther away, the range from draws is used."""
OUTSIDE_RANGE = (0.025, 0.10)
"""A linearised ellipse is used if the share of draws outside the ellipse is in this range."""
MIN_DRAWS = 100  # fewer draws do not determine a 2.5 % quantile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Band:
    """Pointwise 95 % ranges of one or many real numbers."""

    low: Vector
    """Lower edges, (n,)."""
    high: Vector
    """Upper edges, (n,)."""
    method: Method
    """Method by which all ranges were computed."""

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask (n,): True for each x inside its range."""
        x = np.asarray(x, dtype=np.float64)
        return np.asarray((self.low <= x) & (x <= self.high))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """95 % region of a root: an interval, an ellipse, or a region of draws."""

    centre: complex
    """Estimate of the root."""
    method: Method
    """Method by which the region was computed."""
    interval: tuple[float, float] | None = None
    """Interval on the real axis, if the root is or may be real."""
    covariance: Matrix
    """Linearised covariance of real and imaginary part, (2, 2)."""
    densest: HighestDensityRegion | None = None
    """Region of the draws, if the method is "sampled" and the root may be one of a pair."""
    draws: RootDraws | None = None
    """Draws of the root, if the method is "sampled"."""

    def contains(self, z: complex) -> bool:
        """Return whether z is in the region. If there is an interval, a real z must be in it."""
        if abs(z.imag) < REAL_TOLERANCE and self.interval is not None:
            return self.interval[0] <= z.real <= self.interval[1]
        if self.densest is not None:
            return bool(self.densest.excess(np.array([z]))[0] <= 1)
        if self.interval is not None:
            return False
        return bool(_distance(np.array([z - self.centre]), self.covariance)[0] <= RADIUS)

    def border(self) -> Vector | None:
        """Return points of the ellipse, (2, m), or None if the region is no ellipse."""
        if self.interval is not None or self.densest is not None:
            return None
        value, vector = np.linalg.eigh(self.covariance)
        radii = RADIUS * np.sqrt(np.maximum(value, 0.0))
        angle = np.linspace(0, 2 * np.pi, 73)
        around = vector @ (radii[:, None] * np.array([np.cos(angle), np.sin(angle)]))
        return np.asarray(around + np.array([[self.centre.real], [self.centre.imag]]))


def linear_band(value: ArrayLike, std: ArrayLike, *, least: float = -np.inf) -> Band:
    """Return value ± 1.96 std, with lower edges of at least `least`."""
    value = np.asarray(value, dtype=np.float64)
    width = HALF_WIDTH * np.asarray(std, dtype=np.float64)
    return Band(low=np.maximum(value - width, least), high=value + width, method="linearised")


def band_of_draws(samples: Matrix) -> Band:
    """Return the 2.5 % and 97.5 % quantiles of draws (m, n) or (m,)."""
    with np.errstate(invalid="ignore"):
        low, high = np.quantile(samples, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=0)
    return Band(low=low, high=high, method="sampled")


def band(
    value: ArrayLike, std: ArrayLike, samples: Matrix | None, *, least: float = -np.inf
) -> Band:
    """Return the 95 % range of each value (n,), linearised or computed from draws.

    The linearisation is poor if, for any value, an edge computed from draws differs from the
    linearised edge by more than a quarter of 1.96 std. All ranges are then computed from draws.

    `samples` (m, n) are the values for draws of theta; with None the ranges are linearised. `least`
    is a lower limit of the values, such as 0 for a magnitude.
    """
    linear = linear_band(value, std, least=least)
    if samples is None:
        return linear
    if samples.shape[0] < MIN_DRAWS:
        unknown = np.full_like(linear.low, np.nan)
        return Band(low=unknown, high=unknown, method="sampled")
    sampled = band_of_draws(samples)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.maximum(np.abs(sampled.low - linear.low), np.abs(sampled.high - linear.high))
        apart = apart / (HALF_WIDTH * np.asarray(std, dtype=np.float64))
    return sampled if np.any(apart[np.isfinite(apart)] > MAX_EDGE_SHIFT) else linear


def regions(
    centres: Complex, covariances: NDArray[np.float64], draws: Complex | None
) -> list[Region]:
    """Return the 95 % region of each root (n,) of one polynomial.

    The linearised covariances (n, 2, 2) are those of real and imaginary part. `draws` (m, n) are
    the roots of draws of the polynomial, in any order; with None the regions are linearised.
    """
    of_roots = [None] * centres.size if draws is None else root_draws(centres, draws)
    return [
        choose_region(complex(z), P, points)
        for z, P, points in zip(centres, covariances, of_roots, strict=True)
    ]


def linear_region(z: complex, P: Matrix) -> Region:
    """Return the ellipse dz^T P^-1 dz <= 5.99, or the interval z ± 1.96 std for a real root."""
    interval = None
    if _is_real(z):
        width = HALF_WIDTH * float(np.sqrt(max(P[0, 0], 0.0)))
        interval = (z.real - width, z.real + width)
    return Region(centre=z, method="linearised", covariance=P, interval=interval)


def region_of_draws(z: complex, P: Matrix, draws: RootDraws) -> Region:
    """Return the region of the densest 95 % of the pairs, and the interval of the real draws.

    If less than 0.5 % of the draws are pairs, there is no region. If less than 0.5 % of the draws
    are real, there is no interval.
    """
    least = MIN_KIND_SHARE * draws.upper.size
    interval = None
    if draws.reals.size > least:
        x = band_of_draws(draws.reals)
        interval = (float(x.low), float(x.high))
    return Region(
        centre=z,
        method="sampled",
        covariance=P,
        interval=interval,
        densest=highest_density_region(draws.pairs) if draws.pairs.size > max(least, 2) else None,
        draws=draws,
    )


def choose_region(z: complex, P: Matrix, draws: RootDraws | None) -> Region:
    """Return the linearised region, or the sampled region if the linearisation is poor."""
    linear = linear_region(z, P)
    if draws is None or not (np.isfinite(P).all() and P.any()):
        return linear
    if draws.upper.size < MIN_DRAWS:
        unknown = (np.nan, np.nan) if _is_real(z) else None
        nothing = np.full((2, 2), np.nan)
        return Region(centre=z, method="sampled", covariance=nothing, interval=unknown)
    if linear.interval is None:
        beside = draws.upper - complex(z.real, abs(z.imag))
        turn = np.diag([1.0, -1.0 if z.imag < 0 else 1.0])  # mirrored into the upper half plane
        outside = float(np.mean(_distance(beside, turn @ P @ turn) > RADIUS))
        return (
            linear
            if OUTSIDE_RANGE[0] <= outside <= OUTSIDE_RANGE[1]
            else region_of_draws(z, P, draws)
        )
    sampled = region_of_draws(z, P, draws)
    if sampled.interval is None or sampled.densest is not None:
        return sampled
    width = linear.interval[1] - z.real
    apart = np.abs(np.subtract(sampled.interval, linear.interval)).max()
    return sampled if apart > MAX_EDGE_SHIFT * width else linear


def _is_real(z: complex) -> bool:
    return abs(z.imag) < REAL_TOLERANCE


def _distance(z: Complex, P: Matrix) -> Vector:
    """Return the Mahalanobis distance of each z (n,) from 0."""
    plane = np.stack([z.real, z.imag])
    with np.errstate(divide="ignore", invalid="ignore"):
        try:
            return np.asarray(np.sqrt(np.maximum((plane * np.linalg.solve(P, plane)).sum(0), 0.0)))
        except np.linalg.LinAlgError:
            return np.full(z.size, np.inf)


REAL_TOLERANCE = 1e-9
"""A root with an imaginary part below this number counts as real."""
MIN_KIND_SHARE = 0.005
"""Least share of a root's draws: rarer real draws, or rarer complex pairs, are ignored."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RootDraws:
    """Draws of one root of the estimate."""

    pairs: Complex
    """Draws in which the root is one of a pair, mirrored into the upper half plane, (n,)."""
    reals: Vector
    """Draws in which the root is real, (m,), including both roots of a pair that became real."""

    @property
    def upper(self) -> Complex:
        """All draws: pairs in the upper half plane, then real roots."""
        return np.concatenate([self.pairs, self.reals.astype(np.complex128)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HighestDensityRegion:
    """Region of the densest 95 % of the draws of a root of a complex pair.

    The density at a point is measured by the distance to the k-th nearest draw, with k = sqrt(n).
    The limit is the 95 % quantile of the distance from a draw to the k-th nearest other draw.
    """

    points: Complex
    """Draws above the real axis, (n,)."""
    scale: Matrix
    """Matrix that scales (x, -y²) before distances are computed, (2, 2)."""
    limit: float
    """Largest distance to the k-th nearest draw for a point inside the region."""
    tree: Any
    """K-d tree of the scaled draws, from scipy."""

    def excess(self, z: Complex) -> Vector:
        """Return the distance of each z (k,) divided by the limit; the ratio is 1 at the border."""
        distance, _ = self.tree.query(_plane(z) @ self.scale.T, k=[_neighbours(self.points.size)])
        return np.asarray(distance[:, 0] / self.limit)

    def inside(self) -> Complex:
        """Return the draws inside the region."""
        return np.asarray(self.points[self.excess(self.points) <= 1])


def highest_density_region(points: Complex) -> HighestDensityRegion:
    """Return the region of the densest 95 % of at least three points."""
    from scipy.spatial import cKDTree

    scale = _whitening(points)
    plane = _plane(points) @ scale.T
    tree = cKDTree(plane)
    # The first neighbour of a draw is the draw itself, so k is larger by 1.
    distances, _ = tree.query(plane, k=[_neighbours(points.size) + 1])
    limit = float(np.quantile(distances[:, 0], 0.95)) or 1e-12
    return HighestDensityRegion(points=points, scale=scale, limit=limit, tree=tree)


def root_draws(centres: Complex, roots: Complex) -> list[RootDraws]:
    """Return the draws of each root of the estimate (n,) from the roots of all draws (m, n).

    In each draw the roots are assigned to the roots of the estimate so that the sum of distances is
    least. If a pair became two real roots, both real roots are draws of each root of the pair.
    """
    assigned = _assign_roots(centres, roots)
    draws = []
    for i, z in enumerate(centres):
        drawn_roots = assigned[:, i]
        real = np.abs(drawn_roots.imag) < REAL_TOLERANCE
        pairs = drawn_roots[~real].real + 1j * np.abs(drawn_roots[~real].imag)
        reals = drawn_roots[real].real
        if abs(z.imag) >= REAL_TOLERANCE:
            other = assigned[:, int(np.argmin(np.abs(centres - np.conj(z))))]
            reals = np.concatenate([reals, other[np.abs(other.imag) < REAL_TOLERANCE].real])
        draws.append(RootDraws(pairs=pairs, reals=reals))
    return draws


def _assign_roots(centres: Complex, roots: Complex) -> Complex:
    from scipy.optimize import linear_sum_assignment

    out = np.empty_like(roots)
    for i, row in enumerate(roots):
        indices, at = linear_sum_assignment(np.abs(centres[:, None] - row[None, :]))
        out[i, indices] = row[at]
    return out


def _plane(z: Complex) -> Matrix:
    return np.stack([z.real, -(z.imag**2)], axis=1)


def _neighbours(n: int) -> int:
    return max(1, round(float(np.sqrt(n))))


def _whitening(points: Complex) -> Matrix:
    """Return the matrix that scales the inner 90 % of the draws to a unit covariance matrix."""
    plane = _plane(points)
    centre = np.median(plane, axis=0)
    spread = np.median(np.abs(plane - centre), axis=0)
    far = np.abs((plane - centre) / np.where(spread > 0, spread, 1.0)).max(axis=1)
    inner = np.cov(plane[far <= np.quantile(far, 0.9)].T)
    by = np.sqrt(np.maximum(np.diag(inner), 1e-30))
    value, vector = np.linalg.eigh(inner / np.outer(by, by))
    return np.asarray((vector / np.sqrt(np.maximum(value, 1e-6))).T / by)
