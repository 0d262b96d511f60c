"""Where an answer lies with 95 %: by its derivative, or by draws where that is poor.

By first order (Gauss's approximation) an answer f(theta) is normal, of variance f'^T P f'. Draws of
theta say whether that holds: where they put an edge of the range elsewhere by more than a quarter
of its half-width, or more than 10 % or less than 2.5 % of them outside the region in the plane, the
linearisation is called poor and what the draws say takes its place. Where fewer than 100 of them
count, nothing is known.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 9.6 and 13.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig.numerics.root_draws import (
    RARE,
    REAL,
    HighestDensityRegion,
    RootDraws,
    highest_density_region,
    root_draws,
)

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
