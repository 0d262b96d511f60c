"""A test without power is not reported as passed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import armrig
import numpy as np
from armrig.numerics.polynomial import filtered

if TYPE_CHECKING:
    pass


def test_a_constant_input_tests_neither_dynamics_nor_feedback() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 4)
    noise = 0.1 * rng.standard_normal(400)
    fit = armrig.arx(
        armrig.Dataset(u=u, y=filtered([0, 1], [1, -0.7], u) + noise, Ts=0.1), na=1, nb=1
    )

    said = repr(armrig.residuals(fit, armrig.Dataset(u=np.ones(400), y=3.3 + noise, Ts=0.1)))

    assert "dynamics missing: not tested" in said
    assert "feedback: not tested" in said
    assert "no feedback" not in said
