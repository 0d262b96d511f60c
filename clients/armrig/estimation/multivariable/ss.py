"""State-space models by the prediction error, with several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.finding import EstimateFinding, warning
from armrig.data.signals import Signals
from armrig.estimation.multivariable.data_checks import instability, origin, require_informative
from armrig.estimation.multivariable.inference import (
    OutputResiduals,
    inferred,
    pairwise_covariance,
)
from armrig.estimation.multivariable.n4sid import n4sid
from armrig.estimation.multivariable.state_space_problem import (
    Linear,
    Part,
    StateSpaceProblem,
    delays_of,
    parts_of,
    reflected_matrix,
    scaled_signals,
    stable_matrix,
    tangent,
    whitened,
)
from armrig.estimation.multivariable.subspace import (
    complete_stretches,
    from_impulses,
    long_regression,
    projected,
    realised,
)
from armrig.estimation.multivariable.whitening import whitening
from armrig.estimation.orders import require_samples
from armrig.models.estimate import Start
from armrig.models.multivariable.fit import MultivariableFit
from armrig.models.multivariable.matrices import Matrices
from armrig.numerics.checks import require_flags, require_integers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array

_STEPS = 6  # steps of the search between two estimates of Lambda
_MAX_ROUNDS = 40
_SAME_TOLERANCE = 1e-9  # change of log det Lambda at which the search ends
_TRIED_ROUNDS = 3  # rounds of every start before only the best continue
_TRIED_TOLERANCE = 1e-3  # change of log det Lambda at which a trial ends
_PART_SAMPLES = 2000  # samples of long data on which every start is tried
_DISTINCT = 1e-4  # difference of log det Lambda between two minima
_CONTINUED = 3  # starts that continue
_MIN_LAGS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    """State of a search."""

    name: str
    Abar: Array
    C: Array
    Lambda: Array
    criterion: float
    iterations: int
    converged: bool


def ss(
    data: Signals,
    *,
    order: int | None = None,
    nk: int | Sequence[int] = 1,
    noise: bool = True,
) -> MultivariableFit:
    """Estimate A, B, C, D and K of x(t+1) = A x + B u + K e, y = C x + D u + e.

    The search minimises log det of the covariance of the prediction errors. Inputs and outputs are
    scaled inside, so that units do not matter. The poles of the predictor, the eigenvalues of A - K
    C, are inside the unit circle.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs. Only with noise=False may values be missing.
    order : int, optional
        Number of states, >= 1; by default the order that `n4sid` chooses.
    nk : int or sequence of int, default 1
        Samples before each input reaches the outputs; 0 for all inputs is a direct term D.
    noise : bool, default True
        Estimate K. With False the model is an output-error model, K = 0.

    Returns
    -------
    MultivariableFit
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
    """
    if order is None:
        order = n4sid(data, nk=nk, replicates=0).form.realised().A.shape[0]
    require_integers(order=(order, 1))
    require_flags(noise=noise)
    delays = delays_of(nk, data)
    require_informative(data)
    if noise and data.missing:
        raise InputError(
            f"{data.missing} values are missing, and ss estimates K from complete data only; give "
            "noise=False for an output-error model, or use bj"
        )
    n, nu, ny = int(order), data.nu, data.ny
    direct = max(delays) == 0
    parameters = n * (ny + nu) + (n * ny if noise else 0) + (ny * nu if direct else 0)
    require_samples(f"order={n}", needed=parameters // ny + 2 * n + 2, got=data.N)
    signals, su, sy = scaled_signals(data, delays)
    problem = StateSpaceProblem(
        parts=parts_of(signals, np.eye(ny)), order=n, direct=direct, noise=noise
    )
    ends = _searched(problem, signals)
    best = ends[0]
    problem = _weighted(problem, best.Lambda)
    linear = problem.linear(best.Abar, best.C)
    if linear.rank < linear.X.shape[1]:
        raise InputError(
            f"order={n}: the data determine only {linear.rank} of {linear.X.shape[1]} entries of "
            "B, D and K; lower the order or excite with richer inputs"
        )
    form, T = _form(best, linear, su, sy, delays, problem)
    found = _inference(data, problem, best, linear, sy)
    fields = found.fields()
    fields["covariance"] = T @ found.covariance @ T.T
    fields["covariance_robust"] = T @ found.covariance_robust @ T.T
    return MultivariableFit(
        structure="ss",
        orders=f"order={n}, nk={_short(delays)}" + ("" if noise else ", noise=False"),
        form=form,
        converged=best.converged,
        starts=tuple(
            Start(
                name=e.name,
                loss=float(np.exp(e.criterion / ny)),
                iterations=e.iterations,
                converged=e.converged,
            )
            for e in ends
        ),
        findings=tuple(_findings(best, form)),
        **fields,
        **origin(data),
    )


def _short(delays: tuple[int, ...]) -> str:
    return str(delays[0]) if len(set(delays)) == 1 else str(list(delays)).replace(" ", "")


def _weighted(problem: StateSpaceProblem, Lambda: Array) -> StateSpaceProblem:
    parts = tuple(replace(p, weights=whitening(Lambda, p.rows)) for p in problem.parts)
    return replace(problem, parts=parts)


def _searched(problem: StateSpaceProblem, signals: Sequence[tuple[Array, Array]]) -> list[_End]:
    """Return the ends of the searches from all starts, best first.

    All starts are searched for some rounds, and the best ones to the end. For long data the first
    rounds use a part of the data.
    """
    starts = _starts(problem, signals)
    part = _part(problem)
    ends = [
        _improved(part, end, rounds=_TRIED_ROUNDS, tolerance=_TRIED_TOLERANCE) for end in starts
    ]
    ends = _different(sorted(ends, key=lambda end: end.criterion))
    ends = [_improved(problem, end, rounds=_MAX_ROUNDS) for end in ends[:_CONTINUED]]
    return sorted(ends, key=lambda end: end.criterion)


def _part(problem: StateSpaceProblem) -> StateSpaceProblem:
    """Return the problem for the first samples of long data, at most `_PART_SAMPLES`."""
    left, parts = _PART_SAMPLES, []
    for part in problem.parts:
        n = min(part.u.shape[0], left)
        if n > 0:
            fields = {name: getattr(part, name)[:n] for name in ("u", "y", "rows", "weights")}
            parts.append(Part(**fields))
        left -= n
    return replace(problem, parts=tuple(parts))


def _different(ends: list[_End]) -> list[_End]:
    """Return the ends without those that reached the criterion of an earlier one."""
    kept: list[_End] = []
    for end in ends:
        if all(abs(end.criterion - known.criterion) > _DISTINCT for known in kept):
            kept.append(end)
    return [replace(end, criterion=np.inf, converged=False) for end in kept]


def _improved(
    problem: StateSpaceProblem, end: _End, *, rounds: int, tolerance: float = _SAME_TOLERANCE
) -> _End:
    """Return the end of a search; Lambda is estimated again after each few steps."""
    for _ in range(rounds):
        if end.converged:
            return end
        weighted = _weighted(problem, end.Lambda)
        Abar, C, found = weighted.minimise(end.Abar, end.C, most=_STEPS)
        Lambda, criterion = _criterion(weighted, Abar, C)
        settled = abs(end.criterion - criterion) <= tolerance
        end = replace(
            end,
            Abar=Abar,
            C=C,
            Lambda=Lambda,
            criterion=criterion,
            iterations=end.iterations + found.iterations,
            converged=settled,
        )
    return end


def _criterion(problem: StateSpaceProblem, Abar: Array, C: Array) -> tuple[Array, float]:
    """Return the covariance of the errors and the logarithm of its determinant."""
    e = problem.residuals(Abar, C, problem.linear(Abar, C))
    Lambda = pairwise_covariance(np.vstack(e))
    return Lambda, float(np.linalg.slogdet(Lambda)[1])


def _starts(problem: StateSpaceProblem, signals: Sequence[tuple[Array, Array]]) -> list[_End]:
    """Return the starts, each with the covariance of its errors."""
    n = problem.order
    ny = signals[0][1].shape[1]
    signals = [(u, _filled(y)) for u, y in signals]
    found: list[tuple[str, Array, Array]] = []
    N = sum(u.shape[0] for u, _ in signals)
    width = signals[0][0].shape[1] + ny
    most = max(N // (6 * width), 1)
    for horizon in dict.fromkeys(
        max(min(h, most), -(-n // ny) + 1) for h in (n + 2, max(_MIN_LAGS, 2 * n + 2))
    ):
        whole = complete_stretches(signals, 4 * horizon)
        if not whole:
            continue
        for weights in ("cva", "moesp"):
            A, C, K = realised(projected(whole, horizon, weights), n)
            found.append(
                (f"n4sid, {weights}, horizon {horizon}", A - K @ C if problem.noise else A, C)
            )
    for lags in dict.fromkeys(max(min(k, most), n + 1) for k in (2 * n + 2, 4 * n + 10)):
        whole = complete_stretches(signals, 2 * lags)
        if not whole:
            continue
        psi = long_regression(whole, lags, direct=problem.direct)
        if not problem.noise:
            psi = _simulated_impulses(psi, signals[0][0].shape[1], 2 * lags)
        found.append((f"ARX of order {lags}", *from_impulses(psi, n)))
    starts = []
    for name, Abar, C in found:
        Abar = reflected_matrix(Abar)
        if not (np.isfinite(C).all() and stable_matrix(Abar)):
            continue
        Lambda, criterion = _criterion(problem, Abar, C)
        starts.append(
            _End(
                name=name,
                Abar=Abar,
                C=C,
                Lambda=Lambda,
                criterion=criterion,
                iterations=0,
                converged=False,
            )
        )
    if not starts:
        raise InputError(
            f"order={n}: no start value was found; lower the order, or interpolate missing samples"
        )
    return starts


def _filled(y: Array) -> Array:
    """Return y (N, ny) with missing values interpolated, for a start value."""
    known = np.isfinite(y)
    if known.all():
        return y
    t = np.arange(y.shape[0])
    return np.column_stack(
        [
            np.interp(t, t[k], x[k]) if k.any() else np.zeros(t.size)
            for x, k in zip(y.T, known.T, strict=True)
        ]
    )


def _simulated_impulses(psi: Array, nu: int, length: int) -> Array:
    """Return the impulse responses (length, ny, nu) from u of a predictor's impulse responses."""
    lags, ny, _ = psi.shape
    g = np.zeros((length, ny, nu))
    for k in range(length):
        g[k] = psi[k, :, :nu] if k < lags else 0.0
        for m in range(min(k, lags)):
            g[k] += psi[m, :, nu:] @ g[k - m - 1]
    return g


