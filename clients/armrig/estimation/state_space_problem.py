"""Prediction-error problem of a state-space model with several inputs and outputs.

For given Abar and C the `Predictor` is linear in Bbar, K, D and x(0). The search is therefore over
Abar and C only (variable projection). A change of the state's coordinates does not change the
model. The search uses only the n ny directions orthogonal to these changes. These directions span
the tangent space of the models.

References
----------
.. [1] T. McKelvey, A. Helmersson, T. Ribarits, Automatica 40 (2004) 1629-1635 (local coordinates).
.. [2] J. Bruls, C. T. Chou, B. R. J. Haverkamp, M. Verhaegen, European J. Control 5 (1999) 186-200
   (separable least squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Signals
from armrig.estimation.state_space_responses import (
    Predictor,
    ScaledExperiment,
    entries,
    free_responses_with_gaps,
    offsets,
    output_normal,
    responses_with_gaps,
    state_responses,
)
from armrig.numerics.checks import require_integers
from armrig.numerics.covariance import whitening
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import plural
from armrig.numerics.recursion import in_observer_form, outputs, recursion, responses

_MAX_MODULUS = 1 - 1e-7  # largest modulus of an eigenvalue of Abar in a search
_ORBIT_TOLERANCE = 1e-10  # a smaller relative singular value is a rounding error


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """Linear part of the predictor for given Abar and C."""

    at: Predictor
    """Predictor with these parameters; what is not estimated is 0, or given."""
    basis: Basis
    """Basis of the whitened responses to Bbar, K and D, with the responses to x0 projected out."""
    states: tuple[Basis, ...]
    """Basis of the whitened responses to x0 of each experiment."""
    e: Array
    """Whitened errors of all experiments, output after output."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StateSpaceProblem:
    """Search for Abar, C and all linear parameters that minimise the sum of e^T inv(Lambda) e."""

    parts: tuple[ScaledExperiment, ...]
    """Signals of each experiment."""
    order: int
    """Number of states."""
    direct: bool
    """True if D is estimated."""
    noise: bool
    """True if K is estimated; False for an output-error model."""
    level: bool = False
    """True if constant offsets of the signals are estimated."""
    gain: Array | None = None
    """Given K (n, ny), if K is not estimated and not 0."""

    def linear(self, Abar: Array, C: Array, Bbar_D: tuple[Array, Array] | None = None) -> Linear:
        """Return the linear parameters by least squares; Bbar and D may be given."""
        n, (ny, _) = self.order, C.shape
        nu = self.parts[0].u.shape[1]
        bare = self._bare(Abar, C)
        states, left, raw = [], [], []
        for part in self.parts:
            signals = np.hstack([part.u, part.y]) if self.noise else part.u
            driven, free = self._responses(part, bare, signals)
            Z = basis_of_states(part, free)
            left_over = part.y if self.gain is None else part.y - bare.predicted(part, 0)
            both = whiten(part, np.concatenate([driven, left_over.T[None]]))
            states.append(Z)
            raw.append(both)
            left.append(without(Z, both))
        both = stack_blocks(left)
        basis, right = orthonormal(both[:, :-1]), both[:, -1]
        theta = basis.coefficients(right)
        if Bbar_D is not None:
            theta = np.concatenate([Bbar_D[0].T.ravel(), Bbar_D[1].ravel()[: theta.size - n * nu]])
        signals = theta[: n * (nu + ny * self.noise)].reshape(-1, n).T
        D = theta[signals.size :].reshape(ny, nu) if self.direct else np.zeros((ny, nu))
        first = [
            Z.coefficients(M[:, -1] - M[:, :-1] @ theta) for Z, M in zip(states, raw, strict=True)
        ]
        at = replace(
            bare,
            Bbar=signals[:, :nu],
            D=D,
            K=signals[:, nu:] if self.noise else bare.K,
            x0=tuple(x[:n] for x in first),
            levels=tuple(x[n:] for x in first if self.level),
        )
        return Linear(at=at, basis=basis, states=tuple(states), e=basis.without(right))

    def _responses(
        self, part: ScaledExperiment, at: Predictor, signals: Array, moved: tuple[Array, ...] = ()
    ) -> tuple[Array, Array]:
        """Return the responses (k, ny, N) to (Abar, C) and the parameters, and to the state."""
        (n, ny), of_D = at.K.shape, part.u if self.direct else None
        if part.rows.all() or not at.K.any():
            driven, free = state_responses(signals, at.Abar, at.C, direct=of_D)
            if self.level:
                free = np.concatenate([free, offsets(at.Abar, at.C, len(part.u))])
            return np.concatenate(
                [_derivatives_along(at, *moved), driven]
            ) if moved else driven, free
        w, at_once = entries(signals, n, of_D, ny)
        if moved:
            x, directions = moved
            by_A, by_C = np.split(directions.T, [n * n], axis=1)
            w = np.concatenate([x @ by_A.reshape(-1, n, n).swapaxes(1, 2), w])
            at_once = np.concatenate([x @ by_C.reshape(-1, ny, n).swapaxes(1, 2), at_once])
        by = responses_with_gaps(part, at, w.swapaxes(0, 1), at_once.swapaxes(0, 1))
        return by.transpose(1, 2, 0), free_responses_with_gaps(part, at, level=self.level)

    def _bare(self, Abar: Array, C: Array) -> Predictor:
        """Return the predictor with the given gain whose other linear parameters are 0."""
        n, nu, ny = self.order, self.parts[0].u.shape[1], len(C)
        K = np.zeros((n, ny)) if self.gain is None else self.gain
        x0 = (np.zeros(n),) * len(self.parts)
        return Predictor(Abar=Abar, Bbar=np.zeros((n, nu)), C=C, D=np.zeros((ny, nu)), K=K, x0=x0)

    def linearise_along(self, Abar: Array, C: Array, directions: Array) -> tuple[Linear, Array]:
        """Return the linear part, and the derivatives of the whitened predictions.

        The derivatives are those in the directions (n (n + ny), k) of Abar, then of C, each row by
        row. The effects of the linear parameters and initial states are projected out.
        """
        linear, J = self.linear(Abar, C), []
        at = linear.at
        for part, x0, Z in zip(self.parts, at.x0, linear.states, strict=True):
            x = _states(at, part.u @ at.Bbar.T + part.y @ at.K.T, x0)
            J.append(without(Z, whiten(part, _derivatives_along(at, x, directions))))
        return linear, without(linear.basis, stack_blocks(J))

    def sensitivities(self, i: int, at: Predictor, directions: Array) -> tuple[Array, Array]:
        """Return the derivatives (d, ny, N) of yhat in experiment i, and the other responses.

        The derivatives are with respect to (Abar, C) in the given directions, then to the entries
        of Bbar, and of K with fixed A and B, signal by signal. Those of D follow, row by row. The
        other responses are those to the initial state and to offsets. The changes of the gains of a
        Kalman filter after a missing output are neglected.
        """
        part, K = self.parts[i], at.K
        yhat = at.predicted(part, i)
        y = np.where(part.rows, part.y, yhat) if K.any() else part.y
        signals = np.hstack([part.u, np.where(part.rows, part.y - yhat, 0.0)][: 1 + self.noise])
        x = _states(at, part.u @ at.Bbar.T + y @ K.T, at.x0[i])
        return self._responses(part, at, signals, (x, directions))

    def minimise(self, Abar: Array, C: Array, *, most: int) -> tuple[Array, Array, Linear, Optimum]:
        """Return Abar, C and the linear part after at most `most` steps along the tangent space."""
        Abar, C = output_normal(Abar, C)
        V = tangent(Abar, C)
        n = self.order
        last: dict[bytes, Linear] = {}

        def at(t: Array) -> tuple[Array, Array]:
            moved = V @ t
            return Abar + moved[: n * n].reshape(n, n), C + moved[n * n :].reshape(C.shape)

        def linearise(t: Array) -> tuple[Array, Array]:
            A, c = at(t)
            linear, J = self.linearise_along(A, c, V)
            last.clear()
            last[t.tobytes()] = linear
            return linear.e, J

        optimum = levenberg_marquardt(
            linearise, np.zeros(V.shape[1]), admissible=lambda t: stable_matrix(at(t)[0]), most=most
        )
        Abar, C = at(optimum.theta)
        linear = last.get(optimum.theta.tobytes()) or self.linear(Abar, C)
        return Abar, C, linear, optimum

    def residuals(self, at: Predictor) -> list[Array]:
        """Return e (N, ny) of each experiment, NaN where an output is missing."""
        return [
            np.where(part.rows, part.y - at.predicted(part, i), np.nan)
            for i, part in enumerate(self.parts)
        ]


