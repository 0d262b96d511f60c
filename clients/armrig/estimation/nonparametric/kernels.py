"""Priors of an impulse response that dies out, and how likely each makes the data.

A kernel is the covariance P(lambda, rho) of g(0) … g(n-1) up to a scale; its factor L has
L L^T = P.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]
Kernel = Literal["tc", "dc", "ss"]

KERNELS = ("tc", "dc", "ss")
_DECAYS = (0.5, 0.7, 0.85, 0.93, 0.98)
_SCALES = (1e-2, 1.0, 1e2, 1e4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posterior:
    """g given the data, for the hyperparameters that make the data likeliest."""

    g: Vector
    """Posterior mean, (n,)."""
    covariance: Matrix
    """Posterior covariance, (n, n)."""
    noise_variance: float
    """Estimate of sigma², of y's unit squared."""
    hyperparameters: dict[str, float]
    """scale (of P, in g's unit squared), decay lambda, and for "dc" the correlation rho."""


def factor(kernel: Kernel, n: int, decay: float, correlation: float = 0.0) -> Matrix:
    """Return L (n, n) with L L^T = P, where for i, j = 1 … n the kernel P(i, j) is as follows.

    ::

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
        # By eigenvalues: P is singular to rounding, and Cholesky would need a jitter.
        value, vector = np.linalg.eigh(P)
        return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))
    # TC is DC with rho = sqrt(lambda); an AR(1) process has this factor in closed form.
    rho = np.sqrt(decay) if kernel == "tc" else correlation
    apart = np.subtract.outer(i, i)
    ar = np.where(apart >= 0, rho ** np.maximum(apart, 0), 0.0)
    ar[:, 1:] *= np.sqrt(1 - rho**2)
    return np.asarray(decay ** (i / 2)[:, None] * ar)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """The marginal likelihood of M samples y = Phi g + e, reduced once to a triangle.

    With [Phi y] = Q [[R, r], [0, s]], e white of variance sigma² and g of covariance
    kappa sigma² L L^T, one QR of [[R L sqrt(kappa), r], [I, 0]] gives [[T, t], [0, d]] and ::

        -2 log p(y) = M log(sigma²) + 2 log|det T| + (d² + s²)/sigma²

    least for sigma² = (d² + s²)/M. N samples are met once, n lags at each trial.

    References
    ----------
    .. [1] T. Chen, L. Ljung, Automatica 49 (2013) 2213-2220.
    """

    kernel: Kernel
    R: Matrix
    """(n, n), upper triangular."""
    r: Vector
    """(n,)."""
    rest: float
    """s², what no g explains."""
    M: int
    """Samples less the nuisance parameters."""

    def posterior(self) -> Posterior:
        """Return the posterior for the likeliest hyperparameters."""
        return self._given(self.likeliest())

    def likeliest(self) -> Vector:
        """Return log kappa and the logits of lambda and rho that maximise the likelihood."""
        from scipy.optimize import minimize

        starts = sorted(self._starts(), key=self._cost)[:1]
        if self.kernel == "dc":  # TC is one of its cases, and easier found
            x = replace(self, kernel="tc").likeliest()
            starts.append(np.append(x, _logit(np.sqrt(self._parameters(x)[1]))))
        options = {"xatol": 1e-2, "fatol": 1e-3, "maxiter": 400}
        ends = [
            minimize(self._cost, start, method="Nelder-Mead", options=options) for start in starts
        ]
        return np.asarray(min(ends, key=lambda end: float(end.fun)).x)

    def _starts(self) -> list[Vector]:
        # kappa |R|_F² / n is the ratio of signal to noise of a coefficient.
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

    def _given(self, x: Vector) -> Posterior:
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
