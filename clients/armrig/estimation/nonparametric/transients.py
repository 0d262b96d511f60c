"""The transient in periods of the response to a periodic input."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from armrig.data.columns import Matrix, Vector
from armrig.numerics.criteria import mdl
from armrig.numerics.rounding import SEARCH_SHARE, rounding_std

Integers = NDArray[np.intp]

_RATES = 48  # time constants that are tried
_SHORTEST, _LONGEST = 0.15, 60.0  # of them, in periods and in records
_ALIKE = 1 - 1e-9  # correlation of two exponentials that the periods do not distinguish
_PENALTY = 3  # coefficients that an exponential counts: its own, its time constant, the choice
_LEAST_INDEPENDENT = 10.0
_PASSES = 8  # of a record with missing samples


def decaying_transient(
    y: Matrix, seen: NDArray[np.bool_], number: Integers | None = None
) -> tuple[Matrix, float]:
    """Return the transient of y (periods, P), and its longest time constant in samples.

    `number` (periods,) counts the periods from 0 on, where some are left out; by default none is.

    A period differs from the next by the transient and by noise. The transient is a sum of at most
    two exponentials exp(-t/tau), so many as the description length (MDL) allows. Coloured noise
    counts by the number of its independent samples. Values of y that are not `seen` are ignored.

    Returns
    -------
    Matrix, shape (periods, P)
        Transient; 0 if none is seen.
    float
        The longest tau; 0 if none is seen.
    """
    periods, P = y.shape
    found = np.zeros(y.shape), 0.0
    least = rounding_std(y, share=SEARCH_SHARE)
    if periods < 2 or np.max(np.abs(y - y.mean(axis=0))) <= least:
        return found
    tau = P * np.geomspace(_SHORTEST, _LONGEST * periods, _RATES)
    number = np.arange(periods) if number is None else number - number[0]
    of_period = np.exp(-number[:, None] * P / tau)
    of_sample = np.exp(-np.arange(P)[:, None] / tau)
    moving = of_period - of_period.mean(axis=0)
    gram = (moving.T @ moving) * (of_sample.T @ of_sample)
    scale = np.sqrt(np.diag(gram))
    complete = y
    for _ in range(1 if seen.all() else _PASSES):
        scatter = complete - complete.mean(axis=0)
        cross = np.einsum("pi,pi->i", moving, scatter @ of_sample) / scale
        fits = _fits(gram / np.outer(scale, scale), cross, float(np.sum(scatter**2)))
        courses = [(of_period[:, i] * (x / scale[i])) @ of_sample[:, i].T for i, x, _ in fits]
        rest = scatter - (courses[2] - courses[2].mean(axis=0))
        N = _independent(rest) * (periods - 1) / periods
        bits = [
            float(mdl(max(power, least**2) / rest.size, _PENALTY * n, int(N)))
            for n, (_, _, power) in enumerate(fits)
        ]
        best = int(np.argmin(bits))
        found = courses[best], float(np.max(tau[fits[best][0]], initial=0.0))
        level = np.nanmean(np.where(seen, y - courses[best], np.nan), axis=0)
        complete = np.where(seen, y, level + courses[best])
    return found


def _fits(gram: Matrix, cross: Vector, power: float) -> list[tuple[Integers, Vector, float]]:
    """Return the best fit of 0, 1 and 2 exponentials: indices, coefficients, sum of squares."""
    best = [(np.zeros(0, np.intp), np.zeros(0), power if n == 0 else np.inf) for n in range(3)]
    for pair in combinations_with_replacement(range(len(cross)), 2):
        used = np.unique(pair)
        M = gram[np.ix_(used, used)]
        if used.size == 2 and M[0, 1] > _ALIKE:
            continue
        x = np.linalg.solve(M, cross[used])
        if (left := power - float(cross[used] @ x)) < best[used.size][2]:
            best[used.size] = used, x, left
    return best


def _independent(e: Matrix) -> float:
    """Return the number of independent samples of e, by the correlation of neighbours."""
    power = float(np.sum(e**2))
    near = float(np.sum(e[:, 1:] * e[:, :-1])) / power if power else 0.0
    return max(e.size * (1 - near) / (1 + near), _LEAST_INDEPENDENT)
