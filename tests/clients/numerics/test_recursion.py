"""The recursion in blocks against one step after the other."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.recursion import (
    free_responses,
    in_observer_form,
    outputs,
    recursion,
    responses,
)
from numpy.typing import NDArray


@pytest.mark.parametrize("N", [0, 1, 2, 3, 4, 8, 9, 10, 101])
def test_blocks_and_single_steps_give_the_same_recursion(N: int) -> None:
    rng = np.random.default_rng(N)
    Phi = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
    w, x0 = rng.normal(size=(N, 2, 3)), rng.normal(size=(2, 3))

    expected = [x0]
    for row in w:
        expected.append(expected[-1] @ Phi.T + row)

    np.testing.assert_allclose(recursion(Phi, w, x0), np.array(expected), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("N", [0, 1, 2, 3, 10, 101])
def test_free_responses_are_the_recursion_without_input(N: int) -> None:
    rng = np.random.default_rng(N)
    Phi, C = 0.5 * rng.standard_normal((3, 3)), rng.standard_normal((2, 3))

    found = free_responses(Phi, C, N)

    expected = recursion(Phi, np.zeros((N, 3, 3)), np.eye(3))[:N] @ C.T
    np.testing.assert_allclose(found, expected.transpose(1, 2, 0), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    "Phi",
    [
        np.diag([0.9, -0.5, 0.2]),
        np.array([[0.8, 0.3, 0.1], [-0.4, 0.7, 0.0], [0.2, 0.0, 0.5]]),
        np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]]),
    ],
    ids=["real modes", "a pair", "one eigenvector"],
)
@pytest.mark.parametrize("ny", [1, 2])
def test_the_response_is_computed_for_each_signal_and_state(
    Phi: NDArray[np.float64], ny: int
) -> None:
    rng = np.random.default_rng(4)
    signals, C = rng.standard_normal((30, 2)), rng.standard_normal((ny, 3))

    found = responses(Phi, C, signals)

    assert found.shape == (2, 3, ny, 30)
    for j, s in enumerate(signals.T):
        for k, unit in enumerate(np.eye(3)):
            x, expected = np.zeros(3), []
            for value in s:
                expected.append(C @ x)
                x = Phi @ x + unit * value
            np.testing.assert_allclose(found[j, k], np.transpose(expected), atol=1e-12)


@pytest.mark.parametrize("N", [1, 3, 101])
def test_the_observer_form_has_the_responses_of_the_recursion(N: int) -> None:
    rng = np.random.default_rng(N)
    Phi, C = np.eye(3, k=1), np.eye(1, 3)
    Phi[:, 0] = [1.5, -0.9, 0.2]
    signals, w, x0 = rng.normal(size=(N, 2)), rng.normal(size=(N, 3)), rng.normal(size=3)

    assert in_observer_form(Phi, C)
    assert not in_observer_form(Phi.T, C)
    driven = responses(Phi, C, signals)
    for j, k in np.ndindex(2, 3):
        expected = recursion(Phi, signals[:, j, None] * np.eye(3)[k], np.zeros(3))[:-1] @ C.T
        np.testing.assert_allclose(driven[j, k, 0], expected[:, 0], atol=1e-12)
    free = recursion(Phi, np.zeros((N, 3, 3)), np.eye(3))[:-1] @ C.T
    np.testing.assert_allclose(free_responses(Phi, C, N)[:, 0], free[:, :, 0].T, atol=1e-12)
    np.testing.assert_allclose(outputs(Phi, C, w, x0), recursion(Phi, w, x0)[:-1] @ C.T, atol=1e-12)
