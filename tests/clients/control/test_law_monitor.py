"""The monitor that a design writes into its law: its deviations, outputs, feed-forward, prelude."""

from __future__ import annotations

from typing import Any

import armrig
import control
import numpy as np
import pytest
from armrig.control.law_monitor import kalman_predictor, with_disturbance
from armrig.control.plant import Plant, design_model
from armrig_core.control.control_law import ControlLaw, Monitor, Reference
from armrig_core.errors import InputError
from armrig_core.rig.description import Description, builtin
from msgspec.structs import replace

from tests.clients.control import plants
from tests.clients.control.plants import Fault, TruePlant, play

STEP = 0.0076 * 64
"""Step of the heater's thermometer, in degC."""
NAMES: dict[str, Any] = {
    "input": "power",
    "output": "T1",
    "unit": "degC",
    "noise_covariance": np.array([[0.01]]),
    "covariance": 1e-12 * np.eye(2),
    "covariance_robust": 1e-12 * np.eye(2),
}
POLE = float(np.exp(-1 / 175))
HEATER = plants.model([0.0] * 16 + [9 * (1 - POLE)], [1, -POLE], 1.0, **NAMES)
LATE = {"rig": builtin("heater"), "u0": 0.0, "y0": 23.0}
ARM = armrig.physics.arm(armrig.physics.ArmParameters())


def _monitor(law: ControlLaw) -> Monitor:
    assert law.monitor is not None
    return law.monitor


@pytest.mark.parametrize(
    "design",
    [
        lambda **more: armrig.control.pid(HEATER, time_constant=40.0, **more),
        lambda **more: armrig.control.place(HEATER, [-0.02], **more),
        lambda **more: armrig.control.lqg(HEATER, effort=3.0, **more),
    ],
    ids=["pid", "place", "lqg"],
)
def test_each_method_writes_the_same_monitor(design: Any) -> None:
    """It is that of the model, whatever the law is."""
    law = design(**LATE)

    m, other = _monitor(law), _monitor(armrig.control.lqg(HEATER, effort=1.0, **LATE))

    assert replace(m, forward=other.forward) == other
    assert (m.input_delay, m.prelude, m.settling) == (15, 50, (True,))
    assert law.most_blind == 9
    assert m.forward[0] == pytest.approx(1 / 9)
    assert m.forward[0] * 23 + m.forward[1] == pytest.approx(0.0, abs=1e-6)  # rest
    assert np.dot(m.C[0], m.x0) == pytest.approx(23.0)


def test_poles_of_a_users_observer_do_not_change_the_monitor() -> None:
    m = _monitor(armrig.control.place(HEATER, [-0.02], observer=[-0.1, -0.11], **LATE))
    other = _monitor(armrig.control.place(HEATER, [-0.02], **LATE))

    assert m.forward == pytest.approx(other.forward)
    assert replace(m, forward=other.forward) == other


def test_the_deviations_are_those_of_the_innovations() -> None:
    """20 000 samples with the assumed noise of readings and input: both are right within 3 %."""
    B = np.array([0.3, 0.1])
    plant = Plant(A=np.array([[0.9, 0.1], [0.0, 0.7]]), B=B, C=np.array([[1.0, 0.0], [0.2, 1.0]]))
    noise, rng, N = np.diag([0.04, 0.01]), np.random.default_rng(3), 20_000
    L, S = kalman_predictor(plant, noise, 5.0)
    A, C = with_disturbance(plant)
    x, observed, e = np.zeros(3), np.zeros(3), np.zeros((N, 2))

    for k in range(N):
        e[k] = C @ (x - observed) + rng.standard_normal(2) * np.sqrt(np.diag(noise))
        observed = A @ observed + L @ e[k]
        x = A @ x + np.append(B * 0.1 * rng.standard_normal(), 0.01 * rng.standard_normal())

    np.testing.assert_allclose(e.std(axis=0), np.sqrt(np.diag(S)), rtol=0.03)


def test_the_units_of_a_model_do_not_change_its_monitor() -> None:
    """A model in rpm and m has numbers of 1e-7, and its law sees the disturbance none the less."""
    rig = b"""
        rig = {name = "drive"}
        input = {name = "drive", unit = "rpm", per_volt = -840.0}
        outputs = {p = {unit = "m", per_count = 1.3e-5, zero_counts = 32768}}
    """
    B, F = np.array([0.0, 3e-4, 2.7e-4]), [1, -1.77, 0.785]
    names = {**NAMES, "input": "drive", "output": "p", "unit": "m"}
    names |= {"covariance": 1e-16 * np.eye(4), "covariance_robust": 1e-16 * np.eye(4)}
    names["noise_covariance"] = np.array([[1e-7]])
    model = armrig.Fit.of_channel(B=B / -840, F=F, nk=1, Ts=0.05, input_unit="rpm", **names)

    law = armrig.control.lqg(model, effort=2.0, rig=Description.of(rig), u0=0.0)

    m = _monitor(law)
    assert m.B == (1.0, 0.0, 0.0)
    np.testing.assert_allclose(m.C[0][:2], B[1:])
    assert np.abs(m.L[2]).max() * 13 > 0.01  # V of disturbance in a sample, for 13 m


