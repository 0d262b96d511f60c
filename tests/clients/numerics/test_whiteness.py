"""The test of whiteness: its level, its findings, and its words."""

from __future__ import annotations

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import telegraph
from armrig.numerics.criteria import mdl
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import apply_filter, lag_columns
from armrig.numerics.whiteness import (
    Whiteness,
    autoregression,
    default_lags,
    joint_p_value,
    ljung_box,
    portmanteau,
    portmanteau_p_value,
    two_sided,
)
from scipy.special import chdtrc, ndtr

from tests.sampling import sampled


@pytest.mark.parametrize(("N", "lags"), sampled([(250, 25), (250, 10), (500, 25)], 2))
def test_white_noise_is_rejected_at_the_nominal_level(N: int, lags: int) -> None:
    """Ljung and Box's statistic of 10 000 series; chi-squared rejects 6 % instead of 5 %."""
    e = np.random.default_rng(1).standard_normal((10_000, N))
    spectrum = np.abs(np.fft.rfft(e, 2 * N, axis=1)) ** 2
    R = np.fft.irfft(spectrum, axis=1)[:, : lags + 1]
    Q = N * (N + 2) * np.sum((R[:, 1:] / R[:, :1]) ** 2 / (N - np.arange(1, lags + 1)), axis=1)

    p = np.array([portmanteau_p_value(float(q), lags, N) for q in Q])

    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.005)
    assert np.mean(p < 0.01) == pytest.approx(0.01, abs=0.004)
    if lags == 25:
        assert np.mean(chdtrc(lags, Q) < 0.05) > 0.055


def test_the_statistic_is_chi_squared_for_many_samples() -> None:
    assert portmanteau_p_value(37.65, 25, 10**7) == pytest.approx(chdtrc(25, 37.65), rel=1e-4)
    assert portmanteau_p_value(3.0, 2, 100) == pytest.approx(chdtrc(2, 3.0))
    assert np.isnan(portmanteau_p_value(0.0, 0, 100))


@pytest.mark.parametrize("known", [False, True])
def test_the_test_accounts_for_fitted_parameters_by_its_formula(known: bool) -> None:
    rng = np.random.default_rng(1)
    lags, sizes = 5, (80, 60)
    Psi = [rng.standard_normal((n, 3)).cumsum(axis=0) for n in sizes]
    spans = [np.linalg.qr(rng.standard_normal((n, 2)))[0] for n in sizes]
    e = [rng.standard_normal(n) for n in sizes]
    holes = np.array([7, 8, 30])
    e[1][holes], Psi[1][holes], spans[1][holes] = np.nan, 0.0, 0.0
    Q = orthonormal(np.vstack(Psi)).Q

    found = portmanteau(e, Psi, spans, lags, Q=Q if known else None)

    x = [np.nan_to_num(part) for part in e]
    Z = [lag_columns(part, range(1, lags + 1)) for part in x]
    s = np.array([sum(a @ b[:, k] for a, b in zip(x, Z, strict=True)) for k in range(lags)])
    there = [np.isfinite(part) for part in e]
    pairs = np.array([sum(np.sum(t[k:] & t[:-k]) for t in there) for k in range(1, lags + 1)])
    N = sum(int(t.sum()) for t in there)
    R0 = sum(float(part @ part) for part in x) / N
    m, M = np.zeros(lags), np.diag(pairs) * R0**2 * N / (N + 2) * N / (N - 2 * 2 - 3)
    through = np.zeros((lags, Q.shape[1]))
    for z, span, q in zip(Z, spans, (Q[:80], Q[80:]), strict=True):
        both = np.hstack([span, q])
        m -= [R0 * np.trace(both[k:] @ both[:-k].T) for k in range(1, lags + 1)]
        M -= R0 * z.T @ span @ span.T @ z
        through += z.T @ q
    M -= R0 * through @ through.T
    statistic = float((s - m) @ np.linalg.solve(M, s - m))
    assert found.p_value == pytest.approx(portmanteau_p_value(statistic, lags, N), rel=1e-9)
    assert found.test == "portmanteau test"


@pytest.mark.parametrize("seed", sampled([0, 1, 2]))
def test_a_random_walk_is_always_rejected_as_white(seed: int) -> None:
    """For seed 1 M is indefinite, and M^+ gave p = 0.999."""
    rng = np.random.default_rng(seed)
    u = telegraph(10_000, 0.1, 0.0, 5.0, seed=rng) - (2.5 if seed else 0.0)
    y = apply_filter([0, 1, 0.5], [1, -1.5, 0.7], u) + 0.3 * np.cumsum(rng.standard_normal(u.size))
    data = Dataset(u=u, y=y, Ts=0.01)

    fit = armrig.oe(data, nb=4, nf=4, starts="few")
    tested = armrig.residuals(fit, data)

    assert fit.whiteness < 1e-10
    assert fit.whiteness_test == ("Ljung-Box test" if seed == 1 else "portmanteau test")
    assert fit.trusted_covariance is fit.covariance_robust
    assert "coloured (p < 0.001" in repr(fit)
    assert (tested.white.p_value, tested.white.test) == (fit.whiteness, fit.whiteness_test)


