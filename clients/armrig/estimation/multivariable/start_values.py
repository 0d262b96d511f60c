"""Start values of a search: denominators from the contribution of each input, then noise models.

An ARX model of high order gives the contribution of each input to each output, without most of the
noise. Steiglitz and McBride's iteration then fits B/F to each contribution; channels with the same
denominator are fitted together.

References
----------
.. [1] K. Steiglitz, L. E. McBride, IEEE Trans. Automatic Control 10 (1965) 461-464.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.estimation.hannan_rissanen import noise_start
from armrig.estimation.multivariable.ends import log_cost, ranked
from armrig.estimation.multivariable.problem import ONE, PolynomialProblem, Row, RowData
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered, lagged, reflected

_EXTRA_ORDER = 12  # order of the ARX model minus the largest order of the row
_ITERATIONS = 8
_MAX_OUTPUT_ERROR_STEPS = 15  # steps of the search for an output-error start value


@dataclass(frozen=True, slots=True, kw_only=True)
class _Path:
    """Signals of one equation F y = sum of B_j u_j in one experiment."""

    y: Array
    """Output (N,)."""
    inputs: tuple[tuple[Array, range], ...]
    """Inputs (N,) with their lags."""


def start_values(problem: PolynomialProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values theta with stable C and F."""
    output_error = replace(problem, rows=tuple(row.without_noise for row in problem.rows))
    candidates = list(_denominators(problem))
    if not candidates:
        yield "least squares", _with_noise(problem, np.zeros(sum(problem.sizes)))
        return
    candidates = ranked(candidates, lambda found: log_cost(output_error.cost(found[1])))
    names = dict(reversed(candidates))  # the best start value of each name
    for name, theta in names.items():
        yield name, _with_noise(problem, theta)
    if any(row.c or row.d or row.integrated_noise for row in problem.rows):
        best = output_error.minimise(candidates[0][1], most=_MAX_OUTPUT_ERROR_STEPS).theta
        yield "OE", _with_noise(problem, best)


