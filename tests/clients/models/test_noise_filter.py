"""Innovations of noise with missing samples, against the covariance matrix of the noise."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.models.noise_filter import noise_filter, noise_projection
from armrig.numerics.kalman_gains import kalman_gains
from armrig.numerics.polynomial import Array, apply_filter, impulse, lag_columns
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
    v = apply_filter(C, D, np.random.default_rng(1).normal(size=N))
    L = np.tril(toeplitz(apply_filter(C, D, np.eye(1, N)[0])))
    R = (L @ L.T)[np.ix_(rows, rows)]

    found = noise_filter(C, D, rows)
    e = found.innovations(v)

    expected = np.linalg.solve(np.linalg.cholesky(R), v[rows])
    np.testing.assert_allclose(e[rows], expected, rtol=1e-9, atol=1e-12)
    assert not e[~rows].any()
    assert found.log_scale == pytest.approx(np.linalg.slogdet(R)[1], abs=1e-9)


@pytest.mark.parametrize("gaps", GAPS)
def test_a_known_input_of_the_noise_changes_no_innovation(gaps: str) -> None:
    """D v = z + C e has the same innovations as D v = C e, if z is known."""
    z, e = np.random.default_rng(2).normal(size=(2, N))
    both, alone = apply_filter([1.0], D, z) + apply_filter(C, D, e), apply_filter(C, D, e)
    found = noise_filter(C, D, known(gaps))

    difference = found.innovations(both) - found.responses(z[:, None])[:, 0]

    np.testing.assert_allclose(difference, found.innovations(alone), atol=1e-10)


@pytest.mark.parametrize("gaps", GAPS)
def test_pulses_at_the_start_have_the_effect_of_an_unknown_state(gaps: str) -> None:
    """With its free response, the noise of another past has the same innovations."""
    rows, e = known(gaps), np.random.default_rng(2).normal(size=N + 50)
    late = apply_filter(C, D, e)[50:]
    found = noise_filter(C, D, rows)
    pulses = found.responses(lag_columns(impulse([1.0], N), range(2)))

    left = found.innovations(late) - found.innovations(apply_filter(C, D, e[50:]))

    x = np.linalg.lstsq(pulses, left, rcond=None)[0]
    np.testing.assert_allclose(pulses @ x, left, atol=1e-10)


@pytest.mark.parametrize("gaps", GAPS)
def test_derivatives_equal_finite_differences(gaps: str) -> None:
    v, z = np.random.default_rng(2).normal(size=(2, N))
    h = 1e-6

    def at(c: Array, d: Array) -> tuple[Array, float]:
        found = noise_filter(c, d, known(gaps))
        return found.innovations(v) - found.responses(z[:, None])[:, 0], found.log_scale

    J, by_scale = noise_filter(C, D, known(gaps)).derivatives(v, z)

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

    found = noise_filter(one, one, rows)

    assert found.log_scale == 0.0
    e = found.innovations(impulse([1.0], N))
    np.testing.assert_array_equal(e, np.where(rows, impulse([1.0], N), 0.0))


def test_the_filter_of_an_extremely_unstable_D_is_finite_after_gaps() -> None:
    """A search may try such a D."""
    unstable = np.array([1.0, -400.0, 3.0, 2.0])
    rows = np.ones(N, dtype=np.bool_)
    rows[[*range(10, 22), *range(30, 40)]] = False

    found = noise_filter(np.array([1.0, 0.5, 0.2]), unstable, rows)

    assert found.filter.gains is not None
    assert np.isfinite(found.filter.gains.gain).all()
    assert np.isfinite(found.filter.white).all()


@pytest.mark.parametrize("pole", [1.05, 1.3, 3.0])
def test_the_gains_of_an_unstable_model_after_a_long_gap_are_no_error(pole: float) -> None:
    """Two outputs; the variances reach 1e200, or exceed the range of numbers and are NaN."""
    rows = np.ones((3000, 2), dtype=np.bool_)
    rows[100:2500] = rows[50, 0] = False
    A, C = np.diag([pole, 0.5]), np.array([[1.0, 0.2], [0.3, 1.0]])

    found = kalman_gains(A, C, 0.3 * np.ones((2, 2)), np.eye(2), rows)

    assert np.isfinite(found.gain[:100]).all()
    assert np.isfinite(found.gain).all() == (pole < 1.1)


def test_missing_samples_have_no_band_if_the_response_is_long_or_infinite() -> None:
    rows = known("scattered")

    for C in ([1.0, -50.0], [1.0, 3.0, 2.0], [1.0, -1e200]):
        found = noise_projection(np.array(C), D, rows)
        assert found is None or np.isfinite(found.missing.band).all()
    assert noise_projection(np.array([1.0, -0.9999]), D, np.arange(20_000) % 7 > 0) is None


@pytest.mark.parametrize("gaps", ["one", "scattered", "long"])
def test_estimated_samples_leave_the_squares_of_the_innovations(gaps: str) -> None:
    """And the same sum of the logarithms of their variances, and the same slopes."""
    v, z = np.random.default_rng(2).normal(size=(2, N))
    found, filtered_ = noise_projection(C, D, known(gaps)), noise_filter(C, D, known(gaps))
    assert found is not None

    both = [f.innovations(v) - f.responses(z[:, None])[:, 0] for f in (found, filtered_)]
    slopes = [f.derivatives(v, z) for f in (found, filtered_)]

    assert both[0] @ both[0] == pytest.approx(both[1] @ both[1], rel=1e-9)
    assert found.log_scale == pytest.approx(filtered_.log_scale, abs=1e-9)
    gradients = [J.T @ e for (J, _), e in zip(slopes, both, strict=True)]
    np.testing.assert_allclose(*gradients, rtol=1e-6)
    np.testing.assert_allclose(slopes[0][1], slopes[1][1], atol=1e-6)
