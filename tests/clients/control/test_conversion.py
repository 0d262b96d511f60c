"""A controller of python-control as a law: the same loop, its anti-windup, and its refusals."""

from __future__ import annotations

from typing import Any

import armrig
import control
import numpy as np
import pytest
from armrig_core.commands.control_rehearsal import rehearse_control
from armrig_core.control.control_law import ControlLaw, Reference
from armrig_core.control.evaluation import Latch, begin, decide, observe
from armrig_core.errors import InputError, InputTypeError
from armrig_core.rig.description import Description, builtin
from msgspec.structs import replace
from numpy.typing import NDArray

TS = 0.01
PI = control.tf([0.02, -0.0195], [1, -1], TS)
HEATER = builtin("heater")
TCLAB = builtin("tclab")
SETTLING = control.ss(
    [[0.9, 0.1], [-0.2, 0.8]], [[0.1], [0.2]], [[1.0, 0.0], [0.3, 0.4]], np.zeros((2, 1)), TS
)
"""Plant with two outputs, with one sample of delay."""
MODEL = armrig.Fit.of_channel(
    B=[0, 0, 0, 1.0],
    F=[1, -0.9],
    nk=3,
    Ts=TS,
    input="power",
    output="T1",
    input_unit="V",
    unit="degC",
)
"""Model with two samples of dead time."""


def _heater(C: Any, **options: Any) -> ControlLaw:
    """Return the law of a controller of T1, in V."""
    fields = {"outputs": "T1", "reference": (0, 90), "rig": HEATER, "unit": "V", **options}
    return armrig.control.control_law(C, **fields)


