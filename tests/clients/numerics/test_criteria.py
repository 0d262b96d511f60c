"""Criteria of choice, and the simplest model within one standard error."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.criteria import (
    aic,
    batch_means,
    deviance,
    fit_percent,
    fpe,
    mdl,
    simplest_as_good,
    standard_error,
)


def test_the_deviance_follows_from_the_gaussian_density() -> None:
    """-2 log of the density of N residuals, at the variance that maximises it."""
    e = np.random.default_rng(1).standard_normal(50)
    loss = float(np.mean(e**2))

    log_density = -0.5 * np.log(2 * np.pi * loss) - e**2 / (2 * loss)

    assert deviance(loss, e.size) == pytest.approx(-2 * np.sum(log_density))


def test_the_penalty_of_a_parameter_is_2_or_the_logarithm_of_the_samples() -> None:
    assert aic(0.5, 3, 100) - aic(0.5, 2, 100) == pytest.approx(2)
    assert mdl(0.5, 3, 100) - mdl(0.5, 2, 100) == pytest.approx(np.log(100))
    loss, d = np.array([0.5, 0.1]), np.array([2, 3])
    np.testing.assert_array_equal(aic(loss, d, 9), [aic(0.5, 2, 9), aic(0.1, 3, 9)])
    np.testing.assert_array_equal(mdl(loss, d, 9), [mdl(0.5, 2, 9), mdl(0.1, 3, 9)])


def test_a_perfect_model_has_a_finite_criterion() -> None:
    """The logarithm of a loss of 0 is that of the smallest number."""
    least = np.finfo(np.float64).tiny

    assert aic(0.0, 2, 10) == aic(least, 2, 10) < aic(2 * least, 2, 10)
    assert aic(0.0, 2, 10) == pytest.approx(10 * (np.log(2 * np.pi * least) + 1) + 4)


def test_the_final_prediction_error_has_no_bound_with_as_many_parameters_as_samples() -> None:
    """Beyond d = N the formula becomes negative, which would be the best value of all."""
    found = fpe(np.ones(4), np.array([0, 5, 10, 11]), 10)

    np.testing.assert_allclose(found, [1.0, 3.0, np.inf, np.inf])
    assert fpe(0.0, 10, 10) == np.inf


def test_an_undetermined_model_has_no_criterion() -> None:
    assert np.isnan([aic(np.nan, 2, 10), mdl(np.nan, 2, 10), fpe(np.nan, 2, 10)]).all()


def test_batches_account_for_correlated_samples() -> None:
    """The mean of an autoregression scatters by this deviation over runs, not by s / sqrt(N)."""
    from scipy.signal import lfilter

    e = np.random.default_rng(2).standard_normal((400, 3000))
    x = lfilter([1.0], [1.0, -0.8], e)

    told = np.array([float(standard_error(batch_means(row))) for row in x])

    true = np.std(x.mean(axis=1))
    assert np.sqrt(np.mean(told**2)) == pytest.approx(true, rel=0.12)
    assert true > 2 * np.std(x) / np.sqrt(3000)


def test_one_batch_has_no_standard_error() -> None:
    assert standard_error(np.array([1.0])) == 0
    np.testing.assert_allclose(standard_error(np.array([[1.0, 3.0], [2.0, 2.0]])), [1.0, 0.0])
    assert batch_means(np.arange(3.0)).tolist() == [0.0, 1.0, 2.0]
    assert batch_means(np.arange(300.0)).size == 30


def test_the_simplest_within_one_standard_error_is_chosen() -> None:
    excess = np.array([0.0, 0.1, 0.2, 0.05, np.nan])
    std = np.array([0.0, 0.2, 0.1, 0.1, np.nan])

    assert simplest_as_good(excess, std, [5, 3, 1, 4, 0]) == 1
    assert simplest_as_good(excess, std, [5, 3, 1, 3, 0]) == 3
    assert simplest_as_good(excess, std, [2, 3, 1, 3, 0]) == 0


def test_a_fit_is_the_share_of_the_spread_that_is_explained() -> None:
    y = np.array([1.0, 4.0, 7.0, 8.0])  # 5 on average, and 30 = |y - 5|²

    assert fit_percent(y, 30.0) == pytest.approx(0.0)
    assert fit_percent(y, 30.0 / 16) == pytest.approx(75.0)
    assert fit_percent(y, 120.0) == pytest.approx(-100.0)
    assert fit_percent(y, np.inf) == fit_percent(y, np.nan) == -np.inf
    assert np.isnan([fit_percent(np.ones(3), 1.0), fit_percent(y[:0], 0.0)]).all()
