"""The physics as python-control systems, and as a transfer function of the sampled model."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.physics.systems import ArmParameters, beside_the_handout, chassis, transfer
from armrig_core.rig.arm import chassis_matrices


def test_the_chassis_responds_with_its_time_constant_and_gain() -> None:
    """G = K / (s (1 + s tau)) with K = 1.8623 rad/(s V) and 1/tau = 52.836 1/s."""
    s = 3.0j

    G = chassis(ArmParameters())(s)

    assert pytest.approx(1.8623 / (s * (1 + s / 52.836)), rel=1e-4) == G


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({}, ["handout"]),
        ({"J_2": 0.004}, ["handout", "J_2=0.004"]),
        ({"J_2": 0.004, "b_1": 0.01}, ["handout", "J_2=0.004", "b_1=0.01", "both"]),
        (
            {"J_1": 0.002, "J_2": 0.004, "N": 60.0},
            ["handout", "J_1=0.002", "J_2=0.004", "N=60", "all"],
        ),
    ],
)
def test_each_case_has_the_name_of_its_change(changes: dict[str, float], names: list[str]) -> None:
    p = ArmParameters(**changes)

    cases = beside_the_handout(p)

    assert list(cases) == names
    assert cases["handout"] == ArmParameters()
    assert cases[names[-1]] == p


@pytest.mark.parametrize("Ts", [1e-2, 1e-3])
def test_the_chassis_has_the_textbooks_coefficients(Ts: float) -> None:
    """From K/(s (tau s + 1)): a pole at 1, one at exp(-Ts/tau), and B by partial fractions.

    At 1 kHz B is about 1e-5, and has all of its digits.
    """
    p = ArmParameters()
    A, B, C = chassis_matrices(p)
    K, tau = p.torque_per_volt / p.damping, p.J_1 / p.damping
    x, a = Ts / tau, np.exp(-Ts / tau)

    b, f = transfer(A, B, C[0], Ts)

    np.testing.assert_allclose(f, [1.0, -1.0 - a, a], rtol=1e-14)
    first, second = np.expm1(-x) + x, -np.expm1(-x) - x * a
    np.testing.assert_allclose(b, [0.0, K * tau * first, K * tau * second], rtol=1e-12)
