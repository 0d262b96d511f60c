"""Coefficients of polynomials in q^-1 from their values on a circle."""

from __future__ import annotations

from typing import Any

import numpy as np

from armrig.models.model import Complex

_RADIUS = 1.05
"""Radius of the circle in q, divided by the modulus of the largest pole. If all poles are inside
the unit circle, this number is the radius itself."""


def circle(n: int, poles: Any) -> Complex:
    """Return n values of q^-1 on a circle in q that contains all poles."""
    radius = _RADIUS * max(1.0, float(np.max(np.abs(poles), initial=0.0)))
    return np.asarray(np.exp(-2j * np.pi * np.arange(n) / n) / radius)


def coefficients(values: Any, x: Complex) -> Any:
    """Return the n coefficients of the polynomials that have the values (n, …) at the points x."""
    n = x.size
    powers = np.abs(x[0]) ** np.arange(n)
    found = np.fft.ifft(values, axis=0).real
    return found / powers.reshape((n,) + (1,) * (found.ndim - 1))
