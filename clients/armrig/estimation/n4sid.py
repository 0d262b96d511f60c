"""Subspace identification: a state-space model without an iterative search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_signals
from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding, warning
from armrig.data.signals import Signals
from armrig.data.treatment import INTEGRATING_OUTPUTS, integrating
from armrig.estimation.data_checks import (
    instability,
    origin,
    poor_fits,
    require_informative,
)
from armrig.estimation.data_faults import NO_OPTION, data_faults
from armrig.estimation.error_process import error_process
from armrig.estimation.stability import REFLECT, reflection_warnings, stabilised, unstable
from armrig.estimation.start_values import noise_start
from armrig.estimation.state_space_fit import (
    Derivatives,
    derivatives,
    inference,
    influence,
    matrices,
)
from armrig.estimation.state_space_problem import (
    Part,
    Predictor,
    StateSpaceProblem,
    basis_of_states,
    delays_of,
    directions,
    entries,
    held_responses,
    offsets,
    parts_of,
    scaled_signals,
    stacked,
    state_responses,
    whitened,
    without,
)
from armrig.estimation.state_space_starts import interpolated
from armrig.estimation.subspace import Parts, projection, suggested_order, visible_states
from armrig.estimation.subspace_horizon import (
    MIN_HORIZON,
    Innovations,
    best_innovations,
    companion,
    innovations_at,
    least_horizon,
    require_windows,
    usable_windows,
)
from armrig.models.fit import Fit
from armrig.models.structure_table import Focus, Weights
from armrig.numerics.checks import require_integers
from armrig.numerics.covariance import pairwise_covariance
from armrig.numerics.inference import Inference
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import levenberg_marquardt
from armrig.numerics.polynomial import (
    Array,
    drawn_to_edge,
    filtered,
    outward_normals,
    reflected,
    without_integrator,
)
from armrig.numerics.polynomial import stable as stable_polynomial
from armrig.numerics.recursion import outputs
from armrig.numerics.stretches import stretches
from armrig.numerics.whitening import patterns

_MAX_SUGGESTED_ORDER = 10
_STEP = 1e-6  # change of a parameter for a numerical derivative
_RANK_TOLERANCE = 1e-8  # a smaller relative singular value belongs to a change of coordinates
_MAX_PASSES = 20  # of the estimation of missing outputs
_MAX_DISTANCE_FROM_1 = 0.02  # a pole farther from 1 is not taken for an integrator
_NO_GAIN_TEXT = (
    "no steady Kalman gain was found, so C of the subspace model is A with its roots inside the "
    "unit circle"
)
_UNSETTLED_TEXT = (
    f"the missing outputs were estimated {_MAX_PASSES} times and did not settle: use ss"
)
_BOUND_TEXT = (
    "the standard deviations are a lower bound; the true standard deviations of a subspace "
    "estimate are larger"
)
_COLOURED_TEXT = (
    "the residuals are coloured, maybe only because a subspace estimate does not minimise the "
    "one-step errors: check whether the residuals of armax or bj are white"
)


@takes_signals
def n4sid(
    data: Signals,
    order: int | None = None,
    weights: Weights = "cva",
    *,
    nk: int | Sequence[int] = 1,
    integrator: bool = False,
    horizon: int | None = None,
    focus: Focus = "prediction",
    stable: bool = False,
    replicates: int = 0,
    seed: int = 0,
) -> Fit:
    """Estimate a state-space model x(t+1) = A x + B u + K e, y = C x + D u + e by projections.

    The future outputs are projected on past u and y, for given future u. The singular values of the
    weighted projection indicate the order. A and C are computed from the left singular vectors. K
    is computed from the residuals of a regression of the states. Least squares on the one-step
    errors then estimate B, D and the unknown past. A, C and K do not minimise the prediction error.
    The searches `armax`, `oe` and `bj` are therefore somewhat more accurate.

    Parameters
    ----------
    data : Dataset
        N samples. A window of 2 `horizon` samples with a missing sample is not used. The means of u
        and y are projected out. With an integrator, the ramp due to an offset of u is projected out
        too.
    order : int, optional
        Number of states, >= 1. By default MDL of the one-step errors selects the order.
    weights : {"cva", "moesp", "n4sid"}
        Weights of the projection: Larimore's canonical variates, Verhaegen's PO-MOESP, or N4SID
        of Van Overschee and De Moor.
    nk : int, default 1
        Number of samples before u reaches y; 0 means a direct term D.
    integrator : bool, default False
        Set the pole nearest 1 to exactly 1, and estimate the input offset too. The projection uses
        y, not the difference of y. Noise in the difference would hide the slow poles.
    horizon : int, optional
        Number of past and of future samples, at least order + 2. With a shorter horizon the noise
        model would be wrong. The default is the largest of 10, 2 (order + 1) and the order of an
        ARX model. AIC chooses the order of the ARX model, at most 30. For short data the default is
        smaller. If a horizon of order + 2 predicts the data better, order + 2 is the default. A
        long horizon suits white output noise. A short horizon suits noise with the poles of A.
    focus : {"prediction", "simulation"}
        Purpose of A and B. With "simulation" a search from the poles of the subspace model
        minimises the simulation error. For each candidate of A, least squares give B and the
        initial states. The result is an output-error model (`oe`) with a noise model. This model
        simulates better than the model of "prediction" if the system is not exactly linear or not
        exactly of this order. Its poles are always inside the unit circle.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, and estimate B again. A finding of
        the fit reports the reflection.

    Returns
    -------
    Fit
        `covariance` is the bound lambda (Psi^T Psi)^-1 that a search attains for the same
        polynomials. The covariance of the subspace estimate is larger and not known. In 200
        simulations of an ARMAX system of order 2 (N = 2000), the true standard deviations were 0.92
        to 1.06 times the bound. The test of `whiteness` assumes that the model minimises the
        one-step errors. The errors of a subspace estimate have a bias that does not decrease with
        N. Therefore the test rejects whiteness too often if the data are long. For a Box-Jenkins
        system of order 3 (N = 1000) the test at the level 5 % rejected whiteness in 10 of 100
        simulations.

    Raises
    ------
    ValueError
        There are too few samples, y is constant, or the data show fewer states than `order`.

    References
    ----------
    .. [1] P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 10.6.

    Examples
    --------
    >>> import armrig
    >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
    >>> fit.heading
    'N4SID(order=3, nk=1)'
    >>> fit.poles().values.round(2)
    array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """
    _require_known(weights, focus)
    require_integers(order=(1 if order is None else order, 1), replicates=(replicates, 0))
    delays = delays_of(nk, data)
    require_windows(horizon or least_horizon(order, data.ny), data.nu + data.ny, data.N)
    require_informative(data)
    scaled, su, sy = scaled_signals(data, delays)
    options = _Options(
        order=order if order is None else int(order),
        weights=weights,
        horizon=horizon,
        integrator=integrator,
        stable=stable,
        direct=max(delays) == 0,
        simulated=focus == "simulation",
    )
    found = _estimated(scaled, options)
    if focus == "simulation":
        found = _for_simulation(scaled, found, options)
    # The weight of a single output has no effect.
    one = data.ny == 1
    Lambda = np.eye(1) if one else pairwise_covariance(np.vstack(found.errors))
    problem = StateSpaceProblem(
        parts=parts_of(scaled, Lambda),
        order=len(found.model.A),
        direct=options.direct,
        noise=True,
        level=integrator,
    )
    V = directions(found.at.Abar, found.at.C)
    by = derivatives(problem, found.at, V)
    Psi, states = influence(problem, found.at, V, found.states if one else None)
    if integrator:
        fixed = by.at_fixed_pole(found.model.A)
        by, Psi = by.along(fixed), Psi @ fixed
    inferred = inference(data, problem, Psi, states, found.errors, sy)
    if replicates > 1:
        covariance = _replicated(scaled, found, by, options, replicates, seed)
        inferred = replace(inferred, covariance=covariance, covariance_robust=covariance)
    notes = [] if found.model.steady else [warning("no_gain", _NO_GAIN_TEXT)]
    notes += [] if found.settled else [warning("not_converged", _UNSETTLED_TEXT, steps=_MAX_PASSES)]
    if stable:
        both = (np.real(np.poly(A)) for A in (found.free, found.model.A))
        notes += reflection_warnings(*both)
    notes += [] if replicates > 1 else [warning("bound", _BOUND_TEXT)]
    more = {"inferred": inferred, "notes": tuple(notes), "su": su, "sy": sy}
    if data.nu == data.ny == 1:
        return _one_channel(data.dataset(), found, by, delays[0], options, **more)
    return _several(data, found, by, delays, **more)


def _require_known(weights: str, focus: str) -> None:
    if weights not in get_args(Weights):
        allowed = ", ".join(f'"{x}"' for x in get_args(Weights))
        raise InputError(f"weights={weights!r} must be one of {allowed}")
    if focus not in get_args(Focus):
        raise InputError(f'focus={focus!r} must be one of "prediction", "simulation"')


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options:
    """Options of the estimate."""

    order: int | None
    weights: Weights
    horizon: int | None
    integrator: bool
    stable: bool
    direct: bool
    simulated: bool
    """True if the model is for simulation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """Estimate of all matrices."""

    model: Innovations
    """A, C and K."""
    free: Array
    """A before the option `stable` reflected its poles."""
    at: Predictor
    """Predictor of the scaled signals."""
    predicted: list[Array]
    """One-step predictions (N, ny) of each experiment."""
    states: list[Basis]
    """Effects of the initial states on the predictions of each experiment."""
    errors: list[Array]
    """One-step errors (N, ny) of each experiment, NaN where y is missing."""
    canonical_correlations: Array
    suggested_order: int
    settled: bool = True
    """True if the estimates of the missing outputs did not change in the last pass."""


