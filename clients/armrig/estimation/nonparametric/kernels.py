"""Priors for a decaying impulse response, and marginal likelihood of the data.

A kernel is the covariance P(lambda, rho) of g(0) … g(n-1) up to a scale factor. The factor L of a
kernel satisfies L L^T = P.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import orthonormal, triangle
from armrig.numerics.rounding import rounding_std

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]
Kernel = Literal["tc", "dc", "ss"]

KERNELS = ("tc", "dc", "ss")
_DECAYS = (0.5, 0.7, 0.85, 0.93, 0.98)
_SCALES = (1e-2, 1.0, 1e2, 1e4)
_BLOCK_ROWS = 4096  # rows computed at once; they fit into the cache


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posterior:
    """Posterior of g at the hyperparameters that maximise the marginal likelihood."""

    g: Vector
    """Posterior mean, (n,)."""
    covariance: Matrix
    """Posterior covariance, (n, n)."""
    noise_variance: float
    """Estimate of sigma², in the squared unit of y."""
    hyperparameters: dict[str, float]
    """Scale of P in the squared unit of g, decay lambda, and for "dc" the correlation rho."""


def factor(kernel: Kernel, n: int, decay: float, correlation: float = 0.0) -> Matrix:
    """Return L (n, n) with L L^T = P.

    For i, j = 1 … n the kernel P(i, j) is ::

        TC: lambda^max(i,j)
        DC: lambda^((i+j)/2) rho^|i-j|
        SS: lambda^(i+j+max(i,j))/2 - lambda^(3 max(i,j))/6

    References
    ----------
    .. [1] T. Chen, H. Ohlsson, L. Ljung, Automatica 48 (2012) 1525-1535.
    """
    i = np.arange(1, n + 1)
    if kernel == "ss":
        largest = np.maximum.outer(i, i)
        P = decay ** (np.add.outer(i, i) + largest) / 2 - decay ** (3 * largest) / 6
        # P is nearly singular, so that a Cholesky factor would need a larger diagonal. The
        # eigenvalues do not need it.
        value, vector = np.linalg.eigh(P)
        return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))
    # TC is DC with rho = sqrt(lambda). The covariance of an AR(1) process has a closed-form factor.
    rho = np.sqrt(decay) if kernel == "tc" else correlation
    apart = np.subtract.outer(i, i)
    ar = np.where(apart >= 0, rho ** np.maximum(apart, 0), 0.0)
    ar[:, 1:] *= np.sqrt(1 - rho**2)
    return np.asarray(decay ** (i / 2)[:, None] * ar)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Marginal likelihood of M samples y = Phi g + e, from a triangular factor.

    Let [Phi y] = Q [[R, r], [0, s]]. The noise e is white with the variance sigma², and g has the
    covariance kappa sigma² L L^T.
    The triangular factor of [[R L sqrt(kappa), r], [I, 0]] is [[T, t], [0, d]]. Then ::

        -2 log p(y) = M log(sigma²) + 2 log|det T| + (d² + s²)/sigma²

    The minimum over sigma² is at sigma² = (d² + s²)/M. Only the first QR decomposition needs all
    samples. The second QR decomposition, for each kappa, lambda and rho, has only 2 n rows.

    References
    ----------
    .. [1] T. Chen, L. Ljung, Automatica 49 (2013) 2213-2220.
    """

    kernel: Kernel
    """Name of the kernel."""
    R: Matrix
    """Triangular factor R of Phi, (n, n)."""
    r: Vector
    """First n elements r of Q^T y, (n,)."""
    rest: float
    """Part s² of |y|² that no g explains."""
    M: int
    """Number of samples less the number of nuisance parameters."""

    def posterior(self) -> Posterior:
        """Return the posterior at the hyperparameters that maximise the marginal likelihood."""
        return self._posterior_at(self.likeliest())

    def likeliest(self) -> Vector:
        """Return log kappa, logit lambda and (for "dc") logit rho that maximise the likelihood."""
        from scipy.optimize import minimize

        starts = sorted(self._starts(), key=self._cost)[:1]
        if self.kernel == "dc":  # the optimum of TC, a special case of DC, is a good start value
            x = replace(self, kernel="tc").likeliest()
            starts.append(np.append(x, _logit(np.sqrt(self._parameters(x)[1]))))
        options = {"xatol": 1e-2, "fatol": 1e-3, "maxiter": 400}
        ends = [
            minimize(self._cost, start, method="Nelder-Mead", options=options) for start in starts
        ]
        return np.asarray(min(ends, key=lambda end: float(end.fun)).x)

    def _starts(self) -> list[Vector]:
        # kappa |R|_F² / n is the signal-to-noise ratio of a coefficient.
        unit = self.r.size / max(float(np.sum(self.R**2)), 1e-300)
        correlations = (0.3, 0.8, 0.97) if self.kernel == "dc" else (None,)
        return [
            np.array([np.log(scale * unit), _logit(decay), *([] if c is None else [_logit(c)])])
            for scale in _SCALES
            for decay in _DECAYS
            for c in correlations
        ]

    def _parameters(self, x: Vector) -> tuple[float, float, float]:
        kappa = float(np.exp(np.clip(x[0], -200.0, 200.0)))
        decay = float(np.clip(_logistic(x[1]), 1e-6, 1 - 1e-6))
        rho = float(np.clip(_logistic(x[2]), 1e-6, 1 - 1e-6)) if x.size > 2 else 0.0
        return kappa, decay, rho

    def _triangle(self, x: Vector) -> tuple[Matrix, Matrix]:
        kappa, decay, rho = self._parameters(x)
        n = self.r.size
        L = np.sqrt(kappa) * factor(self.kernel, n, decay, rho)
        upper = np.hstack([self.R @ L, self.r[:, None]])
        lower = np.hstack([np.eye(n), np.zeros((n, 1))])
        return L, np.asarray(np.linalg.qr(np.vstack([upper, lower]), mode="r"))

    def _cost(self, x: Vector) -> float:
        _, T = self._triangle(x)
        n = self.r.size
        sse = float(T[n, n] ** 2) + self.rest
        determinant = float(np.sum(np.log(np.abs(np.diag(T)[:n]))))
        return self.M * float(np.log(max(sse, 1e-300))) + 2 * determinant

    def _posterior_at(self, x: Vector) -> Posterior:
        L, T = self._triangle(x)
        n = self.r.size
        sigma2 = (float(T[n, n] ** 2) + self.rest) / self.M
        spread = np.linalg.solve(T[:n, :n].T, L.T).T  # L T^-1
        kappa, decay, rho = self._parameters(x)
        hyperparameters = {"scale": kappa * sigma2, "decay": decay}
        return Posterior(
            g=np.asarray(spread @ T[:n, n]),
            covariance=np.asarray(sigma2 * (spread @ spread.T)),
            noise_variance=sigma2,
            hyperparameters=hyperparameters | ({"correlation": rho} if x.size > 2 else {}),
        )


