"""Autoregression of one-step errors, from which a bootstrap draws errors.

The gain K of a subspace estimate is biased, because the estimate uses finite windows. The one-step
errors of the model are then not white. With independently drawn errors, the noise of the simulated
data would not have the spectrum of the noise in the measured data. The number of lags is fixed,
because a criterion such as AIC chooses no lags for short data. Without lags the spectrum at low
frequencies is wrong by a fifth.

References
----------
.. [1] P. Bühlmann, "Sieve bootstrap for time series", Bernoulli 3 (1997) 123-148.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armrig.estimation.subspace import complete_stretches, long_regression
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion

_LAGS = 10  # number of lags; fewer if there are few rows
_MIN_ROWS = 10  # least number of rows for each coefficient of the regression
_SETTLING = 200  # samples that are dropped at the start of the process


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorProcess:
    """Process e(t) = A_1 e(t-1) + … + A_p e(t-p) + w(t)."""

    coefficients: Array
    """Matrices A_1 … A_p (p, ny, ny); p = 0 for white errors."""
    w: Array
    """Estimates of w at all instants (N, ny), with mean 0."""

    @property
    def companion(self) -> Array:
        """Transition matrix (p ny, p ny) of the last p errors, the last error first."""
        p, ny, _ = self.coefficients.shape
        F = np.eye(p * ny, k=-ny)
        F[:ny] = self.coefficients.transpose(1, 0, 2).reshape(ny, p * ny)
        return F

    def drawn(self, rng: np.random.Generator, N: int) -> Array:
        """Return N errors (N, ny) of the process, with w drawn from the estimated values of w."""
        p, ny, _ = self.coefficients.shape
        w = self.w[rng.integers(0, self.w.shape[0], N + _SETTLING * (p > 0))]
        if p == 0:
            return np.asarray(w)
        driven = np.hstack([w, np.zeros((w.shape[0], (p - 1) * ny))])
        x = recursion(self.companion, driven, np.zeros(p * ny))
        return np.asarray(x[1 + _SETTLING :, :ny])


def error_process(errors: Sequence[Array]) -> ErrorProcess:
    """Return the autoregression with 10 lags, or with fewer lags if there are few errors.

    The one-step errors (N, ny) of each experiment are NaN where an output is missing.
    """
    all_errors = np.vstack(errors)
    ny = all_errors.shape[1]
    mean = np.nanmean(all_errors, axis=0)
    for p in range(_LAGS, 0, -1):
        inputs = [(np.zeros((len(e), 0)), e - mean) for e in errors]
        parts = complete_stretches(inputs, p + 1)
        rows = sum(len(e) - p for _, e in parts)
        if rows < _MIN_ROWS * p * ny:
            continue
        A = long_regression(parts, p, direct=False)
        w = np.vstack([_errors(e, A) for _, e in parts])
        w = (w - w.mean(axis=0)) * np.sqrt(rows / (rows - p * ny))  # degrees of freedom
        process = ErrorProcess(coefficients=A, w=w)
        if np.max(np.abs(np.linalg.eigvals(process.companion))) < 1:
            return process
    complete = all_errors[np.isfinite(all_errors).all(axis=1)]
    if not complete.size:  # no instant has all outputs, so their errors are taken as independent
        each = [e[np.isfinite(e)] for e in all_errors.T]
        complete = np.column_stack([e[: min(map(len, each))] for e in each])
    return ErrorProcess(coefficients=np.zeros((0, ny, ny)), w=complete - complete.mean(axis=0))


def _errors(e: Array, A: Array) -> Array:
    """Return the errors (N - p, ny) of the prediction of e from its last p values."""
    p = len(A)
    return np.asarray(e[p:] - sum(e[p - k : len(e) - k] @ A[k - 1].T for k in range(1, p + 1)))
