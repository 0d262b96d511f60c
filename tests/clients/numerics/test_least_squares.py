"""Least squares through an orthonormal basis."""

from __future__ import annotations

import numpy as np
from armrig.numerics.least_squares import least_squares, orthonormal, triangle, without_span


def test_the_solution_does_not_depend_on_the_use_of_a_basis() -> None:
    rng = np.random.default_rng(1)
    M = rng.standard_normal((40, 6)) * 10.0 ** np.arange(-4, 8, 2)
    M[:, 3] = M[:, 0] * 1e3 + M[:, 1]
    M[:, 5] = 0.0
    Y = rng.standard_normal((40, 3))
    before = M.copy()

    basis = orthonormal(M)

    assert basis.rank == 4
    np.testing.assert_allclose(M @ least_squares(M, Y), M @ basis.coefficients(Y), atol=1e-9)
    np.testing.assert_allclose(without_span(M, Y), basis.without(Y), atol=1e-12)
    np.testing.assert_allclose(M.T @ without_span(M, Y) / 1e6, 0.0, atol=1e-9)
    np.testing.assert_array_equal(M, before)


def test_dependent_columns_share_their_coefficient_in_any_order() -> None:
    rng = np.random.default_rng(2)
    M = rng.standard_normal((40, 3))[:, [0, 1, 1, 2, 1]] * [1.0, 1.0, 100.0, 1.0, 1.0]
    y = M @ [1.0, 2.0, 0.01, 3.0, 0.0]
    swap = [4, 2, 0, 1, 3]

    x = least_squares(M, y[:, None])[:, 0]

    np.testing.assert_allclose(x, [1.0, 1.0, 0.01, 3.0, 1.0])
    np.testing.assert_allclose(least_squares(M[:, swap], y[:, None])[:, 0], x[swap])


def test_a_matrix_of_zeros_or_without_columns_explains_nothing() -> None:
    Y = np.ones((3, 2))

    assert not least_squares(np.zeros((3, 2)), Y).any()
    np.testing.assert_array_equal(without_span(np.zeros((3, 0)), Y), Y)
    assert orthonormal(np.zeros((0, 2))).rank == 0


def test_a_triangle_has_the_products_of_all_blocks() -> None:
    """Also with blocks without rows, and with fewer rows than columns."""
    blocks = [np.zeros((0, 3)), np.array([[1.0, 2.0, 4.0]]), np.array([[3.0, -1.0, 5.0]])]

    R = triangle(blocks, 3)

    M = np.vstack(blocks)
    np.testing.assert_allclose(R.T @ R, M.T @ M, atol=1e-13)
    np.testing.assert_array_equal(R, np.triu(R))
    assert triangle([np.zeros((4, 0))], 0).shape == (0, 0)
