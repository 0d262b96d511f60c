"""Residuals of several outputs, and their projection on the quantities that were estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.data.signals import Signals
from armrig.models.multivariable.fit import MultivariableFit
from armrig.models.multivariable.state_space import ErrorResponses, error_responses
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.whitening import whitening

_STEP = 1e-3  # step of a parameter for a difference quotient, in standard deviations
_MIN_VARIANCE_SHARE = 1e-12  # share of the largest variance below which a variance counts as 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """Residuals of one experiment."""

    u: Array
    """Inputs minus their means (N, nu)."""
    e: Array
    """Residuals (N, ny), NaN where they are not known."""
    S: Array
    """Responses of e to the initial state and the ramps (N, ny, r)."""
    Psi: Array
    """Derivatives of e with respect to p independent combinations of the parameters, (N, ny, p).
    Each combination has the standard deviation 1."""
    G: Array
    """Weights (N, ny, ny): the estimator minimises the sum of |G(t) e(t)|²."""

    @property
    def known(self) -> Array:
        """True where there is a residual, (N, ny)."""
        return np.isfinite(self.e)


def parts_of(fit: MultivariableFit, data: Signals) -> list[Part]:
    """Return the residuals of each experiment with their derivatives."""
    std = np.sqrt(np.diag(fit.noise_covariance))

    def responses(theta: Array) -> list[ErrorResponses]:
        system = fit.form.replaced(theta).realised()
        return [
            error_responses(system, part, integrating=fit.form.integrators)
            for part in data.experiments()
        ]

    experiments = list(data.experiments())
    at_theta = responses(fit.theta)
    # For a derivative the initial states stay fixed, because `projection` removes the effect of
    # their estimates. Another estimate of the initial states would amplify rounding errors.
    states = [r.combination(part, std) for r, part in zip(at_theta, experiments, strict=True)]
    by: list[list[Array]] = []
    for direction in _directions(fit).T:
        ahead, behind = (responses(fit.theta + h * _STEP * direction) for h in (1, -1))
        by.append(
            [
                np.einsum("k,tki->ti", c, a.errors - b.errors) / (2 * _STEP)
                for c, a, b in zip(states, ahead, behind, strict=True)
            ]
        )
    # Outputs that are estimated together are weighted by the inverse of Lambda.
    together = fit.shared or fit.form.coupled or fit.structure == "arx"
    Lambda = fit.noise_covariance if together else np.diag(std**2)
    if fit.output_weights:
        Lambda = np.diag(1 / np.asarray(fit.output_weights))
    mean = np.mean(data.u, axis=0)
    found = []
    for k, (r, c, part) in enumerate(zip(at_theta, states, experiments, strict=True)):
        e = np.where(part.valid, np.einsum("k,tki->ti", c, r.errors), np.nan)
        S = (r.errors[:, 1:] * part.valid[:, None]).transpose(0, 2, 1)
        Psi = [np.where(part.valid, one[k], 0.0) for one in by]
        found.append(
            Part(
                u=part.u - mean,
                e=e,
                S=S,
                Psi=np.stack(Psi, axis=-1) if Psi else np.zeros((*e.shape, 0)),
                G=whitening(Lambda, np.isfinite(e)),
            )
        )
    return found


def _directions(fit: MultivariableFit) -> Array:
    """Return independent directions of theta, (d, p), each with standard deviation 1.

    The covariance of theta is singular for the matrices of a state space, and if a root is fixed at
    1.
    """
    scale = np.sqrt(np.maximum(np.diag(fit.covariance_robust), 1e-300))
    values, axes = np.linalg.eigh(fit.covariance_robust / np.outer(scale, scale))
    kept = values > _MIN_VARIANCE_SHARE * values[-1]
    return np.asarray(scale[:, None] * axes[:, kept] * np.sqrt(values[kept]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """P = B B^T W, the projection on the estimated quantities with the weights W = G^T G.

    The residuals are e = (1 - P) v, with the noise v. B is an orthonormal basis: B^T W B = 1.
    """

    B: Sequence[Array]
    """Basis of each experiment (N, ny, r)."""
    WB: Sequence[Array]
    """W B of each experiment (N, ny, r)."""

    @property
    def rank(self) -> int:
        """Number r of estimated quantities."""
        return int(self.B[0].shape[2])

    def influence(self, Z: Sequence[Array]) -> list[Array]:
        """Return H = (1 - P)^T Z (N, ny, k) of each experiment, so that Z^T e is equal to H^T v."""
        c = sum_of_products(self.B, Z)
        return [z - wb @ c for z, wb in zip(Z, self.WB, strict=True)]

    def applied(self, parts: Sequence[Part]) -> list[Part]:
        """Return the experiments with the residuals (1 - P) e.

        These residuals are (1 - P) v even if e was projected with other weights, or if the search
        ended shortly before its minimum. The reason is that e and v differ by a combination of the
        columns of B, which 1 - P removes.
        """
        e = [np.nan_to_num(part.e)[:, :, None] for part in parts]
        c = sum_of_products(self.WB, e)
        return [
            replace(part, e=part.e - (b @ c)[:, :, 0])
            for part, b in zip(parts, self.B, strict=True)
        ]

    def loss(self, Lambda: Array, known: Sequence[Array]) -> list[tuple[Array, Array]]:
        """Return B and D of each experiment: cov e is Lambda - B D^T - D B^T if v is white."""
        C = [
            np.einsum("ij,tjr->tir", Lambda, wb) * at[:, :, None]
            for wb, at in zip(self.WB, known, strict=True)
        ]
        M = sum_of_products(self.WB, C)
        return [(b, c - b @ (0.5 * M)) for b, c in zip(self.B, C, strict=True)]


def projection(parts: Sequence[Part], *, own: bool) -> Projection:
    """Return the projection on the effects of initial states and ramps (`own`: also parameters)."""
    bases = [orthonormal(_weighted(part, part.S)) for part in parts]
    ranks = np.cumsum([0, *(basis.rank for basis in bases)])
    B = []
    for k, (part, basis) in enumerate(zip(parts, bases, strict=True)):
        states = np.zeros((*part.e.shape, int(ranks[-1])))
        states[:, :, ranks[k] : ranks[k + 1]] = part.S @ basis.W
        B.append(states)
    if own:
        free = [
            part.Psi - part.S @ basis.coefficients(_weighted(part, part.Psi))
            for part, basis in zip(parts, bases, strict=True)
        ]
        by_theta = [_weighted(part, psi) for part, psi in zip(parts, free, strict=True)]
        W = orthonormal(np.vstack(by_theta)).W
        B = [np.concatenate([b, psi @ W], axis=2) for b, psi in zip(B, free, strict=True)]
    WB = [part.G.transpose(0, 2, 1) @ (part.G @ b) for part, b in zip(parts, B, strict=True)]
    return Projection(B=B, WB=WB)


def _weighted(part: Part, X: Array) -> Array:
    """Return G X with the rows of all outputs in one matrix, (N ny, k)."""
    return (part.G @ X).reshape(-1, X.shape[2])


def sum_of_products(X: Sequence[Array], Y: Sequence[Array]) -> Array:
    """Return the sum of X(t)^T Y(t) over all experiments, (r, k)."""
    each = [
        x.reshape(-1, x.shape[2]).T @ y.reshape(-1, y.shape[2]) for x, y in zip(X, Y, strict=True)
    ]
    return np.asarray(np.sum(each, axis=0))
