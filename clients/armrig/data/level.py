"""Levels of signals, such as those of an operating point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from armrig.data.dataset import Vector

_MIN_SAMPLES = 20
"""Smallest number of samples for which a note about the mean is printed."""


def far_from_zero(every: Sequence[Vector]) -> bool:
    """Return True if a mean is far from 0, as at an operating point, and all signals vary."""
    import numpy as np

    # Subtracting the mean of a constant signal would leave 0.
    if any(x.size < _MIN_SAMPLES or not np.ptp(x) for x in every):
        return False
    return any(abs(x.mean()) > 2 * x.std() for x in every)
