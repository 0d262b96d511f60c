"""Output error: the prediction-error estimate of B/F where the noise is white on the output."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from armrig.dataset import Dataset
from armrig.estimation.covariance import exogenous_score
from armrig.estimation.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.estimation.orders import Sizes, require_order, require_samples
from armrig.estimation.steiglitz_mcbride import equation_error, high_order_output, steiglitz_mcbride
from armrig.fit import Fit, Start
from armrig.free_response import FreeResponse, free_columns, offset_from_ramp, transient_count
from armrig.goodness import fit_percent
from armrig.least_squares import Basis, orthonormal
from armrig.polynomial import Array, reflected, stable
from armrig.prediction import spread, summed_input
from armrig.sensitivity import by_denominator, by_numerator
from armrig.whiteness import WHITE_LEVEL, default_lags, portmanteau

SAME_MINIMUM = 1e-6  # relative difference in cost up to which two searches agree
ROUNDING = 1e-18  # share of |y|² below which |e|² is rounding noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """The least-squares answer for a given denominator."""

    b: Array
    """Numerator coefficients (nb,)."""
    free: tuple[Array, ...]
    """Coefficients of each experiment's free response."""
    e: Array
    """Residuals in the valid rows of all experiments, (M,)."""
    Psi: Array
    """Derivatives of the model output by (b, f), less the free response, (M, nb + nf)."""
    J: Array
    """The derivatives by f, less what b and the free response explain, (M, nf)."""
    spans: tuple[Array, ...]
    """Orthonormal basis of each experiment's free response in its valid rows."""
    rank: int
    """Number of b's that the data determine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Given:
    """One experiment for a given denominator."""

    by_b: Array
    """Derivatives of the output by b, (N, nb)."""
    columns: Array
    """Free response, (N, count + 2 drift)."""
    basis: Basis
    """Of the free response in the valid rows."""
    projected: Array
    """[by_b, y] in the valid rows less the free response."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputError:
    """min |y - B/F u - free response| over B, F and the free responses of all experiments.

    B and the free responses enter linearly and are projected out, so the search is over the
    coefficients of F alone (variable projection; Kaufman's Jacobian, whose gradient is exact).

    References
    ----------
    .. [1] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432.
    .. [2] L. Kaufman, BIT 15 (1975) 49-57.
    """

    experiments: tuple[tuple[Array, Array, Array], ...]
    """(u, y, valid) of each; u is summed where the model integrates."""
    sizes: Sizes
    """Orders and nuisance parameters."""

    def _given(self, F: Array) -> list[_Given]:
        """Return what each experiment is linear in, for a denominator."""
        n = self.sizes
        given = []
        for u, y, valid in self.experiments:
            by_b = by_numerator(u, F, range(n.nk, n.nk + n.nb))
            columns = free_columns(F, y.size, count=n.count, drift=n.drift)
            basis = orthonormal(_rows(columns, valid))
            projected = basis.without(np.column_stack([_rows(by_b, valid), _rows(y, valid)]))
            given.append(_Given(by_b=by_b, columns=columns, basis=basis, projected=projected))
        return given

    def solve(self, f: Array) -> Solution:
        """Return the best b and free responses for F = [1, f]."""
        F, n = np.append(1.0, f), self.sizes
        given = self._given(F)
        whole = np.vstack([g.projected for g in given])
        numerator = orthonormal(whole[:, :-1])
        b = numerator.coefficients(whole[:, -1])
        by_f, states = [], []
        for g, (_, y, valid) in zip(given, self.experiments, strict=True):
            forced = g.by_b @ b
            x = g.basis.coefficients(_rows(y - forced, valid))
            forced = forced + g.columns[:, : n.count] @ x[: n.count]
            by_f.append(g.basis.without(_rows(by_denominator(forced, F, n.nf), valid)))
            states.append(x)
        Psi_f = np.vstack(by_f)
        return Solution(
            b=b,
            free=tuple(states),
            e=numerator.without(whole[:, -1]),
            Psi=np.hstack([whole[:, :-1], Psi_f]),
            J=numerator.without(Psi_f),
            spans=tuple(g.basis.Q for g in given),
            rank=numerator.rank,
        )

    def linearise(self, f: Array) -> tuple[Array, Array]:
        """Return e and J at f."""
        solution = self.solve(f)
        return solution.e, solution.J

    def cost(self, F: Array) -> float:
        """Return |e|² for a denominator."""
        whole = np.vstack([g.projected for g in self._given(F)])
        e = orthonormal(whole[:, :-1]).without(whole[:, -1])
        return float(e @ e)

    def minimise(self, F: Array) -> Optimum:
        """Search from a denominator; F stays stable on the way."""
        return levenberg_marquardt(
            self.linearise, F[1:], admissible=lambda f: stable(np.append(1.0, f))
        )

    def start_values(self) -> Iterator[tuple[str, Array]]:
        """Yield named stable denominators to search from.

        The starts, and only they, need a y without holes: there it is interpolated. The search
        itself leaves the missing rows out.
        """
        signals = [(u, _interpolated(y, valid)) for u, y, valid in self.experiments]
        F, _ = equation_error(signals, np.ones(1), self.sizes)
        yield "ARX", reflected(F)
        smooth = high_order_output(signals, self.sizes)
        at_rest = replace(self.sizes, count=0, drift=False)
        *_, F = steiglitz_mcbride(smooth, np.ones(1), at_rest, iterations=5)
        candidates = [F, *steiglitz_mcbride(signals, F, self.sizes, iterations=5)]
        yield "high-order ARX, Steiglitz-McBride", min(candidates, key=self.cost)


