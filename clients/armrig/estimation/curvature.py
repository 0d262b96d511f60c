"""Whether the loss is the parabola that standard deviations of coefficients take it for."""

from __future__ import annotations

import numpy as np

from armrig.estimation.prediction_error import PredictionError
from armrig.numerics.polynomial import Array

_AWAY = 2.0  # standard deviations
_LEAST = 1e-3  # ratio below which one is as good as 0
_UNSTABLE = -float(np.log(_LEAST))


def curvature(
    problem: PredictionError, theta: Array, covariance: Array, noise_variance: float
) -> float:
    """Return the largest |ln| of the loss's rise two deviations away over that of the parabola.

    Along each principal axis v of the scaled covariance of (c, d, f), both ways, a and b fitted ::

        (V(theta ± 2 s v) - V(theta)) / lambda  is 4  where V is a parabola

    Parameters
    ----------
    theta : ndarray (n,)
        (c, d, f) at the minimum.
    covariance : ndarray (n, n)
        Its covariance.
    noise_variance : float
        lambda.

    Returns
    -------
    float
        0 for a parabola, and where there is no c, d or f; 6.9 at most.

    References
    ----------
    .. [1] D. M. Bates, D. G. Watts, *Nonlinear Regression Analysis and Its Applications*, 1988,
       section 6.1 (profiles of the sum of squares).
    """
    deviation = np.sqrt(np.diag(covariance))
    if not theta.size or not noise_variance > 0 or not np.all(deviation > 0):
        return 0.0
    values, axes = np.linalg.eigh(covariance / np.outer(deviation, deviation))
    least, worst = problem.cost(theta), 0.0
    for value, axis in zip(values, axes.T, strict=True):
        step = _AWAY * np.sqrt(max(value, 0.0)) * deviation * axis
        for moved in (theta + step, theta - step):
            if not problem.admissible(moved):
                return _UNSTABLE
            rise = (problem.cost(moved) - least) / noise_variance / _AWAY**2
            worst = max(worst, abs(float(np.log(max(rise, _LEAST)))))
    return worst
