"""Curvature of a loss: whether standard deviations can be trusted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armrig.numerics.polynomial import Array

MAX_TRUSTED = 0.3
"""Largest `curvature` at which standard deviations are reliable. OE models of two separate poles (N
= 600, noise 10 % of y) had at most 0.13 in 95 of 100 records. With a resonance and noise of 32 % it
was above 0.3 in 92 of 100, and 95 % intervals contained 75 to 85 % of the coefficients."""
_CURVED_TEXT = (
    "do not trust the standard deviations: the loss is far from parabolic within two of them. "
    "Estimate fewer parameters (a pole and a zero may nearly cancel), or record more data. The "
    "deviations of responses are closer, but may be too small as well"
)
_FEW_TEXT = (
    "do not trust the standard deviations: the noise is so slow that {} samples count as {} "
    "independent ones, and std_robust may be half of the true deviation. Record longer, or "
    "estimate a model of the noise"
)
_MIN_INDEPENDENT = 20  # independent samples for each parameter
_DRAWS = 40
_FIRST_DRAWS = 4  # the longest draws, which suffice if none of them has a |ln r| above the limit
_NO_MODEL = -10.0  # ln r of a draw at which there is no model; no |ln r| counts as more


def doubts(
    curved: float, covariance: Array, robust: Array, *, N: int, coloured: bool, outputs: int = 1
) -> list[tuple[str, str]]:
    """Return the reasons (name, text) to distrust the standard deviations of d coefficients.

    One reason is a large curvature. The other reason is coloured noise whose robust covariance (d,
    d) is much larger than the classic covariance. The N samples of each output then count as less
    than 20 d/outputs independent samples, and the robust covariance is too small. With the noise
    1/(1 - 0.9 q^-1), N = 300, and three parameters its 95 % intervals contained 75 to 83 % of the
    true values.
    """
    reasons = [("curved", _CURVED_TEXT)] if curved > MAX_TRUSTED else []
    classic, used = np.diag(covariance), np.diag(robust)
    varies = np.flatnonzero((classic > 0) & (used > 0))
    if coloured and varies.size:
        std = np.sqrt(classic[varies])
        d = np.linalg.matrix_rank(covariance[np.ix_(varies, varies)] / np.outer(std, std), 1e-8)
        independent = N * float(np.min(classic[varies] / used[varies]))
        if independent < _MIN_INDEPENDENT * d / outputs:
            reasons.append(("few_independent", _FEW_TEXT.format(N, round(independent))))
    return reasons


@np.errstate(over="ignore", invalid="ignore")
def curvature(
    cost: Callable[[Array], float],
    theta: Array,
    covariance: Array,
    variance: float,
    *,
    used: Array | None = None,
    followers: slice = slice(0, 0),
) -> float:
    """Return the standard deviation of ln r over theta and draws from its normal distribution.

    r is the likelihood divided by that of the normal distribution, with the rise of the loss V
    against that of a parabola ::

        ln r = -d² (rise / parabola - 1) / 2,   d² = step^T inv(used) step
        rise = V(theta + step) - V(theta),   parabola = variance · step^T inv(covariance) step

    Parameters
    ----------
    cost : callable
        V of theta (n,); inf or NaN where there is no model.
    theta : ndarray (n,)
        Parameters at the minimum. The loss is minimised over all others.
    covariance : ndarray (n, n)
        `variance` times twice the inverse of the second derivative of V.
    variance : float
        Variance of the noise in the unit of V.
    used : ndarray (k, k), optional
        Covariance that is printed, of all parameters but the followers. The default is that in
        `covariance`; that of coloured noise differs.
    followers : slice
        Parameters that are not drawn; they follow the others as in the parabola.

    Returns
    -------
    float
        0 for a parabola.

    References
    ----------
    .. [1] A. Gelman et al., *Bayesian Data Analysis*, 3rd ed., 2013, sections 4.1 and 10.4 (normal
       approximation and importance ratios).
    """
    free = np.delete(np.arange(theta.size), followers)
    classic = covariance[np.ix_(free, free)]
    used = classic if used is None else used
    deviation, scale = (np.sqrt(np.diag(M)) for M in (used, classic))
    if not free.size or not (np.all(deviation > 0) and np.all(scale > 0)):
        return 0.0
    values, axes = np.linalg.eigh(used / np.outer(deviation, deviation))
    root = deviation[:, None] * axes * np.sqrt(np.maximum(values, 0.0))
    information = np.linalg.pinv(classic / np.outer(scale, scale)) / np.outer(scale, scale)
    along = covariance[:, free] @ information
    least, logs = cost(theta), [0.0]  # ln r is 0 at theta: draws that are all alike differ from it
    draws = np.random.default_rng(0).standard_normal((_DRAWS, free.size))
    for z in draws[np.argsort(-np.sum(draws**2, axis=1))]:
        step = root @ z
        rise, parabola = cost(theta + along @ step) - least, variance * (step @ information @ step)
        log = 0.0 if parabola <= 0 else float(-z @ z * (rise / parabola - 1) / 2)
        logs.append(max(min(log, -_NO_MODEL), _NO_MODEL) if np.isfinite(log) else _NO_MODEL)
        drawn = len(logs) - 1
        if drawn == _FIRST_DRAWS and np.max(np.abs(logs)) < MAX_TRUSTED:
            break
        if drawn == 3 * _FIRST_DRAWS and np.std(logs) < MAX_TRUSTED / 2:
            break
    return float(np.std(logs))
