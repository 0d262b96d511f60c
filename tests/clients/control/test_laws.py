"""The laws of pid, place and lqg (armrig.control) do on the plant what their design says."""

from __future__ import annotations

from typing import Any

import armrig
import control
import numpy as np
import pytest
from armrig.control.loop import LawMatrices, close_loop, simulate
from armrig.control.plant import design_model
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError
from armrig_core.rig.description import builtin

from tests.clients.control import plants

ARM = armrig.physics.arm(armrig.physics.ArmParameters())
POLES = [-18 + 18j, -18 - 18j, -42]
LAG = plants.model([0, 0.1], [1, -0.9])
"""Gain 1, and a time constant of 0.475 s."""
LATE = plants.model([0] * 16 + [0.1], [1, -0.9])
"""The same with a dead time of 15 samples."""
TWO_LAGS = plants.model([0, 0.02, 0.015], [1, -1.5, 0.56])
ANGLE = plants.model([0, 0.01, 0.008], [1, -1.8, 0.8], integrator=True, output="theta", unit="rad")


def _two_outputs() -> armrig.Fit:
    data = armrig.example_recording().signals()
    return armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")


def _predicted(law: ControlLaw, model: Any, r: Any) -> tuple[Any, Any]:
    design = design_model(model)
    matrices = LawMatrices.of(law, [o.name for o in design.outputs])
    y, u = simulate(close_loop(matrices, [design.plant]), r)
    return y[0], u[0]


@pytest.mark.parametrize(
    ("name", "law", "model"),
    [
        ("pid", lambda m: armrig.control.pid(m), TWO_LAGS),
        ("lambda", lambda m: armrig.control.pid(m, time_constant=0.4), LAG),
        ("pid of a late plant", lambda m: armrig.control.pid(m), LATE),
        ("rate", lambda m: armrig.control.pid(m, rate=True), ANGLE),
        ("place", lambda m: armrig.control.place(m, [-4, -5]), TWO_LAGS),
        ("place with 15 samples of dead time", lambda m: armrig.control.place(m, [-0.7]), LATE),
        ("lqg with 15 samples of dead time", lambda m: armrig.control.lqg(m, effort=8), LATE),
        (
            "lqg with 3 samples as states",
            armrig.control.lqg,
            plants.model([0] * 4 + [0.1], [1, -0.9]),
        ),
        ("lqg of an angle", lambda m: armrig.control.lqg(m, reference=(-1, 1)), ANGLE),
        ("lqg of two outputs", lambda m: armrig.control.lqg(m, effort=0.5), "two outputs"),
    ],
)
def test_a_predicted_step_is_that_of_a_direct_simulation(name: str, law: Any, model: Any) -> None:
    """The difference equations of model and law give the same y and u to 1e-12."""
    model = _two_outputs() if model == "two outputs" else model
    designed = law(model)
    r = np.ones(300)

    y, u = _predicted(designed, model, r)
    y_direct, u_direct = plants.simulate(designed, model, r)

    assert "late" not in name or designed.input_delay == 0
    assert ("15 samples" in name) == (designed.input_delay == 15)
    scale = np.abs(y_direct).max()
    np.testing.assert_allclose(y, y_direct, rtol=0, atol=1e-12 * max(scale, 1.0))
    np.testing.assert_allclose(u, u_direct, rtol=0, atol=1e-12 * max(np.abs(u_direct).max(), 1.0))


@pytest.mark.parametrize(
    "law",
    [
        armrig.control.pid(LAG),
        armrig.control.pid(LAG, time_constant=0.3),
        armrig.control.place(TWO_LAGS, [-4, -5]),
        armrig.control.lqg(LATE, effort=8),
    ],
    ids=["pid", "lambda", "place", "lqg"],
)
def test_an_output_follows_r_despite_a_disturbance_of_the_input(law: ControlLaw) -> None:
    model = {2: LAG, 3: TWO_LAGS}[law.order] if not law.input_delay else LATE
    design = design_model(model)
    loop = close_loop(LawMatrices.of(law, ["y"]), [design.plant])

    y, u = simulate(loop, np.ones(3000), np.full(3000, 0.7))

    assert y[0, -1, 0] == pytest.approx(1.0, abs=1e-6)
    assert u[0, -1] == pytest.approx(1 / design.plant.gain(0) - 0.7, abs=1e-6)


