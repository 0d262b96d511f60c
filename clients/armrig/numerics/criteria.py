"""Criteria for the choice between models, and the one-standard-error rule.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.4.
.. [2] T. Hastie, R. Tibshirani, J. Friedman, *The Elements of Statistical Learning*, 2nd ed.,
   2009, section 7.10 (one standard error).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from armrig.numerics.polynomial import Array

Criterion = Literal["aic", "mdl", "fpe", "validation"]
BATCHES = 30
"""Number of batches for the standard error of the mean of correlated samples."""


def deviance(loss: ArrayLike, N: int) -> Array:
    """Return -2 log likelihood of N Gaussian residuals whose mean square is `loss`."""
    least = np.finfo(np.float64).tiny
    return np.asarray(N * (np.log(2 * np.pi * np.maximum(loss, least)) + 1))


def aic(loss: ArrayLike, d: ArrayLike, N: int) -> Array:
    """Return Akaike's criterion of d parameters, -2 log likelihood + 2 d, for Gaussian e."""
    return np.asarray(deviance(loss, N) + 2 * np.asarray(d))


def mdl(loss: ArrayLike, d: ArrayLike, N: int) -> Array:
    """Return Rissanen's criterion (BIC), -2 log likelihood + d log N, for Gaussian e."""
    return np.asarray(deviance(loss, N) + np.asarray(d) * float(np.log(max(N, 1))))


def fpe(loss: ArrayLike, d: ArrayLike, N: int) -> Array:
    """Return Akaike's final prediction error, loss (1 + d/N) / (1 - d/N); inf if d >= N."""
    share = np.asarray(d) / N
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.asarray(loss) * (1 + share) / (1 - share)
    return np.where(share < 1, error, np.inf)


def batch_means(x: Array) -> Array:
    """Return the means of 30 successive batches of x (N,), or x itself if N < 30."""
    return np.array([part.mean() for part in np.array_split(x, min(BATCHES, x.size))])


def standard_error(means: Array) -> Array:
    """Return the standard error of the mean, from batch means (..., K) along the last axis.

    If neighbouring samples are correlated, the standard error of the mean exceeds s / sqrt(N). If
    the batches are longer than the correlation time of the samples, the batch means are nearly
    independent. For one batch the result is 0.
    """
    K = means.shape[-1]
    if K < 2:
        return np.zeros(means.shape[:-1])
    return np.asarray(np.std(means, axis=-1, ddof=1) / np.sqrt(K))


def simplest_as_good(excess: Array, std: Array, parameters: ArrayLike) -> int:
    """Return the index of the model with fewest parameters among the models as good as the best.

    `excess` (n,) is the loss of each model minus the least loss, or NaN if a model has no loss. A
    model is as good as the best if its excess is at most `std` (n,), the standard error of the
    excess, which is 0 for the model of least loss. If several of these models have the fewest
    parameters, the model with the least excess is chosen.
    """
    d = np.asarray(parameters)
    as_good = np.flatnonzero(excess <= std).tolist()
    return int(min(as_good, key=lambda i: (d[i], excess[i])))


def fit_percent(y: Array, sse: float) -> float:
    """Return the fit 100 (1 - |y - ŷ| / |y - mean y|) in percent, with sse = |y - ŷ|².

    The whole package uses this measure of fit.
    """
    spread = float(np.linalg.norm(y - np.mean(y))) if y.size else 0.0
    if not np.isfinite(sse):
        return -np.inf
    return 100 * (1 - float(np.sqrt(sse)) / spread) if spread > 0 else float("nan")
