"""Whether an input repeats itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# A PWM of 10 bits puts 1e-3 of a multisine's 125 lines on each of the lines between, 2e-3 at most.
_ROUNDED = 5e-3


def period(u: Vector, tolerance: float = 1e-9) -> int | None:
    """Return the least P with u(t + P) = u(t) throughout and two periods at least, else None.

    A constant has none.
    """
    allowed = tolerance * float(np.ptp(u))
    if allowed == 0:
        return None
    head = min(16, u.size // 2)
    for P in range(2, u.size // 2 + 1):
        # Most candidates fail on the first few samples.
        if np.abs(u[P : P + head] - u[:head]).max() <= allowed and (
            np.abs(u[P:] - u[:-P]).max() <= allowed
        ):
            return P
    return None


def excited(U: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Tell at which lines of a transform there is power beyond rounding, and that of the PWM."""
    return np.asarray(np.abs(U) > _ROUNDED * np.abs(U).max(initial=0.0))