def _estimated(signals: Parts, options: _Options) -> _Found:
    """Return the estimate from the windows, in which missing outputs are estimated as well.

    The windows need a value for each missing output. The first value is interpolated. The model's
    predictions then replace these values, and the model is estimated again, until the values change
    by less than std(e)/sqrt(N). If they do not settle, the model with the least errors is returned.
    """
    known = _bridged(signals, options.horizon or MIN_HORIZON)
    least = np.inf
    for _ in range(_MAX_PASSES):
        found = _from_windows(signals, known, options)
        e = np.vstack(found.errors)
        before = np.vstack([y for _, y in known])
        estimated = np.isnan(e) & np.isfinite(before)
        if not estimated.any():
            return found
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
            return found
    return replace(best, settled=False)


def _bridged(signals: Parts, longest: int) -> list[tuple[Array, Array]]:
    """Return the signals with outputs interpolated over gaps of at most `longest` samples."""
    found = []
    for u, y in signals:
        filled = interpolated(y)
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


def _from_windows(signals: Parts, known: Parts, options: _Options) -> _Found:
    """Return the estimate from windows of the `known` signals, which have no missing outputs."""
    w = usable_windows(known, options.order, options.horizon)
    found = projection(w, options.weights)
    canonical = found if options.weights == "cva" else projection(w, "cva")
    states = visible_states(w)
    most = min(_MAX_SUGGESTED_ORDER, (w.future - 2) * w.ny, states)
    suggested = suggested_order(w, canonical, most)
    n = suggested if options.order is None else options.order
    if n > states:
        raise InputError(f"order={n}: the data show {states} states; lower the order")
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
    at, predicted, states = completed(signals, model, direct=direct, level=integrator)
    return _Found(
        model=model,
        free=free,
        at=at,
        predicted=predicted,
        states=states,
        errors=[y - yhat for (_, y), yhat in zip(signals, predicted, strict=True)],
        canonical_correlations=canonical.singular_values,
        suggested_order=suggested,
    )


