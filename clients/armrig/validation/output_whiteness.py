"""Portmanteau test of the residuals of one output, or of several outputs together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armrig.models.predictor import PredictionErrors
from armrig.numerics.covariance import pairwise_covariance
from armrig.numerics.polynomial import Array, lag_columns
from armrig.numerics.whiteness import NOT_TESTED, Whiteness, portmanteau, whiteness_of_sums
from armrig.validation.projection import Projection, sum_of_products


def white_by_output(
    projected: Projection, theta_covariance: Array | None, L: int
) -> list[Whiteness]:
    """Test each output; give the parameters' covariance if they are estimated from other data."""
    parts = projected.parts
    if parts[0].e.shape[1] == 1:
        e, Psi, S = zip(*((p.e[:, 0], p.Psi[:, 0], p.S[:, 0]) for p in parts), strict=True)
        return [portmanteau(e, Psi, S, L, theta_covariance)]
    Lambda = _covariance(parts)
    rows = np.diag(1 / np.sqrt(np.diag(Lambda)))
    return [_white(projected, Lambda, row[None], theta_covariance, L) for row in rows]


def jointly_white(projected: Projection, theta_covariance: Array | None, L: int) -> Whiteness:
    """Test whether the residuals of all outputs are jointly white, also across outputs.

    The residuals are whitened across the outputs. Instants with a missing output are left out.
    """
    Lambda = _covariance(projected.parts)
    T = np.linalg.inv(np.linalg.cholesky(Lambda))
    return _white(projected, Lambda, T, theta_covariance, L)


def _covariance(parts: Sequence[PredictionErrors]) -> Array:
    return pairwise_covariance(np.vstack([p.e for p in parts]))


def _white(
    projected: Projection, Lambda: Array, T: Array, theta_covariance: Array | None, L: int
) -> Whiteness:
    """Test whether w = T e, which has m outputs with covariance 1, is white.

    The test uses the sums over t of w_a(t) w_b(t - k), k = 1 … L. If the parameters are known, the
    variance of a sum is the number of its products. The fit makes the variance of w smaller than
    that of the noise, and the variance of a sum is larger in that ratio. The estimation changes cov
    e from Lambda to Lambda - B D^T - D B^T. B and D follow from the projection P on the estimated
    quantities. The last two terms shift the means of the sums, and the influence H = (1 - P)^T Z
    reduces the covariance of the sums. For one output the test equals
    `armrig.numerics.whiteness.portmanteau`, which is quicker.
    """
    parts = projected.parts
    m = T.shape[0]
    used = np.flatnonzero(T.any(axis=0))
    rows = [np.asarray(p.known[:, used].all(axis=1)) for p in parts]
    N = int(sum(k.sum() for k in rows))
    p = parts[0].Psi.shape[2]
    if L + p + sum(part.S.shape[2] for part in parts) >= N or not _vary(parts, used):
        return NOT_TESTED
    w = [
        np.where(k[:, None], np.nan_to_num(part.e) @ T.T, 0.0)
        for part, k in zip(parts, rows, strict=True)
    ]
    past = [np.stack([lag_columns(column, range(1, L + 1)) for column in x.T], axis=1) for x in w]
    # The products of a(t) with b(t - k) are columns a, b, k.
    sums = np.sum(
        [np.einsum("ta,tbk->abk", x, late) for x, late in zip(w, past, strict=True)], axis=0
    ).ravel()
    Z = [
        np.reshape(
            T.T[None, :, :, None, None] * (late * k[:, None, None])[:, None, None],
            (late.shape[0], T.shape[1], -1),
        )
        for late, k in zip(past, rows, strict=True)
    ]
    pairs = np.sum([[np.sum(k[lag:] & k[:-lag]) for lag in range(1, L + 1)] for k in rows], axis=0)
    lost = [
        tuple((T @ x) * k[:, None, None] for x in factors)
        for factors, k in zip(projected.loss(Lambda), rows, strict=True)
    ]
    left = 1 - 2 * sum(np.diag(_product(b, d, 0)) for b, d in lost) / N  # of the variance of w
    V = (pairs * N / (N + 2) / np.sqrt(np.outer(left, left))[:, :, None]).ravel()
    H = projected.influence(Z)
    M = np.diag(V) + _spread(H, Lambda) - _spread(Z, Lambda)
    if theta_covariance is not None:
        slope = sum_of_products([part.Psi for part in parts], H)
        M += slope.T @ theta_covariance @ slope
    mean = np.zeros((m, m, L))
    for b, d in lost:
        for lag in range(1, L + 1):
            mean[:, :, lag - 1] -= _product(b, d, lag) + _product(d, b, lag)
    return whiteness_of_sums(sums - mean.ravel(), M, V, N * m)


def _vary(parts: Sequence[PredictionErrors], used: Array) -> bool:
    """Return whether each used output has a residual that is not 0."""
    return bool(np.all(np.sum([np.nansum(part.e[:, used] ** 2, axis=0) for part in parts], axis=0)))


def _product(x: Array, y: Array, lag: int) -> Array:
    """Return the sum of x_a(t)^T y_b(t - lag), (m, m)."""
    ahead, behind = x[lag:], y[: max(y.shape[0] - lag, 0)]
    return np.asarray(np.tensordot(ahead, behind, axes=((0, 2), (0, 2))))


def _spread(H: Sequence[Array], Lambda: Array) -> Array:
    """Return the covariance of the sum of H(t)^T e(t) for white e."""
    root = np.linalg.cholesky(Lambda)
    rooted = [root.T @ h for h in H]
    return sum_of_products(rooted, rooted)
