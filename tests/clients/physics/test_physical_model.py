"""Transfer functions of sampled state spaces."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.physics.systems import ArmParameters, transfer
from armrig_core.rig.arm import chassis_matrices


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
