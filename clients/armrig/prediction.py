"""What a model says of measured data: simulation, prediction, residuals and their sensitivity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from armrig.dataset import Dataset, Mask, Vector
from armrig.free_response import free_columns, transient_count
from armrig.least_squares import Basis, orthonormal
from armrig.polynomial import Array, filtered, lagged, without_integrator
from armrig.sensitivity import by_denominator, by_numerator

if TYPE_CHECKING:
    from armrig.fit import Fit


@dataclass(frozen=True, slots=True, kw_only=True)
class ArxRegression:
    """One experiment as y = Phi theta + e."""

    Phi: Array
    """(N, na + nb)."""
    y: Array
    """(N,)."""
    usable: Mask
    """(N,), False where a regressor or y is missing or lies before the start."""


def arx_regression(part: Dataset, *, na: int, nb: int, nk: int) -> ArxRegression:
    """Return the regressors [-y(t-1) … -y(t-na) u(t-nk) … u(t-nk-nb+1)] of one experiment."""
    past = [-lagged(part.y, range(1, na + 1)), lagged(part.u, range(nk, nk + nb))]
    Phi = np.hstack(past)
    usable = part.valid & np.isfinite(Phi).all(axis=1)
    usable[: max(na, nb + nk - 1)] = False
    return ArxRegression(Phi=Phi, y=part.y, usable=usable)


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """One experiment simulated from the initial state that fits it best."""

    y: Array
    """Model output (N,)."""
    forced: Array
    """Part of it (N,) that went through the denominator."""
    u: Array
    """Input (N,) of B/F, summed where there is an integrator."""
    F: Array
    """Denominator without the integrator."""
    free: Basis
    """Basis of the free response in the valid rows."""


def summed_input(u: Array, *, centred: bool) -> Array:
    """Return U with B/F u = B/F̃ U for F = (1 - q^-1) F̃; centred where a ramp is free anyway."""
    return np.cumsum(u - np.mean(u)) if centred else np.cumsum(u)


def simulated(fit: Fit, part: Dataset) -> Simulation:
    """Simulate one experiment, its initial state estimated by least squares.

    With an integrator the input's offset is estimated too: data that were detrended, and data
    that were not, are then judged alike.
    """
    F, u = fit.denominator, part.u
    if fit.integrator:
        F, u = without_integrator(F), summed_input(u, centred=True)
    count = transient_count(
        numerator_degree=fit.B.size - 1,
        denominator_degree=fit.denominator.size - 1,
        integrator=fit.integrator,
    )
    with np.errstate(over="ignore", invalid="ignore"):
        forced = filtered(fit.B, F, u)
        columns = free_columns(F, part.N, count=count, drift=fit.integrator)
        if not (np.isfinite(forced).all() and np.isfinite(columns).all()):
            # An unstable model's output leaves the range of floating point.
            columns, forced = np.zeros((part.N, 0)), np.full(part.N, np.inf)
    free = orthonormal(columns[part.valid])
    x = free.coefficients(part.y[part.valid] - forced[part.valid])
    return Simulation(
        y=forced + columns @ x, forced=forced + columns[:, :count] @ x[:count], u=u, F=F, free=free
    )


def predicted(fit: Fit, data: Dataset, horizon: int | None) -> Vector:
    """Return ŷ (N,), see `Fit.predict`.

    Raises
    ------
    ValueError
        horizon is below 1, or output, unit or Ts of the data are not the model's.
    """
    require_same_signals(fit, data)
    if horizon is not None and horizon < 1:
        msg = f"horizon={horizon!r} must be >= 1, or None for simulation"
        raise ValueError(msg)
    parts = data.experiments()
    if horizon is None or fit.A.size == 1:
        return np.concatenate([simulated(fit, part).y for part in parts])
    return np.concatenate([_arx_predicted(fit, part, horizon) for part in parts])


def _arx_predicted(fit: Fit, part: Dataset, horizon: int) -> Vector:
    past = _known_past(fit, part)
    driven = filtered(fit.B, [1.0], part.u)
    driven[: fit.B.size - 1] = np.nan
    N, k = part.N, min(horizon, part.N)
    y = np.full(N, np.nan)
    ahead = past[: N - k + 1]
    now = np.zeros(0)
    for i in range(k):
        now = driven[i : N - k + 1 + i] - ahead @ fit.A[1:]
        ahead = np.column_stack([now, ahead[:, :-1]])
    y[k - 1 :] = now
    return y


def _known_past(fit: Fit, part: Dataset) -> Array:
    """Return E[y(t-1) … y(t-na) | data to t-1], (N, na), NaN before the first complete stretch.

    Where all were measured that is what was measured. Across a gap a Kalman filter goes on from
    the last complete stretch, and skips the update where y is missing.
    """
    na = fit.A.size - 1
    a = fit.A[1:]
    past = lagged(part.y, range(1, na + 1))
    past[:na] = np.nan
    complete = np.asarray(np.isfinite(past).all(axis=1))
    driven = filtered(fit.B, [1.0], part.u)
    shift = np.vstack([-a, np.eye(na - 1, na)])
    P = np.zeros((na, na))
    for t in np.flatnonzero(~complete):
        if t == 0 or not np.isfinite(past[t - 1]).all():
            continue
        P = np.zeros((na, na)) if complete[t - 1] else P
        x = shift @ past[t - 1]
        x[0] += driven[t - 1]
        P = shift @ P @ shift.T
        P[0, 0] += 1.0  # in units of the noise variance, which the gain does not depend on
        if part.valid[t - 1]:
            gain = P[:, 0] / P[0, 0]
            x = x + gain * (part.y[t - 1] - x[0])
            P = P - np.outer(gain, P[0])
        past[t] = x
    return past


@dataclass(frozen=True, slots=True, kw_only=True)
class Residuals:
    """One experiment's one-step prediction errors and how they depend on the model."""

    e: Vector
    """(N,), NaN where y or the past it needs is missing."""
    Psi: Array
    """(N, d), derivatives of the prediction by the free parameters, less their projection on the
    free response; zero where e is NaN."""
    free: Basis
    """Basis of the free response in the rows where e is known."""

    @property
    def span(self) -> Array:
        """The basis in all rows, (N, r), zero where e is NaN."""
        return spread(self.free.Q, np.isfinite(self.e))