def completed(
    signals: Parts,
    model: Innovations,
    *,
    direct: bool,
    level: bool,
    given: tuple[Array, Array] | None = None,
) -> tuple[Predictor, list[Array], list[Basis]]:
    """Return the predictor whose B, D and initial states minimise the one-step errors.

    The error of a missing output is taken as 0. With `level` constant offsets of the signals are
    estimated, too. If B and D are `given`, only the initial states and the offsets are estimated.

    Returns
    -------
    Predictor
    list of ndarray
        Predictions (N, ny) of each experiment.
    list of Basis
        Effects of the initial states on the predictions of each experiment.

    Raises
    ------
    ValueError
        u determines fewer coefficients than B and D have.
    """
    (n, ny), nu = model.K.shape, signals[0][0].shape[1]
    zero = np.zeros((n, nu)), np.zeros((ny, nu))
    at = Predictor(Abar=model.Abar, Bbar=zero[0], C=model.C, D=zero[1], K=model.K, x0=())
    states, blocks, left = [], [], []
    for part in parts_of(signals, np.eye(ny)):
        fed, driven, free = _responses(part, at, direct=direct)
        if level:
            free = np.concatenate([free, offsets(at.Abar, at.C, len(fed))])
        columns = np.concatenate([driven, (part.y - fed).T[None]])
        blocks.append((fed, driven, free, whitened(part, columns)))
        states.append(basis_of_states(part, free))
        left.append(without(states[-1], blocks[-1][-1]))
    M = stacked(left)
    basis = orthonormal(M[:, :-1])
    if given is None and basis.rank < M.shape[1] - 1:
        raise InputError(
            f"u determines only {basis.rank} of {M.shape[1] - 1} numerator coefficients; lower the "
            "order or excite with a richer input"
        )
    theta = basis.coefficients(M[:, -1])
    if given is not None:
        B, D = given
        theta = np.concatenate([(B - at.K @ D).T.ravel(), D.ravel() if direct else []])
    first, predicted = [], []
    for Z, (fed, driven, free, raw) in zip(states, blocks, strict=True):
        x0 = Z.coefficients(raw[:, -1] - raw[:, :-1] @ theta)
        first.append(x0[:n])
        of_both = np.tensordot(theta, driven, axes=1) + np.tensordot(x0, free, axes=1)
        predicted.append(fed + of_both.T)
    Bbar = theta[: n * nu].reshape(nu, n).T
    D = theta[n * nu :].reshape(ny, nu) if direct else zero[1]
    return replace(at, Bbar=Bbar, D=D, x0=tuple(first)), predicted, states


