"""The recursion in blocks against one step after the other."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.recursion import free_responses, recursion


@pytest.mark.parametrize("N", [0, 1, 2, 3, 4, 8, 9, 10, 101])
def test_the_blocks_give_what_the_steps_give(N: int) -> None:
    rng = np.random.default_rng(N)
    Phi = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
    w, x0 = rng.normal(size=(N, 2, 3)), rng.normal(size=(2, 3))

    expected = [x0]
    for row in w:
        expected.append(expected[-1] @ Phi.T + row)

    np.testing.assert_allclose(recursion(Phi, w, x0), np.array(expected), rtol=1e-12, atol=1e-12)


def test_one_right_hand_side_keeps_its_shape() -> None:
    x = recursion(np.array([[0.5j]]), np.ones((7, 1)), np.ones(1))

    assert x.shape == (8, 1)
    assert x[1, 0] == 1 + 0.5j


@pytest.mark.parametrize("N", [0, 1, 2, 3, 10, 101])
def test_free_responses_are_the_recursion_without_input(N: int) -> None:
    rng = np.random.default_rng(N)
    Phi, C = 0.5 * rng.standard_normal((3, 3)), rng.standard_normal((2, 3))

    found = free_responses(Phi, C, N)

    expected = recursion(Phi, np.zeros((N, 3, 3)), np.eye(3))[:N] @ C.T
    np.testing.assert_allclose(found, expected.transpose(1, 2, 0), rtol=1e-10, atol=1e-12)
