"""Estimate of all matrices of a state-space model from projections, for signals with gaps, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.estimation.problem import UnitCircle
from armrig.estimation.stability import stabilised
from armrig.estimation.start_values import noise_start
from armrig.estimation.state_space_gaps import filtered_parts, scaled_errors
from armrig.estimation.state_space_problem import StateSpaceProblem, directions, parts_of
from armrig.estimation.state_space_responses import Part, Predictor
from armrig.estimation.subspace import Parts, projection, suggested_order, visible_states
from armrig.estimation.subspace_horizon import (
    MIN_HORIZON,
    Innovations,
    best_innovations,
    companion,
    innovations_at,
    usable_windows,
)
from armrig.models.innovations import interpolated
from armrig.models.structure_table import Weights
from armrig.numerics.covariance import pairwise_covariance, patterns
from armrig.numerics.least_squares import Basis
from armrig.numerics.levenberg_marquardt import levenberg_marquardt
from armrig.numerics.polynomial import (
    Array,
    filtered,
    reflected,
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

    model: Innovations
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
    parts: tuple[Part, ...]
    """Signals of each experiment; with the gains of a Kalman filter if an output is missing."""
    Lambda: Array | None = None
    """Covariance of e that the Kalman filter assumes."""
    settled: bool = True
    """True if the estimates of the missing outputs did not change in the last pass."""


def estimated(signals: Parts, options: SubspaceOptions) -> SubspaceEstimate:
    """Return the estimate from the windows, in which missing outputs are estimated as well.

    Interpolated values of the missing outputs are replaced by the model's predictions, and the
    model is estimated again, until they change by less than std(e)/sqrt(N). If they do not settle,
    the model with the least errors is returned.
    """
    known = _bridged(signals, options.horizon or MIN_HORIZON)
    least = np.inf
    for _ in range(MAX_PASSES):
        found = _from_windows(signals, known, options)
        e = np.vstack(found.errors)
        before = np.vstack([y for _, y in known])
        estimated = np.isnan(e) & np.isfinite(before)
        if not estimated.any():
            break
        loss = float(np.nanmean(e**2))
        if loss < least:
            least, best = loss, found
        Lambda = pairwise_covariance(e)
        known = [
            (u, np.where(np.isnan(y), np.nan, at + _conditional(x, Lambda)))
            for (u, y), at, x in zip(known, found.predicted, found.errors, strict=True)
        ]
        change = (np.vstack([y for _, y in known]) - before)[estimated]
        if np.mean(change**2) <= loss / len(e):
            break
    else:
        found = replace(best, settled=False)
    return filtered_estimate(signals, found, options)


def filtered_estimate(
    signals: Parts,
    found: SubspaceEstimate,
    options: SubspaceOptions,
    given: tuple[Array, Array] | None = None,
) -> SubspaceEstimate:
    """Return the estimate with a Kalman filter after each missing output.

    The errors are scaled, so that each error has the variance of an error without missing outputs.
    """
    model, e = found.model, np.vstack(found.errors)
    if np.isfinite(e).all() or not model.K.any():
        return found
    Lambda = weights_of(found)
    parts = filtered_parts(signals, model.A, model.C, model.K, Lambda)
    return replace(found, **_of_model(signals, parts, model, options, given, Lambda))


def weights_of(found: SubspaceEstimate) -> Array:
    """Return the covariance of e; the weight of a single output has no effect."""
    e = np.vstack(found.errors)
    return np.eye(1) if e.shape[1] == 1 else pairwise_covariance(e)


def _bridged(signals: Parts, longest: int) -> list[tuple[Array, Array]]:
    """Return the signals with outputs interpolated over gaps of at most `longest` samples."""
    found = []
    for u, y in signals:
        filled = np.apply_along_axis(interpolated, 0, y)
        for k, missing in enumerate(np.isnan(y).T):
            for gap in stretches(missing):
                if gap.stop - gap.start > longest:
                    filled[gap, k] = np.nan
        found.append((u, filled))
    return found


def _conditional(errors: Array, Lambda: Array) -> Array:
    """Return the errors (N, ny); a missing error is estimated from those of the other outputs."""
    known = np.isfinite(errors)
    found = np.where(known, errors, 0.0)
    for o, times in patterns(known):
        gain = np.linalg.solve(Lambda[np.ix_(o, o)], Lambda[o])
        found[times] = found[np.ix_(times, o)] @ gain
    return found


def _from_windows(signals: Parts, known: Parts, options: SubspaceOptions) -> SubspaceEstimate:
    """Return the estimate from windows of the `known` signals, which have no missing outputs."""
    w = usable_windows(known, options.order, options.horizon)
    found = projection(w, options.weights)
    canonical = found if options.weights == "cva" else projection(w, "cva")
    states = visible_states(w)
    most = min(_MAX_SUGGESTED_ORDER, (w.future - 2) * w.ny, states)
    suggested = suggested_order(w, canonical, most)
    n = suggested if options.order is None else options.order
    if n > states:
        raise InputError(f"order={n}: the data show {plural(states, 'state')}; lower the order")
    integrator, direct = options.integrator, options.direct
    if options.horizon is None:
        model = best_innovations(
            known,
            w,
            found,
            n,
            options.weights,
            integrator=integrator,
            direct=direct,
            simulated=options.simulated and w.ny > 1,
        )
    else:
        model = innovations_at(w, found, n, integrator=integrator)
    free = model.A
    if options.stable:
        model = model.stabilised()
    return SubspaceEstimate(
        free=free,
        canonical_correlations=canonical.singular_values,
        suggested_order=suggested,
        **_of_model(signals, unweighted(signals), model, options),
    )


def _of_model(
    signals: Parts,
    parts: Sequence[Part],
    model: Innovations,
    options: SubspaceOptions,
    given: tuple[Array, Array] | None = None,
    Lambda: Array | None = None,
) -> dict[str, Any]:
    """Return the fields of an estimate that follow from A, C and K, such as its errors."""
    at, predicted, states = completed(parts, model, direct=options.direct, given=given)
    errors = [y - yhat for (_, y), yhat in zip(signals, predicted, strict=True)]
    if Lambda is not None:
        errors = [scaled_errors(part, e, Lambda) for part, e in zip(parts, errors, strict=True)]
    found = {"model": model, "at": at, "predicted": predicted, "states": states}
    return found | {"errors": errors, "parts": tuple(parts), "Lambda": Lambda}


def completed(
    parts: Sequence[Part],
    model: Innovations,
    *,
    direct: bool,
    given: tuple[Array, Array] | None = None,
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
    found = problem.linear(
        model.Abar, model.C, None if given is None else (given[0] - model.K @ given[1], given[1])
    )
    if given is None and found.basis.rank < found.basis.d:
        raise InputError(
            f"u determines only {found.basis.rank} of {found.basis.d} numerator coefficients; "
            "lower the order or excite with a richer input"
        )
    predicted = [found.at.predicted(part, i) for i, part in enumerate(parts)]
    return found.at, predicted, found.states


def unweighted(signals: Parts) -> tuple[Part, ...]:
    """Return the signals of each experiment without weights of the outputs."""
    return parts_of(signals, np.eye(signals[0][1].shape[1]))


def for_simulation(
    signals: Parts, found: SubspaceEstimate, options: SubspaceOptions
) -> SubspaceEstimate:
    """Return the model with the B and D, and for one output the poles, of least simulation error.

    The simulation error y - (B u + x(0)) / A is linear in B, D and x(0). For several outputs the
    poles do not change. In six of nine trials, a search over the n ny parameters of A and C
    improved the simulation of other data. In another it made the simulation worse by a third.

    K is the candidate with the least one-step loss. The candidates are the gain of the projection,
    K = 0 (white output noise), and for one output K by Hannan and Rissanen's regressions.
    """
    model, parts, direct = found.model.stabilised(), unweighted(signals), options.direct
    one = len(model.C) == 1
    if one and len(model.A) > model.integrator:  # a pole at 1 alone is fixed
        model = model.with_transition(_searched_poles(parts, model, direct=direct))
    still = replace(model, K=np.zeros(model.K.shape))
    at, simulated, _ = completed(parts, still, direct=direct)
    gains = [model.K, still.K]
    if one:
        a = np.append(1.0, -model.A[:, 0])
        v = [y - yhat for (_, y), yhat in zip(signals, simulated, strict=True)]
        polynomials = noise_start([_without_past(a, x[:, 0]) for x in v], nc=a.size - 1, nd=0)[0]
        gains = [model.K, *((c - a)[1:, None] for c in (polynomials, reflected(a)))]
    given, models = (at.Bbar, at.D), [replace(model, K=K) for K in gains]
    fields = [_of_model(signals, parts, each, options, given) for each in models]
    fits = [replace(found, free=model.A, **of) for of in fields]
    losses = [np.linalg.slogdet(pairwise_covariance(np.vstack(fit.errors)))[1] for fit in fits]
    best = fits[int(np.argmin(losses))]
    return filtered_estimate(signals, best, options, given)


def _without_past(a: Array, v: Array) -> Array:
    """Return a(q) v; a sample that depends on a missing or unknown sample is NaN."""
    found = filtered(a, [1.0], v) if np.isfinite(v).all() else np.convolve(v, a)[: v.size]
    found[: a.size - 1] = np.nan
    return found


def _searched_poles(parts: tuple[Part, ...], model: Innovations, *, direct: bool) -> Array:
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
        linear, J = problem.linearised(transition(f), model.C, V)
        return linear.e, J

    walls = UnitCircle((slice(0, start.size - 1),))
    found = levenberg_marquardt(linearise, start[1:], admissible=walls.admits, walls=walls)
    return transition(stabilised(np.append(1.0, found.theta))[1:])
