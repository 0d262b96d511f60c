"""Trend that `detrend` removed from an experiment: a straight line for each input and output."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Levels = float | Vector
"""One number, or an array with a number for each column."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trend:
    """Level and slope of u and of y; a slope is 0 if only the mean was removed.

    In the trends of a Dataset the fields are numbers. In the trends of Signals they are arrays with
    a number for each column of u and of y.
    """

    u_level: Levels = 0.0
    """Value of u's line at the experiment's first sample, in u's unit."""
    u_slope: Levels = 0.0
    """Slope of u, in u's unit per s."""
    y_level: Levels = 0.0
    """Value of y's line at the experiment's first sample, in y's unit."""
    y_slope: Levels = 0.0
    """Slope of y, in y's unit per s."""

    def u(self, t: Vector) -> Vector:
        """Return the lines of u at times t (n,), in s from the experiment's first sample."""
        return np.asarray(self.u_level + np.multiply.outer(t, self.u_slope))

    def y(self, t: Vector) -> Vector:
        """Return the lines of y at times t (n,), in s from the experiment's first sample."""
        return np.asarray(self.y_level + np.multiply.outer(t, self.y_slope))

    def later(self, seconds: float) -> Trend:
        """Return the same lines for data that begin `seconds` later; only the levels change."""
        return Trend(
            u_level=self.u_level + self.u_slope * seconds,
            u_slope=self.u_slope,
            y_level=self.y_level + self.y_slope * seconds,
            y_slope=self.y_slope,
        )

    def each(self, of_u: Callable[[Any], Any], of_y: Callable[[Any], Any]) -> Trend:
        """Return the results of `of_u` for the fields of u, and of `of_y` for the fields of y."""
        return Trend(
            u_level=of_u(self.u_level),
            u_slope=of_u(self.u_slope),
            y_level=of_y(self.y_level),
            y_slope=of_y(self.y_slope),
        )

    def __add__(self, other: Trend) -> Trend:
        """Return the sum of two trends that were removed one after the other."""
        return Trend(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in _FIELDS})

    def __eq__(self, other: object) -> bool:
        """Return whether all levels and slopes are equal."""
        return isinstance(other, Trend) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in _FIELDS
        )


_FIELDS = fields(Trend)
