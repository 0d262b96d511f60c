"""A lasting change of the level of y that u does not explain, as by a load."""

from __future__ import annotations

import numpy as np

from armrig.data.columns import Matrix, Vector
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.regressors import long_arx
from armrig.numerics.rounding import rounding_std

_ORDER = 10
_ROWS_PER_PARAMETER = 5
_MOST_SAMPLES = 50_000  # of more samples no change is looked for
_LARGEST, _EVEN = 5, 30  # tried places: at the largest errors, and evenly spaced
_MOST_LEFT = 0.85  # share of the errors that a change leaves; a nonlinear rig leaves 0.94
_SURE = 40.0  # least F of the change; the largest of 10 000 places of white noise has about 19


def level_change(u: Matrix, y: Vector) -> int | None:
    """Return the first sample after a lasting change of the level of y (N,); None without one.

    Errors e(t) of an ARX model of order 10 change their mean at the sample. The errors of the next
    samples, to whose regressors the old level belongs, are left out. A straight line explains the
    change less well. Of several changes, that with the least errors is returned.
    """
    if not 2 * _ROWS_PER_PARAMETER * (2 + u.shape[1]) * _ORDER <= y.size <= _MOST_SAMPLES:
        return None
    arx = long_arx([(u, y)], _ORDER, 0)
    rows = np.flatnonzero(arx.rows)
    if rows.size < _ROWS_PER_PARAMETER * arx.base.d:
        return None
    e, t = arx.errors(y), np.arange(y.size, dtype=np.float64)
    power, degrees = float(e @ e), rows.size - arx.base.rank - _ORDER
    if power <= y.size * rounding_std(y) ** 2:
        return None
    line = power - float(np.sum(orthonormal(arx.errors(t[:, None])).without(e) ** 2))
    largest = rows[np.argsort(-np.abs(e))[:_LARGEST]]
    places = np.union1d(largest, np.linspace(y.size / 10, 0.9 * y.size, _EVEN).astype(int))

    def left(at: int) -> float:
        """Return the sum of squared errors with a change at a sample; inf if none is sure."""
        if not 2 * _ORDER < at < y.size - 2 * _ORDER:
            return np.inf
        near = (t[:, None] == at + np.arange(_ORDER)).astype(np.float64)
        others = orthonormal(arx.errors(near))
        without = others.without(e)
        step = others.without(arx.errors((t >= at).astype(np.float64)))
        size, rest = float(step @ step), float(without @ without)
        explained = float(step @ without) ** 2 / size if size > 0 else 0.0
        is_sure = explained > max(line, _SURE * max(rest - explained, 0.0) / degrees)
        return rest - explained if is_sure else np.inf

    best = min(places.tolist(), key=left, default=0)
    if left(best) > _MOST_LEFT * power:
        return None
    return int(min(range(best - _ORDER, best + _ORDER + 1), key=left))
