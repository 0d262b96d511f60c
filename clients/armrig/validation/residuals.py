"""Tests of a model by its residuals: whiteness, and independence of the input."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, cast, overload

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import NDArray

from armrig.data.argument import HasDataset, as_dataset
from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding
from armrig.data.signals import Signals
from armrig.models.estimation_data import findings_on_own_data
from armrig.models.fit import Fit
from armrig.models.prediction import Residuals, prediction_errors, require_same_signals
from armrig.numerics.covariance import exogenous_score
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import p_relation
from armrig.numerics.whiteness import (
    WHITE_LEVEL,
    Whiteness,
    autocovariance,
    default_lags,
    joined,
    joint_p_value,
    ljung_box,
    portmanteau,
)
from armrig.validation.power import lack_of_power
from armrig.validation.residual_figure import BAND_99_PERCENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.validation.multivariable.residual_test import SignalsResidualTest

Vector = NDArray[np.float64]

_COLUMNS = 8  # number of lagged inputs that are processed at once


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ResidualTest:
    """Correlation of the residuals with themselves and with the input."""

    e: Vector
    """Residuals one step ahead, (N,), NaN where they are not known."""
    lags: NDArray[np.int_]
    """Lags 0 … L."""
    autocorrelation: Vector
    """Autocorrelation of the residuals at `lags`; 1 at lag 0."""
    autocorrelation_band: float
    """Half width 2.58/sqrt(N) of the 99 % band for white residuals, at all lags except 0."""
    whiteness: float
    """p value of the hypothesis that the residuals are white, from the test `whiteness_test`."""
    whiteness_test: str
    """Name of the whiteness test: portmanteau, or Ljung-Box if the portmanteau is unreliable."""
    ljung_box: float
    """p value of the Ljung-Box test, for comparison with other programs."""
    cross_lags: NDArray[np.int_]
    """Lags -L … L; at a positive lag the input precedes the residual."""
    cross_correlation: Vector
    """Correlation of e(t) with u(t - lag) at `cross_lags`."""
    cross_band: float
    """Half width 2.58 sqrt(P / (N R_e(0) R_u(0))) of the 99 % band, if the parameters are exactly
    known. `residuals` defines P."""
    cross_std: Vector
    """Standard deviation of `cross_correlation`, including the effect of the estimated
    parameters."""
    missing_dynamics: float
    """p value of the hypothesis that past and present input, lags 0 … L, are uncorrelated with
    e."""
    feedback: float
    """p value of the hypothesis that future input, lags -L … -1, is uncorrelated with e."""
    on_estimation_data: bool
    """True if the parameters were estimated from these data; the tests account for this."""
    source: str
    """Hash of the recording, or ""."""
    findings: tuple[EstimateFinding, ...] = ()
    """Warnings, with the code "overlap" if the model was also estimated from a part of these data.
    """

    @property
    def white(self) -> Whiteness:
        """Result of the whiteness test; str() returns it as text."""
        return Whiteness(p_value=self.whiteness, test=self.whiteness_test)

    @property
    def allowance(self) -> float:
        """Factor by which the parameters' uncertainty widens the band of the cross-correlation."""
        known = self.cross_band / BAND_99_PERCENT
        return float(np.median(self.cross_std)) / known if known > 0 else float("nan")

    @property
    def powerless(self) -> str:
        """Reason why the tests have no power, with a remedy; "" if they have power."""
        return lack_of_power(self.allowance, on_estimation_data=self.on_estimation_data)

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of both correlations: see `armrig.plots.plot_residuals`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.residual_figure import plot_residual_test

        return figure_of(plot_residual_test(self, ax=ax))

    def __repr__(self) -> str:
        """Return the results of the tests in a few lines."""
        if self.powerless:
            p_values = (self.whiteness, self.missing_dynamics, self.feedback)
            if not any(p < WHITE_LEVEL for p in p_values):
                powerless = f"residuals on validation data: no test has power: {self.powerless}"
                return "\n".join([powerless, *self._warnings()])
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
            if np.isnan(p):
                subject = bad.partition(",")[0]
                said = f"{subject}: not tested, because u is constant or the samples are few"
            elif not p < WHITE_LEVEL:
                said = f"{good} (p {p_relation(p)})"
            lines.append(f"  {said}")
        return "\n".join([*lines, *self._warnings()])

    def _warnings(self) -> list[str]:
        return [f"  {finding.text}" for finding in self.findings]


@overload
def residuals(  # type: ignore[overload-overlap]
    fit: Fit, data: Signals, lags: int | None = None
) -> SignalsResidualTest: ...


@overload
def residuals(fit: Fit, data: Dataset | HasDataset, lags: int | None = None) -> ResidualTest: ...


