"""Predictor of a model: the errors of data, their derivatives, and predictions h steps ahead.

The model is used in its innovations form ::

    x(t+1) = A x(t) + B u(t) + K e(t),    y(t) = C x(t) + D u(t) + e(t)

The predictor is x(t+1) = A x + B u + G(t) nu, nu = y - C x - D u. For complete data G is K. If an
output is missing, G is the gain of the Kalman filter (`armrig.numerics.kalman_gains`). The errors
nu are scaled, so that they have the covariance of e for the measured outputs.

The initial state, and a ramp of each integrating output, are estimated by least squares. With
`offset`, the level of each other output is estimated, too. The ramp or the level represents the
offset of the input. The errors of one channel are computed by filters: `armrig.models.innovations`.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 3.2 and 4.3.
.. [2] R. H. Jones, Technometrics 22 (1980) 389-395 (missing observations).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from armrig.data.dataset import Dataset, Signals
from armrig.models.innovations import errors, input_sum, prepare, regression
from armrig.models.innovations_filter import InnovationsFilter, innovations_filter
from armrig.models.prediction import require_same_signals, structure_of
from armrig.models.state_space import StateSpace
from armrig.models.structure import free_columns, transient_count
from armrig.models.structure_table import row_of
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.checks import require_integers
from armrig.numerics.covariance import colour_noise, whitening
from armrig.numerics.least_squares import column_norms, orthonormal
from armrig.numerics.polynomial import Array, apply_filter, impulse, lag_columns, without_integrator

if TYPE_CHECKING:
    from armrig.models.fit import Fit

_MIN_SINGULAR_VALUE = 1e-10  # least singular value of the responses, divided by the largest
_WHOLE_LEVERAGE = 1 - 1e-9  # leverage of a sample that the estimated initial state reproduces
_FORGOTTEN = 1e-9  # largest effect of a state that a predictor of finite memory has forgotten
_MOST_VALUES = 1 << 23  # values of the states that are computed at once
_MIN_VARIANCE_SHARE = 1e-12  # share of the largest variance below which a variance counts as 0
_MIN_STD = 1e-150  # its square is not 0
_MIN_EIGENVALUE = 1e-8  # least eigenvalue of the correlation of e


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Innovations:
    """Errors of one experiment from the estimated initial state and trends, and their effects."""

    filter: InnovationsFilter
    used: Array
    """Mask (N, ny) of the errors that are used."""
    u: Array
    """Inputs (N, nu)."""
    trend: Array
    """Estimated trend of the outputs, with the opposite sign, (N, ny)."""
    x: Array
    """States (N, n)."""
    nu: Array
    """Errors (N, ny), 0 where an output is missing."""
    free: Array
    """Responses of U nu to each unit initial state, and to each trend, (N, ny, q)."""


def innovations(model: Fit, part: Signals, system: StateSpace, Lambda: Array) -> Innovations | None:
    """Return the errors of one experiment; None if they exceed the range of numbers."""
    integrating = model.form.integrators
    at = [i for i, integrates in enumerate(integrating) if integrates or model.offset]
    n, N = system.order, part.N
    trends = np.zeros((N, len(at), part.ny))
    for k, i in enumerate(at):
        trends[:, k, i] = np.arange(1.0, N + 1.0) if integrating[i] else 1.0
    y, kalman = np.where(part.valid, part.y, 0.0), innovations_filter(system, Lambda, part.valid)
    free = np.empty((N, n + len(at), part.ny))
    few = max(_MOST_VALUES // (N * max(n, 1)), 1)  # columns at once, for the memory
    with np.errstate(over="ignore", invalid="ignore"):
        for begin in range(0, free.shape[1], few):
            some = np.arange(begin, min(begin + few, free.shape[1]))
            u, signals = np.zeros((N, some.size, part.nu)), np.zeros((N, some.size, part.ny))
            signals[:, some >= n] = trends[:, some[some >= n] - n]
            x = kalman.states(u, signals, np.eye(free.shape[1], n)[some])
            free[:, some] = kalman.whiten(kalman.innovations(x, u, signals))
        u, signals = part.u[:, None], y[:, None]
        x = kalman.states(u, signals, np.zeros((1, n)))
        white = kalman.whiten(kalman.innovations(x, u, signals))[:, 0]
    if not (np.isfinite(free).all() and np.isfinite(white).all()):
        return None
    used = part.valid & ~_first_of_differences(model, part.valid) if system.K.any() else part.valid
    free = free.transpose(0, 2, 1) * used[:, :, None]
    c = -_initial(free[used], white[used])
    trend = np.einsum("m,tmi->ti", c[n:], trends)
    signals = (y + trend)[:, None]
    x = kalman.states(u, signals, c[None, :n])
    nu = kalman.innovations(x, u, signals)[:, 0]
    return Innovations(filter=kalman, used=used, u=part.u, trend=trend, x=x[:, 0], nu=nu, free=free)


def _first_of_differences(model: Fit, rows: Array) -> Array:
    """Return the samples (N, ny) that only begin the differences of y, if A integrates."""
    first_samples = rows & (np.cumsum(rows, axis=0) == 1)
    F = getattr(model.form, "F", ((),) * model.ny)
    for i, integrates in enumerate(model.form.integrators):
        first_samples[:, i] &= integrates and all(f.size == 1 for f in F[i])
    return np.asarray(first_samples)


def _initial(responses: Array, errors: Array) -> Array:
    """Return least-squares coefficients of the responses, without undetermined combinations."""
    scale = np.maximum(column_norms(responses), 1e-100)
    U, s, V = np.linalg.svd(responses / scale, full_matrices=False)
    kept = s > _MIN_SINGULAR_VALUE * s[:1]
    return np.asarray(V[kept].T @ ((U.T @ errors)[kept] / s[kept])) / scale


def predictions(model: Fit, data: Dataset | Signals, horizon: int | None) -> Array:
    """Return ŷ, as `Fit.predict` documents.

    Raises ValueError if horizon is below 1, or the data differ from the model in signals, units or
    Ts.
    """
    require_same_signals(model, data)
    if horizon is not None:
        require_integers(horizon=(horizon, 1))
    if model.Ts == 0:
        return predictions(model.to_discrete(data.Ts), data, horizon)
    system, Lambda = model.form.innovations_form(), noise_covariance(model)
    system = system if horizon else system.deterministic
    if not system.K.any():  # the errors of a simulation are not e, and have other correlations
        Lambda = np.diag(np.diag(Lambda))
    parts = data.signals().experiments()
    if (model.ny, model.nu) != (1, 1):
        return np.concatenate([_predict(model, part, system, Lambda, horizon) for part in parts])
    if horizon is None or not system.K.any():
        return np.concatenate([_simulate(model, part.dataset()) for part in parts])
    return np.concatenate(
        [
            _ahead(model, part.dataset(), horizon)
            if part.valid.all()
            else _predict(model, part, system, Lambda, horizon)[:, 0]
            for part in parts
        ]
    )


def _simulate(model: Fit, part: Dataset) -> Array:
    """Return the simulated output of one channel (N,), from the least-squares initial state."""
    F, u = model.denominator, part.u
    if model.integrator:
        F, u = without_integrator(F), input_sum(u, centred=True)
    count = transient_count(
        numerator_degree=model.B.size - 1,
        denominator_degree=model.denominator.size - 1,
        integrator=model.integrator,
    )
    with np.errstate(over="ignore", invalid="ignore"):
        forced = apply_filter(model.B, F, u)
        columns = free_columns(F, part.N, count=count, drift=True)
        columns = columns[:, : count + (2 if model.integrator else int(model.offset))]
        if not (np.isfinite(forced).all() and np.isfinite(columns).all()):
            # The output of an unstable model exceeds the range of floating-point numbers.
            return np.full(part.N, np.inf)
    free = orthonormal(columns[part.valid])
    return np.asarray(forced + columns @ free.coefficients(part.y[part.valid] - forced[part.valid]))


def _ahead(model: Fit, part: Dataset, horizon: int) -> Array:
    """Return y (N,) of complete data, minus the effect of the errors of the last samples."""
    e, ahead = _of_channel(model, part).e[:, 0], min(horizon, part.N)
    h = apply_filter(model.C, np.convolve(model.A, model.D), impulse([1.0], ahead))
    return np.asarray(part.y - lag_columns(e, range(ahead)) @ h)


def _predict(
    model: Fit, part: Signals, system: StateSpace, Lambda: Array, horizon: int | None
) -> Array:
    r = innovations(model, part, system, Lambda)
    if r is None:
        return np.full(part.y.shape, np.inf)
    x, steps = r.x, min(horizon or 1, part.N) - 1
    for _ in range(steps):
        x = np.concatenate([x[:1], x[:-1] @ system.A.T + r.u[:-1] @ system.B.T])
    yhat = r.filter.outputs(x, r.u) - r.trend
    if not system.K.any():  # the past of y does not help to predict y
        return yhat
    # Before its first measured sample, hardly any data determine the state of an output.
    unknown = np.cumsum(part.valid, axis=0) == 0
    # Without C, the predictor has a finite memory. The initial state then reproduces the first
    # samples whatever their values are.
    late = system.C @ np.linalg.matrix_power(system.A - system.K @ system.C, system.order)
    forgets = np.max(np.abs(late), axis=1, initial=0.0) < _FORGOTTEN
    Q = orthonormal(stack_outputs(r.free)).Q
    leverage = np.sum(Q**2, axis=1).reshape(part.y.shape)
    lost = (forgets & (leverage > _WHOLE_LEVERAGE)) | (part.valid & ~r.used)
    for i, at in enumerate(lost.T):
        begin = int(np.flatnonzero(np.append(True, at))[-1])
        unknown[: begin + steps * (begin > 0), i] = True
    return np.where(unknown, np.nan, yhat)


def noise_covariance(model: Fit) -> Array:
    """Return the covariance of e that the predictor assumes; 1 for a model without noise.

    Outputs that were estimated one by one are also predicted one by one: their noise is taken as
    independent.
    """
    Lambda = model.noise_covariance
    if not (np.isfinite(Lambda).all() and Lambda.any()):
        return np.eye(len(Lambda))
    std = np.maximum(np.sqrt(np.diag(Lambda)), _MIN_STD)
    if not (model.shared or model.form.coupled or row_of(model.structure).equation_error):
        return np.diag(std**2)
    values, axes = np.linalg.eigh(Lambda / np.outer(std, std))
    inside = (axes * np.maximum(values, _MIN_EIGENVALUE)) @ axes.T
    return np.asarray(inside * np.outer(std, std))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictionErrors:
    """One-step errors of one experiment, and what their estimation took from them."""

    e: Array
    """Errors (N, ny), with the variance of e after a gap, too. NaN if y is missing, or if a sample
    that the predictor needs is not known."""
    S: Array
    """Basis of the responses of e to the unknown past and the trends, (N, ny, q): S^T W S = 1."""
    Psi: Array
    """Derivatives of the prediction with respect to p parameters, (N, ny, p). Their projection on S
    is subtracted."""
    G: Array
    """Weights (N, ny, ny): the estimator minimises the sum of |G(t) e(t)|². W is G^T G."""

    @property
    def known(self) -> Array:
        """True where there is an error, (N, ny)."""
        return np.isfinite(self.e)

    def weight(self, X: Array) -> Array:
        """Return W X (N, ny, k); one output has the weight 1."""
        if X.shape[1] == 1:
            return X
        return np.asarray(self.G.transpose(0, 2, 1) @ (self.G @ X))


def prediction_errors(
    model: Fit, data: Dataset | Signals, *, on_own_data: bool = False
) -> list[PredictionErrors]:
    """Return the errors of each experiment, with derivatives by the parameters of `parameters_of`.

    On the estimation data (`on_own_data`) the outputs have the weights of the estimator.
    """
    if (model.ny, model.nu) == (1, 1):
        return [_of_channel(model, part) for part in data.signals().dataset().experiments()]
    Lambda = noise_covariance(model)
    if on_own_data and model.output_weights:
        Lambda = np.diag(1 / np.asarray(model.output_weights))
    system, by = model.form.innovations_form(), realisation_derivatives(model, directions(model))
    return [_of_outputs(model, part, system, by, Lambda) for part in data.signals().experiments()]


def parameters_of(model: Fit) -> Array:
    """Return J: the parameters of the derivatives in `prediction_errors` are J theta.

    For one channel an integrator is divided out of F or A. For several signals the parameters are
    coordinates in `directions`.
    """
    if (model.ny, model.nu) != (1, 1):
        return np.linalg.pinv(directions(model))
    J = np.eye(model.theta.size)
    if not model.integrator:
        return J
    part = model.slice_of(model.integrating)
    if model.Ts == 0:  # the coefficient that is 0
        return np.delete(J, part.stop - 1, axis=0)
    # f̃_k = f_1 + … + f_k undoes f_k = f̃_k - f̃_(k-1).
    J[part, part] = np.tri(part.stop - part.start)
    return np.delete(J, part.stop - 1, axis=0)


def directions(model: Fit) -> Array:
    """Return independent directions of theta, (d, p), with std 1; cov theta may be singular."""
    scale = np.sqrt(np.maximum(np.diag(model.covariance_robust), 1e-300))
    values, axes = np.linalg.eigh(model.covariance_robust / np.outer(scale, scale))
    kept = values > _MIN_VARIANCE_SHARE * values[-1]
    return np.asarray(scale[:, None] * axes[:, kept] * np.sqrt(values[kept]))


def realisation_derivatives(model: Fit, along: Array) -> dict[str, Array]:
    """Return the derivatives of A, B, C, D and K in the directions `along` (d, p) of theta.

    The matrices are linear or quadratic in each parameter alone, so that a central difference is
    exact for any step.
    """
    theta, derivatives = model.theta, {}
    pairs = [
        [model.form.replaced(theta + step).innovations_form() for step in (unit, -unit)]
        for unit in np.eye(theta.size)
    ]
    for name in "ABCDK":
        by = np.array([getattr(a, name) - getattr(b, name) for a, b in pairs]) / 2
        derivatives[name] = np.tensordot(along.T, by, axes=1)
    return derivatives


def _of_outputs(
    model: Fit, part: Signals, system: StateSpace, by: dict[str, Array], Lambda: Array
) -> PredictionErrors:
    r = innovations(model, part, system, Lambda)
    G = whitening(Lambda, part.valid)
    p = len(by["A"])
    if r is None:
        none = np.zeros((*part.y.shape, p))
        return PredictionErrors(e=np.full(part.y.shape, np.nan), S=none[:, :, :0], Psi=none, G=G)
    kalman = r.filter
    e = colour_noise(part.valid, kalman.whiten(r.nu[:, None]).swapaxes(1, 2), Lambda)[:, :, 0]
    slopes, _ = kalman.derivatives(by, r.x, r.u, r.nu)
    basis = orthonormal(stack_outputs(r.free))
    Psi = -stack_outputs(slopes.swapaxes(1, 2) * r.used[:, :, None])
    Psi = (Psi - basis.Q @ (basis.Q.T @ Psi)).reshape(*part.y.shape, p)
    S = basis.Q.reshape(*part.y.shape, -1)
    return PredictionErrors(
        e=np.where(r.used, e, np.nan),
        S=colour_noise(part.valid, S, Lambda),
        Psi=colour_noise(part.valid, Psi, Lambda),
        G=G,
    )


def stack_outputs(X: Array) -> Array:
    """Return X (N, ny, k) as a matrix (N ny, k)."""
    return X.reshape(-1, X.shape[2])


def _of_channel(model: Fit, part: Dataset) -> PredictionErrors:
    if isinstance(model.form, TransferFunction):
        sampled, J = model.form.sampled(part.Ts)
        sampled_errors = _of_channel(model.to_discrete(part.Ts), part)
        if model.integrator:  # f̃_k = f_1 + … + f_k
            of_f = sampled.slice_of("f", 0, 0)
            J[of_f] = np.cumsum(J[of_f], axis=0)
            J = np.delete(np.delete(J, of_f.stop - 1, axis=0), model.slice_of("f").stop - 1, axis=1)
        return replace(sampled_errors, Psi=sampled_errors.Psi @ J)
    structure = structure_of(model)
    p = {letter: getattr(model, letter) for letter in "ABCDF"}
    if model.integrating:
        p[model.integrating.upper()] = without_integrator(p[model.integrating.upper()])
    experiment = prepare(part.u, part.y, structure)
    with np.errstate(over="ignore", invalid="ignore"):
        C, D, F = p["C"], p["D"], p["F"]
        if not np.isfinite(apply_filter(np.convolve(D, model.B), np.convolve(C, F), part.u)).all():
            # The output of an unstable predictor overflows.
            none = np.zeros((part.N, 1, model.parameters))
            e, G = np.full((part.N, 1), np.nan), np.zeros((part.N, 1, 1))
            return PredictionErrors(e=e, S=none[:, :, :0], Psi=none, G=G)
        linear = regression(experiment, structure, A=p["A"], C=C, D=D, F=[F], innovations=True)
        solution = errors(experiment, structure, linear, A=p["A"], B=[p["B"]], C=C, D=D, F=[F])
    by_a, others = np.split(solution.Psi, [structure.na], axis=1)
    Psi = linear.unknown.without(np.hstack([by_a, linear.X, others]))
    return PredictionErrors(
        e=np.where(experiment.rows, solution.e, np.nan)[:, None],
        S=linear.unknown.span[:, None],
        Psi=Psi[:, None],
        G=experiment.rows[:, None, None].astype(np.float64),
    )
