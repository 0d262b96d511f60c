"""Covariance and whiteness of a model with several outputs.

The error of an estimate is the sum of H_i(t) e_i(t) over time t and outputs i. H_i (N, d) is the
influence of e_i on the estimate. If e is white with covariance Lambda, the covariance of the
estimate is the sum of Lambda_ij H_i^T H_j. The sandwich form replaces Lambda by the autocovariance
of the residuals, or estimates the covariance of the sum directly from the scores H_i(t) e_i(t).

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from armrig.models.quality import OutputQuality
from armrig.numerics.covariance import correlated_score
from armrig.numerics.criteria import fit_percent
from armrig.numerics.inference import Score
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.whiteness import (
    LJUNG_BOX,
    NOT_TESTED,
    Whiteness,
    autoregression,
    default_lags,
    joined,
    ljung_box,
    portmanteau,
)

_MIN_WHITENED = 30  # least number of errors from which the correlation of outputs is estimated


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutputResiduals:
    """Residuals of one output in one experiment, and their derivatives."""

    e: Array
    """Residuals (N,), NaN where there is none."""
    y: Array
    """Measured output (N,)."""
    H: Array
    """Influence of e on the parameters (N, d); 0 in rows without a residual."""
    Psi: Array
    """Derivatives of the prediction with respect to the parameters of this output, (N, d_i); 0 in
    rows without a residual."""
    Z: Array
    """Responses to the unknown state (N, r)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inference:
    """Uncertainty of the parameters, and quality for each output."""

    covariance: Array
    """Covariance of the parameters, classic form, (d, d)."""
    covariance_robust: Array
    """Covariance of the parameters, sandwich form, (d, d)."""
    noise_covariance: Array
    """Covariance of e (ny, ny)."""
    quality: tuple[OutputQuality, ...]
    """Loss, fit and whiteness of each output."""

    def fields(self) -> dict[str, Any]:
        """Return the fields of this result that a `Fit` also has, by name."""
        names = ("covariance", "covariance_robust", "noise_covariance", "quality")
        return {name: getattr(self, name) for name in names}


def inferred(
    experiments: Sequence[Sequence[OutputResiduals]], *, parameters: Sequence[float], score: Score
) -> Inference:
    """Return covariance, loss and tests of whiteness.

    Parameters
    ----------
    experiments : sequence of sequence of OutputResiduals
        Residuals of each experiment and output.
    parameters : sequence of float
        Number of parameters that were fitted to each output; a parameter shared by k outputs counts
        1/k for each output.
    score : {"exogenous", "correlated"}
        "exogenous" assumes that the influence H is independent of the noise.
    """
    ny = len(parameters)
    by_output = [[of[i] for of in experiments] for i in range(ny)]
    counts = np.array([sum(int(np.isfinite(r.e).sum()) for r in rs) for rs in by_output])
    unknown = [sum(orthonormal(r.Z).rank for r in rs) for rs in by_output]
    degrees = np.maximum(counts - np.array(unknown) - np.asarray(parameters), 1.0)
    Lambda = covariance_of(experiments, counts / degrees)
    classic = np.sum(
        [
            Lambda[i, k] * (of[i].H.T @ of[k].H)
            for of in experiments
            for i in range(ny)
            for k in range(ny)
        ],
        axis=0,
    )
    robust = exogenous_covariance(experiments) if score == "exogenous" else _correlated(experiments)
    robust *= float(np.sum(counts) / np.sum(degrees))
    return Inference(
        covariance=np.asarray(classic),
        covariance_robust=robust,
        noise_covariance=Lambda,
        quality=tuple(_quality(rs, n) for rs, n in zip(by_output, counts.tolist(), strict=True)),
    )


def covariance_of(experiments: Sequence[Sequence[OutputResiduals]], inflation: Array) -> Array:
    """Return the covariance of e; each pair of outputs uses instants at which both are measured."""
    e = np.vstack([np.column_stack([r.e for r in of]) for of in experiments])
    return np.asarray(pairwise_covariance(e) * np.sqrt(np.outer(inflation, inflation)))


