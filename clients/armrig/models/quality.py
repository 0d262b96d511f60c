"""Quality of an estimated model on its data, and results of the search for its parameters."""

from __future__ import annotations

from dataclasses import dataclass

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
