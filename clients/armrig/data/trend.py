"""Trend that `detrend` removed from an experiment: one straight line for u and one for y."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """Level and slope of u and of y; a slope is 0 if only the mean was removed."""

    u_level: float = 0.0
    """Value of u's line at the experiment's first sample, in u's unit."""
    u_slope: float = 0.0
    """Slope of u, in u's unit per s."""
    y_level: float = 0.0
    """Value of y's line at the experiment's first sample, in y's unit."""
    y_slope: float = 0.0
    """Slope of y, in y's unit per s."""

    def u(self, t: Vector) -> Vector:
        """Return the line of u at times t (n,), in s from the experiment's first sample."""
        return np.asarray(self.u_level + self.u_slope * t)

    def y(self, t: Vector) -> Vector:
        """Return the line of y at times t (n,), in s from the experiment's first sample."""
        return np.asarray(self.y_level + self.y_slope * t)

    def later(self, seconds: float) -> Trend:
        """Return the same lines for data that begin `seconds` later; only the levels change."""
        return Trend(
            u_level=self.u_level + self.u_slope * seconds,
            u_slope=self.u_slope,
            y_level=self.y_level + self.y_slope * seconds,
            y_slope=self.y_slope,
        )

    def __add__(self, other: Trend) -> Trend:
        """Return the sum of two trends that were removed one after the other."""
        names = [field.name for field in fields(self)]
        return Trend(**{name: getattr(self, name) + getattr(other, name) for name in names})
