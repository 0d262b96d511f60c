"""Treatment of data before identification; each step is written into the data's history."""

from __future__ import annotations

import warnings

import numpy as np

from armrig.dataset import Dataset, Mask, Vector
from armrig.least_squares import orthonormal
from armrig.polynomial import lagged

# Outputs that integrate by construction, whatever a test on a short record says.
INTEGRATING_OUTPUTS = frozenset({"theta_1"})

DICKEY_FULLER_TREND_5_PERCENT = -3.41  # Fuller 1976, table 8.5.2, constant and trend, n = inf
_TEST_LAGS = 5


class IntegratingOutputWarning(UserWarning):
    """A linear trend was removed from an output that integrates its input."""


def detrend(data: Dataset, order: int = 0) -> Dataset:
    """Return the data with mean (order 0) or straight line (order 1) removed from u and y.

    Each experiment loses its own, fitted to its valid samples by least squares.

    Parameters
    ----------
    data : Dataset
        N samples.
    order : {0, 1}
        Remove the mean, or the straight line.

    Returns
    -------
    Dataset
        N samples in the same units, the step written into `history`.

    Warns
    -----
    IntegratingOutputWarning
        order=1 on an output that integrates: the line is then the answer to the input's mean,
        not a drift, and the model is wrong without it.

    Raises
    ------
    ValueError
        order is neither 0 nor 1.
    """
    if order not in (0, 1):
        msg = f"order={order!r} must be 0 (remove the mean) or 1 (remove a straight line)"
        raise ValueError(msg)
    if order == 1 and (reason := integrating(data)):
        warnings.warn(
            f"detrend(order=1): {reason}, so its line is the answer to the mean of u and not a "
            "drift; keep it, and use order=0, oe(integrator=True) or difference(data)",
            IntegratingOutputWarning,
            stacklevel=2,
        )
    everywhere = np.ones(data.N, dtype=np.bool_)
    return data.replaced(
        u=_without_line(data, data.u, everywhere, order),
        y=_without_line(data, data.y, data.valid, order),
        step=f"detrend(order={order})",
    )


def difference(data: Dataset) -> Dataset:
    """Return the velocity (y(t) - y(t-1)) / Ts as output, u unchanged.

    It is missing where either neighbour is, and at the first sample of each experiment. A model
    of it has the orders of the position's without the integrator, and the same nk.

    Parameters
    ----------
    data : Dataset
        N samples, Ts in s.

    Returns
    -------
    Dataset
        N samples whose output is in y's unit per s: `velocity` for theta_1.
    """
    y = np.full(data.N, np.nan)
    y[1:] = np.diff(data.y) / data.Ts
    y[list(data.starts)] = np.nan
    return data.replaced(
        y=y,
        valid=np.isfinite(y),
        output="velocity" if data.output == "theta_1" else f"rate of {data.output}",
        unit=f"{data.unit}/s" if data.unit else "",
        step="difference",
    )


def integrating(data: Dataset) -> str:
    """Say why the output must be taken as integrating, "" where nothing speaks for it.

    An output that is known by name to integrate does. Another one is tested with the
    Dickey-Fuller regression with a trend, lags and the input as covariate ::

        y(t) - y(t-1) = c + d t + g y(t-1) + lags of the difference and of u + e(t)

    and taken as integrating where g is not significantly negative (5 %). The input lowers the
    critical value's magnitude (Hansen 1995), so the one used here errs towards a warning.

    References
    ----------
    .. [1] D. A. Dickey, W. A. Fuller, J. Amer. Statist. Assoc. 74 (1979) 427-431.
    .. [2] B. E. Hansen, Econometric Theory 11 (1995) 1148-1171.
    """
    if data.output in INTEGRATING_OUTPUTS:
        return f"{data.output} integrates its input"
    lags = range(1, _TEST_LAGS + 1)
    rows, targets = [], []
    for part in data.experiments():
        change = np.diff(part.y, prepend=np.nan)
        trend = np.column_stack([np.ones(part.N), np.arange(part.N) / max(part.N, 1)])
        columns = [lagged(part.y, [1]), trend, lagged(change, lags), lagged(part.u, lags)]
        rows.append(np.hstack(columns)[_TEST_LAGS + 1 :])
        targets.append(change[_TEST_LAGS + 1 :])
    Phi, target = np.vstack(rows), np.concatenate(targets)
    usable = np.isfinite(target) & np.isfinite(Phi).all(axis=1)
    Phi, target = Phi[usable], target[usable]
    basis = orthonormal(Phi)
    degrees = target.size - basis.rank
    if degrees < 10 or not basis.W[0].any():
        return ""  # too little to tell, or y is constant
    variance = float(np.sum(basis.without(target) ** 2)) / degrees
    g, std = basis.coefficients(target)[0], np.sqrt(variance * np.sum(basis.W[0] ** 2))
    if g < DICKEY_FULLER_TREND_5_PERCENT * std:
        return ""
    return f"{data.output} behaves as an integrating output (no pull back to its line is found)"


def _without_line(data: Dataset, x: Vector, where: Mask, order: int) -> Vector:
    treated = np.array(x)
    for a, b in zip(data.starts, (*data.starts[1:], data.N), strict=True):
        t = np.linspace(-1.0, 1.0, b - a)
        line = orthonormal(np.vander(t, order + 1, increasing=True)[where[a:b]])
        values = x[a:b][where[a:b]]
        treated[a:b][where[a:b]] = line.without(values)
    return treated
