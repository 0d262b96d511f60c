"""Means and straight lines in data: removal, restoration, and estimation of a drift."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TypeVar, overload

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.argument import takes_signals, treats_signals
from armrig.data.columns import Matrix, Vector, columns, constancy
from armrig.data.dataset import Dataset, Signals
from armrig.data.experiments import Trend
from armrig.data.step import LINE, MEAN, Step
from armrig.data.treatment.integrating import IntegratingOutputWarning, integrating
from armrig.data.treatment.level_change import level_change
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.quantities import digits, plural
from armrig.numerics.regressors import unique_whitening
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
    remove a line from an integrating output, such as an angle. Instead, use ``integrator=True``
    with raw data, or compute the rate with `difference` and remove its mean.

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
        (theta_1) or a test of the data decides whether the output integrates: see
        `armrig.data.treatment.integrating`.

    Raises
    ------
    ValueError
        order is neither 0 nor 1.

    Examples
    --------
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
    findings = [integrating(data, name) for name in data.outputs] if order == 1 else []
    evidence = " and ".join(x.text for x in findings if x)
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
    trend_name = "the mean" if order == 0 else "a straight line"
    each = "" if len(trends) == 1 else " of each experiment"
    despite = f", although {evidence}" if evidence else ""
    return data.replaced(
        u=u,
        y=y,
        trends=trends,
        step=Step(
            f"removed {trend_name} from u and y{each} (order {order}){despite}",
            LINE if order else MEAN,
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
    >>> import numpy as np
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
            u=data.u + u_trend, y=data.y + y_trend, trends=(), step="restored the trend of u and y"
        )
    outputs = columns("y", y)
    if outputs.shape[0] != data.N:
        raise InputError(
            f"y has {plural(outputs.shape[0], 'sample')} and the data have {data.N}; give one for "
            "each instant"
        )
    if outputs.size != y_trend.size:
        raise InputError(
            f"y has {plural(outputs.shape[1], 'column')}; give one for each of the "
            f"{plural(y_trend.size // data.N, 'output')}"
        )
    return outputs.reshape(y_trend.shape) + y_trend


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Straight-line drift of the output of one experiment, with its standard deviation."""

    rate: float
    """Slope, in `unit` per s."""
    std: float
    """Standard deviation of the slope, in `unit` per s."""
    seconds: float
    """Length of the experiment, in s."""
    unit: str
    """Unit of the output."""
    output: str = "y"
    """Name of the output."""
    change_s: float | None = None
    """Time in the experiment, in s, at which the level of the output changes for good, as by a
    load; the drift is then that of the longer part. None without such a change."""

    @property
    def z(self) -> float:
        """Rate divided by its standard deviation; |z| > 2.58 is significant at the 1 % level."""
        return self.rate / self.std if self.std > 0 else float("nan")

    def __str__(self) -> str:
        """Describe the drift in one line."""
        verdict = "a drift" if abs(self.z) > 2.58 else "no significant drift"
        if self.change_s is not None:
            change = f"the level of {self.output} changes at {self.change_s:g} s, as by a load"
            verdict = f"{change}; {verdict} in the longer part"
        return (
            f"{verdict}: {digits(self.rate, 3)} ± {digits(self.std, 2)} {self.unit or '1'}/s, "
            f"{f'{digits(self.rate * self.seconds, 3)} {self.unit}'.rstrip()} in {self.seconds:g} s"
        )


@takes_signals
def drift(data: Signals, order: int = 10, *, integrator: bool | None = None) -> tuple[Drift, ...]:
    """Estimate the drift of the output of each experiment, without the response to the input.

    For each output a model of high order, A(q) y(t) = B(q) u(t) + c + d t + e(t), is estimated by
    least squares. The drift of the output is d / A(1) per sample. A line through y
    alone would also contain the response to the input, and its standard deviation would ignore the
    colour of the noise.

    Parameters
    ----------
    data : Dataset or Signals
        N samples; equations that contain a missing sample are left out.
    order : int, default 10
        Order of A and B.
    integrator : bool, optional
        True if the output integrates. By default, the name of the output (theta_1) or a test of the
        data decides. On a short record the test can mistake a stable output for an integrator. If
        the output is known to be stable, give False.

    Returns
    -------
    tuple of Drift
        A drift for each experiment, first those of the first output.

    Raises
    ------
    ValueError
        The output integrates (its trend is then the response to the input), or there are too few
        samples.

    Examples
    --------
    The drift of the output is less than two standard deviations.

    >>> (found,) = armrig.drift(armrig.example_recording().dataset("alpha"))
    >>> print(f"{1e3 * found.rate:.2f} ± {1e3 * found.std:.2f} mrad/s")
    -0.02 ± 0.06 mrad/s
    """
    for name in data.outputs:
        finding = integrating(data, name) if integrator is None else None
        if finding or integrator:
            reason = finding.text if finding else f"{name} integrates, as integrator=True says"
            raise InputError(
                f"{reason}: its line is the response to the mean of u, not a drift; estimate the "
                "input's offset instead, oe(data, ..., integrator=True).free[0].offset"
            )
    return tuple(_drift_of(part, i, order) for i in range(data.ny) for part in data.experiments())


def _drift_of(part: Signals, i: int, n: int) -> Drift:
    """Return the drift of output i in an experiment."""
    y, count = part.y[:, i], int(np.count_nonzero(part.valid[:, i]))
    if text := constancy(part.outputs[i], y):
        raise InputError(text)
    needed = 4 * n + 10
    if count < needed:
        raise InputError(
            f"an experiment has {plural(count, 'sample')}; a drift estimate of order {n} "
            f"needs {needed}: lower the order"
        )
    model = unique_whitening([(part.u, y)], n, slope=True)
    change_s = None
    if model.rows >= needed - n and (at := level_change(part.u, y)) is not None:
        change_s = at * part.Ts
        longer = slice(at, None) if 2 * at < part.N else slice(0, at)
        part, y = part[longer], y[longer]
        model = unique_whitening([(part.u, y)], n, slope=True)
    if model.rows < needed - n:
        raise InputError(
            f"an experiment has {plural(model.rows, 'sample')} after {plural(n, 'sample')} without "
            f"a gap; a drift estimate of order {n} needs {needed - n}: lower the order"
        )
    Ts, gain = part.Ts, model.at_1
    if not gain or model.ambiguous:
        raise InputError(
            f"{part.outputs[i]} has no drift to estimate, because it is a ramp or has no noise: "
            "fit a line with detrend(..., order=1), or take a measured record"
        )
    rate = model.d / gain / Ts
    by_theta = np.zeros(len(model.covariance))
    by_theta[: model.A.size - 1], by_theta[-1] = -rate / gain, 1 / gain / Ts
    variance = float(by_theta @ model.covariance @ by_theta)
    return Drift(
        rate=rate,
        std=variance**0.5,
        seconds=part.N * Ts,
        unit=part.units[i],
        output=part.outputs[i],
        change_s=change_s,
    )