def prediction_errors(fit: Fit, part: Dataset) -> Residuals:
    """Return the residuals of one experiment. Only complete regressions count for ARX."""
    if fit.A.size > 1:
        n = fit.orders
        regression = arx_regression(part, na=n["na"], nb=n["nb"], nk=fit.nk)
        rows, Psi = regression.usable, regression.Phi
        e = np.where(rows, part.y - Psi @ fit.theta, np.nan)
        free = orthonormal(np.zeros((int(np.count_nonzero(rows)), 0)))
    else:
        sim = simulated(fit, part)
        e, rows, free = part.y - sim.y, part.valid, sim.free
        by_b = by_numerator(sim.u, sim.F, range(fit.nk, fit.B.size))
        Psi = np.hstack([by_b, by_denominator(sim.forced, sim.F, sim.F.size - 1)])
    return Residuals(e=e, Psi=spread(free.without(Psi[rows]), rows), free=free)


def spread(known: Array, rows: Mask) -> Array:
    """Return the known rows in their places, zero in the others."""
    whole = np.zeros((rows.size, known.shape[1]))
    whole[rows] = known
    return whole


def require_same_signals(fit: Fit, data: Dataset) -> None:
    """Refuse data of another output than the model's, or sampled at another rate.

    Nothing is refused for a name or a unit that is not given; an output named y is not.
    """
    if not np.isclose(fit.Ts, data.Ts, rtol=1e-9, atol=0.0):
        msg = f"the model has Ts={fit.Ts:g} s and the data have Ts={data.Ts:g} s; "
        msg += "identify at the rate that you validate at"
        raise ValueError(msg)
    names = {fit.output, data.output} - {"", "y"}
    units = {fit.unit, data.unit} - {""}
    if len(names) > 1 or len(units) > 1:
        of_model, of_data = (f"{x.output} [{x.unit or '–'}]" for x in (fit, data))
        msg = f"the model is of {of_model} and the data show {of_data}; validate with the output "
        msg += f"that was identified from, recording.dataset(output={fit.output!r})"
        raise ValueError(msg)
