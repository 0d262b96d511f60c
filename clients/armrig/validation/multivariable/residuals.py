"""Tests of a model with several signals by its residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from armrig_core.errors import InputError

from armrig.data.signals import Signals
from armrig.models.estimation_data import findings_on_own_data
from armrig.models.multivariable.fit import MultivariableFit, require_same_channels
from armrig.numerics.covariance import joint_exogenous_score
from armrig.numerics.polynomial import Array
from armrig.numerics.whiteness import default_lags, joint_p_value
from armrig.validation.multivariable.projection import (
    Part,
    Projection,
    parts_of,
    projection,
    sum_of_products,
)
from armrig.validation.multivariable.residual_test import SignalsResidualTest
from armrig.validation.multivariable.whiteness import jointly_white, white_by_output

_MIN_SUM_VARIANCE = 1e-4
"""Least variance of a tested combination of the sums of `residuals`, as a share of the largest.

A combination with a smaller variance is not tested, because the estimation of the parameters sets
it to 0. Its computed variance is only the error of the differences that approximate Psi.
"""


def residuals(fit: MultivariableFit, data: Signals, lags: int | None = None) -> SignalsResidualTest:
    """Test whether the residuals are white and independent of the inputs, per pair and jointly.

    The tests use the sums s of e_i(t) u_j(t - k) over t, and of e_i(t) e_j(t - k) over t. Each test
    compares the statistic s^T M^-1 s with the chi-squared distribution. A correction accounts for
    the estimated variance of the noise. The residuals are e = (1 - P) v, with the noise v and the
    projection P on the estimated quantities. The columns of Z contain the lagged signals. Therefore
    s = Z^T e is equal to H^T v with H = (1 - P)^T Z. The covariance of s is ::

        M = H^T R H                                              on estimation data
        M = H^T R H + (H^T Psi) cov(theta) (Psi^T H)             on other data

    R is the covariance of the noise v. P projects on the effects of the initial states, the ramps
    of integrating outputs and, on estimation data, the parameters. P uses the weights of the
    estimator, Lambda^-1 if all outputs are estimated together. Psi, the derivatives of e with
    respect to the parameters, is computed by central differences.

    Parameters
    ----------
    fit : MultivariableFit
        Model of these outputs and inputs.
    data : Signals
        N samples.
    lags : int, optional
        Largest lag L, from 1 to half the number of residuals; 25 by default, fewer for short data.

    Returns
    -------
    SignalsResidualTest
        Residuals (N, ny), correlations with deviations, and p values.

    Raises
    ------
    ValueError
        The model and the data differ in channels or sampling time, or L is out of range.

    References
    ----------
    .. [1] J. R. M. Hosking, J. Am. Stat. Assoc. 75 (1980) 602-608 (several outputs).
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.6.
    """
    require_same_channels(fit, data)
    own = fit.estimated_from(data)
    # For a subspace estimate, which does not minimise the errors, P is not known.
    is_fitted = own and fit.structure != "n4sid"
    parts = parts_of(fit, data)
    projected = projection(parts, own=is_fitted)
    e = np.vstack([p.e for p in parts])
    counts = np.isfinite(e).sum(axis=0)
    N = int(counts.min())
    longest = max(N // 2, 1)
    L = default_lags(N) if lags is None else lags
    if not 1 <= L <= longest:
        raise InputError(f"lags={L} must be 1 to {longest}, half of the {N} residuals")
    R = _autocorrelation([p.e for p in parts], L)
    parts = projected.applied(parts)
    sums, M, allowance = _input_sums(parts, projected, L, own=is_fitted)
    pairs = np.arange(sums.size).reshape(fit.ny, fit.nu, 2 * L + 1)
    past, future = pairs[:, :, L:], pairs[:, :, :L]
    free = counts * (1 - projected.rank / counts.sum()) if is_fitted else counts
    u_power = np.sum(np.vstack([p.u for p in parts]) ** 2, axis=0)
    scale = np.sqrt(np.nansum(e**2, axis=0)[:, None] * u_power)[:, :, None]
    each = white_by_output(parts, projected, L, own=is_fitted)
    return SignalsResidualTest(
        outputs=fit.outputs,
        inputs=fit.inputs,
        e=e,
        lags=np.arange(L + 1),
        autocorrelation=R,
        white_by_output=each,
        white=jointly_white(parts, projected, L, own=is_fitted) if fit.ny > 1 else each[0],
        cross_lags=np.arange(-L, L + 1),
        cross_correlation=sums[pairs] / scale,
        cross_std=np.sqrt(np.maximum(np.diag(M)[pairs], 0.0)) / scale,
        missing_dynamics_by_pair=_by_pair(sums, M, past, free),
        feedback_by_pair=_by_pair(sums, M, future, free),
        missing_dynamics=_joint(sums, M, past, free.sum()),
        feedback=_joint(sums, M, future, free.sum()),
        allowance=allowance,
        on_estimation_data=own,
        source=data.source,
        findings=() if own else tuple(findings_on_own_data([(fit.label, fit)], data)),
    )


def _by_pair(sums: Array, M: Array, at: Array, free: Array) -> Array:
    rows = zip(at, free, strict=True)
    return np.array([[_joint(sums, M, pair, N) for pair in row] for row, N in rows])


def _joint(sums: Array, M: Array, at: Array, N: float) -> float:
    k = at.ravel()
    return joint_p_value(sums[k], M[np.ix_(k, k)], _MIN_SUM_VARIANCE, N)


def _input_sums(
    parts: Sequence[Part], projected: Projection, L: int, *, own: bool
) -> tuple[Array, Array, float]:
    """Return sums of e_i(t) u_j(t - k), pair after pair, their covariance M and the allowance."""
    Z = []
    for part in parts:
        lagged = np.stack([_lagged(u, L) for u in part.u.T], axis=1)  # (N, nu, 2 L + 1)
        N, ny = part.e.shape
        z = np.zeros((N, ny, ny, *lagged.shape[1:]))
        for i in range(ny):
            z[:, i, i] = lagged * part.known[:, i, None, None]
        Z.append(z.reshape(N, ny, -1))
    H = projected.influence(Z)
    sums = sum(np.einsum("tik,ti->k", z, np.nan_to_num(p.e)) for z, p in zip(Z, parts, strict=True))
    M = joint_exogenous_score([[*h.transpose(1, 0, 2)] for h in H], [[*p.e.T] for p in parts])
    known = np.diag(M).copy()
    if own:
        N = sum(int(part.known.sum()) for part in parts)
        M *= N / max(N - projected.rank, 1)
    else:
        slope = sum_of_products([part.Psi for part in parts], H)
        M += slope.T @ slope
    ratios = np.diag(M)[known > 0] / known[known > 0]
    return np.asarray(sums), M, float(np.sqrt(np.median(ratios))) if ratios.size else float("nan")


def _lagged(u: Array, L: int) -> Array:
    """Return u(t - k), k = -L … L, (N, 2 L + 1), zero outside the experiment."""
    padded = np.concatenate([np.zeros(L), u, np.zeros(L)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * L + 1)
    return np.asarray(windows[:, ::-1])


def _autocorrelation(parts: Sequence[Array], L: int) -> Array:
    """Return the correlation of e_i(t) with e_k(t - lag), (ny, ny, L + 1)."""
    known = [np.nan_to_num(e) for e in parts]
    R = np.stack(
        [sum(e[k:].T @ e[: max(e.shape[0] - k, 0)] for e in known) for k in range(L + 1)], axis=-1
    )
    power = np.sqrt(np.maximum(np.diag(R[:, :, 0]), 1e-300))
    return np.asarray(R / np.outer(power, power)[:, :, None])
