"""The numbers of a step response, and their dependence on each parameter."""

from __future__ import annotations

from dataclasses import replace

import armrig
import control
import numpy as np
import pytest
from armrig.physics.step_response import _roots, step_response
from armrig.physics.systems import ArmParameters, arm, chassis

P = ArmParameters()
T = np.linspace(0.0, 1.0, 501)


def test_the_step_figures_equal_those_of_the_handout() -> None:
    """Assignment 2.2: steady speed, initial slope, poles and zeros."""
    seen = armrig.physics.characteristics()

    assert seen.steady_speed == pytest.approx(1.8623, abs=5e-5)
    assert seen.initial_slope == pytest.approx(98.40, abs=5e-3)
    expected = [0, -8.048 - 17.081j, -8.048 + 17.081j, -36.739]
    np.testing.assert_allclose(
        np.sort_complex(seen.poles), np.sort_complex(np.array(expected)), atol=1e-3
    )
    np.testing.assert_allclose(np.sort(seen.zeros.imag), [-15.745, 15.745], atol=1e-3)


def test_the_step_figures_match_the_simulated_response() -> None:
    p = ArmParameters(J_1=2.5e-3, K_lin=0.8, b_1=0.01)
    seen = armrig.physics.characteristics(p)

    assert step_response(p, np.linspace(0, 20, 2001))[-1] == pytest.approx(seen.steady_speed)
    early = np.linspace(0, 1e-6, 2)
    assert step_response(p, early)[-1] / 1e-6 == pytest.approx(seen.initial_slope, rel=1e-4)
    G = arm(p)[0, 0]
    np.testing.assert_allclose(np.sort_complex(G.zeros()), np.sort_complex(seen.zeros), atol=1e-6)


def test_the_response_equals_that_of_python_control() -> None:
    _, y = control.step_response(arm(P)[1, 0], T)

    np.testing.assert_allclose(step_response(P, T, state="alpha"), y, atol=1e-9)


@pytest.mark.parametrize("name", ["J_1", "J_2", "N", "K_lin", "R_m", "K_m"])
def test_sensitivities_are_the_changes_for_one_per_cent(name: str) -> None:
    """To first order: twice the second difference remains."""
    value = getattr(P, name)
    by = armrig.physics.step_sensitivities(P, T, names=[name], u=2.0)[name]

    up, down = (
        step_response(replace(P, **{name: value * np.exp(x)}), T, u=2.0) for x in (1e-4, -1e-4)
    )
    np.testing.assert_allclose(by, (up - down) / 2e-4, atol=1e-6)


def test_the_sensitivity_to_friction_is_relative_to_the_back_emf() -> None:
    """b_1 may be 0."""
    d = (P.N * P.K_m) ** 2 / P.R_m
    by = armrig.physics.step_sensitivities(P, T, names=["b_1"], model=chassis)["b_1"]

    bits = [step_response(replace(P, b_1=x * d), T, model=chassis) for x in (0.0, 1e-4, 2e-4)]
    np.testing.assert_allclose(by, (4 * bits[1] - 3 * bits[0] - bits[2]) / 2e-4, atol=1e-6)


def test_a_pair_of_roots_is_written_once() -> None:
    z = np.array([0.0, -2.5, -1.0 + 3.0j, -1.0 - 3.0j, 4.0j, -4.0j])

    assert _roots(z) == "0, -2.500, -1.000 ± 3.000i, ±4.000i"


def test_impossible_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="equidistant from 0"):
        armrig.physics.step_sensitivities(P, [0.0, 0.1, 0.3])
    with pytest.raises(ValueError, match="'J' is none of J_1"):
        armrig.physics.step_sensitivities(P, T, names=["J"])
    with pytest.raises(ValueError, match="state='beta' is none of"):
        step_response(P, T, state="beta")
