"""Prediction-error estimate of OE, BJ and ARMAX models with several inputs and outputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.finding import EstimateFinding, warning
from armrig.data.signals import Signals
from armrig.estimation.multistart import other_pairs, other_real
from armrig.estimation.multivariable.data_checks import instability, origin, require_informative
from armrig.estimation.multivariable.ends import log_cost, ranked
from armrig.estimation.multivariable.problem import (
    ONE,
    PolynomialProblem,
    Row,
    Solution,
    integrated,
    row_data,
)
from armrig.estimation.multivariable.start_values import start_values
from armrig.estimation.multivariable.whitening import spread, unspread, whitening
from armrig.estimation.orders import require_samples
from armrig.models.fit import Fit
from armrig.models.polynomials import Polynomials
from armrig.models.quality import Start
from armrig.numerics.covariance import pairwise_covariance
from armrig.numerics.inference import Inference, OutputResiduals, infer
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, roots

_MAX_ROUNDS = 10
_SAME_TOLERANCE = 1e-6  # relative change of Lambda at which the iteration from a start ends
_MAX_MOVES = 3  # largest number of rounds in which a mode is moved
_MOVED_STARTS = 3  # start values with a moved mode in each round
_END_TOLERANCE = 1e-10  # relative change of Lambda at which the last iteration ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Rows (equations of outputs) that are estimated together, with their polynomials."""

    outputs: tuple[int, ...]
    """Index of the output of each row."""
    rows: tuple[Row, ...]
    """Equation of each row."""
    sizes: tuple[int, ...]
    """Number of coefficients of each polynomial; the polynomial `ONE` has none."""
    bounded: tuple[bool, ...]
    """True for each polynomial that must be stable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Estimated:
    """Estimate of the rows of one plan."""

    plan: Plan
    problem: PolynomialProblem
    solution: Solution
    theta: Array
    ends: tuple[tuple[str, Optimum], ...]


def estimated(
    data: Signals,
    plans: Sequence[Plan],
    *,
    name: str,
    orders: str,
    shared: bool = False,
    equation_error: bool = False,
) -> Fit:
    """Return one model of all outputs; each plan is estimated by a separate search.

    Parameters
    ----------
    plans : sequence of Plan
        Rows that are estimated together; each output belongs to one plan.
    name : str
        Name of the structure.
    orders : str
        Orders as text.
    equation_error : bool
        True if F and D of each row are both the A of this row, as in an ARMAX model.

    Raises
    ------
    ValueError
        There are too few samples, or the inputs do not excite the model.
    """
    require_informative(data)
    found = [_estimated(data, plan, orders) for plan in plans]
    inference = _inference(data, found)
    T, form = _form(data, found, equation_error=equation_error)
    best = [one.ends[0][1] for one in found]
    fields = inference.fields()
    fields["covariance"] = T @ inference.covariance @ T.T
    fields["covariance_robust"] = T @ inference.covariance_robust @ T.T
    return Fit(
        structure=name,
        specification=orders,
        form=form,
        shared=shared,
        converged=all(o.converged for o in best),
        starts=tuple(start for one in found for start in _starts(data, one)),
        findings=tuple(_findings(data, found, form)),
        **fields,
        **origin(data),
    )


def _estimated(data: Signals, plan: Plan, orders: str) -> _Estimated:
    """Return the estimated model of one plan; with several outputs, Lambda is estimated too."""
    parts = list(data.experiments())
    experiments = tuple(
        tuple(
            row_data(part.u, part.y[:, i], row)
            for i, row in zip(plan.outputs, plan.rows, strict=True)
        )
        for part in parts
    )
    masks = [np.column_stack([x.rows for x in of]) for of in experiments]
    needed = sum(sum(row.nb) for row in plan.rows) + sum(plan.sizes) + 1
    states = sum(sum(row.pulses(plan.sizes).values()) + row.trend for row in plan.rows)
    needed += states * len(parts)
    require_samples(orders, needed=needed, got=int(sum(m.sum() for m in masks)))
    Lambda = np.diag([float(np.nanvar(data.y[:, i])) for i in plan.outputs])
    problem = PolynomialProblem(
        rows=plan.rows,
        sizes=plan.sizes,
        bounded=plan.bounded,
        experiments=experiments,
        weights=tuple(whitening(Lambda, m) for m in masks),
    )
    ends = ranked(
        ((start, problem.minimise(theta)) for start, theta in start_values(problem)),
        lambda end: log_cost(end[1].cost),
    )
    if len(plan.rows) > 1:
        problem, ends = _reweighted(problem, masks, ends)
    theta = ends[0][1].theta
    solution = problem.solve(theta)
    d = sum(sum(row.nb) for row in plan.rows)
    if solution.rank < d:
        names = ", ".join(data.outputs[i] for i in plan.outputs)
        raise InputError(
            f"{orders}: the inputs determine only {solution.rank} of {d} numerator coefficients of "
            f"{names}; lower nb or excite with richer inputs"
        )
    return _Estimated(plan=plan, problem=problem, solution=solution, theta=theta, ends=tuple(ends))


def _reweighted(
    problem: PolynomialProblem, masks: Sequence[Array], ends: Sequence[tuple[str, Optimum]]
) -> tuple[PolynomialProblem, list[tuple[str, Optimum]]]:
    """Return the problem of the best minimum, and the minima with an estimated Lambda.

    Starting from each minimum in `ends`, Lambda is estimated and a search with this Lambda is run,
    in turn. The best minimum has the least det Lambda. Then one mode of a denominator is moved, as
    long as a move leads to a better minimum. The best minimum need not be the first of `ends`,
    because the searches for `ends` used the variances of the outputs as Lambda. With these
    variances, an output that integrates has little weight.
    """
    found = [(name, *_iterated(problem, masks, end, _SAME_TOLERANCE)) for name, end in ends]
    found = ranked(found, lambda one: one[1])
    for _ in range(_MAX_MOVES):
        best = found[0]
        moved = [
            ("moved mode", *_iterated(best[2], masks, best[2].minimise(theta), _SAME_TOLERANCE))
            for theta in _moved_modes(best[2], best[3].theta)
        ]
        found = ranked([*found, *moved], lambda one: one[1])
        if found[0] is best:
            break
    name, _, weighted, end = found[0]
    _, weighted, end = _iterated(weighted, masks, end, _END_TOLERANCE)
    return weighted, [(name, end), *((other, end) for other, _, _, end in found[1:])]


def _moved_modes(problem: PolynomialProblem, theta: Array) -> list[Array]:
    """Move one mode of a denominator in many ways; return the start values of least cost."""
    polynomials = problem.polynomials(theta)
    starts = []
    for g in {f for row in problem.rows for f in row.f if f != ONE}:
        for kind in (other_real, other_pairs):
            for z in kind(roots(polynomials[g])):
                start = theta.copy()
                start[problem.slices[g]] = np.real(np.poly(z))[1:]
                starts.append((problem.cost(start), start))
    starts.sort(key=lambda one: one[0])
    return [start for _, start in starts[:_MOVED_STARTS]]


def _iterated(
    problem: PolynomialProblem, masks: Sequence[Array], end: Optimum, tolerance: float
) -> tuple[float, PolynomialProblem, Optimum]:
    """Return log det Lambda, the problem with the last weights, and its minimum.

    The function starts at the minimum `end`. It estimates Lambda and searches with this Lambda, in
    turn, until Lambda hardly changes.
    """
    Lambda = _covariance(problem, masks, end.theta)
    for _ in range(_MAX_ROUNDS):
        problem = replace(problem, weights=tuple(whitening(Lambda, m) for m in masks))
        end = problem.minimise(end.theta)
        before, Lambda = Lambda, _covariance(problem, masks, end.theta)
        std = np.sqrt(np.diag(Lambda))
        if (np.abs(Lambda - before) <= tolerance * np.outer(std, std)).all():
            break
    return float(np.linalg.slogdet(Lambda)[1]), problem, end


def _covariance(problem: PolynomialProblem, masks: Sequence[Array], theta: Array) -> Array:
    """Return the covariance of the errors at theta."""
    experiments = problem.solve(theta).experiments
    e = [
        np.where(m, np.column_stack([p.e for p in of]), np.nan)
        for m, of in zip(masks, experiments, strict=True)
    ]
    return pairwise_covariance(np.vstack(e))


def _starts(data: Signals, one: _Estimated) -> Iterator[Start]:
    """Yield the result from each start value; the loss is the mean square of whitened errors."""
    names = ", ".join(data.outputs[i] for i in one.plan.outputs)
    errors = sum(int(np.count_nonzero(x.rows)) for of in one.problem.experiments for x in of)
    for name, o in one.ends:
        yield Start(
            name=f"{names}: {name}",
            loss=o.cost / errors,
            iterations=o.iterations,
            converged=o.converged,
        )


def _inference(data: Signals, found: Sequence[_Estimated]) -> Inference:
    """Return the covariance of the parameters of all plans together."""
    widths = [one.problem.row_slices[-1].stop + one.theta.size for one in found]
    d = sum(widths)
    parts = list(data.experiments())
    table: list[dict[int, OutputResiduals]] = [{} for _ in parts]
    begin = 0
    for one, width in zip(found, widths, strict=True):
        problem, solution = one.problem, one.solution
        whole = [
            state.without(spread(G, [row.Psi for row in of]))
            for of, state, G in zip(
                solution.experiments, solution.states, problem.weights, strict=True
            )
        ]
        basis = orthonormal(np.vstack(whole))
        ends = np.cumsum([M.shape[0] for M in whole])[:-1]
        for k, Q in enumerate(np.split(basis.Q @ basis.W.T, ends)):
            influences = unspread(problem.weights[k], Q)
            for r, i in enumerate(one.plan.outputs):
                x, row = problem.experiments[k][r], solution.experiments[k][r]
                H = np.zeros((x.y.size, d))
                H[:, begin : begin + width] = influences[r]
                used = np.flatnonzero(row.Psi.any(axis=0))
                state = orthonormal(np.where(x.rows[:, None], row.Z, 0.0))
                table[k][i] = OutputResiduals(
                    e=np.where(x.rows, row.e, np.nan),
                    y=parts[k].y[:, i],
                    H=H,
                    Psi=state.without(np.where(x.rows[:, None], row.Psi[:, used], 0.0)),
                    Z=state.Q,
                )
        begin += width
    white = all(row.c == row.d == ONE for one in found for row in one.plan.rows)
    return infer(
        [[of[i] for i in range(data.ny)] for of in table],
        np.eye(d),
        parameters=_parameters(data, found),
        score="exogenous" if white else "correlated",
    )


def _parameters(data: Signals, found: Sequence[_Estimated]) -> list[float]:
    """Return the number of parameters of each output; if k outputs share one, it counts 1/k."""
    counts = [0.0] * data.ny
    for one in found:
        users = [
            sum(p in {*row.f, row.c, row.d} for row in one.plan.rows)
            for p in range(len(one.plan.sizes))
        ]
        for i, row in zip(one.plan.outputs, one.plan.rows, strict=True):
            own = {*row.f, row.c, row.d} - {ONE}
            counts[i] = sum(row.nb) + sum(one.plan.sizes[p] / users[p] for p in own)
    return counts


def _form(
    data: Signals, found: Sequence[_Estimated], *, equation_error: bool
) -> tuple[Array, Polynomials]:
    """Return the derivatives of theta with respect to all plans' parameters, and the model."""
    ny, nu = data.ny, data.nu
    rows: dict[int, dict[str, Any]] = {}
    blocks: dict[int, list[Array]] = {}
    d = sum(one.problem.row_slices[-1].stop + one.theta.size for one in found)
    begin = 0
    for one in found:
        theta_begin = begin + one.problem.row_slices[-1].stop
        polynomials = one.problem.polynomials(one.theta)

        def block(p: int, begin: int = theta_begin, one: _Estimated = one) -> Array:
            part = one.problem.slices[p]
            return np.eye(d)[begin + part.start : begin + part.stop]

        for r, i in enumerate(one.plan.outputs):
            row = one.plan.rows[r]
            F = [polynomials[f] for f in row.f]
            by_f = [block(f) for f in row.f]
            if row.integrator:
                by_f = [integrated(M) for M in by_f]
                F = [np.convolve([1.0, -1.0], f) for f in F]
            ends = np.cumsum(row.nb)[:-1]
            b = np.split(one.solution.b[r], ends)
            by_b = np.eye(d)[begin + one.problem.row_slices[r].start :][: sum(row.nb)]
            one_ = np.ones(1)
            A = [np.append(float(k == i), np.zeros(0)) for k in range(ny)]
            by_a: list[Array] = []
            D = polynomials[row.d]
            by_d = [block(row.d)]
            if equation_error:
                A[i] = F[0]
                by_a, F, D, by_d, by_f = [by_f[0]], [one_] * nu, one_, [], []
            rows[i] = {
                "A": tuple(A),
                "B": tuple(np.append(np.zeros(k), x) for k, x in zip(row.nk, b, strict=True)),
                "C": polynomials[row.c],
                "D": D,
                "F": tuple(F),
                "nk": row.nk,
                "integrators": row.integrator,
            }
            blocks[i] = [*by_a, by_b, block(row.c), *by_d, *by_f]
        begin = theta_begin + one.theta.size
    fields = {name: tuple(rows[i][name] for i in range(ny)) for name in rows[0]}
    T = np.vstack([M for i in range(ny) for M in blocks[i]])
    return T, Polynomials(**fields)


def _findings(
    data: Signals, found: Sequence[_Estimated], form: Polynomials
) -> list[EstimateFinding]:
    notes = []
    for one in found:
        best = one.ends[0][1]
        if not best.converged:
            names = ", ".join(data.outputs[i] for i in one.plan.outputs)
            text = f"the search of {names} did not converge in {best.iterations} steps"
            notes.append(warning("not_converged", text, steps=best.iterations))
    return [*notes, *instability(form)]
