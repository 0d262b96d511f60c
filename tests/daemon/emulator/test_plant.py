"""The plant against the handout, against matrix exponentials, and against the laws of friction."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from armrig_daemon.emulator.plant import REST, State, advance, build
from hypothesis import given
from hypothesis import strategies as st

HANDOUT = ArmParameters()
SECOND_NS = 1_000_000_000
MILLISECOND_NS = 1_000_000


def energy(p: ArmParameters, x: State, *, stiffening: float = 0.0) -> float:
    """Return kinetic and elastic energy, in J."""
    _, alpha, omega, rate = x
    kinetic = p.J_1 * omega**2 / 2 + p.J_2 * (omega + rate) ** 2 / 2
    return kinetic + p.K_lin * alpha**2 / 2 + stiffening * alpha**4 / 4


def test_the_steady_speed_equals_that_of_the_handout() -> None:
    """The back-EMF balances the voltage: 1.8623 rad/s per volt."""
    plant = build(HANDOUT)

    x = advance(plant, REST, 1.0, 20 * SECOND_NS)

    assert x[2] == pytest.approx(1.8623, abs=5e-5)


def test_the_initial_slope_of_the_speed_equals_that_of_the_handout() -> None:
    """At rest all torque accelerates J_1: 98.40 rad/s² per volt."""
    plant = build(HANDOUT)

    x = advance(plant, REST, 1.0, 1_000)

    assert x[2] / 1e-6 == pytest.approx(98.40, abs=1e-2)


@given(dt_ns=st.integers(0, 10 * SECOND_NS), u=st.floats(0, 5))
def test_the_plant_is_integrated_exactly_over_any_duration(dt_ns: int, u: float) -> None:
    A, B, _ = arm_matrices(HANDOUT)
    x0 = (0.3, -0.2, 1.0, 2.0)

    x = advance(build(HANDOUT), x0, u, dt_ns)

    Phi, Gamma = zero_order_hold(A, B, dt_ns * 1e-9)
    np.testing.assert_allclose(x, Phi @ x0 + Gamma[:, 0] * u, rtol=1e-9, atol=1e-9)


@given(first=st.integers(0, SECOND_NS), second=st.integers(0, SECOND_NS))
def test_advance_in_two_steps_equals_one_step(first: int, second: int) -> None:
    plant = build(HANDOUT)

    x = advance(plant, advance(plant, REST, 2.0, first), 2.0, second)

    np.testing.assert_allclose(x, advance(plant, REST, 2.0, first + second), atol=1e-10)


def test_without_the_arm_the_chassis_turns_and_alpha_is_0() -> None:
    plant = build(HANDOUT, arm_removed=True)

    x = advance(plant, REST, 1.0, 10 * MILLISECOND_NS)

    steady, decay = 1 / (HANDOUT.N * HANDOUT.K_m), HANDOUT.damping / HANDOUT.J_1
    assert x[2] == pytest.approx(steady * -np.expm1(-decay * 0.01), rel=1e-12)
    assert (x[1], x[3]) == (0.0, 0.0)


def test_below_the_coulomb_torque_the_chassis_sticks() -> None:
    holding = 0.1
    plant = build(HANDOUT, coulomb_nm=holding)

    x = advance(plant, REST, 0.99 * holding / HANDOUT.torque_per_volt, SECOND_NS)

    assert x == REST


def test_above_the_coulomb_torque_the_chassis_moves() -> None:
    plant = build(HANDOUT, coulomb_nm=0.1)
    u = 2 * 0.1 / HANDOUT.torque_per_volt

    x = advance(plant, REST, u, 100_000)

    assert x[2] / 1e-4 == pytest.approx(0.1 / HANDOUT.J_1, rel=1e-2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stiffening_spring_breaks_the_chassis_away(side: float) -> None:
    alpha = 0.5
    linear, cubic = HANDOUT.K_lin * alpha, 5.0 * alpha**3
    plant = build(HANDOUT, coulomb_nm=linear + 0.5 * cubic, stiffening=5.0)

    x = advance(plant, (0.0, side * alpha, 0.0, 0.0), 0.0, 100_000)

    assert x[2] / 1e-4 == pytest.approx(side * 0.5 * cubic / HANDOUT.J_1, rel=1e-2)


def test_coulomb_friction_reduces_the_terminal_speed_by_its_share() -> None:
    """The speed is lower by T_c R_m / (N K_m)²."""
    plant = build(HANDOUT, coulomb_nm=0.02)

    x = advance(plant, REST, 2.0, 2 * SECOND_NS)

    back_emf = HANDOUT.N * HANDOUT.K_m
    assert x[2] == pytest.approx((2.0 - 0.02 * HANDOUT.R_m / back_emf) / back_emf, rel=1e-5)


def test_energy_decreases_at_0_v() -> None:
    plant = build(HANDOUT, coulomb_nm=0.05, stiffening=2.0)
    x: State = (0.0, 0.6, 3.0, 0.0)

    energies = [energy(HANDOUT, x, stiffening=2.0)]
    for _ in range(1000):
        x = advance(plant, x, 0.0, MILLISECOND_NS)
        energies.append(energy(HANDOUT, x, stiffening=2.0))

    assert all(after <= before * (1 + 1e-6) for before, after in pairwise(energies))


def test_a_turning_chassis_comes_to_rest_and_stays() -> None:
    plant = build(HANDOUT, coulomb_nm=0.05)
    x: State = (0.0, 0.03, 0.5, -0.5)

    x = advance(plant, x, 0.0, 200 * MILLISECOND_NS)
    later = advance(plant, x, 0.0, SECOND_NS)

    assert (x[2], later[2]) == (0.0, 0.0)
    assert later[0] == x[0]


def test_a_chassis_held_by_friction_lets_the_arm_swing() -> None:
    """The arm is then a free oscillator of sqrt(K_lin / J_2), whose energy stays."""
    plant = build(HANDOUT, coulomb_nm=1.0)
    x0 = (0.0, 0.2, 0.0, 0.0)
    period_ns = round(2 * np.pi * np.sqrt(HANDOUT.J_2 / HANDOUT.K_lin) * 1e9)

    x = advance(plant, x0, 0.0, 5 * period_ns)

    np.testing.assert_allclose(x, x0, atol=1e-7)


@pytest.mark.parametrize(("coulomb_nm", "stiffening"), [(0.03, 0.0), (0.0, 5.0), (0.03, 5.0)])
def test_halving_the_substep_divides_the_error_by_four(
    coulomb_nm: float, stiffening: float
) -> None:
    """Strang's splitting is of second order while the chassis keeps its direction."""
    x0 = (0.0, 0.5, 5.0, 0.0)
    ends = []
    for substep_ns in (4_000_000, 2_000_000, 1_000_000, 7_812):
        plant = build(HANDOUT, coulomb_nm=coulomb_nm, stiffening=stiffening, substep_ns=substep_ns)
        ends.append(np.array(advance(plant, x0, 5.0, 64 * MILLISECOND_NS)))

    coarse, middle, fine = (np.linalg.norm(end - ends[-1]) for end in ends[:-1])

    assert coarse / middle == pytest.approx(4, rel=0.1)
    assert middle / fine == pytest.approx(4, rel=0.1)


def test_a_decreasing_time_is_refused() -> None:
    with pytest.raises(ValueError, match="dt_ns=-1 must be >= 0"):
        advance(build(HANDOUT), REST, 0.0, -1)
