"""A test without power is not reported as passed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import armrig
import numpy as np
from armrig.cli.model_output import residual_lines
from armrig.numerics.polynomial import filtered

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant


def test_a_test_without_power_says_so_and_what_would_give_it_power(plant: HandoutPlant) -> None:
    """Uncertain parameters accept anything, such as a pole within rounding of 1."""
    fit = armrig.oe(plant.dataset(1, N=800), nb=4, nf=4, integrator=True)
    other = plant.dataset(2, N=800)
    unsure = replace(fit, covariance_robust=1e6 * fit.covariance_robust)

    sound, blind = armrig.residuals(fit, other), armrig.residuals(unsure, other)

    assert sound.powerless == ""
    assert sound.allowance < 3
    assert blind.allowance > 100
    assert blind.missing_dynamics > 0.9
    assert "no test has power" in repr(blind)
    assert "option integrator" in repr(blind)
    assert "no power: " in "\n".join(residual_lines(blind))
    assert "option integrator" in "\n".join(residual_lines(blind))
    assert armrig.residuals(unsure, plant.dataset(1, N=800)).powerless == ""


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
