"""Output error: the prediction-error estimate of B/F where the noise is white on the output."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Literal

import numpy as np

from armrig.checks import require_integers
from armrig.dataset import Dataset
from armrig.estimation.covariance import exogenous_score
from armrig.estimation.levenberg_marquardt import Optimum
from armrig.estimation.orders import Sizes, require_samples
from armrig.estimation.output_error import OutputError, Solution
from armrig.fit import Fit, Start
from armrig.free_response import FreeResponse, offset_from_ramp, transient_count
from armrig.goodness import fit_percent
from armrig.least_squares import Basis, orthonormal
from armrig.polynomial import Array
from armrig.prediction import spread, summed_input
from armrig.whiteness import WHITE_LEVEL, default_lags, portmanteau

SAME_MINIMUM = 1e-6  # relative difference in cost up to which two searches agree
ROUNDING = 1e-18  # share of |y|² below which |e|² is rounding noise


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
    require_integers(nb=(nb, 1), nf=(nf, int(integrator)), nk=(nk, 0))
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
    M, sse = solution.e.size, best.cost
    residuals, blocks, spans = _by_experiment(problem, solution)
    degrees = M - solution.Psi.shape[1] - sum(span.shape[1] for span in solution.spans)
    noise_variance = sse / degrees
    basis = orthonormal(solution.Psi)
    bread = basis.W @ basis.W.T
    robust = bread @ (exogenous_score(blocks, residuals) * M / degrees) @ bread
    to_full = _with_integrator(problem.sizes) if integrator else np.eye(solution.Psi.shape[1])
    valid_y = data.y[data.valid]
    floor = ROUNDING * float(valid_y @ valid_y)
    white = portmanteau(residuals, blocks, spans, default_lags(M)) if sse > floor else float("nan")
    agreed = ends[-1][1].cost <= sse * (1 + SAME_MINIMUM) + floor
    starts = tuple(
        Start(name=name, loss=o.cost / M, iterations=o.iterations, converged=o.converged)
        for name, o in ends
    )
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
        whiteness=white,
        converged=best.converged,
        starts=starts,
        agreed=agreed,
        free=tuple(
            _free_response(problem, B, F, x, part)
            for x, part in zip(solution.free, data.experiments(), strict=True)
        ),
        warnings=tuple(_warnings(best, starts, white, basis, agreed=agreed)),
        **data.origin(),
    )


def _by_experiment(
    problem: OutputError, solution: Solution
) -> tuple[list[Array], list[Array], list[Array]]:
    """Return residuals, sensitivities and free responses of each experiment, on all its rows."""
    masks = [valid for _, _, valid in problem.experiments]
    edges = np.cumsum([0, *(np.count_nonzero(valid) for valid in masks)])
    residuals, blocks = [], []
    for valid, (a, b) in zip(masks, pairwise(edges), strict=True):
        e = np.full(valid.size, np.nan)
        e[valid] = solution.e[a:b]
        residuals.append(e)
        blocks.append(spread(solution.Psi[a:b], valid))
    spans = [spread(Q, valid) for Q, valid in zip(solution.spans, masks, strict=True)]
    return residuals, blocks, spans


def _with_integrator(n: Sizes) -> Array:
    """Return the derivatives of (b, f) by (b, f̃), (nb + nf + 1, nb + nf), F = (1 - q^-1) F̃.

    f_k = f̃_k - f̃_(k-1), f_1 also less 1: linear in f̃.
    """
    step = np.eye(n.nf + 1, n.nf) - np.eye(n.nf + 1, n.nf, k=-1)
    return np.block(
        [[np.eye(n.nb), np.zeros((n.nb, n.nf))], [np.zeros((n.nf + 1, n.nb)), step]],
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
    best: Optimum, starts: tuple[Start, ...], whiteness: float, basis: Basis, *, agreed: bool
) -> Iterator[str]:
    if not best.converged:
        yield f"the search did not converge in {best.iterations} steps"
    if not agreed:
        yield f"the start {starts[-1].name!r} ended in a poorer minimum ({starts[-1].loss:.4g})"
    d = basis.W.shape[0]
    if basis.rank < d:
        yield f"the data determine only {basis.rank} of {d} parameters: the orders are too high"
    if whiteness < WHITE_LEVEL:
        yield "the residuals are coloured: trust std_robust, or raise the orders"
