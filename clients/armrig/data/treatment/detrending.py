"""Removal of means and straight lines from data, and their restoration."""

from __future__ import annotations

import warnings
from typing import TypeVar, overload

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.argument import treats_signals
from armrig.data.columns import Matrix, Vector, columns
from armrig.data.dataset import Dataset, Signals
from armrig.data.step import LINE, MEAN, Step
from armrig.data.treatment.integrating import IntegratingOutputWarning, integrating
from armrig.data.trend import Trend
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.stretches import Mask

Data = TypeVar("Data", Dataset, Signals)


@treats_signals
def detrend(data: Signals, order: int = 0) -> Signals:
    """Return the data with mean (order 0) or straight line (order 1) removed from u and y.

    The mean or line of each experiment is fitted to its valid samples by least squares. The field
    `trends` stores what was removed, and `retrend` restores it. The recording does not change.

    Remove the mean if the operating point is not 0 and the estimator has no option `offset`.
    Estimators without this option are `arx`, `iv4`, `n4sid` and `ss`, and all estimators of several
    inputs or outputs. For `armax`, `oe`, `bj` and `ararx` of one input and one output, prefer raw
    data with ``offset=True``: the mean of a record is not exactly an equilibrium. Never
    remove a line from an integrating output, such as theta_1. Instead, use ``integrator=True`` with
    raw data, or compute the rate with `difference` and remove its mean.

    Parameters
    ----------
    data : Dataset or Signals
        N samples.
    order : {0, 1}
        0 removes the mean, 1 removes a straight line.

    Returns
    -------
    Dataset or Signals
        N samples in the same units, with the step in `history`.

    Warns
    -----
    IntegratingOutputWarning
        The order is 1 and the output integrates. The line is then the response to the mean of the
        input, not a drift, and a model of data without the line is wrong. The name of the output
        (theta_1) or a unit root test decides whether the output integrates: see
        `armrig.data.treatment.integrating`.

    Raises
    ------
    ValueError
        order is neither 0 nor 1.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.detrend(armrig.example_recording().dataset("alpha"))
    >>> data.history
    ('removed the mean from u and y (order 0)',)
    >>> print(f"mean of u removed: {data.trends[0].u_level:.2f} V")
    mean of u removed: 2.49 V
    """
    if order not in (0, 1):
        raise InputError(
            f"order={order!r} must be 0 (remove the mean) or 1 (remove a straight line)"
        )
    found = [integrating(data, name) for name in data.outputs] if order == 1 else []
    evidence = " and ".join(x.text for x in found if x)
    if evidence:
        warnings.warn(
            f"detrend(order=1): {evidence}, so its line is the response to the mean of u and not "
            "a drift; keep the line, and use order=0, oe(integrator=True) or difference(data)",
            IntegratingOutputWarning,
            stacklevel=2,
        )
    u, y, trends = data.u.copy(), data.y.copy(), []
    for k, (part, start) in enumerate(zip(data.experiments(), data.starts, strict=True)):
        t = part.t - part.t[0]
        u_lines = _lines(t, part.u, np.ones(part.u.shape, dtype=np.bool_), order)
        y_lines = _lines(t, part.y, part.valid, order)
        removed = Trend(
            u_level=u_lines[0], u_slope=u_lines[1], y_level=y_lines[0], y_slope=y_lines[1]
        )
        rows = slice(start, start + part.N)
        u[rows] -= removed.u(t)
        y[rows] -= removed.y(t)
        trends.append(data.trends[k] + removed if data.trends else removed)
    what = "the mean" if order == 0 else "a straight line"
    each = "" if len(trends) == 1 else " of each experiment"
    despite = f", although {evidence}" if evidence else ""
    return data.replaced(
        u=u,
        y=y,
        trends=trends,
        step=Step(
            f"removed {what} from u and y{each} (order {order}){despite}", LINE if order else MEAN
        ),
    )


@overload
def retrend(data: Data) -> Data: ...
@overload
def retrend(data: Data, y: ArrayLike) -> Vector: ...
def retrend(data: Data, y: ArrayLike | None = None) -> Data | Vector:
    """Return the data, or an output that a model computed from them, with the trend restored.

    Parameters
    ----------
    data : Dataset or Signals
        N samples treated by `detrend`, or slices, parts or merges of such data. Their `trends`
        still store what was removed.
    y : array_like, shape (N,) or (N, ny), optional
        Outputs simulated or predicted from these data, in y's unit.

    Returns
    -------
    Dataset, Signals or ndarray
        The data with the trend restored; if `y` is given, `y` plus the trend of the output.

    Raises
    ------
    ValueError
        No trend was removed from these data, the data were filtered after `detrend`, or y does not
        have a value for each sample of each output.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> data = armrig.example_recording().dataset("alpha")
    >>> restored = armrig.retrend(armrig.detrend(data))
    >>> np.allclose(restored.y, data.y)
    True
    """
    if not data.trends:
        done = "; ".join(data.history) or "no step"
        raise InputError(
            "there is no trend to restore: detrend was not applied to these data, or they were "
            f"filtered after detrend (history: {done}); keep the data from before the filter"
        )
    u_trend, y_trend = np.zeros(data.u.shape), np.zeros(data.y.shape)
    for trend, part, start in zip(data.trends, data.experiments(), data.starts, strict=True):
        t, rows = part.t - part.t[0], slice(start, start + part.N)
        u_trend[rows], y_trend[rows] = trend.u(t), trend.y(t)
    if y is None:
        return data.replaced(
            u=data.u + u_trend,
            y=data.y + y_trend,
            trends=(),
            step="restored the trend of u and y",
        )
    given = columns("y", y)
    if given.shape[0] != data.N:
        raise InputError(
            f"y has {given.shape[0]} samples and the data have {data.N}; give one for each instant"
        )
    if given.size != y_trend.size:
        raise InputError(
            f"y has {given.shape[1]} columns; give one for each of the "
            f"{y_trend.size // data.N} outputs"
        )
    return given.reshape(y_trend.shape) + y_trend


def _lines(t: Vector, x: Matrix, where: Mask, order: int) -> tuple[Vector, Vector]:
    """Return levels at t = 0 and slopes of the least-squares lines of the columns of x."""
    lines = [_line(t, *column, order) for column in zip(x.T, where.T, strict=True)]
    levels, slopes = np.array(lines).T
    return levels, slopes


def _line(t: Vector, x: Vector, where: Mask, order: int) -> tuple[float, float]:
    """Return level at t = 0 and slope of the least-squares line; (0, 0) without a valid sample."""
    if not where.any():
        return 0.0, 0.0
    if np.ptp(x[where]) == 0:  # exactly: a rounded mean would leave a small signal
        return float(x[where][0]), 0.0
    # With time measured from its mean, the estimates of level and slope are uncorrelated.
    middle = float(np.mean(t[where]))
    basis = orthonormal(np.vander(t[where] - middle, order + 1, increasing=True))
    coefficients = basis.coefficients(x[where])
    level, slope = float(coefficients[0]), float(coefficients[1]) if order == 1 else 0.0
    return level - slope * middle, slope