def oe(
    data: Dataset,
    *,
    nb: int,
    nf: int,
    nk: int = 1,
    integrator: bool = False,
    initial: Literal["estimate", "zero"] = "estimate",
) -> Fit:
    """Estimate B and F in y(t) = B(q)/F(q) u(t) + e(t) by minimising the output error.

    Parameters
    ----------
    data : Dataset
        Missing outputs only cost their own rows. Each experiment has its own initial state.
    nb, nf : int
        Number of b's, >= 1, and of all f's, >= 0.
    nk : int, default 1
        Samples before u reaches y; 0 is a direct term.
    integrator : bool, default False
        F = (1 - q^-1) F̃ with one root at 1 exactly, e white on the integrated output; level and
        input offset u0 of each experiment are estimated along (the offset as the ramp it makes).
    initial : {"estimate", "zero"}
        Estimate each experiment's initial state, or take the rig at rest at y = 0 (then an
        integrator has no offset either).

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 of (b, f) with the nuisance parameters marginalised;
        `covariance_robust` is the sandwich form with an autoregressive estimate of the
        residuals' autocorrelation. With an integrator both are carried from F̃ to F by the linear
        map between them, and so are singular in the direction that would move the root at 1.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the numerator.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.2, 9.3 and 10.2.
    """
    require_order(nb=(nb, 1), nf=(nf, int(integrator)), nk=(nk, 0))
    if initial not in ("estimate", "zero"):
        msg = f'initial={initial!r} must be "estimate" or "zero"'
        raise ValueError(msg)
    problem = _problem(data, nb, nf, nk, integrator, estimate=initial == "estimate")
    orders = f"nb={nb}, nf={nf}, nk={nk}"
    nuisance = (problem.sizes.count + 2 * problem.sizes.drift) * len(data.starts)
    needed = nb + problem.sizes.nf + nuisance + 1
    require_samples(orders, needed=needed, got=data.N - data.missing)

    ends = sorted(
        ((name, problem.minimise(F)) for name, F in problem.start_values()),
        key=lambda end: end[1].cost,
    )
    best = ends[0][1]
    solution = problem.solve(best.theta)
    if solution.rank < nb:
        msg = f"{orders}: u determines only {solution.rank} of {nb} numerator coefficients; "
        msg += "lower nb or excite with a richer input"
        raise ValueError(msg)
    return _fit(data, problem, solution, best, ends, integrator)


def _problem(
    data: Dataset, nb: int, nf: int, nk: int, integrator: bool, *, estimate: bool
) -> OutputError:
    drift = integrator and estimate
    count = transient_count(
        numerator_degree=nk + nb - 1, denominator_degree=nf, integrator=integrator
    )
    return OutputError(
        experiments=tuple(
            (summed_input(d.u, centred=drift) if integrator else d.u, d.y, d.valid)
            for d in data.experiments()
        ),
        sizes=Sizes(
            nb=nb, nf=nf - int(integrator), nk=nk, count=count if estimate else 0, drift=drift
        ),
    )


