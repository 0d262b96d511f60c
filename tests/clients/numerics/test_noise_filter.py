"""Innovations of noise with missing samples, against the covariance matrix of the noise."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.noise_filter import NoiseFilter
from armrig.numerics.polynomial import Array, filtered, impulse
from scipy.linalg import toeplitz

N = 120
C, D = np.array([1.0, -0.5, 0.2]), np.array([1.0, -1.2, 0.5])
GAPS = {"none": [], "one": [40], "scattered": [0, 3, 4, 9, 50, 51, 53, 118], "long": range(30, 90)}


def known(gaps: str) -> Array:
    """Return the rows of a pattern of missing samples."""
    rows = np.ones(N, dtype=np.bool_)
    rows[list(GAPS[gaps])] = False
    return rows


@pytest.mark.parametrize("gaps", GAPS)
def test_innovations_equal_those_of_the_covariance_matrix(gaps: str) -> None:
    rows = known(gaps)
    v = filtered(C, D, np.random.default_rng(1).normal(size=N))
    L = np.tril(toeplitz(filtered(C, D, np.eye(1, N)[0])))
    R = (L @ L.T)[np.ix_(rows, rows)]

    e, _, log_scale = NoiseFilter(C=C, D=D, rows=rows).columns(v[:, None])

    expected = np.linalg.solve(np.linalg.cholesky(R), v[rows])
    np.testing.assert_allclose(e[rows, 0], expected, rtol=1e-9, atol=1e-12)
    assert not e[~rows].any()
    assert log_scale == pytest.approx(np.linalg.slogdet(R)[1], abs=1e-9)


@pytest.mark.parametrize("gaps", GAPS)
def test_derivatives_equal_finite_differences(gaps: str) -> None:
    v = np.random.default_rng(2).normal(size=N)
    x0 = np.array([0.7, -0.3])
    h = 1e-6

    def at(c: Array, d: Array) -> tuple[Array, float]:
        e, past, log_scale = NoiseFilter(C=c, D=d, rows=known(gaps)).columns(v[:, None])
        return e[:, 0] + past @ x0, log_scale

    J, by_scale = NoiseFilter(C=C, D=D, rows=known(gaps)).derivatives(v, x0)

    for k in range(4):
        step = h * np.eye(6)[(1, 2, 4, 5)[k]]
        (up, up_scale), (down, down_scale) = (
            at(C + s * step[:3], D + s * step[3:]) for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(J[:, k], (up - down) / (2 * h), atol=1e-6)
        assert by_scale[k] == pytest.approx((up_scale - down_scale) / (2 * h), abs=1e-6)


def test_the_innovations_of_white_noise_equal_the_noise() -> None:
    rows = known("scattered")
    one = np.ones(1)

    e, past, log_scale = NoiseFilter(C=one, D=one, rows=rows).columns(impulse([1.0], N)[:, None])

    assert past.shape == (N, 0)
    assert log_scale == 0.0
    np.testing.assert_array_equal(e[:, 0], np.where(rows, impulse([1.0], N), 0.0))
