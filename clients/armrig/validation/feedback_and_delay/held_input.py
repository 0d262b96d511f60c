"""Test of a held input: y does not explain its changes, so that u(t) does not follow y(t)."""

from __future__ import annotations

import numpy as np

from armrig.data.dataset import Dataset, Vector
from armrig.numerics.least_squares import orthonormal

_MAX_CHANGES = 1 / 3  # share of the samples in which a held input changes, at most
_MIN_CHANGES = 10  # with fewer changes the tests have no power
_MAX_AGE = 20  # largest distinguished number of samples since the last change
_LEVEL = 0.01


def may_follow_output(data: Dataset) -> bool:
    """Return whether u(t) may have been computed from y(t).

    A controller carries the noise of y into u, so that u changes in nearly each sample, or it is a
    relay. A held input keeps its value in two of three samples. It cannot have been computed from
    y(t) if y explains neither the instants nor the sizes of its changes. Both are F tests. Known
    before y are the time since the last change, the side of the mean, and the old value. y(t) is no
    regressor, because a direct term makes it depend on u(t).
    """
    instants, values = _rows(data)
    changes = float(np.sum(instants[0]))
    if changes < _MIN_CHANGES or changes > _MAX_CHANGES * instants[0].size:
        return True
    return min(_p_value(*instants), _p_value(*values) if values[0].size else 1.0) < _LEVEL


_Regression = tuple[Vector, Vector, Vector]
"""Target (N,), regressors of the hypothesis, and further regressors."""


def _rows(data: Dataset) -> tuple[_Regression, _Regression]:
    """Return the regressions of the instants and of the sizes of the changes of u."""
    middle, rows = float(np.mean(data.u)), list[Vector]()
    for part in data.experiments():
        changed = np.flatnonzero(np.diff(part.u)) + 1
        last = np.zeros(part.N, np.int_)
        last[changed] = changed
        age = np.minimum(np.arange(part.N) - np.maximum.accumulate(last), _MAX_AGE)
        now = np.arange(2, part.N)
        y = np.where(part.valid, part.y, np.nan)
        columns = [part.u[now], part.u[now - 1], age[now - 1], y[now - 1], y[now - 2]]
        rows.append(np.column_stack(columns))
    table = np.vstack(rows)
    u, before, age, y1, y2 = table[np.isfinite(table).all(axis=1)].T
    high = before > middle
    ages = np.eye(_MAX_AGE + 1)[age.astype(np.int_)]
    y = np.column_stack([y1, y2]) - np.mean([y1, y2])
    sides = (high[:, None], ~high[:, None])
    instants = (
        (u != before).astype(np.float64),
        np.hstack([ages * side for side in sides]),
        np.hstack([y * side for side in sides]),
    )
    moved = u != before
    values = u[moved], np.column_stack([np.ones(moved.sum()), before[moved]]), y[moved]
    return instants, values


def _p_value(target: Vector, base: Vector, extra: Vector) -> float:
    """Return the p value of the hypothesis that the further regressors explain nothing."""
    from scipy.special import fdtrc

    first = orthonormal(base).Q
    left = target - first @ (first.T @ target)
    added = orthonormal(extra - first @ (first.T @ extra)).Q
    explained = float(np.sum((added.T @ left) ** 2))
    degrees = target.size - first.shape[1] - added.shape[1]
    sse = float(left @ left) - explained
    if degrees < 1 or not added.shape[1] or sse <= 1e-9 * float(target @ target):
        return 1.0
    return float(fdtrc(added.shape[1], degrees, explained / added.shape[1] / (sse / degrees)))
