"""Prediction-error problem of a state-space model with a gain K, for data with missing outputs.

The predictor of complete data has the constant gain K. After a missing output the state is not
known exactly, and the predictor is a Kalman filter. P(t) is the covariance of the state, given the
outputs measured before t. The index o marks the outputs measured at t ::

    nu(t) = y_o(t) - C_o x(t) - D_o u(t),    S(t) = C_o P(t) C_o^T + Lambda_oo
    G(t) = (A P(t) C_o^T + K Lambda_o) inv(S(t))
    x(t+1) = A x(t) + B u(t) + G(t) nu(t)
    P(t+1) = A P(t) A^T + K Lambda K^T - G(t) S(t) G(t)^T

P is 0 as long as no output is missing, because the initial state is estimated. The criterion is the
likelihood of the measured outputs: the sum of nu^T inv(S) nu, times the geometric mean of det S.

References
----------
.. [1] R. H. Jones, Technometrics 22 (1980) 389-395 (likelihood with missing observations).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.estimation.state_space_problem import by_part, parts_of, stable_matrix, tangent
from armrig.estimation.state_space_responses import Part, Predictor
from armrig.estimation.subspace import Parts
from armrig.numerics.covariance import pairwise_covariance, patterns
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.numerics.polynomial import Array

_NEGLIGIBLE = 1e-9  # a smaller variance of C x, relative to the variance of e, counts as 0
_SETTLED_VARIANCE = 1e-4  # likewise, for gains that are not searched
_STEP = 1e-6  # step of a numerical derivative; the coordinates are scaled
_STEPS = 3  # steps of the search between two estimates of Lambda
_MAX_ROUNDS = 30
_LIKELIHOOD_TOLERANCE = 1e-3  # change of -2 log likelihood at which the search ends


def kalman_steps(
    rows: Array, A: Array, C: Array, K: Array, Lambda: Array, settled: float
) -> Iterator[tuple[int, Array, Array, Array]]:
    """Yield t, o, the root of S(t) and G(t) root(S(t)) of m filters while P is not 0.

    A (m, n, n), C (m, ny, n) and K (m, n, ny) are the matrices of each filter. P is taken as 0 as
    soon as it increases the variances of e by less than the share `settled`.
    """
    noise = K @ Lambda
    Q, P = noise @ K.swapaxes(1, 2), np.zeros(A.shape)
    known = True
    for t, measured in enumerate(rows):
        if known and measured.all():
            continue
        o = np.flatnonzero(measured)
        PC = P @ C[:, o].swapaxes(1, 2)
        root = np.linalg.cholesky(C[:, o] @ PC + Lambda[np.ix_(o, o)])
        G = (A @ PC + noise[:, :, o]) @ np.linalg.inv(root).swapaxes(1, 2)
        P = A @ P @ A.swapaxes(1, 2) + Q - G @ G.swapaxes(1, 2)
        spread = np.einsum("mij,mjk,mik->i", C, P, C)
        known = bool((np.abs(spread) <= settled * np.diag(Lambda)).all())
        P = np.zeros(A.shape) if known else P
        yield t, o, root, G


def filtered_parts(signals: Parts, A: Array, C: Array, K: Array, Lambda: Array) -> list[Part]:
    """Return the parts with the gains G(t) of the Kalman filter, and the roots of inv(S(t))."""
    parts = []
    for part in parts_of(signals, Lambda):
        gains, roots = K * part.rows[:, None, :], part.weights.copy()
        steps = kalman_steps(part.rows, A[None], C[None], K[None], Lambda, _SETTLED_VARIANCE)
        for t, o, root, G in steps:
            inverse = np.linalg.inv(root[0])
            roots[t][np.ix_(o, o)] = inverse
            gains[t][:, o] = G[0] @ inverse
        parts.append(replace(part, weights=roots, gains=gains))
    return parts


def scaled_errors(part: Part, e: Array, Lambda: Array) -> Array:
    """Return the errors (N, ny) of a filtered part, scaled to the covariance Lambda of e."""
    white = part.weights @ np.where(part.rows, e, 0.0)[:, :, None]
    return rescaled(part.rows, white[:, :, 0], Lambda)


def rescaled(rows: Array, white: Array, Lambda: Array) -> Array:
    """Return whitened errors (N, ny) with the covariance Lambda; NaN where y is missing."""
    e = np.full(white.shape, np.nan)
    for o, times in patterns(rows):
        at = np.ix_(times, o)
        e[at] = white[at] @ np.linalg.cholesky(Lambda[np.ix_(o, o)]).T
    return e


@dataclass(frozen=True, slots=True, kw_only=True)
class GapProblem:
    """Minimisation over all parameters of a predictor, for data with missing outputs."""

    parts: tuple[Part, ...]
    """Signals of each experiment, whitened by `Lambda`."""
    Lambda: Array
    """Covariance of e (ny, ny)."""
    direct: bool
    """True if D is estimated."""

    def errors(self, predictors: Sequence[Predictor]) -> tuple[Array, Array]:
        """Return the whitened errors and the mean of the log determinants of each predictor.

        The errors (m, N ny) are ordered by experiment and then by output; the error of a missing
        output is 0. The mean (m,) is the sum of log det(S inv(Lambda_oo)) over the samples after
        gaps, divided by the number of measured values.
        """
        found, logs, count = [], np.zeros(len(predictors)), 0
        for i, part in enumerate(self.parts):
            z, log = self._filtered(part, predictors, np.array([p.x0[i] for p in predictors]))
            found.append(z.transpose(1, 2, 0).reshape(len(predictors), -1))
            logs += log
            count += int(part.rows.sum())
        return np.hstack(found), logs / count

    def _filtered(
        self, part: Part, predictors: Sequence[Predictor], x: Array
    ) -> tuple[Array, Array]:
        """Return the whitened errors (N, m, ny), and the sums (m,) of log det(S inv(Lambda_oo))."""
        A, B, C, D, K = (np.array([getattr(p, x) for p in predictors]) for x in "ABCDK")
        driven = np.einsum("mij,tj->tmi", B, part.u)
        direct = np.einsum("mij,tj->tmi", D, part.u)
        steps = kalman_steps(part.rows, A, C, K, self.Lambda, _NEGLIGIBLE)
        step = next(steps, None)
        z = np.zeros((part.y.shape[0], *x.shape[:1], part.y.shape[1]))
        logs = np.zeros(len(predictors))
        for t, own in enumerate(part.weights):
            nu = part.y[t] - (C @ x[:, :, None])[:, :, 0] - direct[t]
            x = (A @ x[:, :, None])[:, :, 0] + driven[t]
            if step is None or step[0] > t:
                z[t] = nu @ own.T
                x = x + (K @ nu[:, :, None])[:, :, 0]
                continue
            _, o, root, G = step
            z[t][:, o] = np.linalg.solve(root, nu[:, o, None])[:, :, 0]
            diagonal = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            logs += 2 * (diagonal + np.log(np.diag(own)[o]).sum())
            x = x + (G @ z[t][:, o, None])[:, :, 0]
            step = next(steps, None)
        return z, logs

    def moved(self, at: Predictor, V: Array, t: Array) -> Predictor:
        """Return the predictor after a step t from the predictor `at`.

        The first entries of t move (Abar, C) along the tangent space V. The other entries change
        Bbar and K signal by signal, D row by row, and the initial states.
        """
        (n, ny), nu = at.K.shape, at.Bbar.shape[1]
        along, signals, direct, states = np.split(t, self._ends(at, V)[:-1])
        change = V @ along
        columns = signals.reshape(nu + ny, n).T
        return Predictor(
            Abar=at.Abar + change[: n * n].reshape(n, n),
            C=at.C + change[n * n :].reshape(ny, n),
            Bbar=at.Bbar + columns[:, :nu],
            K=at.K + columns[:, nu:],
            D=at.D + direct.reshape(ny, nu) if self.direct else at.D,
            x0=tuple(x + d for x, d in zip(at.x0, states.reshape(-1, n), strict=True)),
        )

    def _ends(self, at: Predictor, V: Array) -> list[int]:
        """Return the end in t of the changes of (Abar, C), (Bbar, K), D and the initial states."""
        sizes = V.shape[1], at.Bbar.size + at.K.size, self.direct * at.D.size
        return [*map(int, np.cumsum([*sizes, len(at.Abar) * len(at.x0)]))]

    def linearise(self, at: Predictor, V: Array, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return e, its negative numerical derivatives, the mean log det, and its derivatives."""
        steps = [t, *(t + _STEP * unit for unit in np.eye(t.size))]
        z, logs = self.errors([self.moved(at, V, step) for step in steps])
        return z[0], -(z[1:] - z[0]).T / _STEP, logs[0], (logs[1:] - logs[0]) / _STEP

    def minimise(self, at: Predictor, *, most: int) -> tuple[Predictor, Optimum]:
        """Return the predictor after at most `most` steps, and the result of the search."""
        at = at.balanced()
        V = tangent(at.Abar, at.C)

        def linearise(t: Array) -> tuple[Array, Array]:
            z, J, log, by_log = self.linearise(at, V, t)
            scale = np.exp(log / 2)
            return scale * z, scale * (J - 0.5 * np.outer(z, by_log))

        found = levenberg_marquardt(
            linearise,
            np.zeros(self._ends(at, V)[-1]),
            admissible=lambda t: stable_matrix(self.moved(at, V, t).Abar),
            most=most,
        )
        return self.moved(at, V, found.theta), found

    def residuals(self, at: Predictor) -> list[Array]:
        """Return the errors (N, ny) of each experiment, scaled like e; NaN where y is missing.

        An error is scaled by the root of Lambda_oo inv(S), so that its covariance is Lambda_oo.
        """
        z, _ = self.errors([at])
        return [
            rescaled(part.rows, white.reshape(part.y.shape[1], -1).T, self.Lambda)
            for part, white in zip(self.parts, by_part(self.parts, z[0]), strict=True)
        ]

    def influence(self, at: Predictor) -> tuple[Array, tuple[Basis, ...]]:
        """Return the derivatives of the whitened predictions, and the effects of initial states.

        The derivatives (ny N, d) are those by t in `moved`, except the initial states, which are
        projected out. The covariance S(t) of the errors is held constant.
        """
        V = tangent(at.Abar, at.C)
        *_, d, size = self._ends(at, V)
        _, J, _, _ = self.linearise(at, V, np.zeros(size))
        parts = by_part(self.parts, J)
        bases = tuple(orthonormal(of[:, d:][:, of[:, d:].any(axis=0)]) for of in parts)
        pairs = zip(bases, parts, strict=True)
        return np.vstack([Z.without(of[:, :d]) for Z, of in pairs]), bases