def test_coloured_noise_widens_the_gates() -> None:
    """The innovations of a drifting output are larger than the one-step errors of its model."""
    fields = {**NAMES, "noise_covariance": np.array([[1.0]])}
    white, coloured = (
        armrig.Fit.of_channel(
            B=[0, 0.01], nk=1, Ts=1.0, input_unit="V", **{letter: [1, -0.99]}, **fields
        )
        for letter in "FA"
    )

    widths = [
        _monitor(armrig.control.lqg(m, effort=1.0, **LATE)).deviations[0] for m in (white, coloured)
    ]

    assert widths[0] < 1.2
    assert widths[1] > 2 * widths[0]


def test_an_angle_and_an_oscillation_have_no_simulation_gate() -> None:
    """The angle integrates, and a constant voltage does not change α."""
    law = armrig.control.place(ARM, [-18 + 18j, -18 - 18j, -42], rate=True, Ts=0.01)

    m = _monitor(law)

    assert m.settling == (False, False)
    assert m.prelude == 50
    assert m.forward == pytest.approx((1 / 1.8623, 0.0), rel=1e-4)
    assert law.most_blind == 19


def test_a_law_of_alpha_alone_has_a_monitor_of_alpha() -> None:
    """α does not show the disturbance of the input, nor the angle."""
    C = control.ss([], [], [], [[0.1, -1.0]], 0.01, inputs=["r", "alpha"], outputs="v")
    r = Reference(name="u", unit="V", low=0.0, high=5.0)

    law = armrig.control.control_law(C, outputs="alpha", reference=r, model=ARM)

    m = _monitor(law)
    assert len(m.x0) == 4
    assert m.L[3] == (0.0,)
    assert m.deviations[0] > 0.006


def test_a_dead_time_beyond_that_of_a_law_is_refused() -> None:
    late = plants.model([0.0] * 250 + [0.05], [1, -0.95], 0.05)

    with pytest.raises(InputError, match="249 samples of dead time; a law allows 200: design"):
        armrig.control.pid(late, time_constant=20.0)


@pytest.mark.parametrize("Ts", [0.005, 0.01, 0.02, 1.0])
def test_a_railed_sensor_ends_a_run_in_time(Ts: float) -> None:
    """0.2 s at 100 Hz and above, 10 Ts + 0.1 s below, with the sample that latches rest."""
    law = armrig.control.pid(control.tf([9.0], [20 * Ts, 1]), time_constant=20 * Ts, Ts=Ts)

    rest = (law.most_blind + 1) * Ts

    assert rest <= max(0.2, 10 * Ts + 0.1) + 1e-9
    assert rest > max(0.2, 10 * Ts + 0.1) - Ts


def _heater() -> TruePlant:
    return TruePlant(
        rows=((POLE, 9 * (1 - POLE)),), outputs=((1.0,),), rest=(23.0,), noise=(0.1,), delay=15
    )


@pytest.mark.parametrize(("fault", "by"), [("", ""), ("stuck", "of T1"), ("railed", "blind")])
def test_a_broken_thermometer_stops_the_heater_before_it_is_too_hot(fault: str, by: str) -> None:
    law = armrig.control.pid(HEATER, time_constant=45.0, **LATE)
    r, rng = [23.0] * 60 + [43.0] * 900, np.random.default_rng(5)

    run = play(law, builtin("heater"), _heater(), r, rng, Fault(fault, 0, 100))

    assert by in run.by
    assert bool(run.by) == bool(fault)
    assert run.y.max() < 43 + 0.35 * 20


def test_the_zeros_of_two_outputs_are_those_of_one_voltage() -> None:
    """At 2 V the outputs are 20 and 5: at the voltage with p at 0, q is -5."""
    rig = b"""
        rig = {name = "two"}
        input = {name = "power"}
        outputs = {p = {unit = "cm", per_count = 0.001}, q = {unit = "cm", per_count = 0.001}}
    """
    u = armrig.telegraph(400, 1.0, low=0.0, high=5.0, seed=1) - 2.5
    y = np.zeros((400, 2))
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + np.array([1.0, 0.5]) * u[k - 1]
    y += 0.01 * np.random.default_rng(1).standard_normal(y.shape)
    data = armrig.Signals(
        u=u, y=y, Ts=0.05, inputs=("power",), outputs=("p", "q"), input_units=("V",),
        units=("cm", "cm"),
    )  # fmt: skip
    fit = armrig.oe(data, nb=[[1], [1]], nf=1, shared="denominator")
    options = {"rig": Description.of(rig), "u0": 2.0, "y0": (20.0, 5.0)}

    by_p, by_q = (armrig.control.lqg(fit, output=name, **options) for name in "pq")

    assert by_p.u0 == pytest.approx(0.0, abs=0.02)
    assert [o.y0 for o in by_p.outputs] == pytest.approx([0.0, -5.0], abs=0.05)
    assert by_q.u0 == pytest.approx(1.0, abs=0.02)
    assert [o.y0 for o in by_q.outputs] == pytest.approx([10.0, 0.0], abs=0.1)
    with pytest.raises(InputError, match=r"y0=\[1, 2, 3\]: give a finite number for each of 2 out"):
        armrig.control.lqg(fit, **{**options, "y0": [1, 2, 3]})


def test_a_check_says_that_a_law_has_no_monitor() -> None:
    law = armrig.control.pid(HEATER, time_constant=45.0, **LATE)
    options = {"rig": builtin("heater"), "draws": 5}

    bare = armrig.control.check_law(replace(law, monitor=None), HEATER, **options)

    assert "the law has no monitor: it runs only with unmonitored=True" in bare.verdict
    assert "monitor" not in armrig.control.check_law(law, HEATER, **options).verdict
    assert design_model(HEATER, **LATE).reading_noise[0, 0] == pytest.approx(0.01 + STEP**2 / 12)
