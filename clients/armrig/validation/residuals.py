"""Tests of a model by its residuals: whiteness, and independence of the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError, InputTypeError

from armrig.data.argument import HasDataset, as_dataset
from armrig.data.dataset import Dataset, Signals
from armrig.data.step import laws_of
from armrig.models.fit import Fit
from armrig.models.polynomials import Polynomials
from armrig.models.prediction import findings_on_own_data, require_same_signals
from armrig.models.predictor import PredictionErrors, parameters_of, prediction_errors
from armrig.models.structure_table import row_of
from armrig.numerics.covariance import Autoregression, joint_exogenous_score
from armrig.numerics.polynomial import Array
from armrig.numerics.rounding import rounding_std, without_rounding
from armrig.numerics.whiteness import (
    BAND_99_PERCENT,
    WHITE_LEVEL,
    autoregression,
    default_lags,
    join_residuals,
    joint_p_value,
    ljung_box,
)
from armrig.validation.output_whiteness import jointly_white, white_by_output
from armrig.validation.projection import Projection, projection, sum_of_products
from armrig.validation.residual_test import MAX_ALLOWANCE, ResidualTest

_MIN_SUM_VARIANCE = 1e-4
"""Least variance of a tested combination of the sums, as a share of the largest.

A combination with a smaller variance is not tested, because the estimation of the parameters sets
it to 0. Its computed variance is only the error of the differences that approximate Psi.
"""


def residuals(
    fit: Fit | Dataset | HasDataset | Signals,
    data: Dataset | HasDataset | Signals | Fit,
    lags: int | None = None,
) -> ResidualTest:
    """Test whether the one-step residuals are white and independent of the inputs.

    Whiteness is tested by a portmanteau test that allows for the estimated parameters. If this test
    cannot be trusted, the Ljung-Box test decides (see `armrig.numerics.whiteness`). For comparison
    with other programs the result always contains the Ljung-Box test, on estimation data with na +
    nc + nd fewer degrees of freedom. Several outputs are also tested together.

    The test of independence uses the sums s_k of e_i(t) u_j(t - k) over t, for all lags k together:
    for each output i and input j, and for all pairs together. The statistic s^T M^-1 s has a
    chi-squared distribution; a beta distribution (on other data an F distribution) accounts for the
    estimated variance of the noise. The residuals are e = (1 - P) v, with the noise v and the
    projection P on the estimated quantities. The columns of Z contain the lagged inputs. Therefore
    s = Z^T e is equal to H^T v with H = (1 - P)^T Z. M is the covariance of the sums ::

        M = H^T R H                                              on estimation data
        M = H^T R H + (H^T Psi) cov(theta) (Psi^T H)             on other data

    R is the covariance of the noise, an autoregression of each output, found at the estimation:
    residuals that are judged would hide their own misfit. Only for a model from an older file it is
    found in these residuals, and `noise_of_estimation` is False. Psi contains
    the derivatives of the prediction with respect to the parameters. P projects on the effects of
    the unknown past, the ramps of integrating outputs and, on estimation data, the parameters. P
    uses the weights of the estimator, the inverse of the noise covariance if outputs are estimated
    together. Because of the estimation, the residuals are on estimation data less correlated with
    the past input than the noise is. If only the present input speaks against the model, lag 0
    counts as feedback: a controller may compute u from y of the same sample.

    For exactly known parameters, the band for a single lag has the variance P/(N R_e(0) R_u(0)). P
    is the sum over k of the product of the autocovariances R_e(k) and R_u(k). The variance is 1/N
    only if e or u is white. `cross_std` is computed from the diagonal of M: smaller at some lags on
    estimation data, larger on other data.

    Parameters
    ----------
    fit : Fit
        Model with the outputs and inputs of the data.
    data : Dataset or Signals
        N samples, or a recording. Model and data may be exchanged, as in `armrig.compare`.
    lags : int, optional
        Largest lag L, from 1 to half the number of residuals; 25 by default, fewer for short data.

    Returns
    -------
    ResidualTest
        Residuals (N, ny) in y's unit, correlations (without unit) with bands, and p values. With
        one input and one output, the axes of outputs and inputs are left out.

    Raises
    ------
    ValueError
        The model and the data differ in channels, unit or sampling time, or L is out of range.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.6.
    .. [2] T. Söderström, P. Stoica, *System Identification*, 1989, section 11.2.
    .. [3] J. R. M. Hosking, J. Am. Stat. Assoc. 75 (1980) 602-608 (several outputs).

    Examples
    --------
    A model of order 2 is too simple for these data.

    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> for n in (2, 3):
    ...     test = armrig.residuals(armrig.oe(data, nb=n, nf=n), data)
    ...     print(f"order {n}: coloured {test.white.coloured}, p {test.missing_dynamics:.2f}")
    order 2: coloured True, p 0.00
    order 3: coloured False, p 0.02

    Each line below names a hypothesis. A p value below 0.01 rejects this hypothesis.

    >>> print(test)
    residuals on estimation data, 3000 samples
      white (p = 0.1..., portmanteau test)
      no dynamics missing (p = 0.02...)
      no feedback (p = 0.5...)
    """
    fit, data = _model_and_data(fit, data)
    on_own_data = fit.estimated_from(data)
    parts, J = prediction_errors(fit, data, on_own_data=on_own_data), parameters_of(fit)
    signals = data.signals()
    inputs = [part.u - np.mean(signals.u, axis=0) for part in signals.experiments()]
    theta_covariance = J @ fit.covariance_robust @ J.T
    ny, nu = fit.ny, fit.nu
    several = (ny, nu) != (1, 1)
    # For a subspace estimate, which does not minimise the errors, P is not known.
    fitted = on_own_data and not (several and row_of(fit.structure).projection)
    of_theta = None if fitted else theta_covariance
    e = np.vstack([p.e for p in parts])
    # Tests of rounding errors would depend on the processor.
    sizes = [rounding_std(y) for y in signals.y.T]
    parts = _without_rounding(parts, sizes)
    counts = np.isfinite(e).sum(axis=0)
    L = _possible(lags, int(counts.min()))
    projected = projection(parts, with_parameters=fitted)
    R = _autocovariance([p.e for p in parts], L)
    if several:
        # The weights of several outputs are estimated, too.
        projected = projected.applied()
    noise, degrees = _noise(fit, projected.parts, sizes, on_own_data=on_own_data)
    noise_known = degrees.size > 0
    sums = _input_sums(projected, inputs, of_theta, L, noise)
    pairs = np.arange(sums.values.size).reshape(ny, nu, 2 * L + 1)
    past, future = pairs[:, :, L:], pairs[:, :, :L]
    free = counts * (1 - projected.rank / counts.sum()) if fitted else counts
    free = degrees if noise_known else free

    def p_value(at: Array, N: float) -> float:
        k = at.ravel()
        s, M = sums.values[k], sums.covariance[np.ix_(k, k)]
        return joint_p_value(s, M, _MIN_SUM_VARIANCE, N, independent=noise_known)

    def by_pair(at: Array) -> Array:
        return np.array([[p_value(k, N) for k in row] for row, N in zip(at, free, strict=True)])

    later, from_now = pairs[:, :, L + 1 :], pairs[:, :, : L + 1]
    if p_value(past, free.sum()) < WHITE_LEVEL <= p_value(later, free.sum()):
        past, future = later, from_now

    def squeeze(x: Array) -> Any:
        if several:
            return x
        return float(x.item()) if x.size == 1 else x[0, 0]

    shares, allowance = np.zeros(ny), sums.allowance
    if of_theta is not None:
        shares = _shares(parts, of_theta, fit)
        # Outside of 0 to 1 (also by rounding), the data do not determine the parameters.
        allowance = allowance if np.all((shares >= 0) & (shares <= 1)) else float("inf")
    # The robust covariance would contain the colour that is tested, and an allowance for parameters
    # that are not determined would hide any colour.
    usable = not allowance > MAX_ALLOWANCE
    if_white = None if fitted else np.where(usable, J @ fit.covariance @ J.T, 0.0)
    each = white_by_output(projected, if_white, L)
    power = np.outer(*[np.sqrt(np.diag(R[:, :, 0]))] * 2)[:, :, None]
    each_e = [join_residuals([p.e[:, i] for p in parts], L) for i in range(ny)]
    parameters = _noise_parameters(fit) if on_own_data else [0] * ny
    box = np.array([ljung_box(x, L, n) for x, n in zip(each_e, parameters, strict=True)])
    each = [replace(white, ljung_box=float(p)) for white, p in zip(each, box, strict=True)]
    white = each[0]
    if ny > 1:
        least = min(1.0, ny * float(np.min(box)))
        white = replace(jointly_white(projected, if_white, L), ljung_box=least)
    larger = [
        _larger([(p.e[:, i], p.Psi[:, i]) for p in parts], theta_covariance, degrees[i], noise[i])
        for i in range(degrees.size)
    ]
    ratio, p_larger = min(larger, key=lambda found: found[1], default=(float("nan"),) * 2)
    return ResidualTest(
        outputs=fit.outputs,
        inputs=fit.inputs,
        e=e if several else e[:, 0],
        lags=np.arange(L + 1),
        autocorrelation=squeeze(R / np.where(power > 0, power, np.nan)),
        autocorrelation_band=squeeze(BAND_99_PERCENT / np.sqrt(np.maximum(counts, 1))),
        white_by_output=tuple(each),
        white=white,
        ljung_box=squeeze(box),
        cross_lags=np.arange(-L, L + 1),
        cross_correlation=squeeze(sums.values[pairs] / sums.scale[:, :, None]),
        cross_band=squeeze(BAND_99_PERCENT * sums.known_std / sums.scale),
        cross_std=squeeze(
            np.sqrt(np.maximum(np.diag(sums.covariance)[pairs], 0.0)) / sums.scale[:, :, None]
        ),
        missing_dynamics_by_pair=by_pair(past),
        feedback_by_pair=by_pair(future),
        missing_dynamics=p_value(past, free.sum()),
        feedback=p_value(future, free.sum()),
        allowance=allowance,
        error_ratio=ratio,
        larger_errors=min(1.0, ny * p_larger) if noise_known else float("nan"),
        noise_of_estimation=noise_known,
        on_estimation_data=on_own_data,
        source=data.source,
        laws=laws_of(data.history),
        findings=() if on_own_data else tuple(findings_on_own_data([(fit.label, fit)], data)),
    )


def _model_and_data(fit: object, data: object) -> tuple[Fit, Dataset | Signals]:
    """Return a model and data in any order, with the model's channels; refuse anything else."""
    if isinstance(data, Fit):
        fit, data = data, fit
    if not isinstance(fit, Fit):
        raise InputTypeError(f"the model is a {type(fit).__name__}: residuals(fit, data)")
    if not fit.quality:
        raise InputError(f"{fit.label} was not estimated: it has no noise model to test")
    if not isinstance(data, Signals) and (fit.ny, fit.nu) == (1, 1):
        data = as_dataset(data)  # type: ignore[arg-type]
    require_same_signals(fit, data)  # type: ignore[arg-type]
    return fit, data  # type: ignore[return-value]


