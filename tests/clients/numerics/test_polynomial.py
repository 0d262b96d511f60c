"""Polynomials in q^-1, least squares on a basis, and roots at the unit circle."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import (
    EDGE_MODULUS,
    evaluate,
    move_to_edge,
    outward_normals,
    reduce_order,
    reflect_roots,
    roots,
    stable,
    summation,
)
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray


@given(st.lists(st.floats(0.01, 3.0), min_size=0, max_size=4))
def test_a_reflected_polynomial_is_stable_and_keeps_its_stable_roots(z: list[float]) -> None:
    assume(all(abs(abs(a) - abs(b)) > 0.05 for i, a in enumerate(z) for b in z[:i]))
    assume(all(r == 1 or abs(r - 1) > 1e-5 for r in z))
    expected = [min(1 / abs(r), 0.999) if abs(r) >= 1 else r for r in z]

    p = reflect_roots(np.poly(z))

    assert stable(p)
    np.testing.assert_allclose(p, np.poly(expected), atol=1e-6)


def test_a_root_on_the_circle_or_a_coefficient_of_nan_is_not_stable() -> None:
    """The search asks for a trial step that overflowed."""
    for p in ([1.0, -1.0], [1.0, 1.0], [2.0, -2.1], [1.0, np.nan], [1.0, 0.5, np.inf]):
        assert not stable(p)
    for p in ([1.0, -0.999], [2.0, -1.9], [1.0]):
        assert stable(p)


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

    found = [np.sort_complex(roots(p)) for p in reduce_order(np.real(np.poly([0.5, *pair, 0.0])))]

    expected = ([*pair, 0.0], [*pair, 0.5], [-0.8, 0.5, 0.0])
    for one in expected:
        assert sum(np.allclose(np.sort_complex(one), z, atol=1e-12) for z in found) == 1
    assert len(found) == 3


def polynomial(*z: complex) -> NDArray[np.float64]:
    return np.real(np.poly(z))


def test_roots_outside_move_along_their_radius() -> None:
    pair = 1.3 * np.exp(0.7j)
    inside, at_edge = polynomial(0.5, -0.2), polynomial(0.5, EDGE_MODULUS)

    crossing = polynomial(0.5, pair, pair.conjugate(), -2.0)
    moved = np.sort_complex(roots(move_to_edge(crossing, at_edge)))

    expected = [
        0.5,
        pair * EDGE_MODULUS / 1.3,
        pair.conjugate() * EDGE_MODULUS / 1.3,
        -EDGE_MODULUS,
    ]
    np.testing.assert_allclose(moved, np.sort_complex(np.array(expected)), atol=1e-9)
    assert move_to_edge(inside, at_edge) is inside


def test_a_step_goes_nine_tenths_of_the_way_to_the_circle() -> None:
    """The way is that of the outermost root of the previous polynomial."""
    moved = move_to_edge(polynomial(1.5), polynomial(0.8))

    assert roots(moved) == pytest.approx(0.98)


@pytest.mark.parametrize("side", [1, -1])
def test_two_real_roots_outside_become_a_pair(side: int) -> None:
    """Two real roots at one point of the circle could not separate along it."""
    z = roots(move_to_edge(polynomial(1.1 * side, 1.2 * side, 0.3), polynomial(EDGE_MODULUS)))

    assert sum(abs(r.imag) > 5e-4 for r in z) == 2
    assert np.abs(z).max() <= EDGE_MODULUS + 1e-9


def test_a_polynomial_that_is_not_finite_has_no_roots() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        move_to_edge(np.array([1.0, np.nan, 0.0, 0.5]), polynomial(0.1, 0.2, 0.3))


def test_normals_are_the_gradients_of_the_moduli() -> None:
    pair = EDGE_MODULUS * np.exp(0.7j)
    p = polynomial(EDGE_MODULUS, pair, pair.conjugate(), 0.4)
    gradients = []
    for r in (EDGE_MODULUS, pair):
        slopes = []
        for k in range(1, p.size):
            h = 1e-6 * np.eye(p.size)[k]
            near = [min(roots(p + s * h), key=lambda z: abs(z - r)) for s in (1, -1)]
            slopes.append((abs(near[0]) - abs(near[1])) / 2e-6)
        gradients.append(np.array(slopes) / np.linalg.norm(slopes))

    normals = outward_normals(p)

    assert normals.shape == (2, 4)
    for gradient in gradients:
        assert min(np.linalg.norm(normals - gradient, axis=1)) < 1e-6
