"""Monte Carlo of the reported standard deviations and of the tests' levels."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.arx import arx
from armrig.estimation.polynomial_structures import oe
from armrig.excitation import telegraph
from armrig.models.fit import Fit
from armrig.numerics.polynomial import apply_filter
from armrig.validation.residuals import residuals

from tests.sampling import sampled

RUNS, N = 200, 500
B, A = np.array([0, 1, 0.5]), np.array([1, -1.2, 0.6])


def arx_data(seed: int) -> Dataset:
    """Return A y = B u + e with white e."""
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, seed=rng)
    e = apply_filter([1], A, 0.3 * rng.standard_normal(N))
    return Dataset(u=u, y=apply_filter(B, A, u) + e, Ts=1)


def oe_data(seed: int, colour: float = 0.0) -> Dataset:
    """Return y = B/A u + e/(1 - colour q^-1)."""
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, seed=rng)
    e = apply_filter([1], [1, -colour], 0.3 * rng.standard_normal(N + 50))[50:]
    return Dataset(u=u, y=apply_filter(B, A, u) + e, Ts=1)


@cache
def estimate_arx(seed: int) -> Fit:
    return arx(arx_data(seed), na=2, nb=2)


@cache
def estimate_oe(seed: int) -> Fit:
    return oe(oe_data(seed), nb=2, nf=2, starts="few")


@pytest.mark.parametrize(
    ("estimate", "truth"),
    sampled([(estimate_arx, [-1.2, 0.6, 1, 0.5]), (estimate_oe, [1, 0.5, -1.2, 0.6])]),
)
def test_standard_deviations_and_intervals_hold(
    estimate: Callable[[int], Fit], truth: list[float]
) -> None:
    """Ratio of reported to true 0.85-1.15, coverage of 95 % intervals 0.92-0.98."""
    fits = [estimate(seed) for seed in range(RUNS)]
    error = np.array([fit.theta for fit in fits]) - truth
    scatter = error.std(axis=0, ddof=1)

    for std in (np.array([f.std for f in fits]), np.array([f.std_robust for f in fits])):
        ratio = std.mean(axis=0) / scatter
        coverage = (np.abs(error) < 1.96 * std).mean(axis=0)

        assert ((ratio > 0.85) & (ratio < 1.15)).all(), ratio
        assert ((coverage > 0.92) & (coverage < 0.98)).all(), coverage


@pytest.mark.exhaustive
def test_robust_deviations_hold_for_coloured_noise() -> None:
    """The classic form errs by a third for the noise 1/(1 - 0.8 q^-1) e."""
    fits = [oe(oe_data(seed, colour=0.8), nb=2, nf=2, starts="few") for seed in range(RUNS)]
    scatter = np.array([fit.theta for fit in fits]).std(axis=0, ddof=1)

    classic, robust = (
        np.mean([getattr(fit, name) for fit in fits], axis=0) / scatter
        for name in ("std", "std_robust")
    )

    assert ((robust > 0.85) & (robust < 1.15)).all(), robust
    assert classic.min() < 0.8
    assert all("trust std_robust" in repr(fit) for fit in fits)


@pytest.mark.parametrize(
    ("estimate", "data"), sampled([(estimate_arx, arx_data), (estimate_oe, oe_data)])
)
@pytest.mark.parametrize("ahead", sampled([10_000, 0]))
def test_the_residual_tests_keep_their_level(
    estimate: Callable[[int], Fit], data: Callable[[int], Dataset], ahead: int
) -> None:
    """Level 5 % within three standard deviations, on estimation data and on fresh data."""
    tests = [residuals(estimate(seed), data(seed + ahead)) for seed in range(RUNS)]

    p = np.array([[t.white.p_value, t.missing_dynamics, t.feedback] for t in tests])

    alarms = (p < 0.05).mean(axis=0)
    assert (np.abs(alarms - 0.05) < 3 * np.sqrt(0.05 * 0.95 / RUNS)).all(), alarms
    assert all(t.on_estimation_data == (ahead == 0) for t in tests)


@pytest.mark.exhaustive
@pytest.mark.parametrize("ahead", [0, 10_000])
def test_few_lags_allow_for_the_parameters_too(ahead: int) -> None:
    """With as many parameters as lags, uncorrected p values would accumulate at one end."""
    p = []
    for seed in range(200):
        noisy, fresh = oe_data(seed), oe_data(seed + ahead)
        e = apply_filter([1], A, np.random.default_rng(seed).standard_normal(N))
        f = apply_filter([1], A, np.random.default_rng(seed + ahead).standard_normal(N))
        weak = arx(Dataset(u=noisy.u, y=e, Ts=1), na=2, nb=1)
        white = residuals(weak, Dataset(u=fresh.u, y=f, Ts=1), lags=3).white.p_value
        p.append([white, residuals(estimate_oe(seed), fresh, lags=4).missing_dynamics])

    np.testing.assert_allclose(np.mean(p, axis=0), 0.5, atol=0.08)