def _without_rounding(
    parts: Sequence[PredictionErrors], sizes: Sequence[float]
) -> list[PredictionErrors]:
    """Return the parts, with errors of 0 in each output whose errors are rounding errors."""
    each = [
        without_rounding([part.e[:, i] for part in parts], size) for i, size in enumerate(sizes)
    ]
    return [
        replace(part, e=np.column_stack(e))
        for part, e in zip(parts, zip(*each, strict=True), strict=True)
    ]


def _possible(lags: int | None, N: int) -> int:
    """Return the number of lags; refuse a number that N residuals do not allow."""
    longest = max(N // 2, 1)
    L = default_lags(N) if lags is None else lags
    if not 1 <= L <= longest:
        raise InputError(f"lags={L} must be 1 to {longest}, half of the {N} residuals")
    return L


@dataclass(frozen=True, slots=True, kw_only=True)
class _InputSums:
    """Sums s of e_i(t) u_j(t - k), k = -L … L, pair after pair, and their covariance."""

    values: Array
    """s, (ny nu (2 L + 1),)."""
    covariance: Array
    scale: Array
    """Root of the sum of e_i(t)² times the sum of u_j(t)², (ny, nu); infinite if a sum is 0."""
    known_std: Array
    """Standard deviation of s at lag 0 for exactly known parameters, (ny, nu)."""
    allowance: float


def _input_sums(
    projected: Projection,
    inputs: Sequence[Array],
    theta_covariance: Array | None,
    L: int,
    noise: Sequence[Autoregression],
) -> _InputSums:
    parts = projected.parts
    ny, nu = parts[0].e.shape[1], inputs[0].shape[1]
    e = [[*p.e.T] for p in parts]
    Z = [_lags_both_ways(u, part.known, L) for u, part in zip(inputs, parts, strict=True)]
    projected.remove_states(Z)
    sums = sum_of_products(Z, [np.nan_to_num(p.e)[:, :, None] for p in parts])[:, 0]
    at_0 = np.arange(L, ny * nu * (2 * L + 1), 2 * L + 1)
    now = [z[:, :, at_0] for z in Z]
    outputs = np.arange(ny * nu) // nu  # output of each pair
    power = np.sum([np.sum(z[:, outputs, np.arange(ny * nu)] ** 2, axis=0) for z in now], axis=0)
    energy = np.array([sum(float(np.nansum(p.e[:, i] ** 2)) for p in parts) for i in range(ny)])
    scale = np.sqrt(power.reshape(ny, nu) * energy[:, None])
    variances = np.diag(joint_exogenous_score([[*z.transpose(1, 0, 2)] for z in now], e, noise))
    projected.remove_parameters(Z)
    M = joint_exogenous_score([[z[:, i] for i in range(ny)] for z in Z], e, noise)
    before = np.diag(M).copy()
    if theta_covariance is not None:
        slope = sum_of_products([part.Psi for part in parts], Z)
        M = M + slope.T @ theta_covariance @ slope
    else:
        N = sum(int(part.known.sum()) for part in parts)
        M = M * (N / max(N - projected.rank, 1))
    ratios = np.diag(M)[before > 0] / before[before > 0]
    middle = float(np.median(ratios)) if ratios.size else float("nan")
    return _InputSums(
        values=sums,
        covariance=M,
        scale=np.where(scale > 0, scale, np.inf),
        known_std=np.sqrt(variances).reshape(ny, nu),
        allowance=float(np.sqrt(max(middle, 0.0))) or float("inf"),
    )


def _noise(
    fit: Fit, parts: Sequence[PredictionErrors], sizes: Sequence[float], *, on_own_data: bool
) -> tuple[list[Autoregression], Array]:
    """Return the noise of each output as found at the estimation, and its degrees of freedom."""
    # Otherwise, and for a model of an older file, the noise is that of the residuals.
    if on_own_data or not all(q.autoregression and q.loss > 0 for q in fit.quality):
        each = [[p.e[:, i] for p in parts] for i in range(len(sizes))]
        noise = [autoregression(e, least=size) for e, size in zip(each, sizes, strict=True)]
        return noise, np.zeros(0)
    noise, degrees = [], []
    for q, variance in zip(fit.quality, np.diag(fit.noise_covariance), strict=True):
        C = np.array(q.autoregression)
        noise.append((C, q.innovation_variance * float(variance) / q.loss))
        degrees.append(q.N * q.loss / float(variance) - (C.size - 1))
    return noise, np.maximum(degrees, 1.0)


def _shares(parts: Sequence[PredictionErrors], theta_covariance: Array, fit: Fit) -> Array:
    """Return the error of each output by uncertain parameters, as a share of the noise variance."""
    Psi = np.concatenate([p.Psi for p in parts])
    caused = np.sum((Psi @ theta_covariance) * Psi, axis=(0, 2))
    counts = np.sum([p.known.sum(axis=0) for p in parts], axis=0)
    return np.asarray(caused / np.maximum(np.diag(fit.noise_covariance) * counts, 1e-300))


def _larger(
    parts: Sequence[tuple[Array, Array]],
    theta_covariance: Array,
    degrees: float,
    noise: Autoregression,
) -> tuple[float, float]:
    """Return the ratio of the rms of C(q) e to that at the estimation, and its p value by F.

    C(q) e is white if the model is right. The mean of its square has (kappa - 1)/2 times the
    variance of Gaussian noise, with the kurtosis kappa. The uncertain parameters increase it.
    """
    from scipy.signal import lfilter
    from scipy.special import fdtrc

    C, s2 = noise
    w = np.concatenate([np.convolve(e, C)[: e.size] for e, _ in parts])
    finite = np.isfinite(w)
    slope = np.vstack([lfilter(C, [1.0], Psi, axis=0) for _, Psi in parts])[finite]
    w, N = w[finite], int(np.count_nonzero(finite))
    if not np.any(w):  # without noise, the errors are set to 0
        return 0.0, 1.0
    allowed = s2 + max(float(np.sum((slope @ theta_covariance) * slope)), 0.0) / max(N, 1)
    ratio = float(np.mean(w**2)) / allowed
    kappa = float(np.mean(w**4) / np.mean(w**2) ** 2)
    c = float(np.clip(kappa - 1, 1.0, None)) / 2
    return float(np.sqrt(ratio)), float(fdtrc(N / c, degrees / c, ratio))


def _lags_both_ways(u: Array, measured: Array, L: int) -> Array:
    """Return u_j(t - k), k = -L … L, for pairs i, j, (N, ny, K), 0 without a residual of i."""
    (N, ny), nu, width = measured.shape, u.shape[1], 2 * L + 1
    # In Fortran order the columns are contiguous.
    Z = np.zeros((N, ny, ny * nu * width), order="F")
    for i in range(ny):
        unknown = np.flatnonzero(~measured[:, i])
        for k in range(-L, L + 1):
            late, early, n = max(k, 0), max(-k, 0), max(N - abs(k), 0)
            columns = slice(i * nu * width + L + k, (i + 1) * nu * width, width)
            Z[late : late + n, i, columns] = u[early : early + n]
            Z[unknown, i, columns] = 0.0
    return Z


def _autocovariance(parts: Sequence[Array], L: int) -> Array:
    """Return the means of e_i(t) e_k(t - lag) over the measured pairs, (ny, ny, L + 1)."""
    e = [np.nan_to_num(x) for x in parts]
    marks = [np.isfinite(x).astype(np.float64) for x in parts]

    def sums(x: Sequence[Array]) -> Array:
        at = [sum(v[k:].T @ v[: max(v.shape[0] - k, 0)] for v in x) for k in range(L + 1)]
        return np.stack(at, axis=-1)

    return np.asarray(sums(e) / np.maximum(sums(marks), 1.0))


def _noise_parameters(fit: Fit) -> list[int]:
    """Return the number of parameters of the noise model of each output, without integrators."""
    form = fit.form
    if not isinstance(form, Polynomials):
        K = form.innovations_form().K
        return [K.shape[0] * bool(K.any())] * fit.ny
    rows = zip(form.A, form.C, form.D, form.F, form.integrators, strict=True)
    return [
        sum(max(a.size - 1, 0) for a in A)
        + (C.size + D.size - 2)
        - int(integrates and all(f.size == 1 for f in F))
        for A, C, D, F, integrates in rows
    ]
