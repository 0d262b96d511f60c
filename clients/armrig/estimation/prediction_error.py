"""Prediction-error estimate of a structure, from its orders to a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, get_args

import numpy as np
from armrig_core.errors import InputError
from scipy.linalg import block_diag

from armrig.data.dataset import Dataset, Signals
from armrig.data.experiments import Experiments
from armrig.data.finding import Finding
from armrig.estimation.continuous_problem import ContinuousProblem
from armrig.estimation.data_faults import (
    CONSTANT_INPUT,
    constant_input,
    data_faults,
    require_informative,
    require_moving_output,
)
from armrig.estimation.estimated_outputs import EstimatedOutput, fit_of_outputs
from armrig.estimation.fit_warnings import (
    not_converged,
    parameter_warnings,
    search_warnings,
    with_doubts,
)
from armrig.estimation.orders import (
    Integrator,
    Shared,
    as_text,
    integrating_outputs,
    order_arrays,
    require_samples,
    structures,
)
from armrig.estimation.problem import PolynomialProblem, Solution
from armrig.estimation.search import (
    Ends,
    rounding_floor,
    same_minimum,
    search_minima,
    search_together,
    with_noise_weights,
)
from armrig.estimation.stability import instability, with_stability_warning, with_stable_poles
from armrig.models.estimate import Minimisation, Start
from armrig.models.fit import Fit
from armrig.models.innovations import Errors, prepare
from armrig.models.structure import FreeResponse, Structure, offset_from_ramp
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_known
from armrig.numerics.covariance import unspread
from armrig.numerics.curvature import curvature
from armrig.numerics.inference import OutputResiduals
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array

PART_SAMPLES = 3000
"""Number of samples in the part of long data on which searches start. If the data have at most
twice this number of samples, searches start on all data."""
AUTO_LEVEL = 0.05
"""Level of the F-test for the initial state."""


class SearchOptions(TypedDict, total=False):
    """Options of a search, which `oe` documents; `estimated` has their defaults."""

    integrator: Integrator
    offset: bool
    initial: Initial
    stable: bool
    starts: Starts
    shared: Shared


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """Data, and options of a search that are the same for all outputs."""

    data: Dataset | Signals
    orders: str
    initial: Initial
    stable: bool
    thorough: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupEstimate:
    """Estimate of the outputs that share a polynomial, or of one output."""

    outputs: tuple[int, ...]
    """Index of the output of each row."""
    problem: PolynomialProblem
    solution: Solution
    theta: Array
    ends: Ends
    findings: tuple[Finding, ...] = ()

    @property
    def parameters(self) -> int:
        """Number of estimated coefficients."""
        return int(self.solution.by_ab.shape[1] + self.solution.by_theta.shape[1])

    def starts(self, prefix: str = "") -> Iterator[Start]:
        """Yield the result from each start value, with the mean square of the whitened errors."""
        for name, o in self.ends:
            yield Start(
                name=prefix + name,
                loss=o.cost / self.problem.N,
                iterations=o.iterations,
                converged=o.converged,
            )


def estimated(
    data: Dataset | Signals,
    name: str,
    orders: Mapping[str, Any],
    *,
    integrator: Integrator = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
    shared: Shared = "",
) -> Fit:
    """Return the model at the lowest minimum of the prediction error over all start values.

    One output is estimated after the other, unless the outputs share a denominator. `name` is the
    name of the structure in `structure_table`; `orders` contains its orders and nk, as the caller
    gave them. `oe` documents the options.

    Raises
    ------
    ValueError
        There are too few samples, u does not excite the model, or an option is unknown.
    """
    require_known(
        initial=(initial, get_args(Initial)),
        starts=(starts, get_args(Starts)),
        shared=(shared, get_args(Shared)),
    )
    if isinstance(data, Signals) and (data.nu, data.ny) == (1, 1):
        data = data.dataset()
    if initial == "backcast":
        initial = "estimate"
    if offset and initial != "estimate":
        raise InputError(
            f'offset=True needs initial="estimate", got {initial!r}: a rig at rest has no offset'
        )
    integrators = integrating_outputs(integrator, data)
    arrays = order_arrays(data, name, orders, integrators, shared)
    rows = structures(arrays, name, integrators, offset=offset, shared=bool(shared))
    if isinstance(data, Signals):
        require_informative(data)
    else:
        require_moving_output(data)
    if isinstance(data, Dataset) and constant_input(data) and (rows[0].trend or not data.u.any()):
        raise InputError(CONSTANT_INPUT)
    text, thorough = as_text(**arrays), starts == "many"
    task = _Task(data=data, orders=text, initial=initial, stable=stable, thorough=thorough)
    groups = [tuple(range(len(rows)))] if shared else [(i,) for i in range(len(rows))]
    group_estimates = [_estimate_group(task, [rows[i] for i in group], group) for group in groups]
    estimates, W = outputs_of(data, group_estimates)
    white = all(n.white for n in rows)
    fields: dict[str, Any] = {
        "structure": name,
        "score": "exogenous" if white else "correlated",
    }
    converged = all(group_estimate.ends[0][1].converged for group_estimate in group_estimates)
    if isinstance(data, Dataset):
        group, estimate = group_estimates[0], estimates[0]
        fit = fit_of_one(data, group, estimate, W, converged=converged, **fields)
        return with_stability_warning(fit)
    fields |= {"specification": text, "offset": offset, "shared": bool(shared)}
    notes, starts_ = (
        [note for group_estimate in group_estimates for note in group_estimate.findings],
        list[Start](),
    )
    for group_estimate in group_estimates:
        names, best = (
            ", ".join(data.outputs[i] for i in group_estimate.outputs),
            group_estimate.ends[0][1],
        )
        starts_ += group_estimate.starts(f"{names}: ")
        notes += [] if best.converged else [not_converged(best.iterations, f" of {names}")]
    search = Minimisation(converged=converged, starts=tuple(starts_))
    fit = fit_of_outputs(data, estimates, W, search=search, **fields)
    fit = with_curvature(fit, group_estimates, estimates, W)
    return replace(fit, findings=(*notes, *instability(fit.form), *fit.findings))


def _estimate_group(
    task: _Task, rows: Sequence[Structure], outputs: tuple[int, ...]
) -> GroupEstimate:
    """Return the estimate; with initial="auto" an F-test chooses the treatment of the state."""
    free, at_rest = ([replace(n, at_rest=resting) for n in rows] for resting in (False, True))
    if task.initial != "auto":
        return _search_group(task, at_rest if task.initial == "zero" else free, outputs)
    with_state, simpler = _search_group(task, free, outputs), _search_group(task, at_rest, outputs)
    return with_state if _state_matters(with_state, simpler) else simpler


def _search_group(
    task: _Task, rows: Sequence[Structure], outputs: tuple[int, ...]
) -> GroupEstimate:
    data, orders = task.data, task.orders
    problem = _problem(data, rows, outputs)
    measured = sum(int(np.isfinite(_output(data, i)).sum()) for i in outputs)
    require_samples(orders, needed=_size(problem) + 1 + nuisance(problem), got=measured)
    if len(rows) == 1:
        part = _part(data, rows, outputs)
        ends = search_minima(problem, part, thorough=task.thorough)
    else:
        problem, ends = search_together(problem)
    # A search also counts as converged if its cost consists only of rounding errors.
    floor = rounding_floor(problem)
    ends = [(start, replace(o, converged=o.converged or o.cost <= floor)) for start, o in ends]
    theta = ends[0][1].theta
    solution = problem.solve(theta)
    d = problem.linear_size
    if solution.rank < d:
        no_a = d == sum(sum(n.nb) for n in rows)
        coefficients = "numerator coefficients" if no_a else "coefficients of A and B"
        raise InputError(
            f"{orders}: u determines only {solution.rank} of {d} {coefficients}; "
            f"lower {'nb' if no_a else 'the orders'} or excite with a richer input"
        )
    notes: tuple[Finding, ...] = ()
    if task.stable:
        theta, solution, notes = with_stable_poles(problem, solution, theta)
    return GroupEstimate(
        outputs=outputs, problem=problem, solution=solution, theta=theta, ends=ends, findings=notes
    )


def _problem(
    data: Dataset | Signals, rows: Sequence[Structure], outputs: tuple[int, ...]
) -> PolynomialProblem:
    """Return the problem; the variances of several outputs are their first weights."""
    experiments = tuple(
        tuple(prepare(part.u, _output(part, i), n) for i, n in zip(outputs, rows, strict=True))
        for part in data.experiments()
    )
    problem = PolynomialProblem(rows=tuple(rows), experiments=experiments)
    if len(rows) == 1:
        return problem
    return with_noise_weights(
        problem, np.diag([float(np.nanvar(_output(data, i))) for i in outputs])
    )


def _output(data: Experiments, i: int) -> Array:
    """Return output i (N,), NaN where it is missing."""
    return data.signals().y[:, i]


def _part(
    data: Dataset | Signals, rows: Sequence[Structure], outputs: tuple[int, ...]
) -> PolynomialProblem | None:
    """Return the problem for the part of the data in which u moves most; None for short data."""
    if data.N <= 2 * PART_SAMPLES:
        return None
    u = data.signals().u
    begins = np.linspace(0, data.N - PART_SAMPLES, 8).astype(int)
    steps = np.abs(np.diff(u, axis=0, prepend=u[:1]))
    moves = np.concatenate(
        [[0.0], np.cumsum((steps / np.maximum(np.std(u, axis=0), 1e-300)).sum(axis=1))]
    )
    begin = int(begins[np.argmax(moves[begins + PART_SAMPLES] - moves[begins])])
    part = data[begin : begin + PART_SAMPLES]
    problem = _problem(part, [replace(n, at_rest=False) for n in rows], outputs)
    enough = 2 * (_size(problem) + nuisance(problem))
    measured = sum(int(np.isfinite(_output(part, i)).sum()) for i in outputs)
    return problem if measured > enough else None


def _size(problem: PolynomialProblem) -> int:
    return problem.linear_size + problem.size


def nuisance(problem: PolynomialProblem) -> int:
    """Return the number of samples that are needed to determine the unknown past."""
    return sum(
        sum(n.counts) + n.trend + (0 if n.white else n.past_pulse_count(x.begin))
        for experiment in problem.experiments
        for n, x in zip(problem.rows, experiment, strict=True)
    )


def _state_matters(free: GroupEstimate, at_rest: GroupEstimate) -> bool:
    """Return whether the initial state is significant, by an F-test."""
    from scipy.special import fdtrc

    rest_problem = at_rest.problem
    if len(rest_problem.rows) > 1:
        rest_problem = replace(rest_problem, weights=free.problem.weights)
    e, e_rest = free.solution.e, rest_problem.solve(at_rest.theta).e
    sse, sse_rest = float(e @ e), float(e_rest @ e_rest)
    degrees, fewer = (_degrees(estimate) for estimate in (free, at_rest))
    p = fewer - degrees
    if p <= 0 or sse <= 0:
        return True
    return bool(fdtrc(p, degrees, max(sse_rest - sse, 0.0) / p / (sse / degrees)) < AUTO_LEVEL)


def _degrees(group: GroupEstimate) -> int:
    """Return the degrees of freedom of the errors."""
    return group.problem.N - group.parameters - sum(past.rank for past in group.solution.past)


def fit_of_one(
    data: Dataset,
    group: GroupEstimate,
    estimate: EstimatedOutput,
    W: Array,
    in_s: ContinuousProblem | None = None,
    *,
    converged: bool = True,
    **fields: Any,
) -> Fit:
    """Return the model of one input and one output; `in_s` is the problem of a search in s."""
    problem, solution = group.problem, group.solution
    floor, n, best = rounding_floor(problem), problem.rows[0], group.ends[0][1]
    p, starts = problem.named(solution.ab, group.theta), tuple(group.starts())
    agreed = same_minimum(problem, best.cost, group.ends[-1][1].cost)
    free = [
        free_response(n, p, part, s)
        for part, (s,) in zip(data.experiments(), solution.parts, strict=True)
    ]
    fit = fit_of_outputs(
        data,
        [estimate],
        W,
        rounding=floor,
        offset=bool(n.trend),
        search=Minimisation(
            converged=converged, starts=starts if len(starts) > 1 else (), agreed=agreed
        ),
        free=tuple(free),
        **fields,
    )
    fit = with_curvature(fit, [group], [estimate], W, in_s)
    residuals = [r.e for r in estimate.residuals]
    way_out = "" if n.trend else "estimate it, too (option offset)"
    findings = (
        *search_warnings(best, starts, agreed=agreed),
        *parameter_warnings(W, p["C"]),
        *fit.findings,
        *data_faults(data, residuals, way_out=way_out),
        *group.findings,
    )
    return replace(fit, findings=findings)


def with_curvature(
    fit: Fit,
    groups: Sequence[GroupEstimate],
    estimates: Sequence[EstimatedOutput],
    W: Array,
    in_s: ContinuousProblem | None = None,
) -> Fit:
    """Return the fit with the largest curvature of a loss, and a warning if it is large."""
    back = np.linalg.pinv(np.vstack([group.J for group in estimates]))
    robust = back @ fit.covariance_robust @ back.T
    worst, begin = 0.0, 0
    for group in groups:
        problem, best, e = in_s or group.problem, group.ends[0][1], group.solution.e
        indices = np.arange(begin + group.problem.linear_size, begin + group.parameters)
        begin += group.parameters
        if best.cost <= rounding_floor(group.problem):
            continue
        at, degrees = group.theta if in_s is None else best.theta, max(_degrees(group), 1)
        # In data with gaps the search is over A, too, which is linear.
        followers = slice(0, group.problem.slice_of("a", 0).stop if in_s is None else 0)
        kept = np.delete(indices, followers)

        def cost(theta: Array, problem: Any = problem) -> float:
            return float(problem.cost(theta)) if problem.circle.admits(theta) else np.inf

        curved = curvature(
            cost,
            at,
            float(e @ e) / degrees * W[indices] @ W[indices].T,
            cost(at) / degrees,
            used=robust[np.ix_(kept, kept)] if fit.trusts_robust else None,
            followers=followers,
        )
        worst = max(worst, curved)
    return with_doubts(replace(fit, search=replace(fit.search, curvature=worst)))


def with_integrator(n: Structure) -> Array:
    """Return the derivatives of (a, b, c, d, f of each input) by the estimated coefficients.

    The estimated coefficients are (a, b, c, d, f of each group). For F = (1 - q^-1) F̃ the
    coefficients are f_k = f̃_k - f̃_(k-1), and f_1 = f̃_1 - 1. Their derivatives are therefore
    constant. An integrator in A leads to the same equations.
    """
    sizes = [n.na, sum(n.nb), n.nc, n.nd, *n.sizes]
    begins = np.cumsum([0, *sizes])
    none = np.zeros((0, begins[-1]))  # an input without effect has F = 1
    of_inputs = {j: k for k, group in enumerate(n.groups, 4) for j in group}
    blocks = [(k, "abcd"[k]) for k in range(4)]
    blocks += [(of_inputs.get(j, len(sizes)), "f") for j in range(len(n.nb))]
    derivatives = []
    for k, letter in blocks:
        block = np.eye(begins[-1])[begins[k] : begins[k + 1]] if k < len(sizes) else none
        if letter == n.integrator:
            size = len(block)
            block = (np.eye(size + 1, size) - np.eye(size + 1, size, k=-1)) @ block
        derivatives.append(block)
    return np.vstack(derivatives)


def free_response(n: Structure, p: dict[str, Any], part: Dataset, errors: Errors) -> FreeResponse:
    """Return the initial state and the input offset of one experiment."""
    count = sum(n.counts)
    transients = tuple(float(v) for v in errors.state[:count])
    coefficients = [float(v) for v in errors.state[count:]]
    if n.trend == 0:
        return FreeResponse(transients=transients)
    B, F = p["B"][0], p["F"][0]
    if n.trend == 2:
        level, slope = coefficients
        offset = offset_from_ramp(B, F, slope, float(np.mean(part.u)))
        return FreeResponse(transients=transients, level=level, offset=offset)
    return FreeResponse(transients=transients, offset=offset_from_ramp(B, F, coefficients[0], 0.0))


def outputs_of(
    data: Dataset | Signals, groups: Sequence[GroupEstimate], J: Array | None = None
) -> tuple[list[EstimatedOutput], Array]:
    """Return the polynomials and residuals of each output, and the matrix W of `fit_of_outputs`.

    J are the derivatives of the coefficients of a single output, by default of polynomials.
    """
    bases = [orthonormal(group.solution.Psi) for group in groups]
    W = block_diag(*(basis.W for basis in bases))
    alone = W.shape[1] == bases[0].rank and len(groups[0].outputs) == 1
    ny = data.signals().ny
    outputs: dict[int, EstimatedOutput] = {}
    row = column = 0
    for group, basis in zip(groups, bases, strict=True):
        problem, solution, k = group.problem, group.solution, len(group.outputs)
        ends = np.cumsum([k * experiment[0].y.size for experiment in problem.experiments])[:-1]
        shares, Psis = np.split(basis.Q, ends), np.split(solution.Psi, ends)
        whitened = [unspread(problem.weights[e], Q) if k > 1 else [Q] for e, Q in enumerate(shares)]
        for r, (i, n) in enumerate(zip(group.outputs, problem.rows, strict=True)):
            residuals = []
            for e, part in enumerate(data.experiments()):
                equation, errors = solution.given[e][r], solution.parts[e][r]
                H, Psi = whitened[e][r], None
                if not alone:
                    H = np.zeros((part.N, W.shape[1]))
                    H[:, column : column + basis.rank] = solution.scales[r] * whitened[e][r]
                    Psi = Psis[e]
                    if k > 1:
                        Psi = equation.unknown.without(np.hstack([equation.X, errors.Psi]))
                residuals.append(
                    OutputResiduals(
                        e=np.where(problem.experiments[e][r].rows, errors.e, np.nan),
                        y=_output(part, i),
                        H=H,
                        Psi=Psi,
                        Z=equation.unknown.span,
                    )
                )
            common = (n.na or sum(n.sizes)) if k > 1 else 0
            p = problem.named(solution.ab, group.theta, r)
            A, F = _with_root(n, p)
            outputs[i] = EstimatedOutput(
                polynomials={
                    "A": tuple(A if j == i else np.zeros(1) for j in range(ny)),
                    "B": tuple(p["B"]),
                    "C": p["C"],
                    "D": p["D"],
                    "F": tuple(F),
                    "nk": n.nk,
                    "integrators": bool(n.integrator),
                },
                residuals=tuple(residuals),
                parameters=n.parameters - common + common / k if k > 1 else group.parameters,
                J=with_integrator(n) @ np.eye(W.shape[0])[row + problem.columns_of(r)]
                if J is None
                else J,
            )
        row, column = row + group.parameters, column + basis.rank
    return [outputs[i] for i in range(ny)], W


def _with_root(n: Structure, p: dict[str, Any]) -> tuple[Array, list[Array]]:
    """Return A, and F of each input, with the root of an integrator."""
    root = np.array([1.0, -1.0])
    A = np.convolve(root, p["A"]) if n.integrator == "a" else p["A"]
    return A, [np.convolve(root, F) for F in p["F"]] if n.integrator == "f" else p["F"]