@dataclass(frozen=True, slots=True, kw_only=True)
class GapSearch:
    """Result of a search with missing outputs."""

    problem: GapProblem
    """Problem with the last estimate of Lambda."""
    predictor: Predictor
    """Predictor after the last step."""
    iterations: int
    """Number of steps of the search."""
    converged: bool
    """True if the likelihood no longer changed at the end of the search."""


def searched(
    signals: Sequence[tuple[Array, Array]], at: Predictor, Lambda: Array, *, direct: bool
) -> GapSearch:
    """Search from the predictor `at`, and estimate Lambda again after every few steps."""
    problem = GapProblem(parts=parts_of(signals, Lambda), Lambda=Lambda, direct=direct)
    value, iterations = np.inf, 0
    for _ in range(_MAX_ROUNDS):
        at, found = problem.minimise(at, most=_STEPS)
        iterations += found.iterations
        e, (_, logs) = np.vstack(problem.residuals(at)), problem.errors([at])
        Lambda = pairwise_covariance(e)
        problem = replace(problem, parts=parts_of(signals, Lambda), Lambda=Lambda)
        logdet = np.linalg.slogdet(Lambda)[1] / len(Lambda)
        before, value = value, float((logdet + logs[0]) * np.isfinite(e).sum())
        converged = abs(before - value) <= _LIKELIHOOD_TOLERANCE
        if converged:
            break
    return GapSearch(problem=problem, predictor=at, iterations=iterations, converged=converged)