def _logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


def _logistic(x: float) -> float:
    return float(1 / (1 + np.exp(-np.clip(x, -500.0, 500.0))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirExperiment:
    """Regression of one experiment; its rows are computed in blocks to save memory."""

    windows: Matrix
    """Inputs x(t - k) at all lags k, (N, d), a view; 0 outside the experiment."""
    y: Vector
    """Output (N,) less its projection on `own`; 0 in rows that are not used."""
    used: NDArray[np.bool_]
    """Mask (N,) of rows in which y and all lagged inputs are known."""
    own: Matrix
    """Orthonormal basis of the experiment's level and ramp, (N, k)."""
    shadow: Matrix
    """Coefficients of the projection of the regressors on `own`, (k, d)."""

    def rows(self, part: slice) -> Matrix:
        """Return the rows `part` of Phi; a row that cannot be used is 0."""
        Phi = np.where(self.used[part, None], self.windows[part], 0.0)
        return np.asarray(Phi - self.own[part] @ self.shadow)

    def parts(self) -> list[slice]:
        """Return the slice of each block of rows, from first to last."""
        N = self.y.size
        return [slice(a, min(a + _BLOCK_ROWS, N)) for a in range(0, N, _BLOCK_ROWS)]

    def residuals(self, g: Vector) -> Vector:
        """Return the residuals y - Phi g, (N,); NaN if not known."""
        e = np.full(self.y.size, np.nan)
        for part in self.parts():
            there = self.used[part]
            e[part][there] = (self.y[part] - self.rows(part) @ g)[there]
        return e


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirRegression:
    """Regression y = Phi g + e; level and ramp of each experiment are projected out."""

    experiments: tuple[FirExperiment, ...]
    """Regression of each experiment."""
    nuisance: int
    """Number of levels and ramps projected out."""
    rounding: float
    """Standard deviation of rounding errors, in y's unit."""

    @property
    def N(self) -> int:
        """Number of rows used."""
        return sum(int(np.count_nonzero(x.used)) for x in self.experiments)

    def triangle(self) -> Matrix:
        """Return the triangular factor R (d + 1, d + 1) of [Phi y], from all used rows."""
        blocks = (
            np.column_stack([x.rows(part), x.y[part]])[x.used[part]]
            for x in self.experiments
            for part in x.parts()
        )
        return triangle(blocks, self.experiments[0].windows.shape[1] + 1)

    def residuals(self, g: Vector) -> list[Vector]:
        """Return the residuals y - Phi g of each experiment, (N_i,); NaN if not known."""
        return [x.residuals(g) for x in self.experiments]

    def backwards(self) -> Iterator[Iterator[Matrix]]:
        """Yield each experiment's Phi as blocks of rows, the last block first."""
        for x in self.experiments:
            yield (x.rows(part) for part in reversed(x.parts()))


def regression(data: Dataset, n: int, *, integrator: bool) -> FirRegression:
    """Return the regression of y(t) on u(t - k) for k = 0 … n - 1.

    For an integrating output the regressors are the running sums Ts (u(0) + … + u(t - k)). The
    coefficients g(k) are then the impulse response of the rate, but the noise is still the noise of
    the measured y. Each experiment has a level and a ramp. The ramp is the effect of an input
    offset.
    """
    mean = float(np.mean(data.u))
    experiments = []
    for part in data.experiments():
        x = data.Ts * np.cumsum(part.u - mean) if integrator else part.u - mean
        experiments.append(_experiment(part, x, n, columns=1 + integrator))
    return FirRegression(
        experiments=tuple(experiments),
        nuisance=sum(x.own.shape[1] for x in experiments),
        rounding=rounding_std(data.y),
    )


def _experiment(part: Dataset, x: Vector, n: int, *, columns: int) -> FirExperiment:
    """Return one experiment's regression; level and (if `columns` is 2) ramp are projected out."""
    windows = sliding_window_view(np.append(np.zeros(n - 1), x), n)[:, ::-1]
    used = np.array(part.valid)
    used[: n - 1] = False
    basis = orthonormal(np.vander(np.linspace(-1, 1, part.N), columns)[used]).spread(used)
    y = np.where(used, part.y, 0.0)
    experiment = FirExperiment(
        windows=windows,
        y=basis.without(y),
        used=used,
        own=basis.Q,
        shadow=np.zeros((basis.rank, n)),
    )
    for rows in experiment.parts():
        experiment.shadow[:] += basis.Q[rows].T @ windows[rows]
    return experiment
