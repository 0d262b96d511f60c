"""Prediction-error problem of a state-space model with a gain K, for data with missing outputs.

After a missing output the predictor is a Kalman filter, with the variances S(t) of the errors nu
(`armrig.numerics.kalman_gains`). The criterion is the likelihood of the measured outputs: the sum
of nu^T inv(S) nu, times the geometric mean of det S. A search computes the same criterion from the
errors of the constant gain, in which the missing outputs are estimated
(`armrig.numerics.missing_samples`). The residuals and their derivatives are those of the filter.

References
----------
.. [1] R. H. Jones, Technometrics 22 (1980) 389-395 (likelihood with missing observations).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.estimation.state_space_fit import Derivatives, derivatives
from armrig.estimation.state_space_problem import (
    StateSpaceProblem,
    by_part,
    parts_of,
    stable_matrix,
    tangent,
)
from armrig.estimation.state_space_responses import Predictor, ScaledExperiment
from armrig.estimation.subspace import Parts
from armrig.models.innovations_filter import InnovationsFilter, innovations_filter
from armrig.models.state_space import StateSpace
from armrig.numerics.covariance import colour_noise, pairwise_covariance, whitening
from armrig.numerics.kalman_gains import kalman_gains
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import FIRST_DAMPING, Optimum, levenberg_marquardt
from armrig.numerics.missing_samples import MissingSamples, missing_samples
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import free_responses, outputs_from_rest, recursion

_MAX_STEPS = 60
_LIKELIHOOD_TOLERANCE = 1e-2  # change of -2 log likelihood at which the search ends


def filter_parts(
    signals: Parts, A: Array, C: Array, K: Array, Lambda: Array
) -> list[ScaledExperiment]:
    """Return the parts with the gains G(t) of the Kalman filter, and the roots of inv(S(t))."""
    parts = []
    for part in parts_of(signals, Lambda):
        kalman = kalman_gains(A, C, K, Lambda, part.rows)
        parts.append(replace(part, weights=kalman.white, gains=kalman.gain))
    return parts


def scale_part_errors(part: ScaledExperiment, e: Array, Lambda: Array) -> Array:
    """Return the errors (N, ny) of a filtered part, scaled to the covariance Lambda of e."""
    return _scale_errors(part.rows, part.weights @ np.where(part.rows, e, 0.0)[:, :, None], Lambda)


def _scale_errors(rows: Array, white: Array, Lambda: Array) -> Array:
    """Return whitened errors (N, ny, 1) with the covariance Lambda; NaN where y is missing."""
    return np.where(rows, colour_noise(rows, white, Lambda)[:, :, 0], np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class _WhitenedErrors:
    """Whitened errors of one experiment."""

    filter: InnovationsFilter
    missing: MissingSamples | None
    """Projection on the effects of missing samples; None for the Kalman filter."""
    y: Array
    """Outputs (N, 1, ny), with estimates of the missing samples that were projected out."""
    x: Array
    """States (N, 1, n)."""
    z: Array
    """Whitened errors (N, ny)."""
    log: float
    """Sum of log det(S inv(Lambda_oo)) over the samples."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GapProblem:
    """Minimisation over all parameters of a predictor, for data with missing outputs."""

    problem: StateSpaceProblem
    """Problem of complete data, with the signals of each experiment whitened by `Lambda`."""
    Lambda: Array
    """Covariance of e (ny, ny)."""

    def errors(
        self, at: Predictor, *, innovations: bool = False
    ) -> tuple[Array, float, list[_WhitenedErrors]]:
        """Return the whitened errors, the mean of the log determinants, and both by experiment.

        The errors (N ny,) are ordered by experiment and then by output. As `innovations` of the
        Kalman filter they are 0 where an output is missing; other errors with the same sum of
        squares are computed much faster. The mean is the sum of log det(S inv(Lambda_oo)) over the
        samples, divided by the number of measured values.
        """
        system = StateSpace(A=at.A, B=at.B, C=at.C, D=at.D, K=at.K)
        parts = self.problem.parts
        by_experiment = [
            (not innovations and self._project_part(system, part, x0))
            or self._filter_part(system, part, x0)
            for part, x0 in zip(parts, at.x0, strict=True)
        ]
        z = np.concatenate([of.z.T.ravel() for of in by_experiment])
        return z, sum(of.log for of in by_experiment) / self._count, by_experiment

    @property
    def _count(self) -> int:
        """Number of measured values."""
        return sum(int(part.rows.sum()) for part in self.problem.parts)

    def _filter_part(
        self, system: StateSpace, part: ScaledExperiment, x0: Array
    ) -> _WhitenedErrors:
        kalman_filter = innovations_filter(system, self.Lambda, part.rows)
        u, y = part.u[:, None], part.y[:, None]
        x = kalman_filter.states(u, y, x0[None])
        z = kalman_filter.whiten(kalman_filter.innovations(x, u, y))[:, 0]
        return _WhitenedErrors(
            filter=kalman_filter, missing=None, y=y, x=x, z=z, log=kalman_filter.log_det
        )

    def _project_part(
        self, system: StateSpace, part: ScaledExperiment, x0: Array
    ) -> _WhitenedErrors | None:
        """Return errors in which the missing samples are projected out; None if that takes long."""
        if part.rows.all() or not system.K.any():
            return None
        complete, y = replace(part, rows=np.ones_like(part.rows)), part.y.copy()
        U = whitening(self.Lambda, complete.rows)[0]
        missing = _missing_samples(system, part.rows, U)
        if missing is None:
            return None
        y[missing.at] -= missing.values(self._filter_part(system, complete, x0).z[:, None])[:, 0]
        errors = self._filter_part(system, replace(complete, y=y), x0)
        at_once = np.diagonal(part.weights, axis1=1, axis2=2)[part.rows]
        log = missing.log_det + 2 * (np.log(at_once).sum() - len(y) * np.log(np.diag(U)).sum())
        return replace(errors, missing=missing, log=log)

    def slopes(self, at: Predictor, errors: Sequence[_WhitenedErrors]) -> tuple[Array, Array]:
        """Return the derivatives of the whitened predictions, and of the mean log determinant.

        The derivatives are those with respect to the parameters of `directions`, then to the
        initial state of each experiment. If missing samples were projected out of the errors, the
        derivatives are those for fixed values of these samples, and projected.
        """
        by, blocks = self.directions(at), []
        p, n = len(by.A), by.A.shape[1]
        logs = np.zeros(p + n * len(errors))
        for k, experiment in enumerate(errors):
            if experiment.missing is None:
                J, log = self._differentiate_filter(k, experiment, by)
            else:
                J = experiment.missing.without(
                    self._differentiate_gain(at, k, experiment)
                ).transpose(1, 2, 0)
                log = _log_det_slopes(experiment.missing, experiment.filter, by)
            padded = np.zeros((*J.shape[1:], logs.size))
            padded[:, :, np.r_[:p, p + n * k : p + n * (k + 1)]] = J.transpose(1, 2, 0)
            blocks.append(padded.reshape(-1, logs.size))
            logs[:p] += log
        return np.vstack(blocks), logs / self._count

    def _differentiate_filter(
        self, k: int, errors: _WhitenedErrors, by: Derivatives
    ) -> tuple[Array, Array]:
        """Return the slopes (p + n, ny, N) of experiment k, and of the sum of log determinants."""
        kalman_filter, u, n = errors.filter, self.problem.parts[k].u, errors.x.shape[2]
        nu = kalman_filter.innovations(errors.x, u[:, None], errors.y)[:, 0]
        named = {name: getattr(by, name) for name in "ABCDK"}
        slope, log = kalman_filter.derivatives(named, errors.x[:, 0], u, nu)
        still_u, still_y = (np.zeros((len(u), n, x.shape[-1])) for x in (u, errors.y))
        free = kalman_filter.states(still_u, still_y, np.eye(n))
        J = np.concatenate([-slope, kalman_filter.whiten(free @ kalman_filter.system.C.T)], axis=1)
        return J.transpose(1, 2, 0), log

    def _differentiate_gain(self, at: Predictor, k: int, errors: _WhitenedErrors) -> Array:
        """Return the slopes (N, p + n, ny) of experiment k, complete and with a constant gain."""
        part = self.problem.parts[k]
        filled = replace(part, y=errors.y[:, 0], rows=np.ones_like(part.rows))
        complete, V = replace(self.problem, parts=(filled,)), tangent(at.Abar, at.C)
        by = complete.sensitivities(0, replace(at, x0=at.x0[k : k + 1]), V)
        return np.asarray((errors.filter.white[0] @ np.concatenate(by)).transpose(2, 0, 1))

    def minimise(self, at: Predictor, *, damping: float) -> tuple[Predictor, Optimum]:
        """Return the predictor after one step of a search, and the result of the step."""
        at = at.balance()
        by = self.directions(at)
        p, n = len(by.A), len(at.Abar)

        def predictor_at(t: Array) -> Predictor:
            after = by.moved(at, t[:p])
            states = zip(at.x0, t[p:].reshape(-1, n), strict=True)
            return replace(after, x0=tuple(x + change for x, change in states))

        def linearise(t: Array) -> tuple[Array, Callable[[], Array]]:
            z, log, errors = self.errors(predictor_at(t))
            scale = np.exp(log / 2)

            def J() -> Array:  # only at t = 0
                slope, by_log = self.slopes(at, errors)
                return np.asarray(scale * (slope - 0.5 * np.outer(z, by_log)))

            return scale * z, J

        optimum = levenberg_marquardt(
            linearise,
            np.zeros(p + n * len(at.x0)),
            admissible=lambda t: stable_matrix(predictor_at(t).Abar),
            damping=damping,
            most=1,
        )
        return predictor_at(optimum.theta), optimum

    def directions(self, at: Predictor) -> Derivatives:
        """Return the derivatives of the matrices with respect to the parameters of a search.

        The first parameters move (Abar, C) along the tangent space. The others change Bbar and K
        signal by signal, and D row by row.
        """
        V = tangent(at.Abar, at.C)
        return derivatives(self.problem, at, V)

    def residuals(self, z: Array) -> list[Array]:
        """Return the innovations (N, ny) of each experiment, scaled like e; NaN where y is missing.

        z are whitened innovations. An innovation is scaled by the root of Lambda_oo inv(S), so that
        its covariance is Lambda_oo.
        """
        parts = self.problem.parts
        return [
            _scale_errors(part.rows, white.reshape(part.y.shape[1], -1).T[:, :, None], self.Lambda)
            for part, white in zip(parts, by_part(parts, z), strict=True)
        ]

    def influence(
        self, at: Predictor, z: Array, errors: Sequence[_WhitenedErrors]
    ) -> tuple[Array, tuple[Basis, ...]]:
        """Return the derivatives of the whitened predictions, and the effects of initial states.

        The derivatives (ny N, d) are those by the parameters of `directions`, with the derivatives
        of the scale in the likelihood. The effects of the initial states are projected out.
        """
        by = self.directions(at)
        slope, by_log = self.slopes(at, errors)
        J, d = slope - 0.5 * np.outer(z, by_log), len(by.A)
        parts = by_part(self.problem.parts, J)
        bases = tuple(orthonormal(rows[:, d:][:, rows[:, d:].any(axis=0)]) for rows in parts)
        pairs = zip(bases, parts, strict=True)
        return np.vstack([Z.without(rows[:, :d]) for Z, rows in pairs]), bases