def _responses(part: Part, at: Predictor, *, direct: bool) -> tuple[Array, Array, Array]:
    """Return the part (N, ny) of the predictions that y drives, and those of B, D and x(0)."""
    (n, ny), u = at.K.shape, part.u
    of_D = u if direct else None
    if part.rows.all() or not at.K.any():
        fed = outputs(at.Abar, at.C, part.y @ at.K.T, np.zeros(n))
        return fed, *state_responses(u, at.Abar, at.C, direct=of_D)
    w, at_once = entries(u, n, of_D, ny)
    k = len(w)
    w = np.concatenate([w, np.zeros((n, *w.shape[1:])), (part.y @ at.K.T)[None]])
    at_once = np.concatenate([at_once, np.zeros((n + 1, *at_once.shape[1:]))])
    x0 = np.eye(len(w), n, k=-k)
    x0[-1] = 0.0
    found = held_responses(part, at, w.swapaxes(0, 1), at_once.swapaxes(0, 1), x0)
    found = found.transpose(1, 2, 0)
    return found[-1].T, found[:k], found[k:-1]


def _for_simulation(signals: Parts, found: _Found, options: _Options) -> _Found:
    """Return the model with the B and D, and for one output the poles, of least simulation error.

    The simulation error y - (B u + x(0)) / A is linear in B, D and x(0). For one output the search
    over A starts from the poles of the projection, reflected into the unit circle. For several
    outputs the poles do not change: a search over the n ny parameters of A and C often fits the
    noise. It improved the simulation of data that were not used in six of nine trials, but made it
    worse by a third in another.

    K is the candidate with the least one-step loss for the estimated A, B and D. The first
    candidate is the gain of the projection. The second candidate is K by Hannan and Rissanen's
    regressions on the simulation error, for one output. The third candidate is K = 0, which is
    correct for white output noise.
    """
    model, like = found.model.stabilised(), {"direct": options.direct, "level": options.integrator}
    one = len(model.C) == 1
    if one:
        model = model.with_transition(_searched_poles(signals, model, **like))
    still = replace(model, K=np.zeros(model.K.shape))
    at, simulated, _ = completed(signals, still, **like)
    gains = [model.K, still.K]
    if one:
        a = np.append(1.0, -model.A[:, 0])
        v = [y - yhat for (_, y), yhat in zip(signals, simulated, strict=True)]
        polynomials = noise_start([_without_past(a, x[:, 0]) for x in v], nc=a.size - 1, nd=0)[0]
        gains = [model.K, *((c - a)[1:, None] for c in (polynomials, reflected(a)))]
    fits = []
    for K in gains:
        candidate = replace(model, K=K)
        B = at.Bbar, at.D
        predictor, predicted, states = completed(signals, candidate, **like, given=B)
        errors = [y - yhat for (_, y), yhat in zip(signals, predicted, strict=True)]
        fit = replace(found, model=candidate, at=predictor, predicted=predicted, errors=errors)
        fits.append(replace(fit, free=candidate.A, states=states))
    losses = [np.linalg.slogdet(pairwise_covariance(np.vstack(fit.errors)))[1] for fit in fits]
    return fits[int(np.argmin(losses))]


