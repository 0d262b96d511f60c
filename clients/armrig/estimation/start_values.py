"""Start values for a search: output-error models and noise models from linear regressions.

An ARX model of high order gives the contribution of each input to the output, without most of the
noise. Steiglitz and McBride's iteration then fits B/F to the contributions, and to the output
itself. Channels with the same F are fitted together.

References
----------
.. [1] E. J. Hannan, J. Rissanen, Biometrika 69 (1982) 81-94.
.. [2] K. Steiglitz, L. E. McBride, IEEE Trans. Automatic Control 10 (1965) 461-464.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.estimation.problem import PolynomialProblem
from armrig.models.innovations import Experiment, trend
from armrig.models.structure import Structure, free_columns
from armrig.numerics.least_squares import (
    RANK_TOLERANCE,
    column_norms,
    least_squares,
    orthonormal,
    triangle,
)
from armrig.numerics.polynomial import Array, apply_filter, lag_columns, reflect_roots
from armrig.numerics.regressors import complete, past
from armrig.numerics.whiteness import autoregression

_PASSES = 3
_MAX_START_ROOT = 0.98  # largest modulus of a root in a start value; the search may exceed it
_HIGH_ORDER = 12
_MAX_OE_STEPS = 12  # steps of the search for an output-error start value; it need not converge

Signals = Sequence[Sequence[tuple[Array, Array]]]
"""Inputs (N, nu) and output (N,) of each experiment and row; no sample is missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """Signals of one equation F y = sum of B_j u_j, the effect of a pulse train, and a trend."""

    parts: tuple[tuple[Array, Array], ...]
    """Inputs (N, k) and output (N,) of each experiment."""
    lags: tuple[range, ...]
    """Lags of each input."""
    pulses: int = 0
    """Number of first samples with a free pulse, in each experiment."""
    trend: tuple[Array, ...] = ()
    """Columns of the trend of each experiment, (N, m); empty without a trend."""


