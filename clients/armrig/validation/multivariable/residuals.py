"""Tests of a model with several signals by its residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError

from armrig.data.signals import Signals
from armrig.estimation.multivariable.inference import (
    OutputResiduals,
    exogenous_covariance,
    pairwise_covariance,
)
from armrig.estimation.multivariable.whitening import whitening
from armrig.models.multivariable.fit import MultivariableFit, require_same_channels
from armrig.models.multivariable.state_space import prediction_errors
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.whiteness import (
    Whiteness,
    decided,
    default_lags,
    joint_p_value,
    portmanteau,
)
from armrig.validation.multivariable.residual_test import SignalsResidualTest

_STEP = 1e-3  # standard deviations by which a parameter moves for a derivative
_MIN_SUM_VARIANCE = 1e-4
"""Share of the largest variance, of a direction of the sums that the parameters leave free.

The search leaves sums of this order in the other directions, because its minimum is not exact.
"""
_MIN_VARIANCE_SHARE = 1e-12  # of the largest one, of a direction that the data determine


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """Residuals of one experiment."""

    u: Array
    """Inputs minus their means (N, nu)."""
    e: Array
    """Residuals (N, ny), NaN where they are not known."""
    S: Array
    """Responses of e to the initial state and the ramps (N, ny, r)."""
    Psi: Array
    """Derivatives of e by independent parameters of standard deviation 1, (N, ny, p)."""
    G: Array
    """Weights (N, ny, ny) of the estimator: it minimises the sum of |G(t) e(t)|²."""


def residuals(fit: MultivariableFit, data: Signals, lags: int | None = None) -> SignalsResidualTest:
    """Test whether the residuals are white and independent of the inputs, per pair and jointly.

    With the sums s of e_i(t) u_j(t - k), and of e_i(t) e_j(t - k), each test is s^T M^-1 s against
    chi-squared. The residuals are e = (1 - P) v, with the noise v and the projection P on the
    estimated parameters. Therefore s = Z^T e is H^T v with H = (1 - P)^T Z, and ::

        M = H^T R H                                              on estimation data
        M = H^T R H + (H^T Psi) cov(theta) (Psi^T H)             on other data

    P contains the parameters only on estimation data. Psi is computed by central differences.

    Parameters
    ----------
    fit : MultivariableFit
        Model of these outputs and inputs.
    data : Signals
        N samples.
    lags : int, optional
        L, from 1 to half the number of residuals; 25 by default, fewer for short data.

    Returns
    -------
    SignalsResidualTest
        Residuals (N, ny), correlations with deviations, and p values.

    Raises
    ------
    ValueError
        The model has other channels or another sampling time, or L is not possible.

    References
    ----------
    .. [1] J. R. M. Hosking, J. Am. Stat. Assoc. 75 (1980) 602-608 (several outputs).
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.6.
    """
    require_same_channels(fit, data)
    own = fit.estimated_from(data)
    # A subspace estimate does not minimise the errors, so that P is not known for it.
    is_fitted = own and fit.structure != "n4sid"
    parts = _parts(fit, data)
    e = np.vstack([p.e for p in parts])
    N = int(np.isfinite(e).sum(axis=0).min())
    longest = max(N // 2, 1)
    L = default_lags(N) if lags is None else lags
    if not 1 <= L <= longest:
        raise InputError(f"lags={L} must be 1 to {longest}, half of the {N} residuals")
    ny, nu = fit.ny, fit.nu
    sums, M = _input_sums(parts, L, own=is_fitted)
    pairs = np.arange(sums.size).reshape(ny, nu, 2 * L + 1)
    past, future = pairs[:, :, L:], pairs[:, :, :L]
    u_power = np.sum(np.vstack([p.u for p in parts]) ** 2, axis=0)
    scale = np.sqrt(np.nansum(e**2, axis=0)[:, None] * u_power)[:, :, None]
    R = _autocorrelation([p.e for p in parts], L)
    return SignalsResidualTest(
        outputs=fit.outputs,
        inputs=fit.inputs,
        e=e,
        lags=np.arange(L + 1),
        autocorrelation=R,
        white_by_output=tuple(_white(parts, i, L, own=is_fitted) for i in range(ny)),
        white=_jointly_white(parts, L, own=is_fitted)
        if ny > 1
        else _white(parts, 0, L, own=is_fitted),
        cross_lags=np.arange(-L, L + 1),
        cross_correlation=sums[pairs] / scale,
        cross_std=np.sqrt(np.maximum(np.diag(M)[pairs], 0.0)) / scale,
        missing_dynamics_by_pair=_by_pair(sums, M, past),
        feedback_by_pair=_by_pair(sums, M, future),
        missing_dynamics=_joint(sums, M, past),
        feedback=_joint(sums, M, future),
        on_estimation_data=own,
        source=data.source,
    )


def _by_pair(sums: Array, M: Array, at: Array) -> Array:
    return np.array([[_joint(sums, M, pair) for pair in row] for row in at])


def _joint(sums: Array, M: Array, at: Array) -> float:
    k = at.ravel()
    return joint_p_value(sums[k], M[np.ix_(k, k)], _MIN_SUM_VARIANCE)


def _parts(fit: MultivariableFit, data: Signals) -> list[_Part]:
    """Return the residuals of each experiment with their derivatives."""
    std = np.sqrt(np.diag(fit.noise_covariance))

    def errors(theta: Array) -> list[tuple[Array, Array]]:
        system = fit.form.replaced(theta).realised()
        return [
            prediction_errors(system, part, integrating=fit.form.integrators, noise_std=std)
            for part in data.experiments()
        ]

    directions = _directions(fit)
    by: list[list[Array]] = []
    for direction in directions.T:
        ahead, behind = (errors(fit.theta + h * _STEP * direction) for h in (1, -1))
        by.append([(a - b) / (2 * _STEP) for (a, _), (b, _) in zip(ahead, behind, strict=True)])
    # Rows that the estimator treats together are weighted by the inverse of Lambda.
    together = fit.shared or fit.form.coupled or fit.structure == "arx"
    Lambda = fit.noise_covariance if together else np.diag(std**2)
    mean = np.mean(data.u, axis=0)
    found = []
    for k, ((e, S), part) in enumerate(zip(errors(fit.theta), data.experiments(), strict=True)):
        Psi = [np.nan_to_num(one[k]) for one in by]
        found.append(
            _Part(
                u=part.u - mean,
                e=e,
                S=S.transpose(0, 2, 1),
                Psi=np.stack(Psi, axis=-1) if Psi else np.zeros((*e.shape, 0)),
                G=whitening(Lambda, np.isfinite(e)),
            )
        )
    return found


def _directions(fit: MultivariableFit) -> Array:
    """Return independent directions of theta, (d, p), each with standard deviation 1.

    The covariance is singular for matrices of a state space, and for a root that is 1.
    """
    scale = np.sqrt(np.maximum(np.diag(fit.covariance_robust), 1e-300))
    values, axes = np.linalg.eigh(fit.covariance_robust / np.outer(scale, scale))
    kept = values > _MIN_VARIANCE_SHARE * values[-1]
    return np.asarray(scale[:, None] * axes[:, kept] * np.sqrt(values[kept]))


def _weighted(part: _Part, X: Array) -> Array:
    """Return G X with the rows of all outputs below each other, (N ny, k)."""
    return (part.G @ X).reshape(-1, X.shape[2])


def _influence(parts: list[_Part], Z: list[Array], *, own: bool) -> list[Array]:
    """Return H = (1 - P)^T Z (N, ny, k) of each experiment, with Z zero without a residual.

    P = X (X^T W X)^-1 X^T W projects on the estimated state and, on estimation data, parameters.
    """
    free = []
    for part, z in zip(parts, Z, strict=True):
        X = _weighted(part, part.S)
        basis = orthonormal(X)
        c = basis.W @ (basis.W.T @ np.einsum("tir,tik->rk", part.S, z))
        free.append(z - part.G.transpose(0, 2, 1) @ (X @ c).reshape(z.shape))
    if not own or not parts[0].Psi.shape[2]:
        return free
    by_theta = [_weighted(part, part.Psi) for part in parts]
    basis = orthonormal(np.vstack(by_theta))
    c = basis.W @ (basis.W.T @ _slope(parts, free))
    return [
        h - part.G.transpose(0, 2, 1) @ (x @ c).reshape(h.shape)
        for part, h, x in zip(parts, free, by_theta, strict=True)
    ]


def _slope(parts: list[_Part], H: list[Array]) -> Array:
    """Return Psi^T H, (p, k)."""
    each = [np.einsum("tir,tik->rk", p.Psi, h) for p, h in zip(parts, H, strict=True)]
    return np.asarray(np.sum(each, axis=0))


def _inflation(parts: list[_Part]) -> float:
    """Return N/(N - d) for the residuals of a model that was estimated from them."""
    N = float(sum(int(np.isfinite(p.e).sum()) for p in parts))
    d: int = parts[0].Psi.shape[2] + sum(orthonormal(_weighted(p, p.S)).rank for p in parts)
    return N / max(N - d, 1)


def _input_sums(parts: list[_Part], L: int, *, own: bool) -> tuple[Array, Array]:
    """Return the sums of e_i(t) u_j(t - k), pair after pair, and their covariance M."""
    Z = []
    for part in parts:
        known = np.isfinite(part.e)
        lagged = np.stack([_lagged(u, L) for u in part.u.T], axis=1)  # (N, nu, 2 L + 1)
        N, ny = part.e.shape
        z = np.zeros((N, ny, ny, *lagged.shape[1:]))
        for i in range(ny):
            z[:, i, i] = lagged * known[:, i, None, None]
        Z.append(z.reshape(N, ny, -1))
    H = _influence(parts, Z, own=own)
    sums = sum(np.einsum("tik,ti->k", z, np.nan_to_num(p.e)) for z, p in zip(Z, parts, strict=True))
    M = exogenous_covariance(
        [
            [_scored(part.e[:, i], h[:, i]) for i in range(part.e.shape[1])]
            for part, h in zip(parts, H, strict=True)
        ]
    )
    M *= _inflation(parts) if own else 1.0
    if not own:
        slope = _slope(parts, H)
        M += slope.T @ slope
    return np.asarray(sums), M


def _scored(e: Array, H: Array) -> OutputResiduals:
    none = np.zeros((e.size, 0))
    return OutputResiduals(e=e, y=e, H=H, Psi=none, Z=none)


def _lagged(u: Array, L: int) -> Array:
    """Return u(t - k), k = -L … L, (N, 2 L + 1), zero outside the experiment."""
    padded = np.concatenate([np.zeros(L), u, np.zeros(L)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * L + 1)
    return np.asarray(windows[:, ::-1])


def _autocorrelation(parts: list[Array], L: int) -> Array:
    """Return the correlation of e_i(t) with e_k(t - lag), (ny, ny, L + 1)."""
    known = [np.nan_to_num(e) for e in parts]
    R = np.stack([sum(e[k:].T @ e[: e.shape[0] - k] for e in known) for k in range(L + 1)], axis=-1)
    power = np.sqrt(np.maximum(np.diag(R[:, :, 0]), 1e-300))
    return np.asarray(R / np.outer(power, power)[:, :, None])


def _white(parts: list[_Part], i: int, L: int, *, own: bool) -> Whiteness:
    """Test the residuals of one output."""
    p = parts[0].Psi.shape[2]
    return portmanteau(
        [part.e[:, i] for part in parts],
        [-part.Psi[:, i] for part in parts],
        [orthonormal(part.S[:, i]).Q for part in parts],
        L,
        None if own else np.eye(p),
    )


def _jointly_white(parts: list[_Part], L: int, *, own: bool) -> Whiteness:
    """Test the residuals of all outputs together.

    The residuals are whitened across the outputs, so that the sums v of e_a(t) e_b(t - k) of a
    known model have the variance of the numbers of products. Instants with a missing output are
    left out.
    """
    Lambda = pairwise_covariance(np.vstack([p.e for p in parts]))
    T = np.linalg.inv(np.linalg.cholesky(Lambda))
    ny = T.shape[0]
    whole = [np.asarray(np.isfinite(p.e).all(axis=1)) for p in parts]
    white = [
        np.where(k[:, None], np.nan_to_num(p.e) @ T.T, 0.0)
        for p, k in zip(parts, whole, strict=True)
    ]
    Z, sums, pairs, mean = [], np.zeros(0), np.zeros(L), np.zeros((ny, ny, L))
    for part, w, k in zip(parts, white, whole, strict=True):
        past = np.stack([_past(w, lag) for lag in range(1, L + 1)], axis=-1)  # (N, ny, L)
        z = T.T[None, :, :, None, None] * past[:, None, None] * k[:, None, None, None, None]
        Z.append(z.reshape(*part.e.shape, -1))
        pairs += [np.sum(k[lag:] & k[:-lag]) for lag in range(1, L + 1)]
        blocks = [part.S, part.Psi] if own else [part.S]
        mean -= _projected_sums(T, np.concatenate(blocks, axis=2) * k[:, None, None], L)
    sums = np.sum(
        [np.einsum("tik,ti->k", z, np.nan_to_num(p.e)) for z, p in zip(Z, parts, strict=True)],
        axis=0,
    )
    H = _influence(parts, Z, own=own)
    N = int(sum(k.sum() for k in whole))
    V = np.broadcast_to(pairs * N / (N + 2), (ny, ny, L)).ravel()
    M = np.diag(V) + _spread(H, Lambda) - _spread(Z, Lambda)
    if not own:
        slope = _slope(parts, H)
        M += slope.T @ slope
    return decided(sums - mean.ravel(), M, V, N * ny)


def _past(w: Array, lag: int) -> Array:
    return np.concatenate([np.zeros((lag, w.shape[1])), w[: w.shape[0] - lag]])


def _projected_sums(T: Array, X: Array, L: int) -> Array:
    """Return the sums of q_a(t) q_b(t - k) of an orthonormal basis of T X, (ny, ny, L)."""
    N, ny, _ = X.shape
    Q = orthonormal((T @ X).reshape(N * ny, -1)).Q.reshape(N, ny, -1)
    return np.stack([np.einsum("tar,tbr->ab", Q[k:], Q[: N - k]) for k in range(1, L + 1)], axis=-1)


def _spread(H: list[Array], Lambda: Array) -> Array:
    """Return the covariance of the sum of H(t)^T e(t) for white e."""
    root = np.linalg.cholesky(Lambda)
    whole = np.concatenate([np.einsum("ij,tik->tjk", root, h).reshape(-1, h.shape[2]) for h in H])
    return np.asarray(whole.T @ whole)
