"""The sampled models against the core and the emulator's plant, and the problem's derivatives."""

from __future__ import annotations

from dataclasses import asdict, replace

import control
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import telegraph
from armrig.physics.grey_box.physical_models import COULOMB, Physics
from armrig.physics.grey_box.shooting import Shooting
from armrig.physics.systems import ArmParameters, arm, chassis
from armrig_core.rig.arm import chassis_matrices, zero_order_hold
from armrig_core.rig.equations import Course
from numpy.typing import NDArray

from tests.clients.chassis_data import Ts, rubbing

Vector = NDArray[np.float64]
P = ArmParameters(b_1=2e-3)
U = telegraph(600, 0.02, 0.05, 5.0, seed=3)  # 0.05 V does not overcome the friction
CHASSIS = Physics(model=chassis, fixed=P, outputs=("theta_1",))


def response(
    physics: Physics, u: Vector, x0: Vector, T_c: float = 0.0, free: bool = True
) -> Vector:
    """Return the outputs (N, ny) of a single segment."""
    inputs = np.column_stack([u, np.full(u.size, float(free))])
    values = asdict(physics.fixed) | {COULOMB: T_c}
    found = physics.integrate(Course.of(inputs, Ts), x0[:, None, None], values, 1)
    return found.y[:, :, 0, 0]


def test_the_model_is_sampled_like_in_the_core() -> None:
    A, B, _ = chassis_matrices(P)
    Phi, Gamma = zero_order_hold(A, B, Ts)

    (found, by_input), _ = CHASSIS.sampled({}, Ts)

    np.testing.assert_allclose(found, Phi, rtol=1e-13)
    np.testing.assert_allclose(by_input, Gamma, rtol=1e-13)


def test_a_simulation_equals_the_engine_s_and_a_direct_term_acts_on_the_input_less_its_offset() -> (
    None
):
    def direct(p: ArmParameters) -> control.StateSpace:
        system = chassis(p)
        named = {"inputs": ["u"], "outputs": ["theta_1"], "states": system.state_labels}
        return control.ss(system.A, system.B, system.C, 0.7, **named)

    physics = replace(CHASSIS, model=direct)

    plain, through = (response(one, U, np.array([0.0, 0.0, 0.2])) for one in (CHASSIS, physics))

    np.testing.assert_allclose(CHASSIS.simulate({}, U - 0.2, Ts), plain[:, 0], atol=1e-11)
    np.testing.assert_allclose((through - plain)[:, 0], 0.7 * (U - 0.2), atol=1e-11)
    held = response(CHASSIS, U, np.array([0.0, 0.0, 0.2]), free=False)
    np.testing.assert_allclose(CHASSIS.simulate({}, U, Ts), held[:, 0], atol=1e-11)


def test_the_response_with_friction_equals_that_of_the_emulator() -> None:
    """The emulator splits each 0.1 ms; the angles agree to a fraction of a converter step."""
    u = telegraph(2000, 0.02, 0.0, 5.0, seed=4)
    rubs = replace(CHASSIS, friction=True)

    ours = response(rubs, u, np.zeros(3), 0.02)[:, 0]

    assert np.any(np.abs(np.diff(ours)) < 1e-12)  # it does stop
    assert np.abs(ours - rubbing(u, P, 0.02)).max() < 2e-3
    assert np.abs(ours - rubbing(u, replace(P, b_1=0.0), 0.0)).max() > 0.5


def test_zero_friction_gives_the_linear_response() -> None:
    rubs = replace(CHASSIS, friction=True)

    np.testing.assert_allclose(
        response(rubs, U, np.zeros(3))[:, 0], CHASSIS.simulate({}, U, Ts), atol=1e-11
    )


def test_the_arm_turns_back_within_a_step_like_the_chassis() -> None:
    """An arm on a spring that is nearly rigid adds its inertia, so that both rub alike."""
    p = replace(P, J_2=1e-9)
    whole = Physics(model=arm, fixed=p, outputs=("theta_1",), friction=True)
    u, x0 = U - 2.5, np.array([0.3, -20.0, 0.0])

    alone = response(replace(CHASSIS, friction=True), u, x0, 0.02)
    found = response(whole, u, np.array([0.3, 0.0, -20.0, 0.0, 0.0]), 0.02)

    np.testing.assert_allclose(found, alone, atol=1e-4)


@pytest.mark.parametrize("friction", [False, True])
def test_the_derivatives_of_joined_segments_equal_finite_differences(friction: bool) -> None:
    """T_c acts as the voltage T_c R_m / (N K_m), so R_m changes both; two experiments, one gap."""
    names = ("R_m", "N", "b_1", *([COULOMB] * friction))
    parts = [
        Dataset(u=u, y=np.zeros(150), Ts=Ts, valid=np.arange(150) % 50 != 9).signals()
        for u in (U[:150], U[150:300] - 2.5)
    ]
    values = asdict(P) | {COULOMB: 0.02}
    problem = Shooting.of(replace(CHASSIS, friction=friction), names, values, parts)
    eta = problem.coordinates.of([values[name] for name in names])
    z = np.append(eta, [0.1, 3.0, 0.0, -0.2, -2.0, 0.3])
    problem.from_rest(eta)

    J = problem.linearise(z)[1]

    assert J.shape == (294, z.size)
    for k, step in enumerate(1e-6 * np.eye(z.size)):
        before, after = (problem.linearise(z + s * step)[0] for s in (-1, 1))
        differences = (before - after) / 2e-6
        near = 1e-4 * np.abs(differences).max()
        np.testing.assert_allclose(J[:, k], differences, atol=near, err_msg=str(k))


def test_a_friction_below_0_drives_the_motor_as_much_as_its_opposite_brakes_it() -> None:
    (up, _), _ = CHASSIS.sampled({"b_1": 1e-9}, Ts)
    (down, _), _ = CHASSIS.sampled({"b_1": -1e-9}, Ts)
    (rest, _), _ = CHASSIS.sampled({"b_1": 0.0}, Ts)

    np.testing.assert_allclose(up + down, 2 * rest, rtol=1e-12)
    assert down[1, 1] > rest[1, 1] > up[1, 1]