def _states(at: Predictor, w: Array, x0: Array) -> Array:
    """Return the states (N, n); in observer form only the first state, which is the output."""
    if not in_observer_form(at.Abar, at.C):
        return recursion(at.Abar, w, x0)[:-1]
    x = np.zeros(w.shape)
    x[:, :1] = outputs(at.Abar, at.C, w, x0)
    return x


def _derivatives_along(at: Predictor, x: Array, directions: Array) -> Array:
    """Return the derivatives (k, ny, N) of yhat in directions of Abar and C, for the states x."""
    n, ny = at.K.shape
    by_A, by_C = np.split(directions.T, [n * n], axis=1)
    by_A, by_C = by_A.reshape(-1, n, n), by_C.reshape(-1, ny, n)
    used = np.flatnonzero(by_A.any(axis=(0, 1)))  # in observer form only the first state
    moved = np.tensordot(
        by_A[:, :, used], responses(at.Abar, at.C, x[:, used]), axes=((2, 1), (0, 1))
    )
    return np.asarray(moved + by_C @ x.T if by_C.any() else moved)


def whiten(part: ScaledExperiment, columns: Array) -> Array:
    """Return the whitened columns (k, ny, N) as a matrix (ny N, k), rows ordered by output."""
    k, ny, N = columns.shape
    if ny == 1:
        white = columns * part.weights[:, 0, 0]
    elif part.rows.all():
        white = part.weights[0] @ columns
    else:
        white = np.einsum("tij,kjt->kit", part.weights, columns)
    return np.asarray(white.reshape(k, ny * N).T)


