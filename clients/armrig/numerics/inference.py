"""Covariance, loss and test of whiteness, from residuals and derivatives, for all estimators.

The error of an estimate is W times the sum of H_i(t) e_i(t) over time t and outputs i. H_i (N, r)
is the influence of e_i on the estimate. If e is white with covariance Lambda, then ::

    covariance         W [sum over i, k of Lambda_ik H_i^T H_k] W^T     valid if e is white
    covariance_robust  W M W^T                                          valid also if e is coloured

M is the covariance of the sum of H_i(t) e_i(t). If one output is fitted by least squares, H is the
orthonormal basis Q of the derivatives Psi of the prediction. W W^T is then (Psi^T Psi)^-1, and the
covariance is lambda W W^T.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.numerics.covariance import (
    joint_exogenous_score,
    newey_west_score,
    pairwise_covariance,
)
from armrig.numerics.criteria import fit_percent, mdl
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import plural
from armrig.numerics.rounding import rounding_std
from armrig.numerics.whiteness import (
    LJUNG_BOX,
    NOT_TESTED,
    Whiteness,
    autoregression,
    default_lags,
    join_residuals,
    ljung_box,
    portmanteau,
)

Score = Literal["exogenous", "correlated"]
Test = Literal["portmanteau", "ljung-box"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutputResiduals:
    """Residuals of one output in one experiment, and their derivatives."""

    e: Array
    """Residuals (N,), NaN where there is none."""
    H: Array
    """Influence of e on the estimate (N, r); 0 in rows without a residual."""
    Psi: Array | None = None
    """Derivatives of the prediction with respect to the parameters of this output, (N, d_i); 0 in
    rows without a residual. Their projection on Z is subtracted. None if H is an orthonormal basis
    of the derivatives."""
    Z: Array | None = None
    """Orthonormal basis of the responses to the unknown state (N, q); 0 in rows without a residual.
    None if there is no unknown state."""
    y: Array | None = None
    """Measured output (N,); None if it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutputQuality:
    """Quality of a model for one output, one step ahead, on the estimation data."""

    loss: float
    """Mean squared error, in the squared unit of the output."""
    N: int
    """Number of errors in the loss."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|); NaN if y is not known."""
    white: Whiteness
    """Result of the whiteness test of the errors; `NOT_TESTED` if no test was requested or
    possible."""
    autoregression: tuple[float, ...] = ()
    """Coefficients of C, with C(q) e = white noise; empty if they are not known."""
    innovation_variance: float = float("nan")
    """Variance of C(q) e."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inference:
    """Uncertainty of d parameters, and the quality of the fit for each of ny outputs."""

    covariance: Array
    """Covariance of the parameters, classic form, (d, d)."""
    covariance_robust: Array
    """Covariance of the parameters, sandwich form, (d, d)."""
    noise_covariance: Array
    """Covariance of e (ny, ny): sums of products divided by their degrees of freedom."""
    quality: tuple[OutputQuality, ...]
    """Loss, fit and whiteness of each output."""

    @property
    def noise_variance(self) -> float:
        """Variance of the noise of the first output."""
        return float(self.noise_covariance[0, 0])

    def fields(self) -> dict[str, Any]:
        """Return the fields of this result by name."""
        names = ("covariance", "covariance_robust", "noise_covariance", "quality")
        return {name: getattr(self, name) for name in names}

    def transformed(self, J: Array) -> Inference:
        """Return the inference for the parameters J theta, with a given matrix J."""
        return replace(
            self,
            covariance=J @ self.covariance @ J.T,
            covariance_robust=J @ self.covariance_robust @ J.T,
        )


def infer(
    experiments: Sequence[Sequence[OutputResiduals]],
    W: Array,
    *,
    score: Score,
    parameters: Sequence[float] | None = None,
    test: Test | None = "portmanteau",
    rounding: float = 0.0,
    prewhitening: float = 0,
) -> Inference:
    """Return covariance, loss and tests of whiteness from the residuals of all experiments.

    Raises ValueError if the number of residuals of an output does not exceed the number of its
    parameters.

    Parameters
    ----------
    experiments, W
        Residuals of each experiment and output, and the matrix W (d, r).
    score : {"exogenous", "correlated"}
        Estimate of M. "exogenous" assumes that H is independent of the noise. With "correlated", H
        may depend on the noise.
    parameters : sequence of float, optional
        Number of parameters that were fitted to each output. A parameter that k outputs share
        counts 1/k for each of them. By default each output has the same number, d/ny.
    test : {"portmanteau", "ljung-box"}, optional
        Test of whiteness. "portmanteau" allows for the fitted parameters. "ljung-box" is for
        residuals to which the parameters were not fitted. With None there is no test.
    rounding : float, default 0.0
        If the sum of squared residuals is at most this number, they are not tested.
    prewhitening : float, default 0
        Number of noise parameters that were fitted to the residuals, such as the order of an
        autoregression. It is subtracted from the degrees of freedom of the Ljung-Box test.
    """
    outputs = list(zip(*experiments, strict=True))
    ny = len(outputs)
    parameters = [W.shape[0] / ny] * ny if parameters is None else parameters
    counts = np.array(
        [sum(int(np.count_nonzero(np.isfinite(r.e))) for r in parts) for parts in outputs]
    )
    degrees = np.array(
        [
            _degrees(parts, N, d)
            for parts, N, d in zip(outputs, counts.tolist(), parameters, strict=True)
        ]
    )
    # For tests on other data by MDL: in short data AIC often finds an autoregression in white
    # residuals, whose variance is too small.
    sizes = [_rounding(parts) for parts in outputs]
    consistent = [
        autoregression([r.e for r in parts], mdl, size)
        for parts, size in zip(outputs, sizes, strict=True)
    ]
    quality = tuple(
        replace(
            quality_of(parts, test=test, rounding=rounding, prewhitening=prewhitening),
            autoregression=tuple(C.tolist()),
            innovation_variance=s2,
        )
        for parts, (C, s2) in zip(outputs, consistent, strict=True)
    )
    inflation = counts / degrees
    if ny == 1:
        Lambda = np.array([[quality[0].loss]]) * inflation
    else:
        e = np.vstack([np.column_stack([r.e for r in experiment]) for experiment in experiments])
        Lambda = pairwise_covariance(e) * np.sqrt(np.outer(inflation, inflation))
    exact = [q.loss <= size**2 for q, size in zip(quality, sizes, strict=True)]
    Lambda = Lambda + np.diag(np.where(exact, np.square(sizes), 0.0))
    if all(exact):
        M = _white_score(experiments, Lambda)
    else:
        M = _score(experiments, score) * float(np.sum(counts) / np.sum(degrees))
    return Inference(
        covariance=W @ _white_score(experiments, Lambda) @ W.T,
        covariance_robust=W @ M @ W.T,
        noise_covariance=Lambda,
        quality=quality,
    )


def _rounding(parts: Sequence[OutputResiduals]) -> float:
    """Return the standard deviation of rounding errors of one output; 0 if y is not known."""
    measured = [r.y for r in parts if r.y is not None]
    return rounding_std(*measured) if measured else 0.0


def _degrees(parts: Sequence[OutputResiduals], N: int, parameters: float) -> float:
    unknown = sum(r.Z.shape[1] for r in parts if r.Z is not None)
    if N - unknown - parameters < 1:
        raise InputError(
            f"{plural(N, 'sample is', 'samples are')} too few to estimate the noise: "
            f"{parameters:g} parameters and "
            f"{unknown} initial conditions are fitted to them; lower the orders, or record longer"
        )
    return float(N - unknown - parameters)


def _white_score(experiments: Sequence[Sequence[OutputResiduals]], Lambda: Array) -> Array:
    """Return the covariance of the sum of H_i(t) e_i(t) for white e with covariance Lambda."""
    if len(Lambda) == 1 and experiments[0][0].Psi is None:
        return np.asarray(Lambda[0, 0] * np.eye(experiments[0][0].H.shape[1]))
    pairs = (
        ((i, k), experiment[i].H.T @ experiment[k].H)
        for experiment in experiments
        for i, k in np.ndindex(Lambda.shape)
    )
    return np.asarray(sum(Lambda[pair] * product for pair, product in pairs))


def _score(experiments: Sequence[Sequence[OutputResiduals]], score: Score) -> Array:
    """Return M, the covariance of the sum of H_i(t) e_i(t)."""
    H, e = (
        [[r.H for r in experiment] for experiment in experiments],
        [[r.e for r in experiment] for experiment in experiments],
    )
    if score == "exogenous":
        return joint_exogenous_score(
            H, e, [autoregression([*errors]) for errors in zip(*e, strict=True)]
        )
    if len(experiments[0]) == 1:
        return newey_west_score([h for (h,) in H], [v for (v,) in e])
    scores = [
        np.sum([r.H * np.nan_to_num(r.e)[:, None] for r in experiment], axis=0)
        for experiment in experiments
    ]
    return newey_west_score(scores, [np.ones(s.shape[0]) for s in scores])


def quality_of(
    parts: Sequence[OutputResiduals],
    *,
    test: Test | None = "portmanteau",
    rounding: float = 0.0,
    prewhitening: float = 0,
) -> OutputQuality:
    """Return loss, fit and whiteness of one output; the arguments are those of `infer`."""
    e = np.concatenate([r.e for r in parts])
    finite = np.isfinite(e)
    N, sse, fit = int(np.count_nonzero(finite)), float(np.nansum(e**2)), float("nan")
    measured = [r.y for r in parts if r.y is not None]
    if measured:
        y = np.concatenate(measured)[finite]
        fit, rounding = fit_percent(y, sse), max(rounding, N * _rounding(parts) ** 2)
    white = NOT_TESTED
    lags = default_lags(N)
    if test == "ljung-box" and sse > rounding:
        fitted = min(round(prewhitening), lags - 1)
        p = ljung_box(join_residuals([r.e for r in parts], lags), lags, fitted)
        white = Whiteness(p_value=p, test=LJUNG_BOX)
    elif test == "portmanteau" and sse > rounding:
        Q = np.vstack([r.H for r in parts]) if parts[0].Psi is None else None
        white = portmanteau(
            [r.e for r in parts],
            [r.H if r.Psi is None else r.Psi for r in parts],
            [np.zeros((r.e.size, 0)) if r.Z is None else r.Z for r in parts],
            lags,
            Q=Q,
        )
    return OutputQuality(loss=sse / max(N, 1), N=N, fit_percent=fit, white=white)