def _denominators(problem: PolynomialProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values with estimated denominators; all other polynomials are 1."""
    groups = [g for g in dict.fromkeys(f for row in problem.rows for f in row.f) if g != ONE]
    if not groups:
        return
    alone, rest, whole = _paths(problem)
    kinds = {"high-order ARX": alone, "high-order ARX, one input": rest, "ARX": whole}
    for name, paths in kinds.items():
        if not all(paths.get(g) for g in groups):
            continue
        F = {g: np.ones(1) for g in groups}
        for _ in range(_ITERATIONS):
            F = {g: _equation_error(paths[g], F[g], problem.sizes[g]) for g in groups}
            theta = np.zeros(sum(problem.sizes))
            for g in groups:
                theta[problem.slices[g]] = F[g][1:]
            yield name, theta


_Paths = dict[int, list[_Path]]


def _paths(problem: PolynomialProblem) -> tuple[_Paths, _Paths, _Paths]:
    """Return the equations of each denominator, in three forms.

    In the first form the output is the contribution of one input. In the second form the output is
    y minus the contributions of all other inputs. In the third form the output is y, and the
    equation has all inputs. Only a row whose inputs share one denominator has the third form.
    """
    alone: _Paths = {}
    rest: _Paths = {}
    whole: _Paths = {}
    for i, row in enumerate(problem.rows):
        parts = [_differenced(of[i]) if row.integrator else of[i] for of in problem.experiments]
        order = _EXTRA_ORDER + max([problem.sizes[f] for f in row.f] + [0])
        for x, shares in zip(parts, _contributions(row, parts, order), strict=True):
            y = _filled(x)
            for j, lags in ((j, row.lags(j)) for j, n in enumerate(row.nb) if n):
                u = x.u[:, j]
                others = shares.sum(axis=1) - shares[:, j]
                alone.setdefault(row.f[j], []).append(_Path(y=shares[:, j], inputs=((u, lags),)))
                rest.setdefault(row.f[j], []).append(_Path(y=y - others, inputs=((u, lags),)))
            if len(row.groups()) == 1:
                inputs = tuple((x.u[:, j], row.lags(j)) for j, n in enumerate(row.nb) if n)
                whole.setdefault(next(iter(row.groups())), []).append(_Path(y=y, inputs=inputs))
    return alone, rest, whole


def _differenced(x: RowData) -> RowData:
    """Return the differences of u and y, for the model of the rate of an integrating output."""
    y = np.diff(_filled(x), prepend=_filled(x)[:1])
    return RowData(u=np.diff(x.u, axis=0, prepend=0.0), y=y, rows=np.ones_like(x.rows))


def _filled(x: RowData) -> Array:
    """Return y with missing values interpolated."""
    if x.rows.all() or not x.rows.any():
        return x.y
    t = np.arange(x.y.size)
    return np.interp(t, t[x.rows], x.y[x.rows])


def _contributions(row: Row, parts: Sequence[RowData], order: int) -> list[Array]:
    """Return each input's contribution to y, (N, nu), simulated by a high-order ARX model."""
    N = sum(x.y.size for x in parts)
    nu = len(row.nb)
    n = max(min(order, N // (4 * (nu + 1))), 1)
    blocks = []
    for x in parts:
        y = _filled(x)
        past = [-lagged(y, range(1, n + 1))]
        inputs = [lagged(x.u[:, j], range(k, k + n)) for j, k in enumerate(row.nk)]
        blocks.append(np.column_stack([*past, *inputs, np.ones(y.size), y])[n + max(row.nk) :])
    stacked = np.vstack(blocks)
    theta = orthonormal(stacked[:, :-1]).coefficients(stacked[:, -1])
    A = reflected(np.append(1.0, theta[:n]))
    B = [
        np.append(np.zeros(k), theta[n * (j + 1) : n * (j + 2)]) if row.nb[j] else np.zeros(1)
        for j, k in enumerate(row.nk)
    ]
    return [np.column_stack([filtered(b, A, x.u[:, j]) for j, b in enumerate(B)]) for x in parts]


def _equation_error(paths: Sequence[_Path], F: Array, n: int) -> Array:
    """Return a stable F by least squares on all paths, with the signals filtered by 1 / `F`."""
    left, right = [], []
    for path in paths:
        y = filtered([1.0], F, path.y)
        inputs = np.hstack([lagged(filtered([1.0], F, u), lags) for u, lags in path.inputs])
        block = np.column_stack([-lagged(y, range(1, n + 1)), y])
        rest = orthonormal(inputs).without(block)
        left.append(rest[:, :-1])
        right.append(rest[:, -1])
    f = orthonormal(np.vstack(left)).coefficients(np.concatenate(right))
    return reflected(np.append(1.0, f))


def _with_noise(problem: PolynomialProblem, theta: Array) -> Array:
    """Return theta with C and D fitted to the residuals of an output-error model."""
    theta = theta.copy()
    silent = replace(problem, rows=tuple(row.without_noise for row in problem.rows))
    solution = silent.solve(theta)
    for i, row in enumerate(problem.rows):
        own = row.d != ONE and row.d not in row.f
        nc, nd = problem.sizes[row.c], problem.sizes[row.d] if own else 0
        if nc + nd == 0:
            continue
        known = problem.polynomials(theta)[row.d] if row.d in row.f else np.ones(1)
        known = np.convolve([1.0, -1.0], known) if row.integrated_noise else known
        v = []
        for x, of in zip(problem.experiments, solution.experiments, strict=True):
            noise = np.where(x[i].rows, of[i].e, np.nan)
            v.append(np.convolve(noise, known)[: noise.size])
        C, D = noise_start(v, nc=nc, nd=nd)
        theta[problem.slices[row.c]] = C[1:]
        if own:
            theta[problem.slices[row.d]] = D[1:]
    return theta
