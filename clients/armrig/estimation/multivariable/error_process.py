"""Autoregression of one-step errors, from which a bootstrap draws errors.

The gain K of a subspace estimate is biased, because the estimate uses finite windows. The one-step
errors of the model are then not white. With independently drawn errors, the noise of the simulated
data would not have the spectrum of the noise in the measured data.

References
----------
.. [1] P. Bühlmann, "Sieve bootstrap for time series", Bernoulli 3 (1997) 123-148.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armrig.estimation.multivariable.subspace import complete_stretches, long_regression
from armrig.numerics.criteria import aic
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion

_MAX_LAGS = 10
_MIN_ROWS = 10  # rows of the regression for each of its coefficients
_SETTLING = 200  # samples before the drawn ones


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorProcess:
    """Process e(t) = A_1 e(t-1) + … + A_p e(t-p) + w(t)."""

    coefficients: Array
    """Matrices A_1 … A_p (p, ny, ny); p = 0 for white errors."""
    w: Array
    """Estimated w of all instants (N, ny), with mean 0."""

    @property
    def companion(self) -> Array:
        """Transition matrix (p ny, p ny) of the last p errors, the last error first."""
        p, ny, _ = self.coefficients.shape
        F = np.eye(p * ny, k=-ny)
        F[:ny] = self.coefficients.transpose(1, 0, 2).reshape(ny, p * ny)
        return F

    def drawn(self, rng: np.random.Generator, N: int) -> Array:
        """Return N errors (N, ny) of the process; each w(t) is drawn from the values in `w`."""
        p, ny, _ = self.coefficients.shape
        w = self.w[rng.integers(0, self.w.shape[0], N + _SETTLING * (p > 0))]
        if p == 0:
            return np.asarray(w)
        driven = np.hstack([w, np.zeros((w.shape[0], (p - 1) * ny))])
        x = recursion(self.companion, driven, np.zeros(p * ny))
        return np.asarray(x[1 + _SETTLING :, :ny])


def error_process(errors: Sequence[Array]) -> ErrorProcess:
    """Return the process with the lowest AIC among stable processes with 0 to 10 lags.

    Parameters
    ----------
    errors : sequence of ndarray
        One-step errors (N, ny) of each experiment, NaN where an output is missing.
    """
    mean = np.nanmean(np.vstack(errors), axis=0)
    centred = [e - mean for e in errors]
    scored = [(_score(process), process) for process in _processes(centred)]
    return min(scored, key=lambda one: one[0])[1]


def _processes(errors: Sequence[Array]) -> Iterator[ErrorProcess]:
    """Yield the stable processes with 0 lags, with 1 lag, and so on."""
    ny = errors[0].shape[1]
    known = np.vstack(errors)
    yield ErrorProcess(coefficients=np.zeros((0, ny, ny)), w=known[np.isfinite(known).all(axis=1)])
    for p in range(1, _MAX_LAGS + 1):
        parts = complete_stretches([(np.zeros((len(e), 0)), e) for e in errors], p + 1)
        if sum(len(e) - p for _, e in parts) < _MIN_ROWS * p * ny:
            return
        A = long_regression(parts, p, direct=False)
        w = np.vstack(
            [
                e[p:] - sum(e[p - k : len(e) - k] @ A[k - 1].T for k in range(1, p + 1))
                for _, e in parts
            ]
        )
        process = ErrorProcess(coefficients=A, w=w - w.mean(axis=0))
        if np.max(np.abs(np.linalg.eigvals(process.companion))) < 1:
            yield process


def _score(process: ErrorProcess) -> float:
    """Return AIC divided by the number of instants, which differs from process to process."""
    N = process.w.shape[0]
    loss = np.exp(np.linalg.slogdet(process.w.T @ process.w / N)[1])
    return float(aic(loss, process.coefficients.size, N)) / N
