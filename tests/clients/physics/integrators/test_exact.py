"""The exact solution against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.physics.integrators.stepping import exact
from armrig_core.rig.arm import ArmParameters, arm_matrices
from numpy.typing import NDArray
from scipy.linalg import expm

T = np.linspace(0.0, 7.0, 40)


@pytest.mark.parametrize("t", [T, np.linspace(7.0, 0.0, 2500)], ids=["few", "many, backwards"])
def test_the_solution_of_a_first_order_system_is_exponential(t: NDArray[np.float64]) -> None:
    """By hand: x' = -2 x + 3 sin 5t. A thousand times are computed at once."""
    A, a, w = -2.0, 3.0, 5.0
    steady = a / (A**2 + w**2) * (-A * np.sin(w * t) - w * np.cos(w * t))
    expected = steady + np.exp(A * t) * (0.7 + a * w / (A**2 + w**2))

    np.testing.assert_allclose(exact([[A]], [1.0], a, w, [0.7], t)[:, 0], expected, atol=1e-12)


def test_at_resonance_the_oscillation_grows_in_a_straight_line() -> None:
    """With x'' + w² x = sin wt: (sin wt - wt cos wt)/(2 w²); a sum of modes would divide by 0."""
    w = 3.0

    x = exact([[0.0, 1.0], [-(w**2), 0.0]], [0.0, 1.0], 1.0, w, [0.0, 0.0], T)

    expected = (np.sin(w * T) - w * T * np.cos(w * T)) / (2 * w**2)
    np.testing.assert_allclose(x[:, 0], expected, rtol=1e-10, atol=1e-13)


def test_the_solution_of_the_arm_satisfies_its_equation() -> None:
    A, B, _ = arm_matrices(ArmParameters())
    w, x0 = 5.0, np.array([0.1, -0.2, 0.3, 1.0])

    x = exact(A, B, 2.0, w, x0, T)

    phasor = np.linalg.solve(1j * w * np.eye(4) - A, 2.0 * B[:, 0])
    free = np.array([expm(A * t) @ (x0 - phasor.imag) for t in T])
    np.testing.assert_allclose(x, free + np.imag(np.outer(np.exp(1j * w * T), phasor)), atol=1e-10)


def test_more_than_one_input_is_refused() -> None:
    with pytest.raises(ValueError, match="one input"):
        exact(np.eye(2), np.eye(2), 1.0, 1.0, [0.0, 0.0], T)
