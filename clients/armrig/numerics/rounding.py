"""The size below which a computed number is a rounding error, for every verdict on data.

A model that explains y exactly leaves errors of about eps times y, multiplied by the condition of
its equations. Such errors depend on the processor, and a test finds a drift, a colour or an order
in them. Each test of data therefore replaces smaller errors by this size, or by 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHARE = 1e-9
"""Share of the standard deviation of y below which the errors of a model are rounding errors.

1e-9 is eps times a condition of 5e6. The noise of a converter with 24 bits is a hundred times
larger.
"""
SEARCH_SHARE = 1e-6
"""The same for a model that a search found, which ends before the last digits."""
_LEVEL_SHARE = 1e3 * float(np.finfo(np.float64).eps)
"""The same, as a share of the largest |y|: the digits that a level takes from changes of y."""


def rounding_std(*signals: NDArray[Any], share: float = SHARE) -> float:
    """Return the standard deviation of rounding errors of a model of y, in y's unit.

    The signals are the values of y in each experiment, (N,) or (N, ny); a missing value is NaN. The
    result is positive, also if y is 0, so that it may be a divisor.
    """
    y = np.concatenate([np.ravel(x) for x in signals]) if signals else np.zeros(0)
    y = y[np.isfinite(y)]
    if not y.size:
        return float(np.finfo(np.float64).tiny)
    size = share * float(np.std(y)) + _LEVEL_SHARE * float(np.max(np.abs(y)))
    return max(size, float(np.sqrt(np.finfo(np.float64).tiny)))


def is_constant(y: NDArray[Any]) -> bool:
    """Return whether all known values of y are equal, apart from rounding errors."""
    y = y[np.isfinite(y)]
    return not y.size or bool(np.ptp(y) <= _LEVEL_SHARE * float(np.max(np.abs(y))))


def without_rounding(
    residuals: Iterable[NDArray[np.float64]], size: float
) -> list[NDArray[np.float64]]:
    """Return the residuals of each experiment, or zeros if their rms is at most `size`.

    NaN remains where a residual is missing. Zeros are not tested for a colour.
    """
    parts = list(residuals)
    e = np.concatenate([np.ravel(x) for x in parts])
    if not np.nansum(e**2) <= size**2 * max(int(np.count_nonzero(np.isfinite(e))), 1):
        return parts
    return [np.where(np.isfinite(x), 0.0, np.nan) for x in parts]
