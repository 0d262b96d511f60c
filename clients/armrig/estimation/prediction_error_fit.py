"""Prediction-error estimate, from the start values to a `Fit`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import get_args

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding, warning
from armrig.estimation.data_faults import CONSTANT_INPUT, constant_input, data_faults
from armrig.estimation.multistart import Ends, rounding_floor, same_minimum, searched_minimum
from armrig.estimation.orders import require_samples
from armrig.estimation.prediction_error import PredictionErrorProblem, Solution
from armrig.estimation.stability import with_stability_warning, with_stable_poles
from armrig.models.fit import Fit
from armrig.models.innovations import Errors, Unknown, prepared
from armrig.models.quality import MAX_TRUSTED_CURVATURE, Start
from armrig.models.structure import FreeResponse, Structure, offset_from_ramp
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.inference import Inference, infer, least_squares_residuals
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, roots
from armrig.numerics.quantities import plural
from armrig.numerics.whiteness import Whiteness

PART_SAMPLES = 3000
"""Number of samples in the part of long data on which searches start. If the data have at most
twice this number of samples, searches start on all data."""
MAX_PULSE_SHARE = 0.01
"""Largest number of pulses after gaps, divided by the number of errors, without a warning of the
fit. `PredictionErrorProblem` explains the pulses."""
CURVED_TEXT = (
    "do not trust the standard deviations of the coefficients: the loss is far from parabolic "
    "within two standard deviations. A pole and a zero may nearly cancel. The standard deviations "
    "of the responses are valid"
)
_CIRCLE_TOLERANCE = 1e-6
AUTO_LEVEL = 0.05
"""Level of the F-test for the initial state."""
_PROBED_SIGMAS = 2.0
_MIN_RISE_RATIO = 1e-3  # a smaller ratio is set to this value
_MAX_CURVATURE = -float(np.log(_MIN_RISE_RATIO))


def searched(
    data: Dataset,
    structure: Structure,
    *,
    name: str,
    orders: str,
    initial: Initial,
    stable: bool = False,
    starts: Starts = "many",
) -> Fit:
    """Return the model at the lowest minimum of the prediction error over all start values.

    Parameters
    ----------
    structure : Structure
        Orders without the root of the integrator. `initial` replaces `at_rest` of the structure.
    name : str
        Name of the structure, for the `Fit`.
    orders : str
        Orders as the caller gave them, for messages.
    initial : {"estimate", "backcast", "zero", "auto"}
        State at the start of each experiment. "backcast", a name from MATLAB, has the same effect
        as "estimate": the search estimates the state by least squares at every step.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, and estimate B again.
    starts : {"many", "few"}
        Number of additional start values, as in `armax`.

    Raises
    ------
    ValueError
        There are too few samples, u does not excite the model, or an option is unknown.
    """
    if initial not in get_args(Initial):
        allowed = ", ".join(f'"{x}"' for x in get_args(Initial))
        raise InputError(f"initial={initial!r} must be one of {allowed}")
    if starts not in get_args(Starts):
        raise InputError(f'starts={starts!r} must be "many" or "few"')
    if initial == "backcast":
        initial = "estimate"
    if structure.offset and initial != "estimate":
        raise InputError(
            f'offset=True needs initial="estimate", got {initial!r}: a rig at rest has no offset'
        )
    if initial == "auto":
        either = partial(
            searched, data, structure, name=name, orders=orders, stable=stable, starts=starts
        )
        free, at_rest = either(initial="estimate"), either(initial="zero")
        return free if _state_matters(free, at_rest) else at_rest
    if constant_input(data) and (structure.trend or not data.u.any()):
        raise InputError(CONSTANT_INPUT)
    n = replace(structure, at_rest=initial == "zero")
    problem = PredictionErrorProblem(
        experiments=tuple(prepared(part, n) for part in data.experiments()), structure=n
    )
    d = n.na + n.nb + n.nc + n.nd + n.nf
    fewest = d + 1 + _nuisance(problem)
    require_samples(orders, needed=fewest, got=data.N - data.missing)
    ends = searched_minimum(problem, _part(data, n), thorough=starts == "many")
    best = ends[0][1]
    solution = problem.solve(best.theta)
    if solution.rank < n.na + n.nb:
        what = "numerator coefficients" if n.na == 0 else "coefficients of A and B"
        raise InputError(
            f"{orders}: u determines only {solution.rank} of {n.na + n.nb} {what}; "
            f"lower {'nb' if n.na == 0 else 'the orders'} or excite with a richer input"
        )
    notes: tuple[EstimateFinding, ...] = ()
    theta = best.theta
    if stable:
        theta, solution, notes = with_stable_poles(problem, solution, theta)
    fit = _fit(data, problem, solution, ends, theta, name)
    return with_stability_warning(replace(fit, findings=(*fit.findings, *notes)))


def _part(data: Dataset, structure: Structure) -> PredictionErrorProblem | None:
    """Return the problem for the part of the data in which u moves most; None for short data."""
    if data.N <= 2 * PART_SAMPLES:
        return None
    begins = np.linspace(0, data.N - PART_SAMPLES, 8).astype(int)
    moves = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(data.u, prepend=data.u[0])))])
    begin = int(begins[np.argmax(moves[begins + PART_SAMPLES] - moves[begins])])
    part = data[begin : begin + PART_SAMPLES]
    n = replace(structure, at_rest=False)
    problem = PredictionErrorProblem(
        experiments=tuple(prepared(x, n) for x in part.experiments()), structure=n
    )
    enough = 2 * (n.na + n.nb + n.nc + n.nd + n.nf + _nuisance(problem))
    return problem if part.N - part.missing > enough else None


def _nuisance(problem: PredictionErrorProblem) -> int:
    """Return the number of samples that are needed to determine the unknown past."""
    n = problem.structure
    state = (n.count + n.trend) * len(problem.experiments)
    return state + sum(
        0 if n.white else max(n.memory, n.first - s.start) * int(not (n.at_rest and s.start == 0))
        for x in problem.experiments
        for s in x.stretches
    )


def _state_matters(free: Fit, at_rest: Fit) -> bool:
    """Return whether the initial state is significant, by an F-test."""
    from scipy.special import fdtrc

    sse, rest = free.loss * free.N, at_rest.loss * at_rest.N
    degrees, fewer = (round(f.loss * f.N / f.noise_variance) for f in (free, at_rest))
    p = fewer - degrees
    if p <= 0 or sse <= 0:
        return True
    return bool(fdtrc(p, degrees, max(rest - sse, 0.0) / p / (sse / degrees)) < AUTO_LEVEL)


def _fit(
    data: Dataset,
    problem: PredictionErrorProblem,
    solution: Solution,
    ends: Ends,
    theta: Array,
    name: str,
) -> Fit:
    # A search also counts as converged if its cost consists only of rounding errors.
    floor = rounding_floor(problem)
    ends = [(start, replace(o, converged=o.converged or o.cost <= floor)) for start, o in ends]
    n, best = problem.structure, ends[0][1]
    p = problem.named(solution.ab, theta)
    basis = orthonormal(solution.Psi)
    free = _inference(data, problem, solution, basis)
    found = free.transformed(with_integrator(n))
    of_theta = free.covariance[n.na + n.nb :, n.na + n.nb :]
    exact = best.cost <= floor
    curved = 0.0 if exact else curvature(problem, theta, of_theta, found.noise_variance)
    N, white = found.quality[0].N, found.quality[0].white
    agreed = same_minimum(problem, best.cost, ends[-1][1].cost)
    starts = tuple(
        Start(name=start, loss=o.cost / N, iterations=o.iterations, converged=o.converged)
        for start, o in ends
    )
    responses = [
        _free_response(n, p, part, s)
        for part, s in zip(data.experiments(), solution.parts, strict=True)
    ]
    if n.integrator:
        letter = n.integrator.upper()
        p[letter] = np.convolve([1.0, -1.0], p[letter])
    return Fit.of_channel(
        structure=name,
        A=p["A"],
        B=p["B"],
        C=p["C"],
        D=p["D"],
        F=p["F"],
        nk=n.nk,
        integrator=bool(n.integrator),
        offset=bool(n.trend),
        Ts=data.Ts,
        converged=best.converged,
        starts=starts if len(starts) > 1 else (),
        agreed=agreed,
        free=tuple(responses),
        curvature=curved,
        findings=(
            *_search_warnings(best, starts, agreed=agreed),
            *_parameter_warnings(basis, white, p["C"], curved),
            *_gap_warnings([g.unknown for g in solution.given], N),
            *data_faults(
                data,
                _residuals(problem, solution),
                way_out="" if n.trend else "estimate it, too (option offset)",
            ),
        ),
        **found.of_one_output(),
        **data.origin(),
    )


def _inference(
    data: Dataset, problem: PredictionErrorProblem, solution: Solution, basis: Basis
) -> Inference:
    """Return the covariance of the parameters, the loss and the test of whiteness."""
    spans = [g.unknown.span for g in solution.given]
    return infer(
        least_squares_residuals(_residuals(problem, solution), basis, spans=spans, y=data.y),
        basis.W,
        score="exogenous" if problem.structure.white else "correlated",
        rounding=rounding_floor(problem),
    )


def _residuals(problem: PredictionErrorProblem, solution: Solution) -> list[Array]:
    """Return e of each experiment, (N_i,), NaN in rows without an error."""
    parts = zip(problem.experiments, solution.parts, strict=True)
    return [np.where(x.rows, s.e, np.nan) for x, s in parts]


def with_integrator(n: Structure) -> Array:
    """Return the derivatives of (a, b, c, d, f) with respect to the estimated coefficients.

    For F = (1 - q^-1) F̃ the coefficients are f_k = f̃_k - f̃_(k-1), and f_1 = f̃_1 - 1. Their
    derivatives are therefore constant. An integrator in A leads to the same equations.
    """
    sizes = {"a": n.na, "b": n.nb, "c": n.nc, "d": n.nd, "f": n.nf}
    blocks = [
        np.eye(k + 1, k) - np.eye(k + 1, k, k=-1) if letter == n.integrator else np.eye(k)
        for letter, k in sizes.items()
    ]
    whole = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    i = j = 0
    for b in blocks:
        whole[i : i + b.shape[0], j : j + b.shape[1]] = b
        i, j = i + b.shape[0], j + b.shape[1]
    return whole


def _free_response(
    n: Structure, p: dict[str, Array], part: Dataset, errors: Errors
) -> FreeResponse:
    transients = tuple(float(v) for v in errors.state[: n.count])
    coefficients = [float(v) for v in errors.state[n.count :]]
    if n.trend == 0:
        return FreeResponse(transients=transients)
    if n.trend == 2:
        level, slope = coefficients
        offset = offset_from_ramp(p["B"], p["F"], slope, float(np.mean(part.u)))
        return FreeResponse(transients=transients, level=level, offset=offset)
    offset = offset_from_ramp(p["B"], p["F"], coefficients[0], 0.0)
    return FreeResponse(transients=transients, offset=offset)


def _search_warnings(
    best: Optimum, starts: tuple[Start, ...], *, agreed: bool
) -> Iterator[EstimateFinding]:
    if not best.converged:
        text = f"the search did not converge in {best.iterations} steps"
        yield warning("not_converged", text, steps=best.iterations)
    if not agreed:
        text = (
            f"the search from {starts[-1].name!r} ended in a poorer minimum "
            f"(loss {starts[-1].loss:.4g})"
        )
        yield warning("poorer_minimum", text, loss=starts[-1].loss)


def _parameter_warnings(
    basis: Basis, white: Whiteness, C: Array, curved: float
) -> Iterator[EstimateFinding]:
    if C.size > 1 and np.max(np.abs(roots(C))) > 1 - _CIRCLE_TOLERANCE:
        yield warning(
            "root_on_circle",
            "C has a root on the unit circle, the limit of the search, so the standard deviation "
            "of the root has no meaning. Lower nc, or check whether the data were differenced or "
            "detrended",
        )
    d = basis.W.shape[0]
    if basis.rank < d:
        text = f"the data determine only {basis.rank} of {d} parameters: lower the orders"
        yield warning("undetermined", text, rank=basis.rank, parameters=d)
    if curved > MAX_TRUSTED_CURVATURE and not white.coloured:
        yield warning("curved", CURVED_TEXT, curvature=curved)


def _gap_warnings(unknown: list[Unknown], N: int) -> Iterator[EstimateFinding]:
    """Yield a warning if many gaps bias the noise model, as `PredictionErrorProblem` explains."""
    pulses = [Q.shape[1] for past in unknown for _, Q in past.noise][1:]
    if sum(pulses) > MAX_PULSE_SHARE * N:
        yield warning(
            "gaps",
            f"the data have {plural(len(pulses), 'gap')}, after which the noise model starts "
            "again. A, C and D may be off by up to half a standard deviation; the test of "
            "whiteness rejects too often",
            count=len(pulses),
        )


def curvature(
    problem: PredictionErrorProblem, theta: Array, covariance: Array, noise_variance: float
) -> float:
    """Return the largest |ln r|; r is the rise of the loss divided by the rise of a parabola.

    Both rises are computed two standard deviations from the minimum, in both directions of each
    principal axis v. The axes are the principal axes of the scaled covariance of (c, d, f). At each
    point the coefficients a and b are fitted again. If the loss V is a parabola and s is the
    standard deviation along v ::

        (V(theta ± 2 s v) - V(theta)) / lambda = 4

    Parameters
    ----------
    theta : ndarray (n,)
        Parameters (c, d, f) at the minimum.
    covariance : ndarray (n, n)
        Covariance of theta.
    noise_variance : float
        Variance lambda of e.

    Returns
    -------
    float
        0 if the loss is a parabola or the model has no c, d or f; at most 6.9.

    References
    ----------
    .. [1] D. M. Bates, D. G. Watts, *Nonlinear Regression Analysis and Its Applications*, 1988,
       section 6.1 (profiles of the sum of squares).
    """
    deviation = np.sqrt(np.diag(covariance))
    if not theta.size or not noise_variance > 0 or not np.all(deviation > 0):
        return 0.0
    values, axes = np.linalg.eigh(covariance / np.outer(deviation, deviation))
    least, worst = problem.cost(theta), 0.0
    for value, axis in zip(values, axes.T, strict=True):
        step = _PROBED_SIGMAS * np.sqrt(max(value, 0.0)) * deviation * axis
        for moved in (theta + step, theta - step):
            if not problem.admissible(moved):
                return _MAX_CURVATURE
            rise = (problem.cost(moved) - least) / noise_variance / _PROBED_SIGMAS**2
            worst = max(worst, abs(float(np.log(max(rise, _MIN_RISE_RATIO)))))
    return worst