def basis_of_states(part: ScaledExperiment, free: Array) -> Basis:
    """Return the basis of the whitened responses (k, ny, N) to the initial state and to offsets."""
    Z = whiten(part, free)
    used = np.flatnonzero(Z.any(axis=1))
    last = used[-1] + 1 if used.size else 0  # the rows after it have settled to 0
    basis = orthonormal(Z[:last])
    return basis if last == len(Z) else basis.spread(np.arange(len(Z)) < last)


def by_part(parts: Sequence[ScaledExperiment], M: Array) -> list[Array]:
    """Return the rows of M (ny N, k) that belong to each experiment."""
    return np.split(M, np.cumsum([part.y.size for part in parts])[:-1])


def without(basis: Basis, M: Array) -> Array:
    """Return M minus its projection on the basis, in column-major order."""
    return np.asarray(M - ((M.T @ basis.Q) @ basis.Q.T).T)


def stack_blocks(blocks: Sequence[Array]) -> Array:
    """Return the blocks stacked vertically, in column-major order."""
    return blocks[0] if len(blocks) == 1 else np.hstack([block.T for block in blocks]).T


def stable_matrix(A: Array) -> bool:
    """Return whether all eigenvalues are inside the unit circle."""
    return bool(np.isfinite(A).all() and np.max(np.abs(np.linalg.eigvals(A))) < _MAX_MODULUS)