def _step(law: ControlLaw, plant: Any, r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Δv (N,) of the unlimited law with a plant whose input is Δu."""
    A, B, C = (np.array(M).reshape(law.order, -1) for M in (law.A, law.B, law.C))
    x, z, v = np.array(law.x0), np.zeros(plant.nstates), []
    for value in r:
        v.append(float(C[:, 0] @ x) + law.D * value)
        y = (plant.C @ z)[: len(law.outputs)]
        x = A @ x + B @ np.array([value, v[-1], *y])
        z = plant.A @ z + plant.B[:, 0] * v[-1]
    return np.array(v)


def _simulated(C: Any, plant: Any, r: NDArray[np.float64], late: int) -> NDArray[np.float64]:
    """Return v (N,) of C on (r[k], y[k-late]), computed from difference equations."""
    x, z, v = np.zeros(C.nstates), np.zeros(plant.nstates), []
    outputs = [np.zeros(plant.noutputs)] * late
    for value in r:
        outputs.append(plant.C @ z)
        y = outputs[-1 - late]
        w = [value - y[0]] if C.ninputs == 1 else [value, *y][: C.ninputs]
        v.append(float((C.C @ x + C.D @ w)[0]))
        x = C.A @ x + C.B @ w
        z = plant.A @ z + plant.B[:, 0] * v[-1]
    return np.array(v)


R = np.where(np.arange(300) < 20, 0.0, 1.0)
RNG = np.random.default_rng(89)


def _drawn(n: int, nu: int, *, direct: bool) -> Any:
    """Return a stable controller with small gains."""
    A = RNG.uniform(-0.4, 0.4, (n, n))
    D = RNG.uniform(-0.3, 0.3, (1, nu)) if direct else np.zeros((1, nu))
    if not direct:
        D[0, 0] = 0.2  # r, which is not delayed
    return control.ss(A, RNG.uniform(-0.3, 0.3, (n, nu)), RNG.uniform(-0.5, 0.5, (1, n)), D, TS)


@pytest.mark.parametrize(
    ("C", "outputs", "late"),
    [
        (PI, "T1", 1),
        (control.ss([[0.9]], [[0.1]], [[0.2]], [[0.0]], TS), "T1", 0),
        (control.ss([], [], [], [[0.3]], TS), "T1", 1),
        (_drawn(4, 2, direct=True), "T1", 1),
        (_drawn(4, 2, direct=False), "T1", 0),
        (_drawn(5, 3, direct=True), ("T1", "T2"), 1),
        (_drawn(6, 3, direct=False), ("T1", "T2"), 0),
    ],
)
def test_the_step_of_a_law_is_that_of_its_controller_and_the_plant(
    C: Any, outputs: str | tuple[str, ...], late: int
) -> None:
    """A direct term from y acts on y[k-1]; r is never delayed."""
    law = _heater(C, outputs=outputs)

    expected = _simulated(control.ss(C), SETTLING, R, late)

    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(_step(law, SETTLING, R), expected, atol=1e-12, rtol=0)


def test_a_transfer_function_of_two_inputs_counts_its_integrator_once() -> None:
    """Two degrees of freedom: r has half of the proportional part."""
    C = control.tf([[[0.01, -0.0095], [-0.02, 0.0195]]], [[[1, -1], [2, -2]]], TS)
    C.den[0][1], C.num[0][1] = C.den[0][1] / 2, C.num[0][1]

    law = _heater(C)

    assert law.order == 2
    v = _step(law, SETTLING, R)
    assert v[20] == pytest.approx(0.01)
    assert abs(v[-1] - v[-2]) < 1e-3


def test_inputs_are_recognised_by_their_names() -> None:
    C = _drawn(3, 3, direct=True)
    named = control.ss(C.A, C.B[:, [2, 0, 1]], C.C, C.D[:, [2, 0, 1]], TS)
    named = control.ss(named, inputs=["T2", "r", "T1"], outputs=["v"])

    outputs = ("T1", "T2")

    np.testing.assert_allclose(
        _step(_heater(named, outputs=outputs), SETTLING, R),
        _step(_heater(C, outputs=outputs), SETTLING, R),
        atol=1e-15,
    )


def test_an_observer_gets_the_latched_input() -> None:
    """A controller with the input u needs no other anti-windup: B has its column."""
    C = control.ss(
        [[0.5]], [[0.1, 0.2, 0.3]], [[1.0]], [[0.4, 0, 0]], TS, inputs=["r", "u", "T1"], outputs="v"
    )

    law = _heater(C)

    assert (law.A, law.B, law.D, law.F) == (((0.5,),), ((0.1, 0.2, 0.3),), 0.4, None)
    with pytest.raises(InputError, match="C has the input u, its own anti-windup: leave out K"):
        _heater(C, K=[0.1])


def _played(law: ControlLaw, r: list[float], y0: float, gain: float = 10.0) -> NDArray[np.float64]:
    """Return u and y (N, 2) of the law in the core with a heater of 9 samples, y0 at 0 V."""
    program, latch, y, rows = law.program(HEATER), Latch(), y0, []
    state = begin(program)
    for k in range(len(r)):
        state, command = decide(program, state, k, r, latch)
        rows.append((command.code / 13107, y))
        state = observe(program, state, k, (y, 0.0), r, latch)
        y += 0.1 * (y0 + gain * command.code / 13107 - y)
    return np.array(rows)


@pytest.mark.parametrize("options", [{}, {"tracking_time": 0.05}, {"K": [0.3]}])
@pytest.mark.parametrize(
    "C",
    [PI, control.ss(1.0, [[0.05, -0.05]], 1.0, [[0.1, -0.3]], TS)],
    ids=["error", "two degrees of freedom"],
)
def test_a_law_rests_at_its_operating_point(C: Any, options: dict[str, Any]) -> None:
    """K (u - v) is 0 there, and keeps no -K u0: 2.5 V hold 25 °C above 20 °C."""
    _assert_rest(_heater(C, u0=2.5, y0=45.0, **options))


def test_a_law_with_the_latched_input_rests_at_its_operating_point() -> None:
    names = {"inputs": ["r", "u", "T1"], "outputs": "v"}

    _assert_rest(
        _heater(
            control.ss(0.5, [[0.1, 0.2, -0.3]], 1.0, [[0.05, 0, 0]], TS, **names), u0=2.5, y0=45.0
        )
    )


def _assert_rest(law: ControlLaw) -> None:
    """Assert that a law stays at 2.5 V if T1 stays at 45 °C, which is r, too."""
    program, r = law.program(HEATER), [45.0] * 50
    state = begin(program)
    for k in range(50):
        state, command = decide(program, state, k, r, Latch())
        state = observe(program, state, k, (45.0, 0.0), r, Latch())
        assert command.v == pytest.approx(2.5, abs=2e-4)  # half a code


def test_the_anti_windup_lets_go_of_a_limit_at_once() -> None:
    """5 V give 70 °C at most: without K the integral part would go on."""
    r = [20.0] * 5 + [80.0] * 60 + [40.0] * 100
    C = control.tf([0.2, -0.17], [1, -1], TS)

    y = _played(_heater(C, y0=20.0), r, 20.0)[:, 1]
    wound = _played(_heater(C, y0=20.0, K=[1e-6]), r, 20.0)[:, 1]

    late = [int(np.argmax(np.abs(run[65:] - 40.0) < 1.0)) for run in (y, wound)]
    assert late[0] + 20 < late[1]


def test_the_default_tracking_time_is_that_of_the_slowest_zero() -> None:
    """The zero of the PI is at 0.975: T_i is 0.395 s, and the law's pole is there, too."""
    law = _heater(PI)

    assert law.A[0][0] == pytest.approx(0.975)
    assert _heater(PI, tracking_time=0.05).A[0][0] == pytest.approx(np.exp(-0.2))
    integral = control.tf([0.001], [1, -1], TS)
    assert _heater(integral).A[0][0] == pytest.approx(np.exp(-0.1))
    fast = control.tf([1, -0.2], [1, -1], TS)  # not faster than two samples
    assert _heater(fast).A[0][0] == pytest.approx(np.exp(-0.5))
    lead = control.tf([1, -0.9], [1, -0.2], TS)
    assert _heater(lead).design["anti_windup"] == [0.0]


def test_fast_modes_stay_where_they_are() -> None:
    """Only the double integrator moves, to the pole of the tracking time."""
    poles = [1.0, 1.0, 0.5, -0.2]
    C = control.tf(0.001 * np.poly([0.98, 0.97, 0.3, 0.1]), np.poly(poles), TS)

    law = _heater(C, tracking_time=0.1)

    found = np.sort(np.linalg.eigvals(np.array(law.A)[:4, :4]).real)
    np.testing.assert_allclose(found, [-0.2, 0.5, np.exp(-0.1), np.exp(-0.1)], atol=1e-6)


def test_a_controller_in_the_unit_of_the_input_drives_the_pin() -> None:
    """TCLab has 25.5 % per volt; limits and operating point are in %, too."""
    options = {"outputs": "T1", "reference": (20, 50), "rig": TCLAB}
    percent = armrig.control.control_law(
        control.tf([5.1, -5.0], [1, -1], 1.0), **options, unit="%", u0=51, hi=76.5, slew=25.5
    )
    volts = armrig.control.control_law(
        control.tf([0.2, -5 / 25.5], [1, -1], 1.0), **options, unit="V", u0=2, hi=3, slew=1
    )

    assert percent.input == "Q1"
    for key in ("A", "D", "u0", "lo", "hi", "slew"):
        np.testing.assert_allclose(getattr(percent, key), getattr(volts, key), atol=1e-12)
    responses = [np.array(law.C) @ np.array(law.B) for law in (percent, volts)]
    np.testing.assert_allclose(*responses, atol=1e-12)
    given = armrig.control.control_law(
        control.tf([5.1, -5.0], [1, -1], 1.0), **options, unit="%", K=[0.1]
    )
    assert given.B[0][1] == pytest.approx(2.55)
    names = {"inputs": ["r", "u", "T1"], "outputs": "v"}
    seen = control.ss(0.5, [[0.1, 0.2, 0.3]], 1.0, [[0.4, 0, 0]], 1.0, **names)
    law = armrig.control.control_law(seen, **options, unit="%")
    # 1 V is 25.5 %: the controller has its own output in %, and sees u in %.
    assert law.B[0][1] * law.C[0] == pytest.approx(0.2)
    assert law.B[0][0] * law.C[0] == pytest.approx(0.1 / 25.5)
    with pytest.raises(InputError, match=r"Q1 is in %, 25.5 % per volt .*unit='V' or unit='%'"):
        armrig.control.control_law(PI, **options)


def test_a_law_of_a_heater_reaches_its_reference_in_a_rehearsal() -> None:
    C = control.tf([0.3, -0.2985], [1, -1], 1.0)
    law = _heater(C, y0=23.0)

    found = rehearse_control(law, np.full(5000, 28.0), HEATER)

    assert found.outputs
    low, high, _ = found.outputs["T1"]
    assert 27.5 < high < 30.0  # a step of the converter is 0.5 °C
    assert low >= 22.9


def _arm(*names: str) -> Any:
    """Return the arm, sampled, with some of its outputs."""
    arm = control.ss(armrig.physics.arm(armrig.physics.ArmParameters()))
    rows = ["theta_1", "alpha"]
    at = [rows.index(name) for name in names]
    part = control.ss(arm.A, arm.B, arm.C[at], arm.D[at], outputs=list(names))
    return control.sample_system(part, TS)


def test_the_monitor_of_the_model_predicts_a_turning_output() -> None:
    """A PI of the rate, by differences of the angle; the monitor bridges the dead band."""
    k_p, k_i = 0.1, 1.0
    rate = control.tf([1, -1], [TS, 0], TS)
    C = control.tf([k_p + k_i * TS, -k_p], [1, -1], TS)
    # Inputs r and theta_1: v = C (r - rate theta_1).
    Cz = control.ss(C)
    R = control.ss(rate)
    both = control.append(control.ss([], [], [], [[1.0]], TS), R)
    difference = control.ss([], [], [], [[1.0, -1.0]], TS)
    system = control.ss(Cz * difference * both, inputs=["r", "theta_1"], outputs="v")
    reference = Reference(name="velocity", unit="rad/s", low=0.0, high=8.0)

    law = armrig.control.control_law(
        system, outputs="theta_1", reference=reference, model=_arm("theta_1")
    )

    assert law.order == 3  # those of C, and the newest angle
    assert law.monitor is not None
    turned = [
        rehearse_control(law, np.full(N, 3.0), builtin("arm")).turned_rad for N in (800, 1200)
    ]
    assert (turned[1] - turned[0]) / 4.0 == pytest.approx(3.0, rel=0.01)


BAD: dict[str, tuple[Any, dict[str, Any], type[Exception], str]] = {
    "continuous": (
        control.tf([1, 1], [1, 0]),
        {},
        InputError,
        r"C is in continuous time: sample it, control.sample_system\(C, Ts, method='tustin'\)",
    ),
    "no system": (3.0, {}, InputTypeError, "C is a float: give a controller of python-control"),
    "two outputs": (
        control.ss([], [], [], [[1.0], [1.0]], TS),
        {},
        InputError,
        "C has 2 outputs; a law drives",
    ),
    "no time": (control.tf([1], [1, -1], True), {}, InputError, "C has no sampling time: give Ts="),
    "another time": (PI, {"Ts": 0.02}, InputError, "Ts=0.02 s, and C has 0.01 s: sample"),
    "part of a µs": (
        control.tf([1], [1, -1], 1 / 150),
        {},
        InputError,
        "a law needs a whole number of µs",
    ),
    "too fast": (
        control.tf([1], [1, -1], 0.001),
        {},
        InputError,
        "C has Ts=0.001 s; a law runs at 0.005 to 1 s",
    ),
    "not finite": (
        control.ss([[np.nan]], 1, 1, 0, TS),
        {},
        InputError,
        "C has a number that is not",
    ),
    "a direct u": (
        control.ss([], [], [], [[1.0, 0.5, 1.0]], TS, inputs=["r", "u", "T1"]),
        {},
        InputError,
        "the output of C depends on u at once",
    ),
    "one input, two outputs": (
        PI,
        {"outputs": ("T1", "T2")},
        InputError,
        "C has one input and acts on r - T1: give one",
    ),
    "inputs": (
        control.ss([], [], [], [[1.0, 1.0]], TS, inputs=["r", "T3"]),
        {},
        InputError,
        r"C has the inputs r, T3: allowed are one input, r - y; r and then T1; or the names",
    ),
    "too many inputs": (
        control.ss([], [], [], [[1.0] * 4], TS),
        {},
        InputError,
        "C has the inputs",
    ),
    "unused": (
        control.ss([], [], [], [[1.0, 1.0]], TS, inputs=["r", "T1"]),
        {"outputs": ("T1", "T2")},
        InputError,
        "C has no input T2: leave T2 out of outputs",
    ),
    "denominators": (
        control.tf([[[1.0], [1.0]]], [[[1, -1], [1, -0.5]]], TS),
        {},
        InputError,
        "the transfer functions of C have different denominators",
    ),
    "not proper": (control.tf([1, 0, 0], [1, -1], TS), {}, InputError, "C is not proper"),
    "three outputs": (PI, {"outputs": ("T1", "T2", "T3")}, InputError, "a law uses one or two"),
    "unknown output": (
        PI,
        {"outputs": "T3"},
        InputError,
        "the rig heater has no T3; it has T1, T2",
    ),
    "no rig": (PI, {"rig": None}, InputError, "these are no outputs of the arm; give the descript"),
    "unit": (PI, {"unit": "W"}, InputError, "unit='W': allowed are 'V' and '%', that of power"),
    "y0": (PI, {"y0": [1.0, 2.0, 3.0]}, InputError, "give a finite number for each of 1 output"),
    "K and time": (PI, {"K": [1.0], "tracking_time": 1.0}, InputError, "two ways of anti-windup"),
    "K": (PI, {"K": [1.0, 2.0]}, InputError, r"K has the shape \(2,\); C has 1 state"),
    "unstable K": (PI, {"K": [-1.0]}, InputError, r"A - K C has a pole at \|z\| = 2"),
    "time": (PI, {"tracking_time": 0.001}, InputError, "tracking_time=0.001 s must be at least Ts"),
    "hidden mode": (
        control.ss([[1.0, 0], [0, 1.0]], [[1], [1]], [[1.0, 0]], 0, TS),
        {},
        InputError,
        "C has a slow mode that its output does not show",
    ),
    "states": (
        control.ss(0.1 * np.eye(8), np.ones((8, 1)), np.ones((1, 8)), 1, TS),
        {},
        InputError,
        "the law would have 9 states, 8 of them of C; at most 8 are allowed: reduce",
    ),
    "no rest": (
        control.ss(1.0, [[0.1, -0.05]], 1.0, 0, TS),
        {"y0": 30.0},
        InputError,
        "C does not rest with r = 30 and y = 30: its integral part goes on",
    ),
    "range": (PI, {"reference": (60, 23)}, InputError, "reference.low = 60 must be at most high"),
    "limits": (
        PI,
        {"hi": 5.5},
        InputError,
        "lo and hi are 0 and 5.5 V at the pin: the rig allows 0 to 5 V",
    ),
    "another model": (
        PI,
        {"outputs": "T2", "model": MODEL},
        InputError,
        "the model predicts T1, and not T2",
    ),
    "operating point": (
        PI,
        {"u0": 1.0, "model": MODEL},
        InputError,
        "with model=, the law has the operating point of the model, 0 V at y = 0, and not 1 V",
    ),
}


@pytest.mark.parametrize(("C", "options", "kind", "sentence"), BAD.values(), ids=BAD)
def test_what_is_no_law_is_refused(
    C: Any, options: dict[str, Any], kind: type[Exception], sentence: str
) -> None:
    with pytest.raises(kind, match=sentence):
        _heater(C, **options)


def test_the_monitor_of_a_model_begins_at_rest() -> None:
    """The rig rests at 1 V, and the model has 10 cm per volt."""
    text = """
        rig = {name = "tank"}
        input = {name = "pump", rest_v = 1.0}
        outputs = {level = {unit = "cm", per_count = 0.001}}
    """
    signals = {"input": "pump", "output": "level", "input_unit": "V", "unit": "cm"}
    model = armrig.Fit.of_channel(B=[0, 1.0], F=[1, -0.9], nk=1, Ts=TS, **signals)

    law = _heater(PI, outputs="level", rig=Description.of(text.encode()), unit=None, model=model)

    assert law.monitor is not None
    assert np.dot(law.monitor.C[0], law.monitor.x0) == pytest.approx(10.0)


def test_a_turning_output_needs_a_model() -> None:
    with pytest.raises(InputError, match=r"theta_1 turns through a dead band, .* model="):
        armrig.control.control_law(PI, outputs="theta_1", reference=(0, 8))
    with pytest.raises(InputError, match="theta_1 turns, so its y0 must be 0, not 1"):
        armrig.control.control_law(PI, outputs="theta_1", reference=(0, 8), y0=1.0)


def test_a_model_adds_no_states_to_a_law() -> None:
    """The monitor has the dead time of 2 samples as a number, and predicts without the law."""
    law, bare = (_heater(PI, model=model) for model in (MODEL, None))

    assert law.monitor is not None
    assert bare.monitor is None
    assert law.monitor.input_delay == 2
    assert law.monitor.forward[0] == pytest.approx(0.1)  # 10 K/V
    assert replace(law, monitor=None) == replace(bare, monitor=None)