def residuals(
    fit: Fit,
    data: Dataset | HasDataset | Signals,
    lags: int | None = None,
) -> ResidualTest | SignalsResidualTest:
    """Test whether the one-step residuals are white and independent of the input.

    Whiteness is tested by a portmanteau test that allows for the estimated parameters. If this test
    cannot be trusted, the Ljung-Box test decides (see `armrig.numerics.whiteness`). The result
    always contains the Ljung-Box test, for comparison with other programs. On estimation data the
    degrees of freedom of the Ljung-Box test are reduced by na + nc + nd. The test of independence
    uses the sums s_k of e(t) u(t - k) over t, for all lags k together. The statistic s^T M^-1 s has
    a chi-squared distribution. M is the covariance of the sums ::

        M = Z_p^T R_e Z_p                                        on estimation data
        M = Z^T R_e Z + (Z^T Psi) cov(theta) (Psi^T Z)           on other data

    Z contains the lagged inputs. R_e is the covariance of the residuals, estimated by an
    autoregression. Psi contains the derivatives of the prediction with respect to the parameters.
    Z_p is Z minus the projection of Z on Psi. The projection accounts for the estimation: on
    estimation data, the residuals are less correlated with the past input than the noise is.

    The band for a single lag has the variance P/(N R_e(0) R_u(0)). P is the sum over k of the
    product of the autocovariances R_e(k) and R_u(k). The variance is 1/N only if e or u is white.
    The band is valid for a model with exactly known parameters. `cross_std` is computed from the
    diagonal of M. On estimation data, `cross_std` is at some lags smaller than the standard
    deviation of the band. On other data, `cross_std` is larger.

    Parameters
    ----------
    fit : Fit
        Model of the same outputs as the data.
    data : Dataset or Signals
        N samples, or a recording.
    lags : int, optional
        Largest lag L, from 1 to half the number of residuals; 25 by default, fewer for short data.

    Returns
    -------
    ResidualTest or SignalsResidualTest
        Residuals (N,) in y's unit, correlations (without unit) with bands, and p values.

    Raises
    ------
    ValueError
        The model and the data differ in output, unit or sampling time, or L is out of range.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.6.
    .. [2] T. Söderström, P. Stoica, *System Identification*, 1989, section 11.2.

    Examples
    --------
    A model of order 2 is too simple for these data.

    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> for n in (2, 3):
    ...     test = armrig.residuals(armrig.oe(data, nb=n, nf=n), data)
    ...     print(f"order {n}: coloured {test.white.coloured}, p {test.missing_dynamics:.2f}")
    order 2: coloured True, p 0.00
    order 3: coloured False, p 0.03

    Each line below names a hypothesis. A p value below 0.01 rejects this hypothesis.

    >>> print(test)
    residuals on estimation data, 3000 samples
      white (p = 0.1..., portmanteau test)
      no dynamics missing (p = 0.02...)
      no feedback (p = 0.5...)
    """
    if not isinstance(fit, Fit) or not fit.quality:
        raise InputTypeError(
            f"the model must come first, got a {type(fit).__name__}: residuals(fit, data)"
        )
    if (fit.ny, fit.nu) != (1, 1) or (fit.specification and isinstance(data, Signals)):
        from armrig.validation.multivariable.residuals import residuals as of_several

        return of_several(fit, cast("Signals", data), lags)
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
        findings=() if own else tuple(findings_on_own_data([(fit.label, fit)], data)),
    )


def _possible(L: int, N: int) -> int:
    """Return the number of lags; refuse a number that N residuals do not allow."""
    longest = max(N // 2, 1)
    if not 1 <= L <= longest:
        raise InputError(f"lags={L} must be 1 to {longest}, half of the {N} residuals")
    return L


@dataclass(frozen=True, slots=True, kw_only=True)
class _InputSums:
    """Sums s_k of e(t) u(t - k), k = -L … L, and their covariance."""

    sums: Array
    """s_k, (2 L + 1,)."""
    covariance: Array
    """M, (2 L + 1, 2 L + 1)."""
    power: float
    """Sum of u(t)²."""
    variance: float
    """Variance of s_0 for exactly known parameters of the model."""


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
        covariance=_score_covariance(Z, known, theta_covariance, own=own),  # changes Z: last
    )


def _lagged_both_ways(u: Vector, L: int, known: Residuals) -> Array:
    """Return u(t - k), k = -L … L, (N, 2 L + 1), zero in the rows without a residual.

    The effects of the unknown past are projected out, because the unknown past is estimated from
    the tested data.
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
    """Return groups of columns, so that only a small part of a long matrix is copied at once."""
    return [slice(a, min(a + _COLUMNS, columns)) for a in range(0, columns, _COLUMNS)]


def _score_covariance(
    Z: list[Array], known: list[Residuals], theta_covariance: Array, *, own: bool
) -> Array:
    """Return M; on estimation data, also replace Z by Z minus its projection on Psi, in place."""
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


def _noise_parameters(fit: Fit) -> int:
    """Return the number of parameters of the noise model C/(A D), without the integrator."""
    noise = fit.A.size + fit.C.size + fit.D.size - 3
    return noise - int(fit.integrating == "a")


def _free_covariance(fit: Fit) -> Array:
    """Return the covariance of the free parameters; an integrator is divided out of F or A."""
    if not fit.integrator:
        return fit.covariance_robust
    part, size = fit.slice_of(fit.integrating), fit.theta.size
    # f̃_k = f_1 + … + f_k undoes f_k = f̃_k - f̃_(k-1).
    summing = np.eye(size)
    summing[part, part] = np.tri(part.stop - part.start)
    summing = np.delete(summing, part.stop - 1, axis=0)
    return np.asarray(summing @ fit.covariance_robust @ summing.T)
