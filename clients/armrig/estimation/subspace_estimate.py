"""Estimate of all matrices of a state-space model from projections, for signals with gaps, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.estimation.problem import UnitCircle
from armrig.estimation.stability import stabilise
from armrig.estimation.start_values import noise_start
from armrig.estimation.state_space_gaps import filter_parts, scale_part_errors
from armrig.estimation.state_space_problem import StateSpaceProblem, directions, parts_of
from armrig.estimation.state_space_responses import Predictor, ScaledExperiment
from armrig.estimation.subspace import Parts, order_by_mdl, projection, visible_states
from armrig.estimation.subspace_horizon import (
    MIN_HORIZON,
    InnovationsForm,
    best_innovations,
    companion,
    innovations_at,
    usable_windows,
)
from armrig.models.innovations import interpolate
from armrig.models.structure_table import Weights
from armrig.numerics.covariance import pairwise_covariance, patterns
from armrig.numerics.least_squares import Basis
from armrig.numerics.levenberg_marquardt import levenberg_marquardt
from armrig.numerics.polynomial import (
    Array,
    apply_filter,
    reflect_roots,
    without_integrator,
)
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import stretches

_MAX_SUGGESTED_ORDER = 10
MAX_PASSES = 20
"""Largest number of times that missing outputs are estimated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SubspaceOptions:
    """Options of the estimate."""

    direct: bool
    order: int | None = None
    weights: Weights = "cva"
    horizon: int | None = None
    integrator: bool = False
    stable: bool = False
    simulated: bool = False
    """True if the model is for simulation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SubspaceEstimate:
    """Estimate of all matrices."""

    model: InnovationsForm
    """A, C and K."""
    free: Array
    """A before the option `stable` reflected its poles."""
    at: Predictor
    """Predictor of the scaled signals."""
    predicted: list[Array]
    """One-step predictions (N, ny) of each experiment."""
    states: tuple[Basis, ...]
    """Effects of the initial states on the predictions of each experiment."""
    errors: list[Array]
    """One-step errors (N, ny) of each experiment, NaN where y is missing."""
    canonical_correlations: Array
    suggested_order: int
    parts: tuple[ScaledExperiment, ...]
    """Signals of each experiment; with the gains of a Kalman filter if an output is missing."""
    Lambda: Array | None = None
    """Covariance of e that the Kalman filter assumes."""
    settled: bool = True
    """True if the estimates of the missing outputs did not change in the last pass."""


def estimate_subspace_model(signals: Parts, options: SubspaceOptions) -> SubspaceEstimate:
    """Return the estimate from the windows, in which missing outputs are estimated as well.

    Interpolated values of the missing outputs are replaced by the model's predictions, and the
    model is estimated again, until they change by less than std(e)/sqrt(N). If they do not settle,
    the model with the least errors is returned.
    """
    filled = _bridge_gaps(signals, options.horizon or MIN_HORIZON)
    least = np.inf
    for _ in range(MAX_PASSES):
        estimate = _from_windows(signals, filled, options)
        e = np.vstack(estimate.errors)
        before = np.vstack([y for _, y in filled])
        replaced = np.isnan(e) & np.isfinite(before)
        if not replaced.any():
            break
        loss = float(np.nanmean(e**2))
        if loss < least:
            least, best = loss, estimate
        Lambda = pairwise_covariance(e)
        filled = [
            (u, np.where(np.isnan(y), np.nan, at + _conditional(x, Lambda)))
            for (u, y), at, x in zip(filled, estimate.predicted, estimate.errors, strict=True)
        ]
        change = (np.vstack([y for _, y in filled]) - before)[replaced]
        if np.mean(change**2) <= loss / len(e):
            break
    else:
        estimate = replace(best, settled=False)
    return filter_estimate(signals, estimate, options)


def filter_estimate(
    signals: Parts,
    estimate: SubspaceEstimate,
    options: SubspaceOptions,
    B_D: tuple[Array, Array] | None = None,
) -> SubspaceEstimate:
    """Return the estimate with a Kalman filter after each missing output.

    The errors are scaled, so that each error has the variance of an error without missing outputs.
    """
    model, e = estimate.model, np.vstack(estimate.errors)
    if np.isfinite(e).all() or not model.K.any():
        return estimate
    Lambda = weights_of(estimate)
    parts = filter_parts(signals, model.A, model.C, model.K, Lambda)
    return replace(estimate, **_of_model(signals, parts, model, options, B_D, Lambda))


def weights_of(estimate: SubspaceEstimate) -> Array:
    """Return the covariance of e; the weight of a single output has no effect."""
    e = np.vstack(estimate.errors)
    return np.eye(1) if e.shape[1] == 1 else pairwise_covariance(e)


def _bridge_gaps(signals: Parts, longest: int) -> list[tuple[Array, Array]]:
    """Return the signals with outputs interpolated over gaps of at most `longest` samples."""
    bridged = []
    for u, y in signals:
        filled = np.apply_along_axis(interpolate, 0, y)
        for k, missing in enumerate(np.isnan(y).T):
            for gap in stretches(missing):
                if gap.stop - gap.start > longest:
                    filled[gap, k] = np.nan
        bridged.append((u, filled))
    return bridged


def _conditional(errors: Array, Lambda: Array) -> Array:
    """Return the errors (N, ny); a missing error is estimated from those of the other outputs."""
    measured = np.isfinite(errors)
    estimates = np.where(measured, errors, 0.0)
    for o, times in patterns(measured):
        gain = np.linalg.solve(Lambda[np.ix_(o, o)], Lambda[o])
        estimates[times] = estimates[np.ix_(times, o)] @ gain
    return estimates


def _from_windows(signals: Parts, filled: Parts, options: SubspaceOptions) -> SubspaceEstimate:
    """Return the estimate from windows of the `known` signals, which have no missing outputs."""
    w = usable_windows(filled, options.order, options.horizon)
    decomposition = projection(w, options.weights)
    canonical = decomposition if options.weights == "cva" else projection(w, "cva")
    states = visible_states(w)
    most = min(_MAX_SUGGESTED_ORDER, (w.future - 2) * w.ny, states)
    suggested = order_by_mdl(w, canonical, most)
    n = suggested if options.order is None else options.order
    if n > states:
        raise InputError(f"order={n}: the data show {plural(states, 'state')}; lower the order")
    integrator, direct = options.integrator, options.direct
    if options.horizon is None:
        model = best_innovations(
            filled,
            w,
            decomposition,
            n,
            options.weights,
            integrator=integrator,
            direct=direct,
            simulated=options.simulated and w.ny > 1,
        )
    else:
        model = innovations_at(w, decomposition, n, integrator=integrator)
    free = model.A
    if options.stable:
        model = model.stabilised()
    return SubspaceEstimate(
        free=free,
        canonical_correlations=canonical.singular_values,
        suggested_order=suggested,
        **_of_model(signals, without_weights(signals), model, options),
    )


def _of_model(
    signals: Parts,
    parts: Sequence[ScaledExperiment],
    model: InnovationsForm,
    options: SubspaceOptions,
    B_D: tuple[Array, Array] | None = None,
    Lambda: Array | None = None,
) -> dict[str, Any]:
    """Return the fields of an estimate that follow from A, C and K, such as its errors."""
    at, predicted, states = least_squares_predictor(parts, model, direct=options.direct, B_D=B_D)
    errors = [y - yhat for (_, y), yhat in zip(signals, predicted, strict=True)]
    if Lambda is not None:
        errors = [scale_part_errors(part, e, Lambda) for part, e in zip(parts, errors, strict=True)]
    fields = {"model": model, "at": at, "predicted": predicted, "states": states}
    return fields | {"errors": errors, "parts": tuple(parts), "Lambda": Lambda}


def least_squares_predictor(
    parts: Sequence[ScaledExperiment],
    model: InnovationsForm,
    *,
    direct: bool,
    B_D: tuple[Array, Array] | None = None,
) -> tuple[Predictor, list[Array], tuple[Basis, ...]]:
    """Return the predictor of least one-step errors, its predictions, and effects of the states.

    B, D, the initial states, and with an integrator constant offsets of the signals are estimated.
    If B and D are `given`, they are not. Without the gains of a Kalman filter the error of a
    missing output is 0.
    """
    problem = StateSpaceProblem(
        parts=tuple(parts),
        order=len(model.A),
        direct=direct,
        noise=False,
        level=model.integrator,
        gain=model.K,
    )
    linear = problem.linear(
        model.Abar, model.C, None if B_D is None else (B_D[0] - model.K @ B_D[1], B_D[1])
    )
    if B_D is None and linear.basis.rank < linear.basis.d:
        raise InputError(
            f"u determines only {linear.basis.rank} of {linear.basis.d} numerator coefficients; "
            "lower the order or excite with a richer input"
        )
    predicted = [linear.at.predicted(part, i) for i, part in enumerate(parts)]
    return linear.at, predicted, linear.states


def without_weights(signals: Parts) -> tuple[ScaledExperiment, ...]:
    """Return the signals of each experiment without weights of the outputs."""
    return parts_of(signals, np.eye(signals[0][1].shape[1]))


def for_simulation(
    signals: Parts, estimate: SubspaceEstimate, options: SubspaceOptions
) -> SubspaceEstimate:
    """Return the model with the B and D, and for one output the poles, of least simulation error.

    The simulation error y - (B u + x(0)) / A is linear in B, D and x(0). For several outputs the
    poles do not change. In six of nine trials, a search over the n ny parameters of A and C
    improved the simulation of other data. In another it made the simulation worse by a third.

    K is the candidate with the least one-step loss. The candidates are the gain of the projection,
    K = 0 (white output noise), and for one output K by Hannan and Rissanen's regressions.
    """
    model, parts, direct = estimate.model.stabilised(), without_weights(signals), options.direct
    single_output = len(model.C) == 1
    if single_output and len(model.A) > model.integrator:  # a pole at 1 alone is fixed
        model = model.with_transition(_search_poles(parts, model, direct=direct))
    still = replace(model, K=np.zeros(model.K.shape))
    at, simulated, _ = least_squares_predictor(parts, still, direct=direct)
    gains = [model.K, still.K]
    if single_output:
        a = np.append(1.0, -model.A[:, 0])
        v = [y - yhat for (_, y), yhat in zip(signals, simulated, strict=True)]
        polynomials = noise_start([_without_past(a, x[:, 0]) for x in v], nc=a.size - 1, nd=0)[0]
        gains = [model.K, *((c - a)[1:, None] for c in (polynomials, reflect_roots(a)))]
    B_D, models = (at.Bbar, at.D), [replace(model, K=K) for K in gains]
    fields = [_of_model(signals, parts, each, options, B_D) for each in models]
    fits = [replace(estimate, free=model.A, **changes) for changes in fields]
    losses = [np.linalg.slogdet(pairwise_covariance(np.vstack(fit.errors)))[1] for fit in fits]
    best = fits[int(np.argmin(losses))]
    return filter_estimate(signals, best, options, B_D)


def _without_past(a: Array, v: Array) -> Array:
    """Return a(q) v; a sample that depends on a missing or unknown sample is NaN."""
    filtered_v = apply_filter(a, [1.0], v) if np.isfinite(v).all() else np.convolve(v, a)[: v.size]
    filtered_v[: a.size - 1] = np.nan
    return filtered_v


def _search_poles(
    parts: tuple[ScaledExperiment, ...], model: InnovationsForm, *, direct: bool
) -> Array:
    """Return A of least simulation error for one output, in observer form."""
    n = len(model.A)
    pole = np.array([1.0, -1.0]) if model.integrator else np.ones(1)
    start = np.append(1.0, -model.A[:, 0])
    start = without_integrator(start) if model.integrator else start
    problem = StateSpaceProblem(
        parts=parts, order=n, direct=direct, noise=False, level=model.integrator
    )
    # A change of the free polynomial, times the pole at 1, is a change of -A[:, 0].
    along = -np.column_stack([np.convolve(pole, row) for row in np.eye(start.size - 1)])
    V = directions(model.A, model.C) @ along

    def transition(f: Array) -> Array:
        return companion(np.convolve(pole, np.append(1.0, f)))

    def linearise(f: Array) -> tuple[Array, Array]:
        linear, J = problem.linearise_along(transition(f), model.C, V)
        return linear.e, J

    walls = UnitCircle((slice(0, start.size - 1),))
    optimum = levenberg_marquardt(linearise, start[1:], admissible=walls.admits, walls=walls)
    return transition(stabilise(np.append(1.0, optimum.theta))[1:])
