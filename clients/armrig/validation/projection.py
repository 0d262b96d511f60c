"""Residuals of a model, and their projection on the quantities that were estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.data.argument import as_dataset
from armrig.data.dataset import Dataset, Signals
from armrig.models.fit import Fit
from armrig.models.prediction import prediction_errors
from armrig.models.state_space import ErrorResponses, error_responses
from armrig.numerics.covariance import whitening
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array

_STEP = 1e-3  # step of a parameter for a difference quotient, in standard deviations
_LONGEST_STEP = 1e-5  # the same as a share of |theta|; a longer step can make a predictor unstable
_MIN_VARIANCE_SHARE = 1e-12  # share of the largest variance below which a variance counts as 0
_COLUMNS = 8  # columns that are projected at once, so that only a part of a matrix is copied


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """Residuals of one experiment."""

    u: Array
    """Inputs minus their means (N, nu)."""
    e: Array
    """Residuals (N, ny), NaN where they are not known."""
    S: Array
    """Basis of the responses of e to the unknown past and the ramps, (N, ny, q): S^T W S = 1."""
    Psi: Array
    """Derivatives of the prediction or of e with respect to p parameters, (N, ny, p). Their
    projection on S is subtracted."""
    G: Array
    """Weights (N, ny, ny): the estimator minimises the sum of |G(t) e(t)|². W is G^T G."""

    @property
    def known(self) -> Array:
        """True where there is a residual, (N, ny)."""
        return np.isfinite(self.e)

    def weighted(self, X: Array) -> Array:
        """Return W X (N, ny, k); one output has the weight 1."""
        if X.shape[1] == 1:
            return X
        return np.asarray(self.G.transpose(0, 2, 1) @ (self.G @ X))


def parts_of(fit: Fit, data: Dataset | Signals) -> tuple[list[Part], Array]:
    """Return the residuals of each experiment, and J: the parameters of Psi are J theta."""
    if isinstance(data, Signals) and (fit.ny, fit.nu) != (1, 1):
        return _parts_by_differences(fit, data)
    data = as_dataset(data)
    mean, parts = np.mean(data.u), []
    for part in data.experiments():
        r = prediction_errors(fit, part)
        known = np.isfinite(r.e)
        parts.append(
            Part(
                u=part.u[:, None] - mean,
                e=r.e[:, None],
                S=r.unknown.span[:, None],
                Psi=r.Psi[:, None],
                G=known[:, None, None].astype(np.float64),
            )
        )
    return parts, _to_free(fit)


def _to_free(fit: Fit) -> Array:
    """Return J, so that J theta are the free parameters; an integrator is divided out of F or A."""
    J = np.eye(fit.theta.size)
    if not fit.integrator:
        return J
    part = fit.slice_of(fit.integrating)
    if fit.Ts == 0:  # the coefficient that is 0
        return np.delete(J, part.stop - 1, axis=0)
    # f̃_k = f_1 + … + f_k undoes f_k = f̃_k - f̃_(k-1).
    J[part, part] = np.tri(part.stop - part.start)
    return np.delete(J, part.stop - 1, axis=0)


def _parts_by_differences(fit: Fit, data: Signals) -> tuple[list[Part], Array]:
    """Return the residuals; Psi are central differences in independent directions of theta."""
    std = np.sqrt(np.diag(fit.noise_covariance))

    def responses(theta: Array) -> list[ErrorResponses]:
        system = fit.form.replaced(theta).realised()
        return [
            error_responses(system, part, integrating=fit.form.integrators, offset=fit.offset)
            for part in data.experiments()
        ]

    experiments = list(data.experiments())
    at_theta = responses(fit.theta)
    # For a derivative the initial states stay fixed, because their effect is projected out. Another
    # estimate of the initial states would amplify rounding errors.
    states = [r.combination(part, std) for r, part in zip(at_theta, experiments, strict=True)]
    by: list[list[Array]] = []
    directions = _directions(fit)
    for direction in directions.T:
        longest = _LONGEST_STEP * np.linalg.norm(fit.theta) / np.linalg.norm(direction)
        step = min(_STEP, float(longest))
        ahead, behind = (responses(fit.theta + h * step * direction) for h in (1, -1))
        by.append(
            [
                np.einsum("k,tki->ti", c, a.errors - b.errors) / (2 * step)
                for c, a, b in zip(states, ahead, behind, strict=True)
            ]
        )
    # Outputs that are estimated together are weighted by the inverse of Lambda.
    together = fit.shared or fit.form.coupled or fit.structure == "arx"
    Lambda = fit.noise_covariance if together else np.diag(std**2)
    if fit.output_weights:
        Lambda = np.diag(1 / np.asarray(fit.output_weights))
    if fit.ny == 1:
        Lambda = np.eye(1)
    mean = np.mean(data.u, axis=0)
    found = []
    for k, (r, c, part) in enumerate(zip(at_theta, states, experiments, strict=True)):
        e = np.where(part.valid, np.einsum("k,tki->ti", c, r.errors), np.nan)
        S = (r.errors[:, 1:] * part.valid[:, None]).transpose(0, 2, 1)
        Psi = np.zeros((*e.shape, len(by)))
        for m, one in enumerate(by):
            Psi[:, :, m] = np.where(part.valid, one[k], 0.0)
        G = whitening(Lambda, np.isfinite(e))
        basis = orthonormal(_stacked(G @ S))
        S = S @ basis.W
        Psi = Psi - S @ (basis.Q.T @ _stacked(G @ Psi))
        found.append(Part(u=part.u - mean, e=e, S=S, Psi=Psi, G=G))
    return found, np.linalg.pinv(directions)


def _directions(fit: Fit) -> Array:
    """Return independent directions of theta, (d, p), with std 1; cov theta may be singular."""
    scale = np.sqrt(np.maximum(np.diag(fit.covariance_robust), 1e-300))
    values, axes = np.linalg.eigh(fit.covariance_robust / np.outer(scale, scale))
    kept = values > _MIN_VARIANCE_SHARE * values[-1]
    return np.asarray(scale[:, None] * axes[:, kept] * np.sqrt(values[kept]))


def _stacked(X: Array) -> Array:
    """Return X (N, ny, k) as a matrix (N ny, k)."""
    return X.reshape(-1, X.shape[2])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """P = B B^T W, the projection on the estimated quantities with the weights W = G^T G.

    The residuals are e = (1 - P) v, with the noise v. B is an orthonormal basis: B^T W B = 1. Its
    columns are S of each experiment, and T, the basis of the effects of the parameters.
    """

    parts: Sequence[Part]
    """Residuals of each experiment."""
    T: Sequence[Array]
    """T of each experiment (N, ny, r); without columns if the parameters are from other data."""

    @property
    def rank(self) -> int:
        """Number of estimated quantities."""
        return int(self.T[0].shape[2] + sum(part.S.shape[2] for part in self.parts))

    def remove_states(self, Z: Sequence[Array]) -> None:
        """Subtract W S S^T Z from Z (N, ny, k) of each experiment, in place."""
        for part, z in zip(self.parts, Z, strict=True):
            begun = np.flatnonzero(part.S.any(axis=(1, 2)))
            if begun.size:  # the effect of the unknown past ends early
                some = slice(0, int(begun[-1]) + 1)
                WS = part.weighted(part.S)[some]
                _subtract(z[some], WS, sum_of_products([part.S[some]], [z[some]]))

    def remove_parameters(self, Z: Sequence[Array]) -> None:
        """Subtract W T T^T Z from Z (N, ny, k) of each experiment, in place."""
        if not self.T[0].shape[2]:
            return
        c = sum_of_products(self.T, Z)
        for part, z, t in zip(self.parts, Z, self.T, strict=True):
            _subtract(z, part.weighted(t), c)

    def influence(self, Z: Sequence[Array]) -> list[Array]:
        """Return H = (1 - P)^T Z (N, ny, k) of each experiment, so that Z^T e is equal to H^T v."""
        H = [z.copy() for z in Z]
        self.remove_states(H)
        self.remove_parameters(H)
        return H

    def applied(self) -> Projection:
        """Return the projection of experiments with the residuals (1 - P) e.

        1 - P removes the difference of e and v, a combination of the columns of B. The residuals
        are therefore (1 - P) v even if e was projected with other weights, or if the search ended
        shortly before its minimum.
        """
        e = [np.nan_to_num(part.e)[:, :, None] for part in self.parts]
        WT = [part.weighted(t) for part, t in zip(self.parts, self.T, strict=True)]
        c = sum_of_products(WT, e)
        parts = []
        for part, x, t in zip(self.parts, e, self.T, strict=True):
            by_state = part.S @ sum_of_products([part.weighted(part.S)], [x])
            parts.append(replace(part, e=part.e - (by_state + t @ c)[:, :, 0]))
        return replace(self, parts=parts)

    def loss(self, Lambda: Array) -> list[tuple[Array, Array]]:
        """Return B and D of each experiment: cov e is Lambda - B D^T - D B^T if v is white."""
        ends = np.cumsum([part.S.shape[2] for part in self.parts])
        B = []
        for part, t, end in zip(self.parts, self.T, ends.tolist(), strict=True):
            states = np.zeros((*part.e.shape, int(ends[-1])))
            states[:, :, end - part.S.shape[2] : end] = part.S
            B.append(np.concatenate([states, t], axis=2))
        WB = [part.weighted(b) for part, b in zip(self.parts, B, strict=True)]
        C = [
            np.einsum("ij,tjr->tir", Lambda, wb) * part.known[:, :, None]
            for part, wb in zip(self.parts, WB, strict=True)
        ]
        M = sum_of_products(WB, C)
        return [(b, c - b @ (0.5 * M)) for b, c in zip(B, C, strict=True)]


def _subtract(z: Array, WB: Array, c: Array) -> None:
    """Subtract WB(t) c from z(t) in place."""
    for i in range(z.shape[1]):
        for a in range(0, z.shape[2], _COLUMNS):
            z[:, i, a : a + _COLUMNS] -= WB[:, i] @ c[:, a : a + _COLUMNS]


def projection(parts: Sequence[Part], *, own: bool) -> Projection:
    """Return the projection on the effects of initial states and ramps (`own`: also parameters)."""
    if not own:
        return Projection(parts=parts, T=[part.S[:, :, :0] for part in parts])
    G = parts[0].Psi.shape[1] > 1
    W = orthonormal(np.vstack([_stacked(p.G @ p.Psi if G else p.Psi) for p in parts])).W
    return Projection(parts=parts, T=[part.Psi @ W for part in parts])


def sum_of_products(X: Sequence[Array], Y: Sequence[Array]) -> Array:
    """Return the sum of X(t)^T Y(t) over all experiments, (r, k)."""
    total = np.zeros((X[0].shape[2], Y[0].shape[2]))
    for x, y in zip(X, Y, strict=True):
        for i in range(x.shape[1]):
            total += x[:, i].T @ y[:, i]
    return total
