"""Derivatives of a filtered signal with respect to the filter's coefficients.

With y = B/P u the derivatives are again filtered signals, one filter and then shifts::

    dy/db_k = q^-k u / P,    dy/dp_k = -q^-k y / P

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 10.3.
"""

from __future__ import annotations

from collections.abc import Sequence

from armrig.numerics.polynomial import Array, filtered, lagged


def by_numerator(u: Array, P: Array, lags: Sequence[int]) -> Array:
    """Return (N, len(lags)), the derivatives of B/P u by the coefficients of B at `lags`."""
    return lagged(filtered([1.0], P, u), lags)


def by_denominator(y: Array, P: Array, n: int) -> Array:
    """Return (N, n), the derivatives of y = B/P u by the n coefficients of P after the 1."""
    return -lagged(filtered([1.0], P, y), range(1, n + 1))
