"""Tests of a model by its residuals: are they white, and free of the input."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import NDArray

from armrig.data.argument import HasDataset, as_dataset
from armrig.data.dataset import Dataset
from armrig.models.estimate import Estimate
from armrig.models.prediction import Residuals, prediction_errors, require_same_signals
from armrig.numerics.covariance import exogenous_score
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.quantile import joint_p_value
from armrig.numerics.quantities import p_relation
from armrig.numerics.whiteness import (
    WHITE_LEVEL,
    Whiteness,
    autocovariance,
    default_lags,
    joined,
    ljung_box,
    portmanteau,
)
from armrig.validation.residual_figure import BAND_99_PERCENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]

MOST_ALLOWED = 10.0
"""Widening of the bands by the parameters' deviations beyond which a test has no power."""
_COLUMNS = 8  # of the lagged inputs that are worked on at once


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ResidualTest:
    """Correlation of the residuals with themselves and with the input."""

    e: Vector
    """Residuals one step ahead, (N,), NaN where they are not known."""
    lags: NDArray[np.int_]
    """0 … L."""
    autocorrelation: Vector
    """r_e at `lags`, 1 at lag 0."""
    autocorrelation_band: float
    """99 % band of each lag but 0 for white residuals, 2.58/sqrt(N)."""
    whiteness: float
    """p value of white residuals over all lags, of the test that decides."""
    whiteness_test: str
    """Name of the test that decides: the portmanteau test, or Ljung-Box where that cannot."""
    ljung_box: float
    """p value of the Ljung-Box test, for comparison with other programs."""
    cross_lags: NDArray[np.int_]
    """-L … L; at a positive lag the input came first."""
    cross_correlation: Vector
    """Correlation of e(t) with u(t - lag) at `cross_lags`."""
    cross_band: float
    """99 % band of each lag for a known model, 2.58 sqrt(P / (N R_e(0) R_u(0)))."""
    cross_std: Vector
    """Standard deviation at each of `cross_lags` with the estimated parameters allowed for."""
    missing_dynamics: float
    """p value of no correlation with past and present input, lags 0 … L."""
    feedback: float
    """p value of no correlation with future input, lags -L … -1."""
    on_estimation_data: bool
    """The tests allow for parameters fitted to these very data."""
    source: str
    """Where the data come from."""

    @property
    def white(self) -> Whiteness:
        """The test of white residuals; its str says what came out."""
        return Whiteness(p_value=self.whiteness, test=self.whiteness_test)

    @property
    def allowance(self) -> float:
        """How many times the parameters' deviations widen the band of the cross-correlation."""
        known = self.cross_band / BAND_99_PERCENT
        return float(np.median(self.cross_std)) / known if known > 0 else float("nan")

    @property
    def powerless(self) -> str:
        """Why nothing could be found, and what would help; "" where the tests have power.

        A test on other data allows for the parameters' deviations. Where those are huge, as of a
        pole that was estimated within rounding of 1, any residuals pass.
        """
        if self.on_estimation_data or not self.allowance > MOST_ALLOWED:
            return ""
        return (
            f"the model's own deviations allow correlations {self.allowance:.0f} times as large as "
            "a known model's, so these tests find nothing. Estimate with integrator=True if a pole "
            "is near 1, or with lower orders, or from more data"
        )

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of both correlations: see `armrig.plots.plot_residuals`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.residual_figure import plot_residual_test

        return figure_of(plot_residual_test(self, ax=ax))

    def __repr__(self) -> str:
        """Say it in a few lines."""
        if self.powerless:
            p_values = (self.whiteness, self.missing_dynamics, self.feedback)
            if not any(p < WHITE_LEVEL for p in p_values):
                return f"residuals on validation data: no test has power: {self.powerless}"
        where = "estimation" if self.on_estimation_data else "validation"
        look = ": look at the noise model or order" if self.white.coloured else ""
        verdicts = (
            ("no dynamics missing", "dynamics missing", self.missing_dynamics, "orders or delay"),
            ("no feedback", "feedback, or a delay too large", self.feedback, "experiment"),
        )
        lines = [
            f"residuals on {where} data, {np.count_nonzero(np.isfinite(self.e))} samples",
            f"  {self.white}{look}",
        ]
        for good, bad, p, where_to_look in verdicts:
            said = f"{bad} (p {p_relation(p)}): look at the {where_to_look}"
            if not p < WHITE_LEVEL:
                said = f"{good} (p {p_relation(p)})" if p >= 0 else f"{good}: too few to test"
            lines.append(f"  {said}")
        return "\n".join(lines)