def start_values(problem: PolynomialProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values theta with stable C and F.

    F is estimated by output-error models. C and D are then estimated from the residual noise. The
    last start value is the fitted output-error model. With strong noise this start value alone is
    not sufficient, because a Box-Jenkins search from it ends in a poor minimum.
    """
    if not any(any(n.sizes) for n in problem.rows):
        yield from _without_denominator(problem)
        return
    output_error = replace(problem, rows=tuple(n.output_error for n in problem.rows))
    candidates = []
    for name, f in denominators(output_error):
        candidates.append(f)
        yield name, _with_noise(problem, f)
    if not all(n.white for n in problem.rows):
        f = output_error.minimise(min(candidates, key=output_error.cost), most=_MAX_OE_STEPS).theta
        yield "OE", _with_noise(problem, f)


def denominators(problem: PolynomialProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values of each F in an output-error problem; each F is stable.

    Missing samples of y are interpolated for these start values, but not in the search itself.
    """
    smooth, measured = paths(
        problem, [[(x.u, x.y) for x in experiment] for experiment in problem.experiments]
    )
    sizes = _sizes(problem)
    pairs = zip(measured, sizes, strict=True)
    yield (
        "ARX",
        np.concatenate([reflect_roots(equation_error(p, np.ones(1), n))[1:] for p, n in pairs]),
    )
    first = [
        [*steiglitz_mcbride(p, np.ones(1), n, iterations=5)][-1]
        for p, n in zip(smooth, sizes, strict=True)
    ]
    more = [
        steiglitz_mcbride(p, F, n, iterations=5)
        for p, F, n in zip(measured, first, sizes, strict=True)
    ]
    candidates = [np.concatenate([F[1:] for F in first]), *_together(more)]
    yield "high-order ARX, Steiglitz-McBride", min(candidates, key=problem.cost)


def denominators_of_signals(problem: PolynomialProblem, signals: Signals) -> Iterator[Array]:
    """Yield start values of each F in an output-error problem, from other signals."""
    for of_groups in paths(problem, signals):
        yield from _together(
            [
                steiglitz_mcbride(p, np.ones(1), n, iterations=5)
                for p, n in zip(of_groups, _sizes(problem), strict=True)
            ]
        )


def _sizes(problem: PolynomialProblem) -> list[int]:
    """Return the number of coefficients of each F of an output-error problem."""
    return [part.stop - part.start for part in problem.layout.slices if part.stop > part.start]


def _together(iterations: Sequence[Iterator[Array]]) -> Iterator[Array]:
    """Yield the coefficients of all polynomials after each iteration, until all have ended."""
    last = [np.ones(1)] * len(iterations)
    while True:
        polynomials = [next(iteration, None) for iteration in iterations]
        if all(F is None for F in polynomials):
            return
        last = [F if new is None else new for F, new in zip(last, polynomials, strict=True)]
        yield np.concatenate([F[1:] for F in last])


def paths(
    problem: PolynomialProblem, signals: Signals
) -> tuple[list[list[Path]], list[list[Path]]]:
    """Return the equations of each F, without most of the noise and as measured.

    Without the noise, the output of an equation is the contribution of one input. As measured, the
    output is y, minus the contributions of the inputs with another F.
    """
    layout = problem.layout
    used = [k for k, part in enumerate(layout.slices) if part.stop > part.start]
    smooth: dict[int, list[Path]] = {k: [] for k in used}
    measured: dict[int, list[Path]] = {k: [] for k in used}
    for i, n in enumerate(problem.rows):
        parts = [experiment[i] for experiment in signals]
        shares = contributions(parts, n)
        trends = tuple(trend(n, y.size) for _, y in parts) if n.trend else ()
        slots = layout.polynomials[i][-len(n.groups) :]
        for k, group, count in zip(slots, n.groups, n.counts, strict=True):
            if k not in used:
                continue
            inputs = [j for j in group if n.nb[j]]
            others = [j for other in n.groups if other != group for j in other]
            equation = Path(
                parts=tuple(
                    (u[:, inputs], y if s is None else y - s[:, others].sum(axis=1))
                    for (u, y), s in zip(parts, shares, strict=True)
                ),
                lags=tuple(n.lags(j) for j in inputs),
                pulses=count,
                trend=trends,
            )
            measured[k].append(equation)
            if shares[0] is None:
                smooth[k].append(equation)
                continue
            smooth[k] += [
                Path(
                    parts=tuple(
                        (u[:, [j]], s[:, j])
                        for (u, _), s in zip(parts, shares, strict=True)
                        if s is not None
                    ),
                    lags=(n.lags(j),),
                )
                for j in inputs
            ]
    return [*smooth.values()], [*measured.values()]


def contributions(parts: Sequence[tuple[Array, Array]], n: Structure) -> list[Array | None]:
    """Return each input's contribution to y, (N, nu), simulated by a high-order ARX model.

    The simulation begins at rest. The contributions are therefore without most of the noise and
    without the free response. They are None if the data are too short.
    """
    nu = len(n.nb)
    order = max(*n.nf, *n.nb)
    most = min(_HIGH_ORDER + order, *(y.size // (2 * (nu + 1)) for _, y in parts))
    if most < order:
        return [None] * len(parts)
    blocks = []
    for u, y in parts:
        inputs = [lag_columns(u[:, j], range(k, k + most)) for j, k in enumerate(n.nk)]
        block = np.column_stack([-lag_columns(y, range(1, most + 1)), *inputs, trend(n, y.size), y])
        blocks.append(block[most + max(n.nk) :])
    stacked = np.vstack(blocks)
    # The high order may exceed the rank of the data; dependent columns share their coefficient.
    theta = least_squares(stacked[:, :-1], stacked[:, -1:])[:, 0]
    A = reflect_roots(np.append(1.0, theta[:most]))
    B = [
        np.append(np.zeros(k), theta[most * (j + 1) : most * (j + 2)]) if n.nb[j] else np.zeros(1)
        for j, k in enumerate(n.nk)
    ]
    return [
        np.column_stack([apply_filter(b, A, u[:, j]) for j, b in enumerate(B)]) for u, _ in parts
    ]


def equation_error(equations: Sequence[Path], F: Array, n: int) -> Array:
    """Return F (n + 1,) that minimises |F y_F - sum of B_j u_jF| over all equations.

    The signals y_F and u_F are y and u filtered by 1/F, where F is the argument. If the argument F
    is 1, the result is an ARX model. Each equation has its own B.
    """
    blocks = []
    for equation in equations:
        triangles, squares = [], np.zeros(n + 1)
        for k, (u, y) in enumerate(equation.parts):
            y_F, *u_F = apply_filter([1.0], F, np.vstack([y, u.T])) if F.size > 1 else (y, *u.T)
            inputs = [lag_columns(x, lags) for x, lags in zip(u_F, equation.lags, strict=True)]
            past = free_columns(F, y.size, count=equation.pulses, drift=False)
            free = np.hstack([past, *equation.trend[k : k + 1]])
            outputs = -lag_columns(y_F, range(1, n + 1))
            columns = np.column_stack([free, *inputs, outputs, y_F])
            R = triangle([columns], columns.shape[1])
            triangles.append(R[free.shape[1] :, free.shape[1] :])
            squares += column_norms(R[:, -n - 1 :]) ** 2
        rest = triangle(triangles, triangles[0].shape[1])[-n - 1 :, -n - 1 :]
        # If y follows from u at once, the rest of a column is its rounding errors.
        known = column_norms(rest) > RANK_TOLERANCE * np.sqrt(squares)
        blocks.append(np.where(known, rest, 0.0))
    stacked = np.vstack(blocks)
    return np.append(1.0, least_squares(stacked[:, :n], stacked[:, n:]))


def steiglitz_mcbride(
    equations: Sequence[Path], F: Array, n: int, *, iterations: int
) -> Iterator[Array]:
    """Yield a stable F (n + 1,) after each iteration, until F changes by less than 0.1 %."""
    for _ in range(iterations):
        previous = F
        F = reflect_roots(equation_error(equations, F, n))
        yield F
        if F.size == previous.size and np.linalg.norm(F - previous) < 1e-3 * np.linalg.norm(F):
            return


def _without_denominator(problem: PolynomialProblem) -> Iterator[tuple[str, Array]]:
    rows = problem.rows
    if all(n.nc + n.nd == 0 for n in rows) and problem.layout.letters[0] != "a":
        yield "least squares", np.zeros(problem.size)
        return
    if all(n.na and n.nc and not n.nd for n in rows):
        theta = np.zeros(problem.size)
        for i, n in enumerate(rows):
            A, C = armax_start([of[i] for of in problem.experiments], n)
            for letter, p in (("a", A), ("c", C)):
                part = problem.slice_of(letter, i)
                theta[part] = p[1 : 1 + part.stop - part.start]
        yield "Hannan-Rissanen", theta
    yield "ARX" if any(n.na for n in rows) else "FIR", _with_noise(problem, np.zeros(0))
    if len(rows) > 1 and rows[0].na:
        yield from _from_output_error(problem)


def _from_output_error(problem: PolynomialProblem) -> Iterator[tuple[str, Array]]:
    """Yield start values with C and D of the noise A (y - (B/A) u), for output-error models B/A."""
    rows = [
        replace(n.output_error, nf=(n.na,) * len(n.nb), shared=True, integrator="", offset=True)
        for n in problem.rows
    ]
    output_error = replace(problem, rows=tuple(rows))
    for name, f in denominators(output_error):
        end = output_error.minimise(f, most=_MAX_OE_STEPS).theta
        for kind, a in (("", f), ("OE, ", end)):
            theta, A = np.zeros(problem.size), np.append(1.0, a)
            if "a" in problem.letters:
                theta[np.array(problem.letters) == "a"] = a
            parts = output_error.solve(a).parts
            for i, n in enumerate(problem.rows):
                v = []
                for experiment, row_errors in zip(problem.experiments, parts, strict=True):
                    y = np.where(experiment[i].known, experiment[i].y, np.nan)
                    v.append(np.convolve(y - row_errors[i].driven, A)[: y.size])
                C, D = noise_start(v, nc=n.nc, nd=n.nd)
                theta[problem.slice_of("c", i)], theta[problem.slice_of("d", i)] = C[1:], D[1:]
            yield kind + name, theta


def _with_noise(problem: PolynomialProblem, f: Array) -> Array:
    """Return theta for given F; C and D are fitted to the noise A y - (B/F) u."""
    theta = np.zeros(problem.size)
    letters = np.array(problem.letters)
    theta[letters == "f"] = f
    if (letters == "f").all():
        return theta
    if "a" in letters:
        theta[letters == "a"] = _equation_errors(problem, theta)
    solution = problem.solve(theta)
    for i, n in enumerate(problem.rows):
        A = problem.named(solution.ab, theta, i)["A"]
        v = []
        for experiment, parts in zip(problem.experiments, solution.parts, strict=True):
            x = experiment[i]
            y = np.where(x.known, x.y, np.nan) if x.gaps else x.y
            noise = np.convolve(y, A)[: y.size] - parts[i].driven
            noise[~x.rows] = np.nan
            v.append(noise)
        C, D = noise_start(v, nc=n.nc, nd=n.nd)
        theta[problem.slice_of("c", i)], theta[problem.slice_of("d", i)] = C[1:], D[1:]
    return theta


def _equation_errors(problem: PolynomialProblem, theta: Array) -> Array:
    """Return the coefficients of A for given F by least squares, without the missing samples."""
    blocks = []
    for i, n in enumerate(problem.rows):
        F = problem.named(np.zeros(problem.linear_size), theta, i)["F"]
        for experiment in problem.experiments:
            x = experiment[i]
            y = np.where(x.known, x.y, np.nan)
            inputs = [
                past(apply_filter([1.0], F[j], x.u[:, j]), n.lags(j)) for j in range(len(n.nb))
            ]
            block = np.column_stack([-past(y, range(1, n.na + 1)), y, *inputs, trend(n, y.size)])
            block = block[complete(block)]  # the rows without an unknown value
            blocks.append(orthonormal(block[:, n.na + 1 :]).without(block[:, : n.na + 1]))
    M = np.vstack(blocks)
    return orthonormal(M[:, :-1]).coefficients(M[:, -1])


def armax_start(experiments: Sequence[Experiment], n: Structure) -> tuple[Array, Array]:
    """Return start values of A and C in A y = B u + C e, with stable C."""
    y = [np.where(x.known, x.y, np.nan) for x in experiments]
    order = _long_order(y, n.parameters)
    long = [_regressors(x, v, n, order) for x, v in zip(experiments, y, strict=True)]
    theta = _solve(long, y)
    e = [v - Phi @ theta for Phi, v in zip(long, y, strict=True)]
    Phis = [_regressors(x, v, n, 0) for x, v in zip(experiments, y, strict=True)]
    C = np.ones(1)
    for _ in range(_PASSES):
        blocks = [
            np.hstack([Phi, past(i, range(1, n.nc + 1))]) for Phi, i in zip(Phis, e, strict=True)
        ]
        theta = _solve(blocks, y)
        C = reflect_roots(np.append(1.0, theta[n.na + sum(n.nb) :]), _MAX_START_ROOT)
        left = [v - Phi @ theta[: Phi.shape[1]] for Phi, v in zip(Phis, y, strict=True)]
        e = [_innovations(np.ones(1), C, v) for v in left]
    return np.append(1.0, theta[: n.na]), C


def _regressors(x: Experiment, y: Array, n: Structure, order: int) -> Array:
    """Return the regressors of A y = B u + e, with `order` coefficients of A and B if not 0."""
    used = [(j, k, m) for j, (k, m) in enumerate(zip(n.nk, n.nb, strict=True)) if m]
    inputs = [past(x.u[:, j], range(k, k + (order or m))) for j, k, m in used]
    return np.hstack([-past(y, range(1, (order or n.na) + 1)), *inputs])


def noise_start(v: Sequence[Array], *, nc: int, nd: int) -> tuple[Array, Array]:
    """Return stable C and D in D v = C e; a missing sample of the signals v is NaN."""
    if nc + nd == 0:
        return np.ones(1), np.ones(1)
    C, D = np.ones(1), autoregression(v)[0] if nc else np.ones(1)
    e = [_innovations(D, C, x) for x in v]
    of_v = [-past(x, range(1, nd + 1)) for x in v]
    for _ in range(_PASSES if nc else 1):
        of_e = [past(i, range(1, nc + 1)) for i in e]
        theta = _solve([np.hstack(both) for both in zip(of_v, of_e, strict=True)], v)
        D = reflect_roots(np.append(1.0, theta[:nd]), _MAX_START_ROOT)
        C = reflect_roots(np.append(1.0, theta[nd:]), _MAX_START_ROOT)
        e = [_innovations(D, C, x) for x in v]
    return C, D


def _long_order(v: Sequence[Array], parameters: int) -> int:
    """Return the order of the long autoregression; the order grows slowly with N."""
    N = sum(x.size for x in v)
    return int(max(1, min(2 * parameters + 10 * np.log10(max(N, 10)) - 10, N // 10, N // 4)))


def _innovations(D: Array, C: Array, x: Array) -> Array:
    """Return D/C x from a zero state; a NaN in x counts as 0 and remains NaN in the result."""
    e = apply_filter(D, C, np.nan_to_num(x))
    e[~np.isfinite(x)] = np.nan
    return e


def _solve(blocks: Sequence[Array], y: Sequence[Array]) -> Array:
    """Return the least-squares coefficients over the rows in which all columns are known."""
    M, right = np.vstack(blocks), np.concatenate(y)
    rows = complete(M, right)
    return orthonormal(M[rows]).coefficients(right[rows])
