"""The residual tests against their sums written out: lags, experiments, deviations of theta."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.arx import arx
from armrig.estimation.oe import oe
from armrig.models.fit import Fit
from armrig.models.prediction import prediction_errors
from armrig.numerics.polynomial import Array, filtered
from armrig.numerics.whiteness import autoregression, joint_p_value, portmanteau
from armrig.validation.residuals import residuals
from scipy.stats import chi2

L = 6


def data(seed: int, N: int, B: list[float] | None = None) -> Dataset:
    """Return y = B/F u + e about a level, so that a mean that stays is seen."""
    rng = np.random.default_rng(seed)
    u = 3.0 + rng.standard_normal(N)
    y = filtered(B or [0, 1, 0.5], [1, -1.2, 0.6], u) + 0.3 * rng.standard_normal(N)
    return Dataset(u=u, y=y, Ts=1)


def two_experiments() -> Dataset:
    return merge([data(2, 180), data(3, 130)])


def lagged_inputs(part: Dataset, mean: float, L: int) -> Array:
    """Return u(t - k), k = -L … L, one column each, 0 outside of the experiment."""
    padded = np.concatenate([np.zeros(L), part.u - mean, np.zeros(L)])
    return np.column_stack([padded[L - k : L - k + part.N] for k in range(-L, L + 1)])


def written_out(fit: Fit, judged: Dataset, *, own: bool) -> tuple[Array, Array, float]:
    """Return s_k, k = -L … L, its covariance M, and the scale of a correlation."""
    known = [prediction_errors(fit, part) for part in judged.experiments()]
    e = np.concatenate([np.nan_to_num(r.e) for r in known])
    Z = []
    for part, r in zip(judged.experiments(), known, strict=True):
        lagged = lagged_inputs(part, float(np.mean(judged.u)), L)
        lagged[~np.isfinite(r.e)] = 0.0
        Z.append(np.column_stack([r.unknown.without(column) for column in lagged.T]))
    C, s2 = autoregression([known[0].e, known[1].e])
    assert C.size == 1  # white: R_e is s² I
    whole, Psi = np.vstack(Z), np.vstack([r.Psi for r in known])
    scale = float(np.sqrt(np.sum(whole[:, L] ** 2) * (e @ e)))
    s = whole.T @ e
    if own:
        Q = np.linalg.qr(Psi)[0]
        whole = whole - Q @ (Q.T @ whole)
        return s, s2 * whole.T @ whole, scale
    slope = whole.T @ Psi
    return s, s2 * whole.T @ whole + slope @ fit.covariance_robust @ slope.T, scale


@pytest.mark.parametrize("own", [False, True])
def test_the_input_is_tested_by_the_sums_of_the_docstring(own: bool) -> None:
    judged = two_experiments()
    fit = oe(judged if own else data(1, 400), nb=2, nf=2)
    fit = replace(fit, covariance_robust=9.0 * fit.covariance)

    tested = residuals(fit, judged, lags=L)

    s, M, scale = written_out(fit, judged, own=own)
    past, future = slice(L, None), slice(0, L)
    assert tested.on_estimation_data is own
    assert tested.missing_dynamics == pytest.approx(joint_p_value(s[past], M[past, past]), rel=1e-6)
    assert tested.feedback == pytest.approx(joint_p_value(s[future], M[future, future]), rel=1e-6)
    np.testing.assert_array_equal(tested.cross_lags, np.arange(-L, L + 1))
    np.testing.assert_allclose(tested.cross_correlation, s / scale, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tested.cross_std, np.sqrt(np.diag(M)) / scale, rtol=1e-6)


def test_a_direct_term_that_the_model_lacks_is_dynamics_missing() -> None:
    seen = data(1, 400, B=[0.3, 1.0, 0.5])

    tested = residuals(arx(seen, na=4, nb=4, nk=1), seen)

    assert tested.missing_dynamics < 1e-6
    assert tested.feedback > 0.01


def test_no_pair_of_residuals_spans_two_experiments() -> None:
    judged, fit = two_experiments(), oe(data(1, 400), nb=2, nf=2)

    tested = residuals(fit, judged, lags=L)

    parts = [prediction_errors(fit, part).e for part in judged.experiments()]
    parts = [e[np.isfinite(e)] for e in parts]
    N = sum(e.size for e in parts)
    pairs = np.array([sum(e.size - k for e in parts) for k in range(L + 1)])
    R = np.array([sum(float(e[k:] @ e[: e.size - k]) for e in parts) for k in range(L + 1)]) / pairs
    Q = (N + 2) / N * np.sum(pairs[1:] * (R[1:] / R[0]) ** 2)
    np.testing.assert_allclose(tested.autocorrelation, R / R[0], rtol=1e-9)
    assert tested.ljung_box == pytest.approx(chi2.sf(Q, L), rel=1e-9)


@pytest.mark.parametrize("own", [False, True])
def test_the_whiteness_test_accounts_for_the_estimated_parameters(own: bool) -> None:
    """By its projection on the estimation data, by its covariance on other data."""
    judged = two_experiments()
    fit = oe(judged if own else data(1, 100), nb=2, nf=2)
    known = [prediction_errors(fit, part) for part in judged.experiments()]
    signals = [r.e for r in known], [r.Psi for r in known], [r.unknown.span for r in known]

    tested = residuals(fit, judged, lags=L)

    p = {
        asked: portmanteau(*signals, L, None if asked else fit.covariance_robust).p_value
        for asked in (True, False)
    }
    assert abs(p[True] - p[False]) > 1e-3
    assert tested.whiteness == pytest.approx(p[own], rel=1e-9)


def test_the_allowance_is_the_widening_of_the_band() -> None:
    fit, judged = oe(data(1, 400), nb=2, nf=2), data(2, 300)
    unsure = replace(fit, covariance_robust=1e4 * fit.covariance_robust)

    sure, wide = residuals(fit, judged), residuals(unsure, judged)

    assert 0.9 < sure.allowance < 2
    assert wide.allowance > 10 * sure.allowance
    assert not sure.powerless
    assert f"correlations by a factor of {wide.allowance:.0f}" in wide.powerless


def test_a_constant_input_tests_neither_dynamics_nor_feedback() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 4)
    noise = 0.1 * rng.standard_normal(400)
    fit = arx(Dataset(u=u, y=filtered([0, 1], [1, -0.7], u) + noise, Ts=0.1), na=1, nb=1)

    said = repr(residuals(fit, Dataset(u=np.ones(400), y=3.3 + noise, Ts=0.1)))

    assert "dynamics missing: not tested" in said
    assert "feedback: not tested" in said
    assert "no feedback" not in said