def test_place_gives_the_poles_that_are_asked_for_and_those_of_the_observer() -> None:
    observer = [-30, -31, -33, -35 + 10j, -35 - 10j]
    law = armrig.control.place(ARM, POLES, observer=observer, rate=True, Ts=0.01)
    design = design_model(ARM, Ts=0.01)

    poles = close_loop(LawMatrices.of(law, ["theta_1", "alpha"]), [design.plant]).poles[0]

    s = np.log(poles[np.abs(poles - 1) > 1e-9]) / 0.01
    np.testing.assert_allclose(
        np.sort_complex(s), np.sort_complex(np.array(POLES + observer)), rtol=1e-6
    )
    assert np.count_nonzero(np.abs(poles - 1) < 1e-9) == 1  # the angle


def test_the_law_of_the_arm_is_that_of_the_design_notes() -> None:
    """K = (-10.43, 0.450, 0.230) for α, the speed and the rate of α."""
    law = armrig.control.place(ARM, POLES, rate=True, Ts=0.01)

    np.testing.assert_allclose(np.array(law.C)[1:4], [10.43, -0.450, -0.230], rtol=6e-3)
    assert law.C[4] == -1.0
    assert law.F is not None


def test_a_law_of_a_system_without_units_has_those_of_its_rig() -> None:
    law = armrig.control.place(ARM, POLES, rate=True, Ts=0.01)

    assert [output.unit for output in law.outputs] == ["rad", "rad"]
    law.check_rig(builtin("arm"), law.Ts_us, 0.0, 5.0)


def test_with_a_dead_time_the_poles_are_exact_and_the_others_are_faster() -> None:
    law = armrig.control.place(LATE, [-0.7])
    design = design_model(LATE)

    poles = close_loop(LawMatrices.of(law, ["y"]), [design.plant]).poles[0]

    assert np.abs(poles - np.exp(-0.7 * 0.05)).min() < 1e-9
    assert law.order == 2
    assert law.input_delay == 15


@pytest.mark.parametrize("effort", [0.001, 1.0, 30.0])
def test_with_a_dead_time_no_other_gain_of_lqg_costs_less(effort: float) -> None:
    """The cost of a pulse at the input, from the plain equations, is least at the law's gain."""
    law = armrig.control.lqg(LATE, effort=effort)
    best = -law.C[0] / LATE.B[16]  # the state of the plant is y/b

    def cost(K: float) -> float:
        u, y, total = np.zeros(1500), np.zeros(1501), 0.0
        y[0] = 0.1
        for k in range(1500):
            u[k] = -K * y[k]
            total += y[k] ** 2 + effort * u[k] ** 2
            y[k + 1] = 0.9 * y[k] + 0.1 * (u[k - 15] if k >= 15 else 0.0)
        return total

    least = cost(best)
    assert all(cost(best * c) > least for c in (0.8, 0.95, 1.05, 1.2))


def test_an_estimate_of_d_is_the_disturbance_in_volts() -> None:
    """The last state of the observer goes to minus what a friction of 0.3 V takes."""
    law = armrig.control.lqg(TWO_LAGS)
    x, y, N = np.zeros(law.order), np.zeros(4), 2000
    u = np.zeros(N + 2)
    A, B = np.array(law.A), np.array(law.B)

    for k in range(N):
        u[k] = np.dot(law.C, x) + law.D
        x = A @ x + B @ np.array([1.0, u[k], y[0]])
        friction = [u[k - j] - 0.3 if k >= j else 0.0 for j in (0, 1)]
        y = np.array([1.5 * y[0] - 0.56 * y[1] + 0.02 * friction[0] + 0.015 * friction[1], *y[:3]])

    assert x[-1] == pytest.approx(-0.3, abs=1e-6)


