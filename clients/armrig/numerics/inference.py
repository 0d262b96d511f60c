"""From residuals and their sensitivity to covariance, loss and verdict, the same for all estimates.

Whatever theta was fitted by least squares, with Psi the sensitivity of the prediction to it, Q its
orthonormal basis, W W^T = (Psi^T Psi)^-1 and M the covariance of the score Psi^T e ::

    covariance         lambda W W^T            right where e is white
    covariance_robust  W (Q^T R Q) W^T         also right where it is coloured

The second is W W^T M W W^T with the covariance R of e, as Psi = Q R_Psi and M = Psi^T R Psi.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.numerics.covariance import correlated_score, exogenous_score
from armrig.numerics.criteria import fit_percent
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.whiteness import (
    LJUNG_BOX,
    NOT_TESTED,
    Whiteness,
    default_lags,
    joined,
    ljung_box,
    portmanteau,
)

Score = Literal["exogenous", "correlated"]
Test = Literal["portmanteau", "ljung-box"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inference:
    """What the residuals tell of d parameters that were fitted to them."""

    covariance: Array
    """Of the parameters, the classic form, (d, d)."""
    covariance_robust: Array
    """Of the parameters, the sandwich form, (d, d)."""
    noise_variance: float
    """Of the residuals, with the degrees of freedom subtracted."""
    loss: float
    """Mean squared residual."""
    N: int
    """Number of residuals."""
    fit_percent: float
    """100 (1 - |e| / |y - mean y|); NaN where y is not known."""
    white: Whiteness
    """Test of white residuals; not made where it was not asked for, or there is no noise."""
    basis: Basis
    """Of the columns of Psi, all experiments below each other."""

    def transformed(self, J: Array) -> Inference:
        """Return the same for parameters whose derivatives by these are J."""
        return replace(
            self,
            covariance=J @ self.covariance @ J.T,
            covariance_robust=J @ self.covariance_robust @ J.T,
        )


def infer(
    residuals: Sequence[Array],
    blocks: Sequence[Array],
    *,
    score: Score,
    spans: Sequence[Array] | None = None,
    nuisance: int = 0,
    y: Array | None = None,
    basis: Basis | None = None,
    test: Test | None = "portmanteau",
    rounding: float = 0.0,
    prewhitening: int = 0,
) -> Inference:
    """Return what the residuals of all experiments tell of the parameters.

    Parameters
    ----------
    residuals : sequence of ndarray (N_i,)
        Of each experiment, NaN where they are not known.
    blocks : sequence of ndarray (N_i, d)
        Psi of each experiment, sensitivity of the prediction less its projection on what else was
        estimated; zero in the rows without a residual.
    score : {"exogenous", "correlated"}
        How M is estimated: for a Psi that does not depend on the noise, or for one that may.
    spans : sequence of ndarray (N_i, r_i), optional
        Orthonormal basis of what else was estimated in each experiment; zero in the same rows.
    nuisance : int, default 0
        Number of parameters projected out that `spans` do not hold.
    y : ndarray (sum of N_i,), optional
        What was to be explained.
    basis : Basis, optional
        Of the columns of all blocks, where it is known.
    test : {"portmanteau", "ljung-box"}, optional
        Of whiteness: with the fitted parameters allowed for, or for residuals that theta was not
        fitted to; None for no test.
    rounding : float, default 0.0
        Sum of squared residuals up to which they are rounding noise, which no test is for.
    prewhitening : int, default 0
        Order of the autoregression that these residuals were filtered by and which was fitted to
        them; the Ljung-Box test has so many degrees of freedom less.

    Raises
    ------
    ValueError
        There are no more residuals than parameters.
    """
    N = sum(int(np.count_nonzero(np.isfinite(e))) for e in residuals)
    spans = [np.zeros((e.size, 0)) for e in residuals] if spans is None else spans
    d = blocks[0].shape[1]
    others = nuisance + sum(span.shape[1] for span in spans)
    degrees = N - d - others
    if degrees < 1:
        raise InputError(
            f"{N} samples leave nothing to estimate the noise from: {d} parameters and {others} "
            "initial conditions were fitted to them; lower the orders, or record longer"
        )
    sse = sum(float(np.nansum(e**2)) for e in residuals)
    if basis is None:
        basis = orthonormal(blocks[0] if len(blocks) == 1 else np.vstack(blocks))
    bread = basis.W @ basis.W.T
    # Through Q, not Psi: where columns are nearly alike, bread times M times bread would round to
    # variances below 0.
    edges = np.cumsum([e.size for e in residuals])[:-1]
    middle = _middle(score, residuals, np.split(basis.Q, edges)) * N / degrees
    tested = test if sse > rounding else None
    return Inference(
        covariance=sse / degrees * bread,
        covariance_robust=basis.W @ middle @ basis.W.T,
        noise_variance=sse / degrees,
        loss=sse / N,
        N=N,
        fit_percent=_explained(y, residuals, sse),
        white=_whiteness(tested, residuals, blocks, spans, basis, prewhitening),
        basis=basis,
    )


def _middle(score: Score, residuals: Sequence[Array], blocks: Sequence[Array]) -> Array:
    """Return M, the covariance of Psi^T e."""
    estimate = exogenous_score if score == "exogenous" else correlated_score
    return estimate(blocks, residuals)


def _explained(y: Array | None, residuals: Sequence[Array], sse: float) -> float:
    if y is None:
        return float("nan")
    return fit_percent(y[np.isfinite(np.concatenate(residuals))], sse)


def _whiteness(
    test: Test | None,
    residuals: Sequence[Array],
    blocks: Sequence[Array],
    spans: Sequence[Array],
    basis: Basis,
    prewhitening: int,
) -> Whiteness:
    if test is None:
        return NOT_TESTED
    lags = default_lags(sum(int(np.count_nonzero(np.isfinite(e))) for e in residuals))
    if test == "ljung-box":
        p = ljung_box(joined(residuals, lags), lags, min(prewhitening, lags - 1))
        return Whiteness(p_value=p, test=LJUNG_BOX)
    return portmanteau(residuals, blocks, spans, lags, Q=basis.Q)
