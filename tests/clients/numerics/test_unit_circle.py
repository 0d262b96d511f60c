"""Roots reach the unit circle and do not cross it."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.polynomial import EDGE_MODULUS, drawn_to_edge, outward_normals, roots
from numpy.typing import NDArray


def polynomial(*z: complex) -> NDArray[np.float64]:
    return np.real(np.poly(z))


def test_roots_outside_move_along_their_radius() -> None:
    pair = 1.3 * np.exp(0.7j)
    inside, at_edge = polynomial(0.5, -0.2), polynomial(0.5, EDGE_MODULUS)

    crossing = polynomial(0.5, pair, pair.conjugate(), -2.0)
    moved = np.sort_complex(roots(drawn_to_edge(crossing, at_edge)))

    expected = [
        0.5,
        pair * EDGE_MODULUS / 1.3,
        pair.conjugate() * EDGE_MODULUS / 1.3,
        -EDGE_MODULUS,
    ]
    np.testing.assert_allclose(moved, np.sort_complex(np.array(expected)), atol=1e-9)
    assert drawn_to_edge(inside, at_edge) is inside


def test_a_step_goes_nine_tenths_of_the_way_to_the_circle() -> None:
    """The way is that of the outermost root of the previous polynomial."""
    moved = drawn_to_edge(polynomial(1.5), polynomial(0.8))

    assert roots(moved) == pytest.approx(0.98)


@pytest.mark.parametrize("side", [1, -1])
def test_two_real_roots_outside_become_a_pair(side: int) -> None:
    """Two real roots at one point of the circle could not separate along it."""
    z = roots(drawn_to_edge(polynomial(1.1 * side, 1.2 * side, 0.3), polynomial(EDGE_MODULUS)))

    assert sum(abs(r.imag) > 5e-4 for r in z) == 2
    assert np.abs(z).max() <= EDGE_MODULUS + 1e-9


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
