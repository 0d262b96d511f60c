"""The errors that a bootstrap draws have the covariances of the errors of the model."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.estimation.error_process import error_process
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion

A1 = np.array([[0.6, 0.3], [-0.2, 0.4]])
LAMBDA = np.array([[1.0, 0.5], [0.5, 2.0]])


def errors(seed: int, N: int, A: Array = A1) -> Array:
    """Return errors e(t) = A e(t-1) + w(t) with an offset."""
    w = np.random.default_rng(seed).multivariate_normal([0, 0], LAMBDA, N + 100)
    return recursion(A, w, np.zeros(2))[101:] + np.array([3.0, -1.0])


def covariances(e: Array) -> Array:
    e = e - e.mean(axis=0)
    return np.array([e.T @ e, e[1:].T @ e[:-1]]) / len(e)


@pytest.mark.parametrize("missing", [0.0, 0.05])
def test_drawn_errors_have_the_covariances_of_the_errors(missing: float) -> None:
    e = errors(1, 20_000)
    expected = covariances(e)
    e[np.random.default_rng(2).random(e.shape) < missing] = np.nan

    process = error_process([e[:9000], e[9000:]])
    drawn = process.drawn(np.random.default_rng(3), 20_000)

    assert process.coefficients.shape == (10, 2, 2)
    np.testing.assert_allclose(process.coefficients[0], A1, atol=0.05)
    np.testing.assert_allclose(covariances(drawn), expected, atol=0.15)
    assert np.abs(drawn.mean(axis=0)).max() < 0.1


def test_the_variance_of_short_errors_is_not_too_small() -> None:
    """Ten lags of two outputs fit 20 coefficients of each output to 300 errors."""
    scales = [np.var(error_process([errors(s, 300, 0 * A1)]).w, axis=0) for s in range(40)]

    np.testing.assert_allclose(np.mean(scales, axis=0), np.diag(LAMBDA), rtol=0.03)


def test_few_errors_are_drawn_by_resampling() -> None:
    e = errors(1, 15)

    process = error_process([e])

    assert process.coefficients.shape == (0, 2, 2)
    np.testing.assert_allclose(process.w.mean(axis=0), 0, atol=1e-12)
    drawn = process.drawn(np.random.default_rng(1), 30)
    assert {tuple(row) for row in drawn} <= {tuple(row) for row in process.w}
