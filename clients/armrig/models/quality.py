"""Quality of an estimated model on its data, and results of the search for its parameters."""

from __future__ import annotations

from dataclasses import dataclass

from armrig.numerics.whiteness import Whiteness

MAX_TRUSTED_CURVATURE = 0.5
"""Largest `Fit.curvature` at which the coefficients' standard deviations are reliable. Up to this
limit the 95 % intervals contain 95 % of the true values (docs/benchmarks.md)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """One start value of the search, and its result."""

    name: str
    """Method that found the start value."""
    loss: float
    """Mean squared residual at the minimum that the search reached."""
    iterations: int
    """Number of steps of the search."""
    converged: bool
    """True if the change of the loss and the scaled gradient are within the tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutputQuality:
    """Quality of a model for one output, one step ahead, on the estimation data."""

    loss: float
    """Mean squared error, in the squared unit of the output."""
    N: int
    """Number of errors in the loss."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|)."""
    white: Whiteness
    """Result of the whiteness test of the errors."""
