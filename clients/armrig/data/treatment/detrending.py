"""Removal of means and straight lines from data, and their restoration."""

from __future__ import annotations

import warnings
from typing import overload

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, Vector
from armrig.data.step import LINE, MEAN, Step
from armrig.data.treatment.channelwise import channelwise
from armrig.data.treatment.integrating import IntegratingOutputWarning, integrating
from armrig.data.trend import Trend
from armrig.numerics.checks import column
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.stretches import Mask


@channelwise
@takes_recordings
def detrend(data: Dataset, order: int = 0) -> Dataset:
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
    data : Dataset
        N samples.
    order : {0, 1}
        0 removes the mean, 1 removes a straight line.

    Returns
    -------
    Dataset
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
    found = integrating(data) if order == 1 else None
    if found:
        warnings.warn(
            f"detrend(order=1): {found.text}, so its line is the response to the mean of u and not "
            "a drift; keep the line, and use order=0, oe(integrator=True) or difference(data)",
            IntegratingOutputWarning,
            stacklevel=2,
        )
    u, y, trends = data.u.copy(), data.y.copy(), []
    for k, part in enumerate(data.experiments()):
        t = part.t
        u_line = _line(t, part.u, np.ones(part.N, dtype=np.bool_), order)
        y_line = _line(t, part.y, part.valid, order)
        removed = Trend(u_level=u_line[0], u_slope=u_line[1], y_level=y_line[0], y_slope=y_line[1])
        rows = slice(data.starts[k], data.starts[k] + part.N)
        u[rows] -= removed.u(t)
        y[rows] -= removed.y(t)
        trends.append(data.trends[k] + removed if data.trends else removed)
    what = "the mean" if order == 0 else "a straight line"
    each = "" if len(trends) == 1 else " of each experiment"
    despite = f", although {found.text}" if found else ""
    return data.replaced(
        u=u,
        y=y,
        trends=tuple(trends),
        step=Step(
            f"removed {what} from u and y{each} (order {order}){despite}", LINE if order else MEAN
        ),
    )


@overload
def retrend(data: Dataset) -> Dataset: ...
@overload
def retrend(data: Dataset, y: ArrayLike) -> Vector: ...
def retrend(data: Dataset, y: ArrayLike | None = None) -> Dataset | Vector:
    """Return the data, or an output that a model computed from them, with the trend restored.

    Parameters
    ----------
    data : Dataset
        N samples treated by `detrend`, or slices, parts or merges of such data. Their `trends`
        still store what was removed.
    y : array_like, shape (N,), optional
        An output simulated or predicted from these data, in y's unit.

    Returns
    -------
    Dataset or ndarray, shape (N,)
        The data with the trend restored; if `y` is given, `y` plus the trend of the output.

    Raises
    ------
    ValueError
        No trend was removed from these data, the data were filtered after `detrend`, or y does not
        have the shape (N,).

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
    u_trend, y_trend = np.zeros(data.N), np.zeros(data.N)
    for trend, part, start in zip(data.trends, data.experiments(), data.starts, strict=True):
        u_trend[start : start + part.N] = trend.u(part.t)
        y_trend[start : start + part.N] = trend.y(part.t)
    if y is None:
        return data.replaced(
            u=data.u + u_trend,
            y=data.y + y_trend,
            trends=(),
            step="restored the trend of u and y",
        )
    given = column("y", y)
    if given.size != data.N:
        raise InputError(
            f"y has {given.size} samples and the data have {data.N}; give one for each instant"
        )
    return given + y_trend


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
