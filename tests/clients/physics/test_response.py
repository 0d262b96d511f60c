"""Sampled models and their derivatives against finite differences and the emulator's plant."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import telegraph
from armrig.physics.grey_box.least_squares_problem import GreyBox, GreyBoxWithFriction
from armrig.physics.grey_box.response import (
    REVERSAL,
    _braked,
    _braked_alone,
    sensitivity,
    with_friction,
)
from armrig.physics.grey_box.sampled_model import Physics, linear_parts
from armrig.physics.systems import ArmParameters, arm, chassis
from armrig_core.rig.arm import chassis_matrices, zero_order_hold
from numpy.typing import NDArray

from tests.clients.chassis_data import Ts, rubbing

Vector = NDArray[np.float64]
P = ArmParameters(b_1=2e-3)
NAMES = ("J_1", "J_2", "N", "K_lin", "R_m", "K_m", "b_1")
U = telegraph(600, 0.02, 0.05, 5.0, seed=3)  # 0.05 V does not overcome the friction


def moved(name: str, x: float) -> dict[str, float]:
    """Return one parameter a little off, in its coordinate."""
    value = getattr(P, name)
    return {name: value + x if name == "b_1" else value * float(np.exp(x))}


def test_the_model_is_sampled_like_in_the_core() -> None:
    A, B, _ = chassis_matrices(P)
    Phi, Gamma = zero_order_hold(A, B, Ts)

    sampled = Physics(model=chassis, fixed=P, output="theta_1").sampled({}, (), Ts)

    np.testing.assert_allclose(sampled.Phi, Phi, rtol=1e-13)
    np.testing.assert_allclose(sampled.Gamma, Gamma[:, 0], rtol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_the_sensitivities_of_the_rig_equal_finite_differences(name: str) -> None:
    physics = Physics(model=arm, fixed=P, output="alpha")
    x0, u0 = np.array([0.3, 0.1, 1.0, -2.0]), 0.2

    def y(x: float) -> Vector:
        forced, free = linear_parts(physics.sampled(moved(name, x), (), Ts), U)
        return forced + free @ np.append(x0, u0)

    ours = sensitivity(physics.sampled(moved(name, 0.0), (name,), Ts), U, x0, u0)[:, 0]

    step = 1e-6 if name == "b_1" else 1e-4
    differences = (y(step) - y(-step)) / (2 * step)
    np.testing.assert_allclose(ours, differences, atol=2e-6 * np.abs(differences).max() + 1e-9)


@pytest.mark.parametrize("name", ["J_1", "K_m", "b_1"])
def test_sensitivities_through_stops_and_starts(name: str) -> None:
    physics = Physics(model=chassis, fixed=P, output="theta_1")

    def y(x: float) -> Vector:
        return with_friction(physics.sampled(moved(name, x), (), Ts), U, np.zeros(2), 0.1, 1)[0]

    sampled = physics.sampled(moved(name, 0.0), (name,), Ts)
    ours, slopes = with_friction(sampled, U, np.zeros(2), 0.1, 1)

    differences = (y(1e-6) - y(-1e-6)) / 2e-6
    assert np.any(np.abs(np.diff(ours)) < 1e-12)  # it does stop
    np.testing.assert_allclose(slopes[:, 0], differences, atol=1e-5 * np.abs(differences).max())


def test_the_response_with_friction_equals_that_of_the_emulator() -> None:
    """The emulator splits each 0.1 ms; the angles agree to a fraction of a converter step."""
    u = telegraph(2000, 0.02, 0.0, 5.0, seed=4)
    V = 0.02 / P.torque_per_volt

    sampled = Physics(model=chassis, fixed=P, output="theta_1").sampled({}, (), Ts)
    ours = with_friction(sampled, u, np.zeros(2), V, 1)[0]

    assert np.abs(ours - rubbing(u, P, 0.02)).max() < 2e-3
    assert np.abs(ours - rubbing(u, replace(P, b_1=0.0), 0.0)).max() > 0.5


def test_zero_friction_gives_the_linear_response() -> None:
    sampled = Physics(model=chassis, fixed=P, output="theta_1").sampled({}, (), Ts)

    np.testing.assert_allclose(
        with_friction(sampled, U, np.zeros(2), 0.0, 1)[0], linear_parts(sampled, U)[0], atol=1e-11
    )


def test_the_special_case_of_one_speed_equals_the_general_friction() -> None:
    sampled = Physics(model=chassis, fixed=P, output="theta_1").sampled({}, (), Ts)
    x0 = np.array([0.3, -20.0])

    frictions, signs = _braked_alone(sampled, U, x0, 0.1, 1)
    expected, expected_signs = _braked(sampled, U, x0, 0.1, 1)

    assert signs == expected_signs
    assert set(signs) == {-1, 0, 1, REVERSAL}
    np.testing.assert_allclose(frictions, expected, atol=1e-12)


def test_a_direct_term_acts_without_delay_on_the_input_less_its_offset() -> None:
    plain = Physics(model=chassis, fixed=P, output="theta_1").sampled({}, ("J_1",), Ts)
    direct, x0 = replace(plain, D=0.7), np.zeros(2)

    (y, free), (y_plain, free_plain) = (linear_parts(model, U) for model in (direct, plain))
    (rubs, slopes), (rubs_plain, slopes_plain) = (
        with_friction(model, U, x0, 0.1, 1) for model in (direct, plain)
    )

    for ours, without in ((y, y_plain), (rubs, rubs_plain)):
        np.testing.assert_allclose(ours - without, 0.7 * U, atol=1e-12)
    np.testing.assert_allclose(free - free_plain, np.tile([0, 0, -0.7], (U.size, 1)), atol=1e-12)
    np.testing.assert_allclose(slopes[:, -1] - slopes_plain[:, -1], -0.7, atol=1e-12)


def test_the_friction_derivatives_equal_finite_differences() -> None:
    """T_c acts as the voltage T_c R_m / (N K_m), so R_m changes both; two experiments, one gap."""
    names = ("R_m", "N", "b_1")
    parts = tuple(
        Dataset(u=u, y=np.zeros(150), Ts=Ts, valid=np.arange(150) % 50 != 9).signals()
        for u in (U[:150], U[150:300] - 2.5)
    )
    physics = Physics(model=chassis, fixed=P, output="theta_1")
    problem = GreyBoxWithFriction(
        plain=GreyBox(physics=(physics,), names=names, experiments=parts), speed=1
    )
    eta = problem.plain.coordinates({name: getattr(P, name) for name in names})
    z = np.concatenate([eta, [0.02], [0.1, 3.0], [-0.2, -2.0, 0.3]])

    J = problem.linearise(z)[1]

    assert J.shape == (294, z.size)
    for k, step in enumerate(1e-6 * np.eye(z.size)):
        before, after = (problem.linearise(z + s * step)[0] for s in (-1, 1))
        differences = (before - after) / 2e-6
        near = 1e-4 * np.abs(differences).max()
        np.testing.assert_allclose(J[:, k], differences, atol=near, err_msg=str(k))


def test_a_custom_model_may_depend_on_the_square_of_a_friction() -> None:
    """The derivative from above is exact to second order; below 0 the model goes on as a line."""

    def mine(p: ArmParameters) -> control.StateSpace:
        return chassis(replace(p, b_1=p.b_1 + 40 * p.b_1**2))

    physics = Physics(model=mine, fixed=P, output="theta_1")

    def y(b_1: float) -> Vector:
        return linear_parts(physics.sampled({"b_1": b_1}, (), Ts), U)[0]

    for b_1, step in ((2e-3, 1e-6), (-3e-3, 1e-6)):
        sampled = physics.sampled({"b_1": b_1}, ("b_1",), Ts)
        ours = sensitivity(sampled, U, np.zeros(2), 0.0)[:, 0]

        differences = (y(b_1 + step) - y(b_1 - step)) / (2 * step)
        near = 1e-5 * np.abs(differences).max()
        np.testing.assert_allclose(ours, differences, atol=near)
