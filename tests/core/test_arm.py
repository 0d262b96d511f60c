"""The arm's dynamics compared with the handout's numbers."""

from __future__ import annotations

import numpy as np
import pytest
from armrig_core.rig.arm import ArmParameters, arm_matrices, chassis_matrices, zero_order_hold


def test_the_steady_speed_equals_that_of_the_handout() -> None:
    """The back-EMF balances the voltage: 1 / (N K_m) = 1.8623 rad/s per volt."""
    A, B, _ = arm_matrices(ArmParameters())

    Phi, Gamma = zero_order_hold(A, B, 20.0)
    x = Phi @ np.zeros((4, 1)) + Gamma

    assert x[2, 0] == pytest.approx(1.8623, abs=5e-5)
    assert x[1, 0] == pytest.approx(0.0, abs=1e-9)


def test_the_initial_slope_of_the_speed_equals_that_of_the_handout() -> None:
    """At rest all torque accelerates J_1: 98.40 rad/s² per volt."""
    _, B, _ = arm_matrices(ArmParameters())

    assert B[2, 0] == pytest.approx(98.40, abs=5e-3)


def test_the_poles_equal_those_of_the_handout() -> None:
    """Poles 0, -36.739, -8.048 ± 17.081i."""
    A, _, _ = arm_matrices(ArmParameters())

    poles = np.sort_complex(np.linalg.eigvals(A))

    expected = np.sort_complex(np.array([0, -36.739, -8.048 + 17.081j, -8.048 - 17.081j]))
    np.testing.assert_allclose(poles, expected, atol=1e-3)


def test_an_arm_without_mass_gives_the_model_of_the_chassis() -> None:
    """For J_2 -> 0 the arm's transfer function tends to that of the chassis alone."""
    p = ArmParameters(J_2=1e-9)
    s = 10j
    (A, B, C), (a, b, c) = arm_matrices(p), chassis_matrices(p)

    whole = (C @ np.linalg.solve(s * np.eye(4) - A, B))[0, 0]
    alone = (c @ np.linalg.solve(s * np.eye(2) - a, b))[0, 0]

    assert whole == pytest.approx(alone, rel=1e-5)


@pytest.mark.parametrize(("name", "value"), [("J_1", 0.0), ("R_m", -1.0), ("K_m", float("nan"))])
def test_impossible_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}=.*must be finite and > 0"):
        ArmParameters(**{name: value})