@pytest.mark.exhaustive
def test_the_ljung_box_test_of_an_autoregression_loses_na_degrees() -> None:
    """A of a pure autoregression; 300 runs at 5 %, of which all 25 lags would reject 2 %."""
    rng = np.random.default_rng(1)
    p, tests = [], []
    for _ in range(300):
        e = rng.standard_normal(500)
        data = Dataset(u=rng.standard_normal(500), y=apply_filter([1], [1, -1.5, 0.7], e), Ts=1)
        fit = armrig.arx(data, na=4, nb=1)
        p.append(fit.whiteness)
        tests.append(fit.whiteness_test)

    assert set(tests) == {"Ljung-Box test"}
    assert 6 <= np.count_nonzero(np.array(p) < 0.05) <= 25
    assert 0.42 < np.mean(np.array(p) < 0.5) < 0.6


@pytest.mark.parametrize(
    ("p", "test", "said"),
    [
        (0.31, "portmanteau test", "white (p = 0.310, portmanteau test)"),
        (0.01, "", "white (p = 0.010)"),
        (0.009, "Ljung-Box test", "coloured (p = 0.009, Ljung-Box test)"),
        (1e-9, "Ljung-Box test", "coloured (p < 0.001, Ljung-Box test)"),
        (np.nan, "", "not tested (too few, or all zero)"),
    ],
)
def test_the_text_of_a_whiteness_test_contains_its_verdict(p: float, test: str, said: str) -> None:
    assert str(Whiteness(p_value=p, test=test)) == said


def test_an_estimated_variance_is_allowed_for_in_the_sum_of_many_squares() -> None:
    """Thirty sums of 60 residuals are tested: chi-squared rejects much less than 5 %."""
    rng = np.random.default_rng(2)
    N, k, runs = 60, 30, 1000
    Z = orthonormal(rng.standard_normal((N, k))).Q
    e = rng.standard_normal((runs, N))
    p = np.array([joint_p_value(Z.T @ x, np.mean(x**2) * np.eye(k), N=N) for x in e])
    known = np.array([joint_p_value(Z.T @ x, np.mean(x**2) * np.eye(k)) for x in e])

    assert 0.03 < np.mean(p < 0.05) < 0.07
    assert np.mean(known < 0.05) < 0.03
    assert 0.45 < np.mean(p) < 0.55
    assert np.isnan(joint_p_value(np.ones(3), np.eye(3), N=3.0))


def test_a_quarter_of_few_samples_are_tested_lags_and_never_more_than_25() -> None:
    found = {N: default_lags(N) for N in (0, 3, 7, 8, 99, 100, 104, 10_000)}

    assert found == {0: 1, 3: 1, 7: 1, 8: 2, 99: 24, 100: 25, 104: 25, 10_000: 25}


def test_a_ljung_box_test_without_a_degree_of_freedom_or_a_sample_has_no_p_value() -> None:
    e = np.random.default_rng(1).standard_normal(40)

    assert np.isnan([ljung_box(e, 3, 3), ljung_box(e[:1], 3), ljung_box(0 * e, 3)]).all()
    assert 0 < ljung_box(e, 3, 2) < ljung_box(e, 3) < 1


@pytest.mark.parametrize("level", [0.5, 0.95, 0.99])
def test_a_two_sided_quantile_leaves_out_both_tails(level: float) -> None:
    assert 2 * ndtr(-two_sided(level)) == pytest.approx(1 - level)
    for wrong in (0.0, 1.0, 95.0, float("nan")):
        with pytest.raises(ValueError, match="must lie between 0 and 1"):
            two_sided(wrong)


def test_white_errors_at_a_third_of_the_samples_have_no_autoregression() -> None:
    """An ARX model of data with gaps has errors where its whole past is known."""
    rng, orders = np.random.default_rng(1), []
    for _ in range(60):
        known = rng.random(400) > 0.3
        known[2:] &= known[1:-1] & known[:-2]
        e = np.where(known, rng.standard_normal(400), np.nan)
        orders.append(autoregression([e], mdl)[0].size - 1)

    assert np.mean(np.array(orders) > 0) < 0.1
    assert max(orders) < 5
