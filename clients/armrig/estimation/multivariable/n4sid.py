"""Subspace estimates with several inputs and outputs, and their covariance by a bootstrap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from armrig_core.errors import InputError

from armrig.data.finding import EstimateFinding, warning
from armrig.data.signals import Signals
from armrig.estimation.data_checks import (
    instability,
    origin,
    poor_fits,
    require_informative,
)
from armrig.estimation.multivariable.error_process import error_process
from armrig.estimation.multivariable.inference import pairwise_covariance, quality_of
from armrig.estimation.multivariable.state_space_problem import (
    Part,
    StateSpaceProblem,
    delays_of,
    parts_of,
    reflected_matrix,
    scaled_signals,
)
from armrig.estimation.multivariable.state_space_starts import interpolated
from armrig.estimation.multivariable.subspace import (
    Projected,
    complete_stretches,
    projected,
    realised,
)
from armrig.estimation.orders import require_samples
from armrig.models.multivariable.fit import MultivariableFit
from armrig.models.multivariable.matrices import Matrices
from armrig.models.structure_table import Weights
from armrig.numerics.checks import require_integers
from armrig.numerics.criteria import mdl
from armrig.numerics.gram import least_squares_by_gram
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion, varying_recursion
from armrig.numerics.stretches import stretches
from armrig.numerics.whitening import patterns

_MAX_SUGGESTED_ORDER = 10
_STEP = 1e-6  # change of a matrix entry for a numerical derivative
_RANK_TOLERANCE = 1e-8  # a smaller relative singular value belongs to a change of coordinates
_MIN_HORIZON = 10
_MAX_PASSES = 20
_REPLICATES = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    """Matrices for the scaled signals, and the state at the start of each experiment."""

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    x0: tuple[Array, ...]


def n4sid(
    data: Signals,
    order: int | None = None,
    weights: Weights = "cva",
    *,
    nk: int | Sequence[int] = 1,
    horizon: int | None = None,
    replicates: int = _REPLICATES,
    seed: int = 0,
) -> MultivariableFit:
    """Estimate x(t+1) = A x + B u + K e, y = C x + D u + e by projections.

    A and C are computed from the left singular vectors of the weighted projection. K is computed
    from the residuals of a regression of the states. Least squares on the one-step errors then
    estimate B, D and the initial states. `ss` continues from this estimate to the minimum of the
    prediction error.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs. Missing outputs are replaced by the model's
        predictions, and the model is estimated again, until these values settle. Windows with a gap
        of more than `horizon` samples are not used.
    order : int, optional
        Number of states, >= 1. By default MDL of the one-step errors selects the order.
    weights : {"cva", "moesp", "n4sid"}
        Weights of the projection, as for one input and output.
    nk : int or sequence of int, default 1
        Number of samples before each input reaches the outputs. With 0 for all inputs the model has
        a direct term D.
    horizon : int, optional
        Number of past and of future samples; by default the larger of 10 and twice the order. For
        short data the default is smaller.
    replicates : int, default 100
        Number of replicates, from which the covariance is computed. For each replicate a data set
        is simulated by the model, and another model is estimated from this data set in the same
        way. The errors of the simulation are drawn from an autoregression of the model's one-step
        errors. With fewer than 2 replicates the covariance is NaN.
    seed : int, default 0
        Seed of the drawn errors.

    Returns
    -------
    MultivariableFit
        The covariance of the matrices is computed from the scatter of the replicates' impulse
        responses.

    Raises
    ------
    ValueError
        There are too few samples, or the data do not determine the model.

    References
    ----------
    .. [1] P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996.
    .. [2] P. Bühlmann, "Sieve bootstrap for time series", Bernoulli 3 (1997) 123-148.
    """
    require_integers(order=(1 if order is None else order, 1), replicates=(replicates, 0))
    if weights not in get_args(Weights):
        allowed = ", ".join(f'"{x}"' for x in get_args(Weights))
        raise InputError(f"weights={weights!r} must be one of {allowed}")
    delays = delays_of(nk, data)
    require_informative(data)
    signals, su, sy = scaled_signals(data, delays)
    i = _horizon(data, order) if horizon is None else horizon
    least = 3 if order is None else -(-int(order) // data.ny) + 1
    require_integers(horizon=(i, least))
    width = 2 * i * (data.nu + data.ny)
    whole = complete_stretches(_bridged(signals, i), 2 * i)
    windows = sum(u.shape[0] - 2 * i + 1 for u, _ in whole)
    require_samples(
        f"horizon={i}, with windows of {2 * i} samples without a gap of more than {i},",
        needed=width + 2 * i,
        got=windows + 2 * i - 1 if windows else 0,
    )
    direct = max(delays) == 0
    given = None if order is None else int(order)
    model, residuals, settled = _estimated(signals, i, weights, given, direct=direct)
    n = model.A.shape[0]
    covariance = _replicated(
        signals, model, residuals, i, weights, direct=direct, replicates=replicates, seed=seed
    )
    form = _form(model, su, sy, delays)
    scale = _scales(model, su, sy)
    parameters = (n * (data.ny + data.nu) + n * data.ny) / data.ny
    outputs = [
        ([e[:, k] * sy[k] for e in residuals], [p.y[:, k] for p in data.experiments()])
        for k in range(data.ny)
    ]
    quality = tuple(quality_of(e, y, parameters) for e, y in outputs)
    return MultivariableFit(
        structure="n4sid",
        orders=f"order={n}, nk={delays[0] if len(set(delays)) == 1 else list(delays)}",
        form=form,
        covariance=scale[:, None] * covariance * scale,
        covariance_robust=scale[:, None] * covariance * scale,
        noise_covariance=pairwise_covariance(np.vstack(residuals)) * np.outer(sy, sy),
        quality=quality,
        converged=settled,
        findings=(*_unsettled(settled), *instability(form), *poor_fits(data, quality)),
        **origin(data),
    )


def _unsettled(settled: bool) -> Iterator[EstimateFinding]:
    """Yield a warning if the estimates of the missing outputs still changed in the last pass."""
    if not settled:
        text = f"the missing outputs were estimated {_MAX_PASSES} times and did not settle: use ss"
        yield warning("not_converged", text, steps=_MAX_PASSES)


def _horizon(data: Signals, order: int | None) -> int:
    """Return the default horizon: shorter for short data."""
    wanted = max(_MIN_HORIZON, 2 * (order or 0))
    most = data.N // (3 * (data.nu + data.ny))
    return max(min(wanted, most), -(-(order or 2) // data.ny) + 1)


def _suggested_order(found: Projected) -> int:
    """Return the order that minimises MDL of the one-step errors."""
    w = found
    most = min(_MAX_SUGGESTED_ORDER, (w.horizon - 1) * w.ny)
    y = w.R[:, w.columns("yf")[: w.ny]]
    now = w.R[:, w.columns("uf")[: w.nu]]
    states = w.R[:, w.columns("up", "yp")] @ (w.H.T @ w.U[:, :most])
    scores = []
    for n in range(1, most + 1):
        known = np.hstack([now, states[:, :n]])
        rest = y - known @ np.linalg.lstsq(known, y, rcond=None)[0]
        loss = np.exp(np.linalg.slogdet(rest.T @ rest / w.N)[1])
        scores.append(float(mdl(loss, n * (2 * w.ny + w.nu), w.N)))
    return 1 + int(np.argmin(scores))


def _estimated(
    signals: Sequence[tuple[Array, Array]],
    horizon: int,
    weights: Weights,
    order: int | None,
    *,
    direct: bool,
) -> tuple[_Model, list[Array], bool]:
    """Return the model, its one-step errors (NaN where y is missing), and True if it settled.

    The windows need a value for each missing output. The first value is interpolated. The model's
    predictions then replace these values, and the model is estimated again, until the values change
    by less than std(e)/sqrt(N). If they do not settle, the model with the least errors is returned.
    """
    known = _bridged(signals, horizon)
    least = np.inf
    for _ in range(_MAX_PASSES):
        found = projected(complete_stretches(known, 2 * horizon), horizon, weights)
        n = _suggested_order(found) if order is None else order
        now, predicted = _completed(signals, *realised(found, n), direct=direct)
        errors = [y - at for (_, y), at in zip(signals, predicted, strict=True)]
        e = np.vstack(errors)
        loss = float(np.nanmean(e**2))
        if loss < least:
            least, best = loss, (now, errors)
        before = np.vstack([y for _, y in known])
        estimated = np.isnan(e) & np.isfinite(before)
        if not estimated.any():
            return now, errors, True
        Lambda = pairwise_covariance(e)
        known = [
            (u, np.where(np.isnan(y), np.nan, at + _conditional(x, Lambda)))
            for (u, y), at, x in zip(known, predicted, errors, strict=True)
        ]
        change = (np.vstack([y for _, y in known]) - before)[estimated]
        if np.mean(change**2) <= loss / len(e):
            return now, errors, True
    return *best, False


def _bridged(signals: Sequence[tuple[Array, Array]], longest: int) -> list[tuple[Array, Array]]:
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


def _completed(
    signals: Sequence[tuple[Array, Array]], A: Array, C: Array, K: Array, *, direct: bool
) -> tuple[_Model, list[Array]]:
    """Return the B, D and initial states that minimise the one-step errors, and the predictions."""
    Abar = reflected_matrix(A - K @ C)
    (n, ny), nu = K.shape, signals[0][0].shape[1]
    problem = StateSpaceProblem(
        parts=parts_of(signals, np.eye(ny)), order=n, direct=direct, noise=False
    )
    blocks = [
        _responses_with_gaps(part, Abar, C, K, direct=direct)
        if K.any() and not part.rows.all()
        else (_fed(part.y, Abar, C, K), *problem.responses(part, Abar, C))
        for part in problem.parts
    ]
    k = len(blocks[0][1])
    columns = []
    for i, (_, driven, free) in enumerate(blocks):
        before, after = (np.zeros((n * m, *free.shape[1:])) for m in (i, len(blocks) - i - 1))
        block = np.concatenate([driven, before, free, after])
        columns.append(block.reshape(len(block), -1))
    missing = [(y - fed).T.ravel() for (_, y), (fed, _, _) in zip(signals, blocks, strict=True)]
    whole = columns[0] if len(columns) == 1 else np.hstack(columns)
    theta = least_squares_by_gram(whole, np.concatenate(missing))
    Bbar, D, x0 = np.split(theta, [n * nu, k])
    B, D = Bbar.reshape(nu, n).T, D.reshape(ny, nu) if direct else np.zeros((ny, nu))
    model = _Model(A=Abar + K @ C, B=B + K @ D, C=C, D=D, K=K, x0=tuple(x0.reshape(-1, n)))
    predicted = [
        fed + (theta @ M).reshape(ny, -1).T for (fed, _, _), M in zip(blocks, columns, strict=True)
    ]
    return model, predicted


def _fed(y: Array, Abar: Array, C: Array, K: Array) -> Array:
    """Return the part (N, ny) of the predictions that is due to the measured outputs."""
    if not K.any():
        return np.zeros(y.shape)
    return np.asarray(recursion(Abar, y @ K.T, np.zeros(len(Abar)))[:-1] @ C.T)


def _responses_with_gaps(
    part: Part, Abar: Array, C: Array, K: Array, *, direct: bool
) -> tuple[Array, Array, Array]:
    """Return what `_fed` and `StateSpaceProblem.responses` return, for data with missing outputs.

    The predictor assumes that the error of a missing output is 0. M(t) is the identity without the
    rows of the missing outputs ::

        x(t+1) = (Abar + K C - K M(t) C) x(t) + (Bbar + K D - K M(t) D) u(t) + K M(t) y(t)
    """
    N, nu = part.u.shape
    n, ny = K.shape
    gain = K * part.rows[:, None, :]
    k = n * nu + direct * ny * nu
    w = np.zeros((N, k + n + 1, n))
    w[:, : n * nu].reshape(N, nu, n, n)[:, :, range(n), range(n)] = part.u[:, :, None]
    if direct:
        unused = (K - gain).swapaxes(1, 2)
        w[:, n * nu : k] = (unused[:, :, None, :] * part.u[:, None, :, None]).reshape(N, -1, n)
    w[:, -1] = (gain @ part.y[:, :, None])[:, :, 0]
    x0 = np.zeros((k + n + 1, n))
    x0[k:-1] = np.eye(n)
    found = varying_recursion(Abar + K @ C - gain @ C, w, x0)[:-1] @ C.T
    if direct:
        at_once = found[:, n * nu : k].reshape(N, ny, nu, ny)
        at_once[:, range(ny), :, range(ny)] += part.u
    found = found.transpose(1, 2, 0)
    return found[-1].T, found[:k], found[k:-1]


def _replicated(
    signals: Sequence[tuple[Array, Array]],
    model: _Model,
    residuals: list[Array],
    horizon: int,
    weights: Weights,
    *,
    direct: bool,
    replicates: int,
    seed: int,
) -> Array:
    """Return the covariance of the matrices over the replicates, in the model's coordinates.

    The state of each replicate has its own coordinates, but impulse responses do not depend on
    coordinates. Each replicate is therefore replaced by the smallest change of the model's matrices
    that reproduces the impulse responses of the replicate.
    """
    d = _vector(model).size
    if replicates < 2:
        return np.full((d, d), np.nan)
    rng = np.random.default_rng(seed)
    process = error_process(residuals)
    samples = []
    length = 2 * horizon
    for _ in range(replicates):
        data = []
        for (u, y), x0 in zip(signals, model.x0, strict=True):
            e = process.drawn(rng, u.shape[0])
            x = recursion(model.A, u @ model.B.T + e @ model.K.T, x0)[:-1]
            simulated = x @ model.C.T + u @ model.D.T + e
            data.append((u, np.where(np.isfinite(y), simulated, np.nan)))
        replicate, _, _ = _estimated(data, horizon, weights, model.A.shape[0], direct=direct)
        samples.append(_impulses(replicate, length))
    spread = np.array(samples) - np.mean(samples, axis=0)
    theta = np.linalg.lstsq(_by_matrices(model, length), spread.T, rcond=_RANK_TOLERANCE)[0]
    return np.asarray(theta @ theta.T / (len(samples) - 1))


def _impulses(model: _Model, length: int) -> Array:
    """Return the impulse responses from u and e, of `length` samples each, as a vector."""
    inputs = np.hstack([model.B, model.K])
    found = [model.D.ravel()]
    for _ in range(length):
        found.append((model.C @ inputs).ravel())
        inputs = model.A @ inputs
    return np.concatenate(found)


def _by_matrices(model: _Model, length: int) -> Array:
    """Return the derivatives of the impulse responses with respect to the matrices."""
    theta = _vector(model)
    columns = []
    for step in _STEP * np.eye(theta.size):
        ahead, behind = (_impulses(_of(theta + d, model), length) for d in (step, -step))
        columns.append((ahead - behind) / (2 * _STEP))
    return np.column_stack(columns)


def _of(theta: Array, like: _Model) -> _Model:
    """Return the model whose matrices have the entries theta."""
    shapes = [M.shape for M in (like.A, like.B, like.C, like.D, like.K)]
    parts = np.split(theta, np.cumsum([a * b for a, b in shapes])[:-1])
    A, B, C, D, K = (p.reshape(shape) for p, shape in zip(parts, shapes, strict=True))
    return _Model(A=A, B=B, C=C, D=D, K=K, x0=())


def _vector(model: _Model) -> Array:
    return np.concatenate([M.ravel() for M in (model.A, model.B, model.C, model.D, model.K)])


def _form(model: _Model, su: Array, sy: Array, delays: tuple[int, ...]) -> Matrices:
    """Return the model in the units of the data."""
    return Matrices(
        A=model.A,
        B=model.B / su,
        C=sy[:, None] * model.C,
        D=sy[:, None] * model.D / su,
        K=model.K / sy,
        nk=delays,
    )


def _scales(model: _Model, su: Array, sy: Array) -> Array:
    """Return the factors that convert the entries of the scaled matrices to units of the data."""
    n = model.A.shape[0]
    one = np.ones((n, 1))
    parts = (np.ones((n, n)), one / su, sy[:, None] * one.T, sy[:, None] / su, one / sy)
    return np.concatenate([p.ravel() for p in parts])
