"""A test without power is not reported as passed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import armrig
from armrig.cli.model_output import residual_lines

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