def pairwise_covariance(e: Array) -> Array:
    """Return the positive definite covariance of e (N, ny) about 0; a missing value is NaN."""
    known = np.isfinite(e)
    x, mark = np.where(known, e, 0.0), known.astype(np.float64)
    pairs = np.maximum(mark.T @ mark, 1.0)
    found = (x.T @ x) / pairs
    std = np.sqrt(np.diag(found))
    if not (std > 0).all():
        return np.diag(np.maximum(std, 1e-150) ** 2)
    values, axes = np.linalg.eigh(found / np.outer(std, std))
    # The missing samples differ between pairs of outputs, so the estimate can be indefinite.
    inside = (axes * np.maximum(values, 1e-8)) @ axes.T
    return np.asarray(inside * np.outer(std, std))


def exogenous_covariance(experiments: Sequence[Sequence[OutputResiduals]]) -> Array:
    """Return the covariance of the sum of H_i(t) e_i(t) for autoregressive residuals.

    H must not depend on the noise.
    """
    ny = len(experiments[0])
    residuals = [[of[i].e for of in experiments] for i in range(ny)]
    models, variances = zip(*(autoregression(e) for e in residuals), strict=True)
    white = [
        np.column_stack([_filtered(C, of[i].e) for i, C in enumerate(models)]) for of in experiments
    ]
    known = np.isfinite(np.vstack(white))
    if np.min(known.T.astype(int) @ known) < _MIN_WHITENED:
        # Missing samples leave too few errors of the autoregressions.
        white = [np.column_stack([r.e for r in of]) for of in experiments]
    Sigma = pairwise_covariance(np.vstack(white))
    Sigma *= np.sqrt(np.outer(variances, variances) / np.outer(np.diag(Sigma), np.diag(Sigma)))
    total = np.zeros((experiments[0][0].H.shape[1],) * 2)
    for of in experiments:
        back = [
            lfilter([1.0], C, r.H[::-1], axis=0) if C.size > 1 else r.H[::-1]
            for r, C in zip(of, models, strict=True)
        ]
        for i in range(ny):
            for k in range(ny):
                total += Sigma[i, k] * (back[i].T @ back[k])
    return total


def _filtered(C: Array, e: Array) -> Array:
    """Return e filtered by C; a value that depends on a NaN is NaN."""
    return np.asarray(np.convolve(e, C)[: e.size])


def _correlated(experiments: Sequence[Sequence[OutputResiduals]]) -> Array:
    """Return the covariance in sandwich form, by the method of Newey and West."""
    scores = [np.sum([r.H * np.nan_to_num(r.e)[:, None] for r in of], axis=0) for of in experiments]
    return correlated_score(scores, [np.ones(s.shape[0]) for s in scores])


def _quality(parts: Sequence[OutputResiduals], N: int) -> OutputQuality:
    """Return loss, fit and whiteness of one output."""
    e = np.concatenate([r.e for r in parts])
    y = np.concatenate([r.y for r in parts])
    known = np.isfinite(e)
    sse = float(np.sum(e[known] ** 2))
    spans = [orthonormal(r.Z) for r in parts]
    blocks = [span.without(r.Psi) for r, span in zip(parts, spans, strict=True)]
    exact = sse <= 1e-18 * float(np.sum(y[known] ** 2))
    lags = default_lags(N)
    white = portmanteau([r.e for r in parts], blocks, [s.Q for s in spans], lags)
    return OutputQuality(
        loss=sse / max(N, 1),
        N=N,
        fit_percent=fit_percent(y[known], sse),
        white=NOT_TESTED if exact else white,
    )


def quality_of(residuals: Sequence[Array], y: Sequence[Array], parameters: float) -> OutputQuality:
    """Return loss, fit and whiteness (Ljung-Box test) of one output, from its residuals alone.

    Parameters
    ----------
    residuals : sequence of ndarray (N_i,)
        Residuals of each experiment, NaN where there is none.
    y : sequence of ndarray (N_i,)
        Measured output of each experiment.
    parameters : float
        Number of noise parameters that were fitted.
    """
    e, whole = np.concatenate(residuals), np.concatenate(y)
    known = np.isfinite(e)
    N, sse = int(known.sum()), float(np.sum(e[known] ** 2))
    lags = default_lags(N)
    p = ljung_box(joined(residuals, lags), lags, min(round(parameters), lags - 1))
    return OutputQuality(
        loss=sse / max(N, 1),
        N=N,
        fit_percent=fit_percent(whole[known], sse),
        white=Whiteness(p_value=p, test=LJUNG_BOX),
    )
