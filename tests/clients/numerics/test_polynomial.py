"""Polynomials in q^-1, and least squares on a basis."""

from __future__ import annotations

import numpy as np
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import (
    evaluate,
    reduced,
    reflected,
    roots,
    stable,
    summation,
)
from hypothesis import assume, given
from hypothesis import strategies as st


@given(st.lists(st.floats(0.01, 3.0), min_size=0, max_size=4))
def test_a_reflected_polynomial_is_stable_and_keeps_its_stable_roots(z: list[float]) -> None:
    assume(all(abs(abs(a) - abs(b)) > 0.05 for i, a in enumerate(z) for b in z[:i]))
    assume(all(r == 1 or abs(r - 1) > 1e-5 for r in z))
    expected = [min(1 / abs(r), 0.999) if abs(r) >= 1 else r for r in z]

    p = reflected(np.poly(z))

    assert stable(p)
    np.testing.assert_allclose(p, np.poly(expected), atol=1e-6)


def test_a_root_on_the_circle_is_not_stable() -> None:
    assert not stable([1.0, -1.0])
    assert not stable([1.0, 1.0])
    assert not stable([2.0, -2.1])
    assert stable([1.0, -0.999])
    assert stable([2.0, -1.9])
    assert stable([1.0])


def test_a_polynomial_with_a_coefficient_of_nan_is_not_stable() -> None:
    """The search asks for a trial step that overflowed."""
    assert not stable([1.0, np.nan])
    assert not stable([1.0, 0.5, np.inf])


def test_a_polynomial_is_stable_if_all_roots_are_inside_the_circle() -> None:
    """300 polynomials with real roots and pairs, on both sides of the circle."""
    rng = np.random.default_rng(28)
    polynomials = [
        np.real(np.poly([*(r * np.exp([1j * w, -1j * w])), x]))
        for r, w, x in rng.uniform([0.8, 0.1, -1.2], [1.1, 3.0, 1.2], (300, 3))
    ]

    told = [stable(p) for p in polynomials]

    assert told == [bool(np.all(np.abs(np.roots(p)) < 1.0)) for p in polynomials]
    assert 100 < sum(told) < 250


def test_rows_of_zeros_change_a_basis_only_by_rows_of_zeros() -> None:
    rng = np.random.default_rng(1)
    M, y, rows = rng.standard_normal((20, 2)), rng.standard_normal(30), np.arange(30) % 3 != 1

    basis = orthonormal(M).spread(rows)

    assert not basis.Q[~rows].any()
    ours, plain = basis.coefficients(y), orthonormal(M).coefficients(y[rows])
    np.testing.assert_allclose(ours, plain, rtol=1e-13)  # as sums in another order may differ


def test_the_summation_is_the_response_from_a_rate_to_its_sum() -> None:
    """Ts / (1 - q^-1) on the unit circle, infinite at 0."""
    Ts, omega = 0.01, np.array([0.0, 3.0, 200.0])

    S = summation(omega, Ts)

    assert S[0] == np.inf
    x = np.exp(-1j * omega[1:] * Ts)
    np.testing.assert_allclose(S[1:] * evaluate([1, -1], x), Ts)


def test_a_reduced_polynomial_lacks_a_real_root_or_has_one_for_a_pair() -> None:
    pair = 0.8 * np.exp(1j * np.array([2.0, -2.0]))  # left of the imaginary axis

    found = [np.sort_complex(roots(p)) for p in reduced(np.real(np.poly([0.5, *pair, 0.0])))]

    expected = ([*pair, 0.0], [*pair, 0.5], [-0.8, 0.5, 0.0])
    for one in expected:
        assert sum(np.allclose(np.sort_complex(one), z, atol=1e-12) for z in found) == 1
    assert len(found) == 3