def _form(
    best: _End,
    linear: Linear,
    su: Array,
    sy: Array,
    delays: tuple[int, ...],
    problem: StateSpaceProblem,
) -> tuple[Matrices, Array]:
    """Return the model in units of the data, and the derivatives of its theta.

    The free parameters are the coordinates along the tangent space, then Bbar and K, signal by
    signal, then D.
    """
    n, ny, nu = problem.order, sy.size, su.size
    Abar, C, K, D = best.Abar, best.C, linear.K, linear.D
    V = tangent(Abar, C)
    width = n * nu + n * ny * problem.noise + ny * nu * problem.direct
    d = V.shape[1] + width
    by_Abar = np.zeros((d, n, n))
    by_C, by_B = np.zeros((d, ny, n)), np.zeros((d, n, nu))
    by_K, by_D = np.zeros((d, n, ny)), np.zeros((d, ny, nu))
    by_Abar[: V.shape[1]] = V[: n * n].T.reshape(-1, n, n)
    by_C[: V.shape[1]] = V[n * n :].T.reshape(-1, ny, n)
    at = V.shape[1]
    for s in range(nu + ny * problem.noise):
        for k in range(n):
            if s < nu:
                by_B[at, k, s] = 1.0
            else:
                by_K[at, k, s - nu] = 1.0
            at += 1
    if problem.direct:
        by_D[at:] = np.eye(ny * nu).reshape(-1, ny, nu)
    by_A = by_Abar + by_K @ C + K @ by_C
    by_B = by_B + by_K @ D + K @ by_D
    form = Matrices(
        A=Abar + K @ C,
        B=(linear.Bbar + K @ D) / su,
        C=sy[:, None] * C,
        D=sy[:, None] * D / su,
        K=K / sy,
        nk=delays,
    )
    blocks = [by_A, by_B / su, sy[:, None] * by_C, sy[:, None] * by_D / su, by_K / sy]
    return form, np.hstack([b.reshape(d, -1) for b in blocks]).T


