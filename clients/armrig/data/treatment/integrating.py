"""Detection of outputs that integrate their input; the trend of such an output is not a drift."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from armrig_core.telemetry import telemetry
from armrig_core.telemetry.telemetry import THETA_1

from armrig.data.argument import treats_signals
from armrig.data.columns import Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.experiments import Trend
from armrig.data.finding import Finding, warning
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.regressors import complete, past
from armrig.numerics.stretches import Mask, pieces

# Outputs that integrate by construction, whatever the result of a test on a short record.
INTEGRATING_OUTPUTS = frozenset({THETA_1})

DICKEY_FULLER_TREND_5_PERCENT = -3.41  # Fuller 1976, table 8.5.2, constant and trend, n = inf
_TEST_LAGS = 5
# The test must be able to detect a return to the trend line by this share of the distance per
# sample. Otherwise the data are too few for the test.
MIN_SEEN_PULL = 0.2
_MIN_HOLD_SAMPLES = 8  # least length of a hold of u before and after a step
_MIN_END_SAMPLES = 4  # least number of known samples at the end of a hold
_MAX_REST_SHARE = 0.25  # of an integrator's change of level, at least 0.4 is in the last third


class IntegratingOutputWarning(UserWarning):
    """A linear trend was removed from an output that integrates its input."""


def integrating(data: Dataset | Signals, output: str | None = None) -> Finding | None:
    """Return the evidence that an output integrates; None without evidence.

    An output whose name is in `INTEGRATING_OUTPUTS` integrates. Any other output is tested with a
    Dickey-Fuller regression, which contains a trend, lags, and the inputs as covariates ::

        y(t) - y(t-1) = c + d t + g y(t-1) + lags of the difference and of u + e(t)

    The output integrates if g is not significantly negative at the 5 % level. With inputs as
    covariates, the exact critical value is smaller in magnitude (Hansen 1995). The critical value
    without covariates, used here, therefore favours an integrator.

    If the data are too few for this test, the result is None. The data are too few if fewer than 10
    degrees of freedom remain, or if g = -0.2 would not be significant. With g = -0.2, the distance
    of the output from its trend line decreases by 20 % per sample. The result is also None if the
    output rests at different values of u (`_rests`).

    References
    ----------
    .. [1] D. A. Dickey, W. A. Fuller, J. Amer. Statist. Assoc. 74 (1979) 427-431.
    .. [2] B. E. Hansen, Econometric Theory 11 (1995) 1148-1171.
    """
    signals = data.signals()
    i = signals.output(output)
    name = signals.outputs[i]
    if name in INTEGRATING_OUTPUTS:
        return warning("integrator", f"{name} integrates its input")
    lags = range(1, _TEST_LAGS + 1)
    rows, targets = [], []
    for part in signals.experiments():
        y = part.y[:, i]
        change = np.diff(y, prepend=np.nan)
        trend = np.column_stack([np.ones(part.N), np.arange(part.N) / max(part.N, 1)])
        inputs = [past(u, lags) for u in part.u.T]
        Phi = np.hstack([past(y, [1]), trend, past(change, lags), *inputs])
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
    if g < limit or limit < -MIN_SEEN_PULL or _rests(signals, i):
        return None
    text = f"{name} behaves as an integrating output (no return to a trend line is visible)"
    return warning("integrator", text, pull=float(g), std=float(std))


def _rests(data: Signals, i: int) -> bool:
    """Return whether y moves from rest to rest at the long steps of u, which refutes an integrator.

    The change of output i in the last third of a hold of all inputs is compared with the change of
    its level from hold to hold. For an integrator, the ratio is 0.4 or more. One standard deviation
    is added to each change, and the ratio is computed from the sums over all steps.
    """
    steps = []
    for part in data.experiments():
        for holds in pairwise(pieces(np.any(np.diff(part.u, axis=0), axis=1))):
            ends = [_end_of_hold(part.y[s, i], part.valid[s, i]) for s in holds]
            length = min(s.stop - s.start for s in holds)
            if length >= _MIN_HOLD_SAMPLES:
                steps.append((length, abs(ends[1][0] - ends[0][0]), ends[0][1] + ends[1][1]))
    longest = max((n for n, _, _ in steps), default=0)
    used = [(moved, drifted) for n, moved, drifted in steps if 2 * n >= longest]
    moved, drifted = np.sum(used, axis=0) if used else (0.0, np.inf)
    return bool(drifted < _MAX_REST_SHARE * moved)


def _end_of_hold(y: Vector, valid: Mask) -> tuple[float, float]:
    """Return the level of the last third of a hold, and the likely change of y there."""
    n = max(y.size // 3, _MIN_END_SAMPLES)
    known = np.flatnonzero(valid[-n:])
    if known.size < _MIN_END_SAMPLES:
        return 0.0, np.inf
    y = y[-n:][known]
    x = (known - known.mean()) / n
    slope = float(x @ y) / float(x @ x)
    std = float(np.std(y - slope * x, ddof=2)) / float(np.linalg.norm(x))
    return float(y.mean()), abs(slope) + std


# Rate of an output, such as an angle's velocity.


def rate_name(output: str) -> str:
    """Return the name of the rate of an output."""
    rates = {channel.name: channel.rate for channel in telemetry.CHANNELS}
    return rates.get(output) or f"rate of {output}"


@treats_signals
def difference(data: Signals) -> Signals:
    """Return data with the velocities (y(t) - y(t-1)) / Ts as outputs; u is unchanged.

    The velocity is missing if one of the two samples is missing, and at the first sample of each
    experiment. A model of the velocity has the same nk as a model of the position, and
    one pole less, because it has no integrator.

    Parameters
    ----------
    data : Dataset or Signals
        N samples, Ts in s.

    Returns
    -------
    Dataset or Signals
        N samples whose outputs are the rates of y, in y's unit per s; the rate of theta_1 is named
        `velocity`.

    Examples
    --------
    >>> data = armrig.difference(armrig.example_recording().dataset("theta_1"))
    >>> data.output, data.unit
    ('velocity', 'rad/s')
    """
    Ts, y = data.equidistant(), np.full(data.y.shape, np.nan)
    y[1:] = np.diff(data.y, axis=0) / Ts
    y[list(data.starts)] = np.nan
    names = [rate_name(output) for output in data.outputs]
    each = f"output{'s' * (data.ny > 1)} {', '.join(map(repr, names))}"
    return data.replaced(
        y=y,
        valid=np.isfinite(y),
        outputs=names,
        units=[f"{unit}/s" if unit else "" for unit in data.units],
        trends=[
            Trend(u_level=t.u_level, u_slope=t.u_slope, y_level=t.y_slope) for t in data.trends
        ],
        step=f"took differences of {', '.join(data.outputs)} over Ts={Ts:g} s as the {each}",
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
        what = "taken as integrating (--assume settling, in Python integrator=False, changes this)"
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