def _missing_samples(system: StateSpace, rows: Array, U: Array) -> MissingSamples | None:
    """Return the projection for the predictor of complete data, with U e white."""
    Abar = system.A - system.K @ system.C

    def responses(L: int) -> Array:
        h = free_responses(Abar, system.C, L - 1).transpose(2, 1, 0) @ system.K
        return np.concatenate([U[None], -(U @ h)])

    def forward(y: Array) -> Array:
        return np.asarray((y - outputs_from_rest(Abar, system.C, y @ system.K.T)) @ U.T)

    def backward(z: Array) -> Array:
        e = (z @ U)[::-1]
        return np.asarray(e - outputs_from_rest(Abar.T, system.K.T, e @ system.C))[::-1]

    return missing_samples(responses, rows, forward, backward)


def _log_det_slopes(
    missing: MissingSamples, kalman_filter: InnovationsFilter, by: Derivatives
) -> Array:
    """Return the derivatives of `missing.log_det` by the parameters of `by`, (p,).

    The responses are H_k = -U C M_k with M_1 = K and M_(k+1) = Abar M_k.
    """
    s, U, L = kalman_filter.system, kalman_filter.white[0], len(missing.H) - 1
    p, n, ny = by.K.shape
    Abar = s.A - s.K @ s.C
    M = recursion(Abar, np.zeros((L, ny, n)), s.K.T)[:L]
    of_Abar = by.A - by.K @ s.C - s.K @ by.C
    forced = np.einsum("pij,ktj->kpti", of_Abar, M).reshape(L, p * ny, n)
    moved = recursion(Abar, forced, by.K.swapaxes(1, 2).reshape(p * ny, n))[:L]
    h = np.einsum("pij,ktj->kpti", by.C, M) + moved.reshape(L, p, ny, n) @ s.C.T
    return np.asarray(-np.einsum("kjt,kpti,ji->p", missing.log_det_gradient()[1:], h, U))