def residuals(fit: Estimate, data: Dataset | HasDataset, lags: int | None = None) -> ResidualTest:
    """Test whether the one-step residuals are white and free of the input.

    Whiteness: the portmanteau test that allows for the estimated parameters, or Ljung-Box's where
    that cannot be trusted (see `armrig.numerics.whiteness`). Beside it stands the Ljung-Box test
    of other programs, its degrees of freedom lessened by na + nc + nd where these are the data
    that A, C and D were fitted to. Input: the sums s_k = sum of e(t) u(t - k) are tested jointly,
    s^T M^-1 s against chi-squared, with ::

        M = Z_p^T R_e Z_p                                        on estimation data
        M = Z^T R_e Z + (Z^T Psi) cov(theta) (Psi^T Z)           on other data

    where Z holds the lagged inputs, R_e is the residuals' covariance (autoregressive estimate),
    Psi the sensitivity of the prediction, and Z_p is Z less its projection on Psi: estimated
    parameters make residuals less correlated with the past input than noise is.

    The band for a single lag has the variance P/(N R_e(0) R_u(0)), P = sum of R_e(k) R_u(k), which
    is 1/N only where e or u is white. It holds for a known model; `cross_std`, from the diagonal
    of M, is narrower at some lags of estimation data and wider on other data.

    Parameters
    ----------
    fit : Fit
        Estimated, of the output that the data show.
    data : Dataset
        N samples; or a recording.
    lags : int, optional
        L, from 1 to half of the residuals; 25 by default, fewer for short data.

    Returns
    -------
    ResidualTest
        Residuals (N,) in y's unit, correlations (without unit) with bands, and p values.

    Raises
    ------
    ValueError
        The model has another output, unit or sampling time, or L is not possible.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.6.
    .. [2] T. Söderström, P. Stoica, *System Identification*, 1989, section 11.2.
    """
    if not hasattr(fit, "noise_variance"):
        raise InputTypeError(
            f"the model stands first, and a {type(fit).__name__} came: residuals(fit, data)"
        )
    data = as_dataset(data)
    require_same_signals(fit, data)
    known = [prediction_errors(fit, part) for part in data.experiments()]
    N = sum(int(np.count_nonzero(np.isfinite(r.e))) for r in known)
    L = _possible(default_lags(N) if lags is None else lags, N)
    own = fit.estimated_from(data)
    e = joined([r.e for r in known], L)
    R, _ = autocovariance(e, L)
    theta_covariance = _free_covariance(fit)
    input_ = _input_sums(data, known, theta_covariance, L, own=own)
    scale = sqrt(input_.power * R[0] * N) if input_.power > 0 and R[0] > 0 else np.inf
    past, future = slice(L, 2 * L + 1), slice(0, L)
    white = portmanteau(
        [r.e for r in known],
        [r.Psi for r in known],
        [r.unknown.span for r in known],
        L,
        None if own else theta_covariance,
    )
    return ResidualTest(
        e=np.concatenate([r.e for r in known]),
        lags=np.arange(L + 1),
        autocorrelation=R / R[0] if R[0] > 0 else np.full(L + 1, np.nan),
        autocorrelation_band=BAND_99_PERCENT / sqrt(max(N, 1)),
        whiteness=white.p_value,
        whiteness_test=white.test,
        ljung_box=ljung_box(e, L, _noise_parameters(fit) if own else 0),
        cross_lags=np.arange(-L, L + 1),
        cross_correlation=input_.sums / scale,
        cross_band=BAND_99_PERCENT * sqrt(input_.variance) / scale,
        cross_std=np.sqrt(np.maximum(np.diag(input_.covariance), 0.0)) / scale,
        missing_dynamics=joint_p_value(input_.sums[past], input_.covariance[past, past]),
        feedback=joint_p_value(input_.sums[future], input_.covariance[future, future]),
        on_estimation_data=own,
        source=data.source,
    )


