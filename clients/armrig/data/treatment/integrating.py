"""Detection of outputs that integrate their input; the trend of such an output is not a drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core import telemetry
from armrig_core.telemetry import THETA_1

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.finding import Finding, warning
from armrig.data.treatment.channelwise import channelwise
from armrig.data.trend import Trend
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.regressors import complete, past

# Outputs that integrate by construction, whatever the result of a test on a short record.
INTEGRATING_OUTPUTS = frozenset({THETA_1})

DICKEY_FULLER_TREND_5_PERCENT = -3.41  # Fuller 1976, table 8.5.2, constant and trend, n = inf
_TEST_LAGS = 5
# The test must be able to detect a return to the trend line by this share of the distance per
# sample. Otherwise the data are too few for the test.
MIN_SEEN_PULL = 0.2


class IntegratingOutputWarning(UserWarning):
    """A linear trend was removed from an output that integrates its input."""


def integrating(data: Dataset) -> Finding | None:
    """Return the evidence that the output integrates; None without evidence.

    An output whose name is in `INTEGRATING_OUTPUTS` integrates. Any other output is tested with a
    Dickey-Fuller regression, which contains a trend, lags, and the input as covariate ::

        y(t) - y(t-1) = c + d t + g y(t-1) + lags of the difference and of u + e(t)

    The output integrates if g is not significantly negative at the 5 % level. With the input as
    covariate, the exact critical value is smaller in magnitude (Hansen 1995). The critical value
    without covariates, used here, therefore favours an integrator.

    If the data are too few for this test, the result is None. The data are too few if fewer than 10
    degrees of freedom remain, or if g = -0.2 would not be significant. With g = -0.2, the distance
    of the output from its trend line decreases by 20 % per sample.

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
        return None  # too few rows, or y is constant
    variance = float(np.sum(basis.without(target) ** 2)) / degrees
    g, std = basis.coefficients(target)[0], np.sqrt(variance * np.sum(basis.W[0] ** 2))
    limit = DICKEY_FULLER_TREND_5_PERCENT * std
    if g < limit or limit < -MIN_SEEN_PULL:
        return None
    text = f"{data.output} behaves as an integrating output (no return to a trend line is visible)"
    return warning("integrator", text, pull=float(g), std=float(std))


# Rate of an output, such as an angle's velocity.


def rate_name(output: str) -> str:
    """Return the name of the rate of an output."""
    rates = {channel.name: channel.rate for channel in telemetry.CHANNELS}
    return rates.get(output) or f"rate of {output}"


@channelwise
@takes_recordings
def difference(data: Dataset) -> Dataset:
    """Return data with the velocity (y(t) - y(t-1)) / Ts as output; u is unchanged.

    The velocity is missing if one of the two samples is missing, and at the first sample of each
    experiment. A model of the velocity has the same nk as a model of the position, and
    one pole less, because it has no integrator.

    Parameters
    ----------
    data : Dataset
        N samples, Ts in s.

    Returns
    -------
    Dataset
        N samples whose output is the rate of y, in y's unit per s; the rate of theta_1 is named
        `velocity`.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.difference(armrig.example_recording().dataset("theta_1"))
    >>> data.output, data.unit
    ('velocity', 'rad/s')
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Integration:
    """Decision whether an output is taken as integrating, with the reason for the decision."""

    integrates: bool
    """True if the model treats y as the integral of its rate."""
    reason: str = ""
    """Evidence from the unit root test; "" if the test finds no integrator or is not needed."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the result, with the evidence from the test; () without evidence."""
        if not self.reason:
            return ()
        what = "taken as integrating (in Python integrator=False prevents this)"
        return (f"{self.reason}: {what}",)


def integration(data: Dataset, integrator: bool | None) -> Integration:
    """Decide whether the output is taken as integrating.

    If `integrator` is given, its value is the decision. Otherwise an output integrates if its name
    is theta_1, or if the unit root test of `integrating` finds an integrator. In this last case,
    the notes report the result of the test.
    """
    if integrator is not None:
        return Integration(integrates=integrator)
    if data.output in INTEGRATING_OUTPUTS:
        return Integration(integrates=True)
    found = integrating(data)
    return Integration(integrates=found is not None, reason=found.text if found else "")
