"""Ranking of the results of searches from several start values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

_SAME_TOLERANCE = 1e-6  # difference of criteria up to which two searches are at one minimum
_LEAST_COST = 1e-300  # so that a cost of 0 has a logarithm

End = TypeVar("End")


def ranked(ends: Iterable[End], criterion: Callable[[End], float]) -> list[End]:
    """Return the results of searches, best first; results at the same minimum keep their order.

    At the same minimum only rounding errors, which differ from processor to processor, decide which
    cost is lower.

    Parameters
    ----------
    criterion : callable
        Function that returns the logarithm of the cost of a result.
    """
    found = list(ends)
    values = np.array([criterion(end) for end in found])
    values[np.isnan(values)] = np.inf
    higher = values > values.min()
    steps = np.zeros(values.size)
    steps[higher] = np.rint((values[higher] - values.min()) / _SAME_TOLERANCE)
    return [found[i] for i in np.argsort(steps, kind="stable")]


def log_cost(cost: float) -> float:
    """Return the logarithm of a sum of squares."""
    return float(np.log(max(cost, _LEAST_COST)))