def _fit(
    data: Dataset,
    problem: OutputError,
    solution: Solution,
    best: Optimum,
    ends: list[tuple[str, Optimum]],
    integrator: bool,
) -> Fit:
    F, B = np.append(1.0, best.theta), np.append(np.zeros(problem.sizes.nk), solution.b)
    n = problem.sizes
    M, d = solution.Psi.shape
    sse = best.cost
    degrees = M - d - sum(span.shape[1] for span in solution.spans)
    basis = orthonormal(solution.Psi)
    bread = basis.W @ basis.W.T
    noise_variance = sse / degrees
    edges = np.cumsum([0, *(np.count_nonzero(valid) for _, _, valid in problem.experiments)])
    residuals, blocks = [], []
    for (_, y, valid), (a, b) in zip(problem.experiments, pairwise(edges), strict=True):
        e = np.full(y.size, np.nan)
        e[valid] = solution.e[a:b]
        residuals.append(e)
        blocks.append(spread(solution.Psi[a:b], valid))
    robust = bread @ (exogenous_score(blocks, residuals) * M / degrees) @ bread
    to_full = np.eye(d)
    if integrator:
        # f_k = f̃_k - f̃_(k-1), f_1 also less 1: linear in f̃.
        step = np.eye(n.nf + 1, n.nf) - np.eye(n.nf + 1, n.nf, k=-1)
        to_full = np.block(
            [
                [np.eye(n.nb), np.zeros((n.nb, n.nf))],
                [np.zeros((n.nf + 1, n.nb)), step],
            ]
        )
    masks = [valid for _, _, valid in problem.experiments]
    spans = [spread(Q, valid) for Q, valid in zip(solution.spans, masks, strict=True)]
    valid_y = data.y[data.valid]
    floor = ROUNDING * float(valid_y @ valid_y)
    exact = sse <= floor
    whiteness = float("nan") if exact else portmanteau(residuals, blocks, spans, default_lags(M))
    starts = tuple(
        Start(name=name, loss=o.cost / M, iterations=o.iterations, converged=o.converged)
        for name, o in ends
    )
    agreed = ends[-1][1].cost <= sse * (1 + SAME_MINIMUM) + floor
    return Fit(
        structure="oe",
        B=B,
        A=np.ones(1),
        F=np.convolve([1.0, -1.0], F) if integrator else F,
        nk=problem.sizes.nk,
        integrator=integrator,
        covariance=to_full @ (noise_variance * bread) @ to_full.T,
        covariance_robust=to_full @ robust @ to_full.T,
        noise_variance=noise_variance,
        loss=sse / M,
        N=M,
        Ts=data.Ts,
        fit_percent=fit_percent(valid_y, sse),
        whiteness=whiteness,
        converged=best.converged,
        starts=starts,
        agreed=agreed,
        free=tuple(
            _free_response(problem, B, F, x, part)
            for x, part in zip(solution.free, data.experiments(), strict=True)
        ),
        warnings=tuple(_warnings(best, starts, whiteness, basis.rank, d, agreed=agreed)),
        output=data.output,
        unit=data.unit,
        input_unit=data.input_unit,
        source=data.source,
        history=data.history,
        digest=data.digest,
    )


def _free_response(
    problem: OutputError, B: Array, F: Array, x: Array, part: Dataset
) -> FreeResponse:
    transients = tuple(float(v) for v in x[: problem.sizes.count])
    if not problem.sizes.drift:
        return FreeResponse(transients=transients)
    level, slope = (float(v) for v in x[problem.sizes.count :])
    offset = offset_from_ramp(B, F, slope, float(np.mean(part.u)))
    return FreeResponse(transients=transients, level=level, offset=offset)


def _warnings(
    best: Optimum, starts: tuple[Start, ...], whiteness: float, rank: int, d: int, *, agreed: bool
) -> Iterator[str]:
    if not best.converged:
        yield f"the search did not converge in {best.iterations} steps"
    if not agreed:
        yield f"the start {starts[-1].name!r} ended in a poorer minimum ({starts[-1].loss:.4g})"
    if rank < d:
        yield f"the data determine only {rank} of {d} parameters: the orders are too high"
    if whiteness < WHITE_LEVEL:
        yield "the residuals are coloured: trust std_robust, or raise the orders"


def _rows(x: Array, valid: Array) -> Array:
    return x if valid.all() else np.asarray(x[valid])


def _interpolated(y: Array, valid: Array) -> Array:
    if valid.all():
        return y
    if not valid.any():
        return np.zeros(y.size)
    t = np.arange(y.size)
    return np.interp(t, t[valid], y[valid])