def _possible(L: int, N: int) -> int:
    """Return the number of lags, or refuse one that N residuals do not allow."""
    longest = max(N // 2, 1)
    if not 1 <= L <= longest:
        raise InputError(f"lags={L} must be 1 to {longest}, half of the {N} residuals")
    return L


@dataclass(frozen=True, slots=True, kw_only=True)
class _InputSums:
    """The sums s_k of e(t) u(t - k), k = -L … L, and how sure they are."""

    sums: Array
    """(2 L + 1,)."""
    covariance: Array
    """M, (2 L + 1, 2 L + 1)."""
    power: float
    """Sum of u(t)²."""
    variance: float
    """Of one sum for a known model, N P."""


def _input_sums(
    data: Dataset, known: list[Residuals], theta_covariance: Array, L: int, *, own: bool
) -> _InputSums:
    mean = np.mean(data.u)
    Z = [
        _lagged_both_ways(part.u - mean, L, r)
        for part, r in zip(data.experiments(), known, strict=True)
    ]
    e = [r.e for r in known]
    u = [z[:, L : L + 1] for z in Z]
    return _InputSums(
        sums=sum((z.T @ np.nan_to_num(x) for z, x in zip(Z, e, strict=True)), np.zeros(2 * L + 1)),
        power=float(sum(np.sum(z**2) for z in u)),
        variance=float(exogenous_score(u, e)[0, 0]),
        covariance=_score_covariance(Z, known, theta_covariance, own=own),  # spends Z: last
    )


def _lagged_both_ways(u: Vector, L: int, known: Residuals) -> Array:
    """Return u(t - k), k = -L … L, (N, 2 L + 1), zero in the rows without a residual.

    The free response is projected out: it was fitted to these residuals, on any data.
    """
    Z = np.zeros((u.size, 2 * L + 1), order="F")
    there = np.isfinite(known.e)
    for columns in _few(2 * L + 1):
        for j in range(columns.start, columns.stop):
            later, earlier = max(j - L, 0), max(L - j, 0)
            n = max(u.size - later - earlier, 0)
            Z[later : later + n, j] = u[earlier : earlier + n]
        Z[~there, columns] = 0.0
        Z[:, columns] = known.unknown.without(Z[:, columns])
    return Z


def _few(columns: int) -> list[slice]:
    """Return groups of columns: what is copied of a long matrix is then small."""
    return [slice(a, min(a + _COLUMNS, columns)) for a in range(0, columns, _COLUMNS)]


def _score_covariance(
    Z: list[Array], known: list[Residuals], theta_covariance: Array, *, own: bool
) -> Array:
    """Return M, and on estimation data leave in Z what Psi does not explain."""
    e = [r.e for r in known]
    if not own:
        pairs = zip(Z, known, strict=True)
        none = np.zeros((Z[0].shape[1], theta_covariance.shape[0]))
        slope = sum((z.T @ r.Psi for z, r in pairs), none)
        return np.asarray(exogenous_score(Z, e) + slope @ theta_covariance @ slope.T)
    Q = orthonormal(np.vstack([r.Psi for r in known])).Q
    parts = list(zip(Z, np.split(Q, np.cumsum([z.shape[0] for z in Z])[:-1]), strict=True))
    shadow = sum((q.T @ z for z, q in parts), np.zeros((Q.shape[1], Z[0].shape[1])))
    for z, q in parts:
        for columns in _few(z.shape[1]):
            z[:, columns] -= q @ shadow[:, columns]
    return exogenous_score(Z, e)


def _noise_parameters(fit: Estimate) -> int:
    """Return how many parameters the noise model C/(A D) has, the integrator not counted."""
    noise = fit.A.size + fit.C.size + fit.D.size - 3
    return noise - int(fit.integrating == "a")


def _free_covariance(fit: Estimate) -> Array:
    """Return the covariance of the parameters that were free: F̃'s, where F has an integrator."""
    if not fit.integrator:
        return fit.covariance_robust
    part, size = fit.slice_of(fit.integrating), fit.theta.size
    # f̃_k = f_1 + … + f_k undoes f_k = f̃_k - f̃_(k-1).
    summing = np.eye(size)
    summing[part, part] = np.tri(part.stop - part.start)
    summing = np.delete(summing, part.stop - 1, axis=0)
    return np.asarray(summing @ fit.covariance_robust @ summing.T)