def test_lambda_tuning_is_that_of_the_textbook_for_a_lag() -> None:
    """k_i = 1/(K (λ + θ)) and T_i = T, with θ of the law's sample and half of a held one."""
    heater = control.tf([9.0], [175, 1])

    gains = armrig.control.pid(heater, time_constant=60.0, Ts=1.0).design["gains"]

    assert gains["k_i"] == pytest.approx(1 / (9 * 61.5), rel=1e-3)
    assert gains["k_p"] / gains["k_i"] == pytest.approx(175, rel=0.01)
    assert gains["k_d"] == 0


@pytest.mark.parametrize("model", [LAG, LATE], ids=["lag", "late"])
def test_no_other_gains_have_a_larger_k_i_at_this_ms(model: armrig.Fit) -> None:
    """10 000 drawn pairs of gains: those with more k_i have a larger Ms, or are unstable."""
    law = armrig.control.pid(model, derivative=False)
    gains, rng = law.design["gains"], np.random.default_rng(2)
    z = np.exp(1j * np.geomspace(1e-3, np.pi, 600))
    P = np.polyval(model.B[::-1], 1 / z) / np.polyval(model.F[::-1], 1 / z)
    k_p = gains["k_p"] * rng.uniform(0, 3, 10_000)
    k_i = gains["k_i"] * rng.uniform(1.02, 2.0, 10_000)
    L = P * (k_p[:, None] / z + k_i[:, None] * model.Ts / (z - 1))
    calm = np.flatnonzero(np.abs(1 + L).min(axis=1) > 1 / 1.6)

    assert law.design["margins"]["Ms"] == pytest.approx(1.6, abs=2e-3)
    for p, i in zip(k_p[calm], k_i[calm], strict=True):
        # 1 + P (p q^-1 + i Ts q^-1/(1 - q^-1)), times F (1 - q^-1)
        closed = np.convolve(model.F, [1, -1])
        product = np.convolve(model.B, [0, p + i * model.Ts, -p])
        n = max(closed.size, product.size)
        poles = np.roots(
            np.pad(closed, (0, n - closed.size)) + np.pad(product, (0, n - product.size))
        )
        assert np.abs(poles).max() > 1


def test_anti_windup_follows_the_voltage_that_was_applied() -> None:
    """At a limit for a long time, I stays near what the limit allows."""
    law = armrig.control.pid(LAG, time_constant=0.3)
    x, A, B = np.zeros(law.order), np.array(law.A), np.array(law.B)
    v = 0.0

    for _ in range(2000):  # y stays at 0 whatever u is
        v = float(np.dot(law.C, x) + law.D * 2.0)
        x = A @ x + B @ np.array([2.0, min(v, 5.0), 0.0])

    assert 5.0 < v < 20.0


@pytest.mark.parametrize("unit", ["mV", "", "V"])
def test_an_input_of_another_unit_is_refused_for_a_rig(unit: str) -> None:
    """A law of a model in mV would have a wrong gain; volts are those of the pin."""
    heater = builtin("tclab")
    name, output = next(iter(heater.outputs.items()))
    model = armrig.Fit.of_channel(
        B=[0, 0.1],
        F=[1, -0.9],
        nk=1,
        Ts=1.0,
        input=heater.input.name,
        input_unit=unit,
        output=name,
        unit=output.unit,
    )

    if unit == "V":
        assert armrig.control.pid(model, rig=heater).outputs[0].name == name
    else:
        with pytest.raises(InputError, match=f"input is in {unit or 'no unit'}, and that of the"):
            armrig.control.pid(model, rig=heater)
