"""Covariance, loss and test of whiteness, from residuals and derivatives, for all estimators.

The parameters theta were fitted by least squares. Psi contains the derivatives of the prediction
with respect to theta, and Q is the orthonormal basis of the columns of Psi. W W^T is
(Psi^T Psi)^-1, and M is the covariance of the score Psi^T e. Then ::

    covariance         lambda W W^T         valid if e is white
    covariance_robust  W (Q^T R Q) W^T      valid also if e is coloured

R is the covariance of e. The robust form equals W W^T M W W^T, since M = Psi^T R Psi and Psi W = Q.

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
    """Uncertainty of d fitted parameters, and the quality of the fit."""

    covariance: Array
    """Covariance of the parameters, classic form, (d, d)."""
    covariance_robust: Array
    """Covariance of the parameters, sandwich form, (d, d)."""
    noise_variance: float
    """Variance of the noise: sum of squared residuals divided by its degrees of freedom."""
    loss: float
    """Mean squared residual."""
    N: int
    """Number of residuals."""
    fit_percent: float
    """100 (1 - |e| / |y - mean y|); NaN if y is not known."""
    white: Whiteness
    """Result of the whiteness test; `NOT_TESTED` if no test was requested or possible."""
    basis: Basis
    """Basis of the columns of Psi, all experiments stacked."""

    def quality(self) -> dict[str, Any]:
        """Return covariances, loss and whiteness test by the field names of a `Fit`."""
        names = ("covariance", "covariance_robust", "noise_variance", "loss", "N", "fit_percent")
        white = {"whiteness": self.white.p_value, "whiteness_test": self.white.test}
        return {name: getattr(self, name) for name in names} | white

    def transformed(self, J: Array) -> Inference:
        """Return the inference for the parameters J theta, with a given matrix J."""
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
    """Return covariance, loss and test of whiteness from the residuals of all experiments.

    Parameters
    ----------
    residuals : sequence of ndarray (N_i,)
        Residuals of each experiment, NaN if they are not known.
    blocks : sequence of ndarray (N_i, d)
        Psi of each experiment: the derivatives of the prediction with respect to theta. The
        projection of these derivatives on the nuisance responses is subtracted. Psi is zero in the
        rows without a residual.
    score : {"exogenous", "correlated"}
        Estimate of M. "exogenous" assumes that Psi is independent of the noise. With "correlated",
        Psi may depend on the noise.
    spans : sequence of ndarray (N_i, r_i), optional
        Orthonormal basis of the responses of the nuisance parameters in each experiment; zero in
        the rows without a residual.
    nuisance : int, default 0
        Number of further nuisance parameters, whose responses are not contained in `spans`.
    y : ndarray (sum of N_i,), optional
        Measured output, for `fit_percent`.
    basis : Basis, optional
        Basis of the columns of all blocks, if it is known.
    test : {"portmanteau", "ljung-box"}, optional
        Test of whiteness. "portmanteau" allows for the fitted parameters. "ljung-box" is for
        residuals to which theta was not fitted. With None there is no test.
    rounding : float, default 0.0
        If the sum of squared residuals is at most this number, the residuals are rounding errors
        and are not tested.
    prewhitening : int, default 0
        Order of the autoregression that was fitted to the residuals to prewhiten them. This order
        is subtracted from the degrees of freedom of the Ljung-Box test.

    Raises
    ------
    ValueError
        The number of residuals does not exceed the number of parameters.
    """
    N = sum(int(np.count_nonzero(np.isfinite(e))) for e in residuals)
    spans = [np.zeros((e.size, 0)) for e in residuals] if spans is None else spans
    d = blocks[0].shape[1]
    others = nuisance + sum(span.shape[1] for span in spans)
    degrees = N - d - others
    if degrees < 1:
        raise InputError(
            f"{N} samples are too few to estimate the noise: {d} parameters and {others} initial "
            "conditions are fitted to them; lower the orders, or record longer"
        )
    sse = sum(float(np.nansum(e**2)) for e in residuals)
    if basis is None:
        basis = orthonormal(blocks[0] if len(blocks) == 1 else np.vstack(blocks))
    bread = basis.W @ basis.W.T
    # Q instead of Psi: if columns are nearly equal, rounding can make variances in W W^T M W W^T
    # negative.
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
    """Return the covariance of X^T e for the stacked `blocks` X."""
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
