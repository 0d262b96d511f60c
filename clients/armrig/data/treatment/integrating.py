"""Whether an output integrates its input, so that its line is no drift."""

from __future__ import annotations

import numpy as np
from armrig_core import telemetry
from armrig_core.telemetry import THETA_1

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.finding import Finding, warning
from armrig.data.trend import Trend
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.regressors import complete, past

# Outputs that integrate by construction, whatever a test on a short record says.
INTEGRATING_OUTPUTS = frozenset({THETA_1})

DICKEY_FULLER_TREND_5_PERCENT = -3.41  # Fuller 1976, table 8.5.2, constant and trend, n = inf
_TEST_LAGS = 5
_SEEN = 0.2  # pull back in a sample, as a share of the distance, that must be seen if there is one


class IntegratingOutputWarning(UserWarning):
    """A linear trend was removed from an output that integrates its input."""


def integrating(data: Dataset) -> Finding | None:
    """Return why the output must be taken as integrating, None where nothing speaks for it.

    An output that is known by name to integrate does. Another one is tested with the
    Dickey-Fuller regression with a trend, lags and the input as covariate ::

        y(t) - y(t-1) = c + d t + g y(t-1) + lags of the difference and of u + e(t)

    and taken as integrating where g is not significantly negative (5 %). The input lowers the
    critical value's magnitude (Hansen 1995), so the one used here errs towards an
    integrator. Nothing is said where too few rows are without a hole to see a pull back of a fifth
    of the distance in a sample.

    References
    ----------
    .. [1] D. A. Dickey, W. A. Fuller, J. Amer. Statist. Assoc. 74 (1979) 427-431.
    .. [2] B. E. Hansen, Econometric Theory 11 (1995) 1148-1171.
    """
    if data.output in INTEGRATING_OUTPUTS:
        return warning("integrator", f"{data.output} integrates its input")
    lags = range(1, _TEST_LAGS + 1)
    rows, targets = [], []
    for part in data.experiments():
        change = np.diff(part.y, prepend=np.nan)
        trend = np.column_stack([np.ones(part.N), np.arange(part.N) / max(part.N, 1)])
        Phi = np.hstack([past(part.y, [1]), trend, past(change, lags), past(part.u, lags)])
        usable = complete(Phi, change)
        rows.append(Phi[usable])
        targets.append(change[usable])
    target = np.concatenate(targets)
    basis = orthonormal(np.vstack(rows))
    degrees = target.size - basis.rank
    if degrees < 10 or not basis.W[0].any():
        return None  # too little to tell, or y is constant
    variance = float(np.sum(basis.without(target) ** 2)) / degrees
    g, std = basis.coefficients(target)[0], np.sqrt(variance * np.sum(basis.W[0] ** 2))
    if g < DICKEY_FULLER_TREND_5_PERCENT * std or DICKEY_FULLER_TREND_5_PERCENT * std < -_SEEN:
        return None
    text = f"{data.output} behaves as an integrating output (no pull back to its line is found)"
    return warning("integrator", text, pull=float(g), std=float(std))


# The rate of an output: an angle's velocity.


def rate_name(output: str) -> str:
    """Return the name of the rate of an output."""
    rates = {channel.name: channel.rate for channel in telemetry.CHANNELS}
    return rates.get(output) or f"rate of {output}"


@takes_recordings
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
    name = rate_name(data.output)
    return data.replaced(
        y=y,
        valid=np.isfinite(y),
        output=name,
        unit=f"{data.unit}/s" if data.unit else "",
        trends=tuple(
            Trend(u_level=t.u_level, u_slope=t.u_slope, y_level=t.y_slope) for t in data.trends
        ),
        step=f"took differences of {data.output} over Ts={data.Ts:g} s as the output {name!r}",
    )