@dataclass(frozen=True, slots=True, kw_only=True)
class GapSearch:
    """Result of a search with missing outputs."""

    problem: GapProblem
    """Problem with the estimate of Lambda before the last step."""
    predictor: Predictor
    """Predictor after the last step."""
    residuals: list[Array]
    """Residuals (N, ny) of each experiment."""
    Psi: Array
    """Derivatives of the whitened predictions, (ny N, d)."""
    states: tuple[Basis, ...]
    """Effects of the initial state of each experiment."""
    iterations: int
    """Number of steps of the search."""
    converged: bool
    """True if the likelihood no longer changed at the end of the search."""


def search_with_gaps(
    problem: StateSpaceProblem, signals: Parts, at: Predictor, Lambda: Array
) -> GapSearch:
    """Search from the predictor `at`, and estimate Lambda again after every step."""

    def problem_for(Lambda: Array) -> GapProblem:
        return GapProblem(problem=replace(problem, parts=parts_of(signals, Lambda)), Lambda=Lambda)

    gap_problem, damping, iterations = problem_for(Lambda), FIRST_DAMPING, 0
    moved, values = True, [np.inf]
    while True:
        z, log, errors = gap_problem.errors(at, innovations=True)
        residuals = gap_problem.residuals(z)
        e = np.vstack(residuals)
        Lambda = pairwise_covariance(e)
        log_det = np.linalg.slogdet(Lambda)[1] / len(Lambda)
        values.append(float((log_det + log) * np.isfinite(e).sum()))
        converged = moved and abs(values[-2] - values[-1]) <= _LIKELIHOOD_TOLERANCE
        if converged or iterations == _MAX_STEPS:
            break
        gap_problem = problem_for(Lambda)
        at, optimum = gap_problem.minimise(at, damping=damping)
        # A rejected step does not move; the next one is shorter.
        iterations, damping = iterations + 1, optimum.damping
        moved = bool(optimum.converged or optimum.theta.any())
    Psi, states = gap_problem.influence(at, z, errors)
    return GapSearch(
        problem=gap_problem,
        predictor=at,
        residuals=residuals,
        Psi=Psi,
        states=states,
        iterations=iterations,
        converged=converged,
    )