def _without_past(a: Array, v: Array) -> Array:
    """Return a(q) v; a sample that depends on a missing or unknown sample is NaN."""
    found = filtered(a, [1.0], v) if np.isfinite(v).all() else np.convolve(v, a)[: v.size]
    found[: a.size - 1] = np.nan
    return found


def _searched_poles(signals: Parts, model: Innovations, *, direct: bool, level: bool) -> Array:
    """Return A of least simulation error for one output, in observer form.

    For given A the simulation error is linear in B, D and the initial state.
    """
    n = len(model.A)
    pole = np.array([1.0, -1.0]) if model.integrator else np.ones(1)
    start = np.append(1.0, -model.A[:, 0])
    start = without_integrator(start) if model.integrator else start
    problem = StateSpaceProblem(
        parts=parts_of(signals, np.eye(1)), order=n, direct=direct, noise=False, level=level
    )
    # A change of the free polynomial, times the pole at 1, is a change of -A[:, 0].
    along = -np.column_stack([np.convolve(pole, row) for row in np.eye(start.size - 1)])
    V = directions(model.A, model.C) @ along

    def transition(f: Array) -> Array:
        return companion(np.convolve(pole, np.append(1.0, f)))

    def linearise(f: Array) -> tuple[Array, Array]:
        linear, J = problem.linearised(transition(f), model.C, V)
        return linear.e, J

    walls = _Circle()
    found = levenberg_marquardt(linearise, start[1:], admissible=walls.admits, walls=walls)
    return transition(stabilised(np.append(1.0, found.theta))[1:])


class _Circle:
    """Unit circle, the boundary of the roots of a monic polynomial."""

    def admits(self, f: Array) -> bool:
        """Return whether the roots are inside the circle."""
        return stable_polynomial(np.append(1.0, f))

    def inside(self, f: Array, previous: Array) -> Array:
        """Return f with the roots that left the circle moved inside."""
        return drawn_to_edge(np.append(1.0, f), np.append(1.0, previous))[1:]

    def normals(self, f: Array) -> Array:
        """Return the gradient of |z| for each root z on the circle."""
        return outward_normals(np.append(1.0, f))


def _replicated(
    signals: Parts, found: _Found, by: Derivatives, options: _Options, replicates: int, seed: int
) -> Array:
    """Return the covariance of the parameters over estimates from data that the model simulates.

    The state of each replicate has its own coordinates, but impulse responses do not depend on
    coordinates. Each replicate is therefore replaced by the change of the parameters that
    reproduces the impulse responses of the replicate.
    """
    rng, at = np.random.default_rng(seed), found.at
    process = error_process(found.errors)
    same = replace(options, order=len(at.Abar), horizon=found.model.horizon)
    length = 2 * found.model.horizon
    samples = []
    for _ in range(replicates):
        data = [
            (u, np.where(np.isfinite(y), at.simulated(u, process.drawn(rng, len(u)), x0), np.nan))
            for (u, y), x0 in zip(signals, at.x0, strict=True)
        ]
        samples.append(_estimated(data, same).at.impulses(length))
    spread = np.array(samples) - np.mean(samples, axis=0)
    columns = [
        (by.moved(at, step).impulses(length) - by.moved(at, -step).impulses(length)) / (2 * _STEP)
        for step in _STEP * np.eye(len(by.A))
    ]
    theta = np.linalg.lstsq(np.column_stack(columns), spread.T, rcond=_RANK_TOLERANCE)[0]
    return np.asarray(theta @ theta.T / (replicates - 1))


