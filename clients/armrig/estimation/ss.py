"""State-space models with several inputs and outputs, by the prediction-error method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_signals
from armrig.data.dataset import Signals
from armrig.estimation.data_faults import require_informative
from armrig.estimation.estimated_outputs import origin
from armrig.estimation.fit_warnings import not_converged, with_doubts
from armrig.estimation.n4sid import n4sid, order_of
from armrig.estimation.orders import as_text, require_samples
from armrig.estimation.search import rank_ends
from armrig.estimation.stability import instability
from armrig.estimation.state_space_fit import derivatives, inference, influence, matrices
from armrig.estimation.state_space_gaps import search_with_gaps
from armrig.estimation.state_space_problem import (
    Linear,
    StateSpaceProblem,
    delays_of,
    experiments_with_response,
    parts_of,
    scale_signals,
    tangent,
)
from armrig.estimation.state_space_responses import ScaledExperiment
from armrig.estimation.state_space_starts import starts, starts_with_moved_eigenvalue
from armrig.models.estimate import Minimisation, Start
from armrig.models.fit import Fit
from armrig.models.structure_table import row_of
from armrig.numerics.checks import require_flags, require_integers
from armrig.numerics.covariance import pairwise_covariance, whitening
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import join_names, plural

_STEPS = 2  # steps of the search between two estimates of Lambda
_TRIED_STEPS = 6  # steps between two estimates of Lambda while the start values are tried
_MAX_ROUNDS = 120
_SAME_TOLERANCE = 1e-9  # change of log det Lambda at which the search ends
_TRIED_ROUNDS = 3  # rounds from every start value before only the best searches continue
_TRIED_TOLERANCE = 1e-3  # change of log det Lambda at which a trial ends
_PART_SAMPLES = 2000  # samples of long data on which every start is tried
_FILLED_SAMPLES = 5000  # samples from which the model that completes data with gaps is estimated
_DISTINCT = 1e-3  # least difference of log det Lambda between two distinct minima
_CONTINUED = 3  # searches that continue on all data
_MAX_MOVES = 3  # largest number of rounds in which a mode is moved
_MAX_CATCH_UP = 10  # a search ends if its excess over the best is larger than 10 last decreases


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    """State of a search."""

    name: str
    Abar: Array
    C: Array
    Lambda: Array
    criterion: float
    iterations: int = 0
    converged: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Criterion:
    """Criterion of the search: log det Lambda, or mean e^T inv(Lambda) e for a given Lambda."""

    given: Array | None

    def __call__(
        self, problem: StateSpaceProblem, Abar: Array, C: Array, linear: Linear
    ) -> tuple[Array, float]:
        """Return the weighting Lambda of the next round, and the logarithm of the criterion."""
        e = np.vstack(problem.residuals(linear.at))
        if self.given is None:
            Lambda = pairwise_covariance(e)
            return Lambda, float(np.linalg.slogdet(Lambda)[1])
        ny = e.shape[1]
        mean = np.nanmean(e**2 / np.diag(self.given))
        return self.given, ny * float(np.log(mean))


@takes_signals
def ss(
    data: Signals,
    order: int | None = None,
    *,
    nk: int | Sequence[int] = 1,
    noise: bool = True,
    output_weights: Sequence[float] | None = None,
) -> Fit:
    """Estimate A, B, C, D and K of x(t+1) = A x + B u + K e, y = C x + D u + e.

    The search minimises log det of the covariance of the prediction errors, or, with given weights
    w_i, the sum of w_i e_i². Inputs and outputs are scaled internally, so that the result does not
    depend on their units. The poles of the predictor, the eigenvalues of A - K C, are inside the
    unit circle.

    Parameters
    ----------
    data : Dataset or Signals
        N samples of nu inputs and ny outputs. After a missing y, a Kalman filter computes the
        predictions. The search then takes some three times as long.
    order : int, optional
        Number of states, >= 1; by default the order that `n4sid` chooses.
    nk : int or sequence of int, default 1
        Number of samples before each input reaches the outputs. With 0 for all inputs the model has
        a direct term D.
    noise : bool, default True
        Estimate K. With False the model is an output-error model, K = 0.
    output_weights : sequence of float, optional
        Weight w_i > 0 of each output. By default the estimated covariance of the noise weights the
        errors. Larger weights select the outputs that a model that is too simple must fit well.

    Returns
    -------
    Fit
        The covariance of the matrices is singular in the directions that only change the state's
        coordinates. Use the standard deviations of poles and responses.

    Raises
    ------
    ValueError
        There are too few samples, or the data do not determine the model.

    References
    ----------
    .. [1] T. McKelvey, A. Helmersson, T. Ribarits, Automatica 40 (2004) 1629-1635.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 7.2 and appendix 4A.

    Examples
    --------
    >>> signals = armrig.example_recording().signals()[:1000]
    >>> fit = armrig.ss(signals, order=4, noise=False)
    >>> A, B, C, D, K = fit.state_space()
    >>> A.shape, B.shape, C.shape
    ((4, 4), (4, 1), (2, 4))
    >>> for name, quality in zip(fit.outputs, fit.quality, strict=True):
    ...     print(f"{name}: {quality.fit_percent:.1f} %")
    theta_1: 100.0 %
    alpha: 97.5 %
    """
    if order is None:
        order = order_of(data, nk=nk)
    require_integers(order=(order, 1))
    require_flags(noise=noise)
    delays = delays_of(nk, data)
    data = experiments_with_response(data, delays)
    require_informative(data)
    n, nu, ny = int(order), data.nu, data.ny
    direct = max(delays) == 0
    parameters = n * (ny + nu) + (n * ny if noise else 0) + (ny * nu if direct else 0)
    require_samples(f"order={n}", needed=parameters // ny + 2 * n + 2, got=data.N)
    gaps = noise and data.missing > 0
    if gaps and output_weights is not None:
        raise InputError(
            f"{plural(data.missing, 'value is', 'values are')} missing: weights of outputs and an "
            "estimated K need complete data; leave out output_weights, or give noise=False"
        )
    filled = _fill_gaps(data, n, nk) if gaps else data
    signals, su, sy = scale_signals(filled, delays)
    problem = StateSpaceProblem(
        parts=parts_of(signals, np.eye(ny)), order=n, direct=direct, noise=noise
    )
    weights = _weights(output_weights, data)
    criterion = _Criterion(given=np.diag(1 / (np.array(weights) * sy**2)) if weights else None)
    ends = _search(problem, signals, criterion)
    best = ends[0]
    problem = _with_weights(problem, best.Lambda)
    linear = problem.linear(best.Abar, best.C)
    if linear.basis.rank < linear.basis.d:
        raise InputError(
            f"order={n}: the data determine only {linear.basis.rank} of {linear.basis.d} entries "
            "of B, D and K; lower the order or excite with richer inputs"
        )
    predictor = linear.at
    if gaps:
        measured = [
            (u, np.where(part.valid[part.N - len(y) :], y, np.nan))
            for (u, y), part in zip(signals, data.experiments(), strict=True)
        ]
        end = search_with_gaps(problem, measured, predictor, best.Lambda)
        problem, predictor = end.problem.problem, end.predictor
        best = replace(best, iterations=best.iterations + end.iterations, converged=end.converged)
        Psi, states, residuals = end.Psi, end.states, end.residuals
    else:
        Psi, states = influence(problem, predictor, tangent(best.Abar, best.C))
        residuals = problem.residuals(predictor)
    # With given weights the criterion has the units of the data already.
    unit = 1.0 if weights else float(np.prod(sy) ** (2 / ny))
    V = tangent(predictor.Abar, predictor.C)
    by = derivatives(problem, predictor, V)
    form, T = matrices(predictor, by, su, sy, delays)
    inferred = inference(data, problem, Psi, states, residuals, sy).transformed(T)
    notes = [] if best.converged else [not_converged(best.iterations)]
    fit = Fit(
        structure="ss",
        specification=as_text(order=n, nk=delays) + ("" if noise else ", noise=False"),
        form=form,
        output_weights=weights,
        search=Minimisation(
            converged=best.converged,
            starts=tuple(
                Start(
                    name=e.name,
                    loss=float(np.exp(e.criterion / ny)) * unit,
                    iterations=e.iterations,
                    converged=e.converged,
                )
                for e in ends
            ),
        ),
        findings=(*notes, *instability(form)),
        **inferred.fields(),
        **origin(data),
    )
    return with_doubts(fit)


def _fill_gaps(data: Signals, order: int, nk: int | Sequence[int]) -> Signals:
    """Return the data with predictions of missing outputs by a subspace model, or a simulation."""
    try:
        model = n4sid(data[:_FILLED_SAMPLES], order, nk=nk, replicates=0)
    except InputError:  # windows without a long gap are too few
        model = ss(data, order=order, nk=nk, noise=False)
    predicted = model.predict(data, horizon=1 if row_of(model.structure).projection else None)
    y = np.where(data.valid, data.y, predicted.reshape(data.y.shape))
    return data.replaced(step=None, y=y, valid=np.isfinite(y))


def _weights(output_weights: Sequence[float] | None, data: Signals) -> tuple[float, ...]:
    """Return the weights of the outputs; () if none are given."""
    if output_weights is None:
        return ()
    values = np.asarray(output_weights, dtype=np.float64)
    if values.shape != (data.ny,) or not (np.isfinite(values) & (values > 0)).all():
        raise InputError(
            f"output_weights={output_weights!r} must be {data.ny} positive numbers, one for "
            "each output of "
            f"{join_names(data.outputs)}"
        )
    return tuple(values.tolist())


def _with_weights(problem: StateSpaceProblem, Lambda: Array) -> StateSpaceProblem:
    parts = tuple(replace(p, weights=whitening(Lambda, p.rows)) for p in problem.parts)
    return replace(problem, parts=parts)


def _search(
    problem: StateSpaceProblem, signals: Sequence[tuple[Array, Array]], criterion: _Criterion
) -> list[_End]:
    """Return the searches from start values and moved modes on a part, continued on all data."""
    part = _part(problem)
    ends = _try_searches(part, _first_ends(part, starts(problem, signals), criterion), criterion)
    for _ in range(_MAX_MOVES):
        best = ends[0]
        moved = _first_ends(part, starts_with_moved_eigenvalue(part, best.Abar, best.C), criterion)
        ends = _different([*ends, *_try_searches(part, moved, criterion)])
        if ends[0] is best:
            break
    improved: list[_End] = []
    for end in ends[:_CONTINUED]:
        least = min((end.criterion for end in improved), default=np.inf)
        begun = replace(end, criterion=np.inf, converged=False)
        improved.append(_improve(problem, begun, criterion, least))
    return rank_ends(improved, lambda end: end.criterion)


def _first_ends(
    problem: StateSpaceProblem, values: Mapping[str, tuple[Array, Array]], criterion: _Criterion
) -> list[_End]:
    """Return the criterion and Lambda at each start value, as the first state of each search."""
    ends = []
    for name, (Abar, C) in values.items():
        Lambda, value = criterion(problem, Abar, C, problem.linear(Abar, C))
        ends.append(_End(name=name, Abar=Abar, C=C, Lambda=Lambda, criterion=value))
    return ends


def _try_searches(
    problem: StateSpaceProblem, ends: list[_End], criterion: _Criterion
) -> list[_End]:
    """Return the distinct models after `_TRIED_ROUNDS` rounds of each search, best first."""
    for _ in range(_TRIED_ROUNDS):
        ends = _different(
            [_round(problem, end, criterion, _TRIED_STEPS, _TRIED_TOLERANCE) for end in ends]
        )
    return ends


def _part(problem: StateSpaceProblem) -> StateSpaceProblem:
    """Return the problem for at most the first `_PART_SAMPLES` samples of the data."""
    left, parts = _PART_SAMPLES, []
    for part in problem.parts:
        n = min(part.u.shape[0], left)
        if n > 0:
            fields = {name: getattr(part, name)[:n] for name in ("u", "y", "rows", "weights")}
            parts.append(ScaledExperiment(**fields))
        left -= n
    return replace(problem, parts=tuple(parts))


def _different(ends: list[_End]) -> list[_End]:
    """Return the searches with distinct criteria, best first."""
    kept: list[_End] = []
    for end in sorted(ends, key=lambda end: end.criterion):
        if not kept or end.criterion > kept[-1].criterion + _DISTINCT:
            kept.append(end)
    return kept


def _improve(problem: StateSpaceProblem, end: _End, criterion: _Criterion, least: float) -> _End:
    """Continue the search `end`; stop early if the criterion falls too slowly to reach `least`."""
    for _ in range(_MAX_ROUNDS):
        before, end = end, _round(problem, end, criterion, _STEPS, _SAME_TOLERANCE)
        decrease = before.criterion - end.criterion
        if end.converged or end.criterion - least > _MAX_CATCH_UP * decrease:
            break
    return end


def _round(
    problem: StateSpaceProblem, end: _End, criterion: _Criterion, most: int, tolerance: float
) -> _End:
    """Continue the search for at most `most` steps with the same Lambda, then estimate Lambda."""
    if end.converged:
        return end
    weighted = _with_weights(problem, end.Lambda)
    Abar, C, linear, optimum = weighted.minimise(end.Abar, end.C, most=most)
    Lambda, value = criterion(weighted, Abar, C, linear)
    return replace(
        end,
        Abar=Abar,
        C=C,
        Lambda=Lambda,
        criterion=value,
        iterations=end.iterations + optimum.iterations,
        converged=abs(end.criterion - value) <= tolerance,
    )