def _inference(
    data: Signals, problem: StateSpaceProblem, best: _End, linear: Linear, sy: Array
) -> Any:
    V = tangent(best.Abar, best.C)
    by = problem.derivatives(best.Abar, best.C, linear, V)
    edges = problem.edges()
    Psi = np.hstack(
        [
            np.vstack(
                [
                    Z.without(whitened(part, d))
                    for part, d, Z in zip(problem.parts, by, linear.states, strict=True)
                ]
            ),
            linear.X,
        ]
    )
    basis = orthonormal(Psi)
    H = basis.Q @ basis.W.T
    residuals = problem.residuals(best.Abar, best.C, linear)
    ny = sy.size
    experiments = []
    for part, e, at, experiment in zip(
        problem.parts, residuals, edges, data.experiments(), strict=True
    ):
        whole = H[at].reshape(ny, part.u.shape[0], -1)
        white = Psi[at].reshape(ny, part.u.shape[0], -1)
        unwhitened = np.linalg.inv(part.weights[0]) if part.rows.all() else None
        of = []
        for i in range(ny):
            h = np.einsum("tk,ktd->td", part.weights[:, :, i], whole) / sy[i]
            psi = (
                np.einsum("k,ktd->td", unwhitened[i], white) if unwhitened is not None else white[i]
            )
            of.append(
                OutputResiduals(
                    e=e[:, i] * sy[i],
                    y=experiment.y[:, i],
                    H=h,
                    Psi=psi,
                    Z=np.zeros((e.shape[0], 0)),
                )
            )
        experiments.append(of)
    states = problem.order * len(problem.parts)
    return inferred(
        experiments,
        parameters=[(Psi.shape[1] + states) / ny] * ny,
        score="correlated" if problem.noise else "exogenous",
    )


def _findings(best: _End, form: Matrices) -> list[EstimateFinding]:
    notes = []
    if not best.converged:
        text = f"the search did not converge in {best.iterations} steps"
        notes.append(warning("not_converged", text, steps=best.iterations))
    return [*notes, *instability(form)]
