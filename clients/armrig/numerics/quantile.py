"""Quantiles of the normal distribution, and refusals of impossible levels."""

from __future__ import annotations

from math import sqrt


def two_sided(level: float) -> float:
    """Return z with P(|x| < z) = level for a standard normal x: 1.96 for 0.95."""
    from scipy.special import erfinv

    if not 0 < level < 1:
        msg = f"level={level!r} must lie between 0 and 1, for example 0.95"
        raise ValueError(msg)
    return sqrt(2) * float(erfinv(level))