def _one_channel(
    data: Dataset,
    found: _Found,
    by: Derivatives,
    nk: int,
    options: _Options,
    *,
    inferred: Inference,
    notes: tuple[EstimateFinding, ...],
    su: Array,
    sy: Array,
) -> Fit:
    """Return the model as A y = B u + C e; the polynomials are entries of the observer form."""
    at, (quality,) = found.at, inferred.quality
    A, C = np.append(1.0, -found.model.A[:, 0]), np.append(1.0, -at.Abar[:, 0])
    D, gain = at.D[0, 0], sy[0] / su[0]
    b = (at.Bbar + at.K @ at.D)[:, 0] + A[1:] * D
    by_a, by_D = -by.A[:, :, 0], by.D[:, 0]
    by_b = by.B[:, :, 0] + by_D * A[1:] + by_a * D
    if options.direct:
        b, by_b = np.append(D, b), np.hstack([by_D, by_b])
    T = np.hstack([by_a, gain * by_b, -by.Abar[:, :, 0]]).T
    inferred = inferred.transformed(T)
    integrator = options.integrator
    residuals = [e[:, 0] * sy[0] for e in found.errors]
    coloured = [warning("coloured", _COLOURED_TEXT)] if quality.white.coloured else []
    way_out = "" if integrator else NO_OPTION
    return Fit.of_channel(
        structure="n4sid",
        A=A,
        B=np.append(np.zeros(nk), gain * b),
        C=C,
        nk=nk,
        integrator=integrator,
        offset=integrator,
        Ts=data.Ts,
        **inferred.of_one_output(),
        weights=options.weights,
        horizon=found.model.horizon,
        singular_values=found.model.singular_values * (sy[0] if options.weights != "cva" else 1.0),
        canonical_correlations=found.canonical_correlations,
        suggested_order=found.suggested_order,
        converged=found.settled,
        findings=(
            *notes,
            *_warnings(data, A, inferred.covariance, integrator=integrator),
            *coloured,
            *data_faults(data, residuals, way_out=way_out),
        ),
        **data.origin(),
    )


def _several(
    data: Signals,
    found: _Found,
    by: Derivatives,
    delays: tuple[int, ...],
    *,
    inferred: Inference,
    notes: tuple[EstimateFinding, ...],
    su: Array,
    sy: Array,
) -> Fit:
    """Return the model as matrices."""
    form, T = matrices(found.at, by, su, sy, delays)
    nk = delays[0] if len(set(delays)) == 1 else list(delays)
    return Fit(
        structure="n4sid",
        specification=f"order={len(form.A)}, nk={nk}",
        form=form,
        converged=found.settled,
        findings=(*notes, *instability(form), *poor_fits(data, inferred.quality)),
        **inferred.transformed(T).fields(),
        **origin(data),
    )


def _warnings(
    data: Dataset, A: Array, covariance: Array, *, integrator: bool
) -> Iterator[EstimateFinding]:
    z = np.roots(A)
    nearest = int(np.argmin(np.abs(z - 1)))
    off, std = float(np.abs(z[nearest] - 1)), _pole_std(A, z[nearest], covariance)
    integrates = (
        not integrator and z[nearest].imag == 0 and off < min(3 * std + 1e-9, _MAX_DISTANCE_FROM_1)
    )
    if integrates:
        known = data.output in INTEGRATING_OUTPUTS
        then = f"{data.output} integrates, so" if known else f"if {data.output} integrates,"
        yield warning(
            "pole_at_1",
            f"a pole is 1 within its accuracy (distance {off:.1g}, standard deviation {std:.1g}): "
            f"{then} set the option integrator, or simulations drift",
            "integrator",
            off=off,
            std=std,
        )
    elif not integrator and _may_integrate(data, z[nearest]) and (found := integrating(data)):
        text = f"{found.text}, and a pole is {off:.1g} from 1: try the option integrator"
        yield warning("pole_near_1", text, off=off)
    others = np.abs(np.delete(z, nearest) if integrates else z)
    if np.any(others > 1 + 1e-9):
        yield unstable(float(others.max()), *REFLECT)


def _may_integrate(data: Dataset, z: complex) -> bool:
    """Return whether the pole z may be an integrator.

    If |z| > 1, y must also be known to integrate.
    """
    return abs(z - 1) < _MAX_DISTANCE_FROM_1 and (abs(z) <= 1 or data.output in INTEGRATING_OUTPUTS)


def _pole_std(A: Array, z: complex, covariance: Array) -> float:
    """Return the standard deviation of a real root z of A(q): dz = -sum da_k z^(n-k) / A'(z)."""
    n = A.size - 1
    slope = np.polyval(np.polyder(A), z)
    if slope == 0:
        return float("inf")
    by_a = np.real(-(z ** np.arange(n - 1, -1, -1)) / slope)
    return float(np.sqrt(max(by_a @ covariance[:n, :n] @ by_a, 0.0)))