def reflect_eigenvalues(A: Array, largest: float = 0.995) -> Array:
    """Return A, for a start value, with all eigenvalues moved into the unit circle."""
    z, V = np.linalg.eig(A)
    size = np.abs(z)
    if not size.size or size.max() < largest:
        return A
    inside = np.where(size > 1, 1 / np.maximum(size, 1), size)
    z = z / np.maximum(size, 1e-300) * np.minimum(inside, largest)
    return np.asarray(np.real(V @ np.diag(z) @ np.linalg.inv(V)))


def directions(Abar: Array, C: Array) -> Array:
    """Return the directions (n (n + ny), n ny) of Abar and C that change the model."""
    if not in_observer_form(Abar, C):
        return tangent(Abar, C)
    n = len(Abar)
    return np.eye(n * (n + 1))[:, : n * n : n]  # the entries of the first column of Abar


def tangent(A: Array, C: Array) -> Array:
    """Return an orthonormal basis (n (n + ny), n ny) of the directions that change the model."""
    n, ny = A.shape[0], C.shape[0]
    # A small change of coordinates, 1 + S, changes A by S A - A S and C by -C S.
    orbit = np.zeros((n * (n + ny), n * n))
    for k, S in enumerate(np.eye(n * n).reshape(-1, n, n)):
        orbit[:, k] = np.concatenate([(S @ A - A @ S).ravel(), (-C @ S).ravel()])
    U, s, _ = np.linalg.svd(orbit)
    rank = int(np.count_nonzero(s > _ORBIT_TOLERANCE * s[0]))
    return np.asarray(U[:, rank:])


def delays_of(nk: int | Sequence[int], data: Signals) -> tuple[int, ...]:
    """Return the delay of each input."""
    delays = (nk,) * data.nu if isinstance(nk, int) else tuple(nk)
    if len(delays) != data.nu:
        raise InputError(f"nk={nk!r}: {data.nu} delays are needed, one for each input")
    for value in delays:
        require_integers(nk=(value, 0))
    if min(delays) == 0 < max(delays):
        raise InputError(f"nk={nk!r}: a direct term needs nk=0 for all inputs")
    return delays


def experiments_with_response(data: Signals, delays: tuple[int, ...]) -> Signals:
    """Return the data without the experiments that end before all delayed inputs are known."""
    experiments, first = [*data.experiments()], max(max(delays) - 1, 0)
    kept = [i for i, part in enumerate(experiments) if first < part.N]
    if not kept:
        longest = plural(first, "sample")
        raise InputError(f"nk={max(delays)}: no experiment has more than {longest}; lower nk")
    return data if len(kept) == len(experiments) else data.select(*kept)


def scale_signals(
    data: Signals, delays: tuple[int, ...]
) -> tuple[list[tuple[Array, Array]], Array, Array]:
    """Return scaled and delayed u and y of each experiment, and the scales of u and of y."""
    su, sy = _scale(data.u), _scale(data.y)
    lags = [max(k - 1, 0) for k in delays]
    first = max(lags)  # the first sample at which all delayed inputs are known
    signals = []
    for part in data.experiments():
        pairs = zip(part.u.T, lags, strict=True)
        u = np.column_stack([x[first - lag : max(part.N - lag, first - lag)] for x, lag in pairs])
        signals.append((u / su, part.y[first:] / sy))
    return signals, su, sy


def _scale(columns: Array) -> Array:
    """Return the standard deviation of each column, 1 for a constant column."""
    # np.nanstd takes ten times as long.
    std = np.std(columns, axis=0) if np.isfinite(columns).all() else np.nanstd(columns, axis=0)
    return np.where(std > 0, std, 1.0)


def parts_of(signals: Sequence[tuple[Array, Array]], Lambda: Array) -> tuple[ScaledExperiment, ...]:
    """Return the signals of each experiment, with the whitening matrices for Lambda."""
    masks = [np.isfinite(y) for _, y in signals]
    return tuple(
        ScaledExperiment(u=u, y=np.where(m, y, 0.0), rows=m, weights=whitening(Lambda, m))
        for (u, y), m in zip(signals, masks, strict=True)
    )
