"""The rehearsal of a law: the emulated rig's readings, limits, ends, and stability."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig_core.commands import control_rehearsal
from armrig_core.commands.control_rehearsal import rehearse_control
from armrig_core.commands.rehearsal import rehearse_outputs
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference, Tracking
from armrig_core.control.evaluation import Latch
from armrig_core.errors import InputError
from armrig_core.rig.description import Description, builtin, read_description, require_model
from armrig_core.rig.firmware_image import WITH_ENABLE_LINE
from msgspec.structs import replace

from tests.core.control.laws import RAD_S_PER_V, arm_law, arm_monitor

ARM = builtin("arm")
STEP = np.where(np.arange(600) < 300, 2.0, 4.0)


def _rehearsed_input(monkeypatch: pytest.MonkeyPatch, law: ControlLaw, **options: Any) -> Any:
    """Return the codes (N,) of a rehearsal, and its result."""
    codes: list[int] = []
    decide = control_rehearsal.decide

    def decide_and_note(*args: Any) -> Any:
        state, command = decide(*args)
        codes.append(command.code)
        return state, command

    monkeypatch.setattr(control_rehearsal, "decide", decide_and_note)
    return codes, rehearse_control(law, **options)


def test_the_arm_follows_its_reference_as_designed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shaft turns at 2 rad/s and at 4 rad/s, for 3 s each."""
    codes, found = _rehearsed_input(monkeypatch, arm_law(), reference=STEP, described=ARM)

    assert found.turned_rad == pytest.approx(18.0, abs=0.5)
    assert found.alpha_rad < 0.15
    assert codes[-1] / 13107 == pytest.approx(4.0 / 1.8623, rel=0.02)
    # The same input without a law moves the same rig in the same way.
    u = np.array(codes) / 13107
    same = rehearse_outputs(u, 0.01, ARM)
    assert found.turned_rad == pytest.approx(same.turned_rad, abs=0.02)  # a duty of 10 bits
    assert found.alpha_rad == pytest.approx(same.alpha_rad, abs=1e-3)


@pytest.mark.parametrize("start_rad", [None, 0.0, 1.0, 6.1])
def test_the_dead_band_of_the_potentiometer_is_where_the_shaft_starts(
    start_rad: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The track has 352°: the law must not see the angle in the other 8°, and not lose a turn."""
    angles: list[float] = []
    observe = control_rehearsal.observe

    def observe_and_note(*args: Any) -> Any:
        angles.append(args[3][0])
        return observe(*args)

    monkeypatch.setattr(control_rehearsal, "observe", observe_and_note)
    found = rehearse_control(arm_law(), STEP, ARM, start_rad=start_rad)

    seen = np.array(angles)
    assert seen[0] == pytest.approx(
        np.pi * 352 / 360 if start_rad is None else start_rad, abs=0.01
    ) or (start_rad == 0.0 and np.isnan(seen[0]))
    share = np.isnan(seen).mean()
    assert 0.01 < share < 0.05
    assert found.turned_rad == pytest.approx(18.0, abs=0.5)
    assert found.theta_1_rad == (None if start_rad is None else start_rad + found.turned_rad)


def test_the_limits_of_the_outputs_hold_between_the_samples() -> None:
    """The message names the sample of the reference."""
    outputs = {**ARM.outputs, "theta_1": replace(ARM.outputs["theta_1"], turns=2.0)}
    limited = _with_outputs(ARM, outputs)

    sentence = r"turns theta_1 by up to 2\.\d+ turns: theta_1.turns = 2 is reached at r\[\d+\], "
    with pytest.raises(InputError, match=sentence + "4.* s; change the reference or the law, or"):
        rehearse_control(arm_law(), STEP, limited)

    rehearse_control(arm_law(), STEP[:100], limited)


def _with_outputs(rig: Description, outputs: dict[str, Any]) -> Description:
    fields = {name: getattr(rig, name) for name in rig.__slots__}
    return Description(**{**fields, "outputs": outputs})


def test_a_monitor_of_the_rigs_model_stays_quiet_after_its_prelude(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Through the converter's steps and the dead band, from rest; the law closes the loop then."""
    law = arm_law(F=None, monitor=arm_monitor(prelude=50))

    codes, result = _rehearsed_input(monkeypatch, law, reference=STEP, described=ARM)

    assert codes[:50] == [round(2.0 / RAD_S_PER_V * 13107)] * 50
    assert len({*codes[50:]}) > 50
    assert result.turned_rad == pytest.approx(18.0, abs=0.6)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"settling": (False, False), "L": ((0.0, 0.0),) * 5},
            "theta_1 differs from the law's monitor (its innovation gate)",
        ),
        (
            {"deviations": (1.0, 7e-3), "L": ((0.5, 0.5),) * 5},
            "alpha differs from the law's monitor (its innovation gate)",
        ),
        ({}, "alpha differs from the law's monitor (its simulation gate)"),
    ],
    ids=["theta_1", "alpha", "simulation"],
)
def test_a_monitor_of_another_model_than_the_rigs_is_refused(
    changes: dict[str, Any], sentence: str
) -> None:
    law = arm_law(monitor=arm_monitor(B=(0.0,) * 5, **changes))

    with pytest.raises(InputError, match=r"^the rehearsal ends at r.*, because the mon") as err:
        rehearse_control(law, STEP, ARM)
    assert sentence in str(err.value)
    assert "change the reference or the law" in str(err.value)

    rehearse_control(law, STEP, ARM, unstable=True)


def test_a_rehearsal_is_faster_than_real_time_by_far() -> None:
    """60 s at 100 Hz within 3 s of processor time; 0.33 s were measured."""
    began = time.process_time()
    rehearse_control(arm_law(), np.full(6000, 3.0), ARM)

    assert time.process_time() - began < 3.0


def test_speed_control_leaves_the_angle_free_and_is_stable() -> None:
    """Its eigenvalue is exactly 1, and is not fed back; the others are those of the design."""
    law = arm_law()
    model = control_rehearsal.rig_model(ARM, None)

    assert control_rehearsal._instability(law.program(ARM), model, 0.01) == ""
    M, _, _ = control_rehearsal._loop(law.program(ARM), model, 0.01)
    poles = np.linalg.eigvals(M)
    for pole in (1.0, *np.exp(0.01 * np.array([-18 + 18j, -18 - 18j, -42]))):
        assert np.abs(poles - pole).min() < 0.01


@pytest.mark.parametrize("Ts", [0.005, 0.01])
def test_the_bound_of_stability_is_that_of_the_loop(Ts: float) -> None:
    """P control of the rate by differences: unstable from k_p 1.22 (10 ms) and 2.06 (5 ms)."""
    bound = {0.01: 1.22, 0.005: 2.06}[Ts]

    rehearse_control(_rate_law(0.97 * bound, Ts), np.full(50, 1.0), ARM)

    sentence = r"is unstable: an oscillation of 1\d\d rad/s grows by 0\.\d+% in each sample; design"
    with pytest.raises(InputError, match=sentence):
        rehearse_control(_rate_law(1.03 * bound, Ts), np.full(50, 1.0), ARM)
    allowed = rehearse_control(_rate_law(1.03 * bound, Ts), np.full(50, 1.0), ARM, unstable=True)
    assert allowed.turned_rad > 0


def _rate_law(k_p: float, Ts: float) -> ControlLaw:
    """Return a PI law of the rate (y[k-1] - y[k-2]) / Ts; its states are I and the two angles."""
    k_i = 3.0
    A = ((1.0, -k_i, k_i), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    B = ((k_i * Ts, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    return arm_law(
        Ts_us=round(Ts * 1e6),
        outputs=(LawOutput(name="theta_1", unit="rad", turning=True),),
        A=A,
        B=B,
        C=(1.0, -k_p / Ts, k_p / Ts),
        D=k_p,
        F=((0.0, 2.0, -1.0),),
        x0=(0.0, 0.0, 0.0),
    )


def _heater_law(
    k_p: float = 0.1, k_i: float = 0.0005, rig: str = "heater", **changes: Any
) -> ControlLaw:
    """Return a PI law of T1 at Ts 1 s, with a state for the integral and one for the newest y."""
    fields = {
        "Ts_us": 1_000_000,
        "input": builtin(rig).input.name,
        "outputs": (LawOutput(name="T1", unit="degC", y0=23.0),),
        "reference": Reference(name="T1 above 23 degC", unit="degC", low=0.0, high=60.0),
        "A": ((1.0, 0.0), (0.0, 0.0)),
        "B": ((k_i, 0.0, -k_i), (0.0, 0.0, 1.0)),
        "C": (1.0, -k_p),
        "D": k_p,
        "F": ((0.0, 1.0),),
        "x0": (0.0, 0.0),
        **changes,
    }
    return ControlLaw(**fields)


def test_a_heater_with_a_dead_time_settles_at_its_reference() -> None:
    low, high = _range(rehearse_control(_heater_law(), np.full(3000, 5.0), builtin("heater")))

    assert 27.5 <= high <= 30
    assert low == 23.0


def _range(rehearsal: Any, name: str = "T1") -> tuple[float, float]:
    low, high, _ = rehearsal.outputs[name]
    return low, high


def test_the_dead_time_of_a_model_counts_for_the_stability() -> None:
    """15 s of dead time: the gain margin of the PI is between 4 and 8."""
    rehearse_control(_heater_law(k_p=0.4), np.full(50, 5.0), builtin("heater"))

    with pytest.raises(InputError, match=r"an oscillation of 0\.\d+ rad/s grows by"):
        rehearse_control(_heater_law(k_p=12.8), np.full(50, 5.0), builtin("heater"))


def test_the_dead_time_in_a_law_has_no_states() -> None:
    """A Smith predictor: the model without its dead time in the law, and the delay of the input."""
    plain = control_rehearsal._loop(
        _heater_law().program(builtin("heater")),
        control_rehearsal.rig_model(builtin("heater"), None),
        1.0,
    )
    delayed = control_rehearsal._loop(
        _heater_law(input_delay=20, B=((0.0, 0.5, 0.0), (0.0, 0.0, 1.0))).program(
            builtin("heater")
        ),
        control_rehearsal.rig_model(builtin("heater"), None),
        1.0,
    )

    assert (len(plain[0]), len(delayed[0])) == (2 + 2 + 15, 2 + 2 + 20)
    assert delayed[0][2, 4 + 19] == 0.5
    assert delayed[0][0, 4 + 14] == pytest.approx(0.01, rel=0.01)


def test_the_output_of_a_heater_leaves_its_limit() -> None:
    outputs = {**builtin("heater").outputs}
    outputs["T1"] = replace(outputs["T1"], high=29.0, rail_is_outside=True)
    rig = _with_outputs(builtin("heater"), outputs)

    sentence = r"takes T1 from 23 to 3\d.* degC: T1.high = 29 is reached at r\[\d+\], \d+ s; change"
    with pytest.raises(InputError, match=sentence):
        rehearse_control(_heater_law(), np.full(3000, 60.0), rig)
    rehearse_control(_heater_law(), np.full(100, 60.0), rig)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"most_limited": 5},
            r"ends at r\[4\], 4 s; .*: the voltage is at a limit in 5 samples in",
        ),
        (
            {"tracking": Tracking(row=(0.0, 0.0, 1.0), most=20.0, samples=10)},
            r"ends at r\[9\], 9 s; .*: the control error is above 20 in 10 samples in a row",
        ),
        (
            {"A": ((1e200, 0.0), (0.0, 0.0)), "x0": (1e-3, 0.0), "C": (0.0, 0.0)},
            r"ends at r\[1\], 1 s; .*: the law's states are not finite",
        ),
        (
            {"A": ((1e200, 0.0), (0.0, 0.0)), "x0": (1e-3, 0.0), "C": (1e300, 0.0)},
            r"ends at r\[1\], 1 s; .*: the law computes the voltage inf",
        ),
    ],
)
def test_the_law_ends_a_rehearsal_as_it_would_end_a_run(
    changes: dict[str, Any], sentence: str
) -> None:
    law = _heater_law(k_p=1.0, **{"k_i": 0.05, **changes})

    with pytest.raises(InputError, match="the rehearsal " + sentence):
        _without_stability(law, builtin("heater"))


def _without_stability(law: ControlLaw, rig: Description) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(control_rehearsal, "_instability", lambda *args: "")
        return rehearse_control(law, np.full(50, 30.0), rig)


def test_an_unstable_loop_may_be_ended_by_its_law() -> None:
    """Its rehearsal then ends there; a state that is not finite is a fault."""
    law = _heater_law(most_limited=5)
    found = rehearse_control(law, np.full(5000, 60.0), builtin("heater"), unstable=True)

    assert _range(found)[1] < 24.0
    at_once = _heater_law(most_limited=1)
    assert _range(rehearse_control(at_once, [60.0], builtin("heater"), unstable=True))[1] == 23.0
    wild = _heater_law(A=((1e200, 0.0), (0.0, 0.0)), x0=(1e-3, 0.0))
    with pytest.raises(InputError, match="the law's states are not finite"):
        rehearse_control(wild, np.full(5, 5.0), builtin("heater"), unstable=True)


def test_a_blind_law_ends_a_rehearsal() -> None:
    """A thermometer that reads an end of its range gives no valid output."""
    outputs = {**builtin("heater").outputs}
    outputs["T1"] = replace(outputs["T1"], zero_counts=-6000.0, high=np.inf, blind_s=None)
    rig = _with_outputs(builtin("heater"), outputs)

    with pytest.raises(InputError, match="the law has no valid output in 20 samples in a row"):
        rehearse_control(_heater_law(), np.full(50, 5.0), rig)


def test_an_integrator_in_the_loop_that_nothing_moves_is_unstable() -> None:
    """The law reads T2, and its integral is fed back only through T1: a deviation stays."""
    law = _heater_law(
        A=((1.0, 0.0), (0.0, 0.0)), B=((0.0, 0.1, 0.0), (0.0, 0.0, 1.0)), C=(0.5, 0.0)
    )
    with pytest.raises(InputError, match=r"unstable: a deviation grows by 5.00% in each sample"):
        rehearse_control(law, np.full(5, 5.0), builtin("heater"))
    free = _heater_law(B=((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    rehearse_control(free, np.full(5, 5.0), builtin("heater"))
    held = _heater_law(C=(0.0, -0.1), B=((0.0, 0.0, 0.1), (0.0, 0.0, 1.0)))
    rehearse_control(held, np.full(5, 5.0), builtin("heater"))
    marginal = _heater_law(
        A=((0.5, 0.0), (0.0, 0.0)), B=((0.0, 0.5, 0.0), (0.0, 0.0, 1.0)), C=(1.0, 0.0)
    )
    with pytest.raises(InputError, match="unstable: a deviation stays; design the law with less"):
        rehearse_control(marginal, np.full(5, 5.0), builtin("heater"))
    _, (A, B, C, *_) = require_model(builtin("heater"))
    gain = float((np.array(C) @ np.linalg.solve(-np.array(A), np.array(B)))[0, 0])
    positive = _heater_law(A=((0.0,),), B=((0.0, 0.0, 1.0),), C=(1 / gain,), x0=(0.0,), F=None)
    with pytest.raises(InputError, match="unstable: a deviation stays; design the law with less"):
        rehearse_control(positive, np.full(5, 5.0), builtin("heater"))
    growing = _heater_law(A=((1.01, 0.0), (0.0, 0.0)), C=(0.0, -0.1))
    with pytest.raises(InputError, match=r"unstable: a deviation grows by 1.00% in each sample"):
        rehearse_control(growing, np.full(5, 5.0), builtin("heater"))


TANK = """
[rig]
name = "tank"
image = "{image}"
[input]
name = "pump"
rest_v = {rest_v}
[outputs.level]
unit = "cm"
per_count = 0.001
high = 60
[model]
{model}
"""


def _tank(folder: Path, model: str, rest_v: float = 0.0) -> Description:
    path = folder / "tank.toml"
    image = WITH_ENABLE_LINE[0] if rest_v else "uno"
    path.write_text(TANK.format(model=model, rest_v=rest_v, image=image))
    return read_description(path)


def _tank_law(**changes: Any) -> ControlLaw:
    fields = {
        "input": "pump",
        "outputs": (LawOutput(name="level", unit="cm"),),
        "reference": Reference(name="level", unit="cm", low=0.0, high=50.0),
        "hi": 5.0,
    }
    return _heater_law(k_p=0.1, k_i=0.002, **{**fields, **changes})


EQUATIONS = """
import numpy as np
import armrig

model = armrig.Ode(
    f=lambda t, x, u, p: [0.2 * u[0] - 0.05 * np.sqrt(np.maximum(x[0], 0.0) + 1e-6)],
    output=lambda t, x, u, p: 0.1 + x[0],
    states=["level"],
    parameters={},
)
"""


def test_own_equations_of_a_tank_are_asked_for_each_sample(tmp_path: Path) -> None:
    (tmp_path / "tank.py").write_text(EQUATIONS)
    rig = _tank(tmp_path, 'file = "tank.py"\noffset = [2.0]')

    low, high = _range(rehearse_control(_tank_law(), np.full(300, 10.0), rig), "level")

    assert 9.5 < high < 14
    assert low >= 2.0
    with pytest.raises(InputError, match=r"level\.high = 60 is reached at r"):
        rehearse_control(_tank_law(u0=5.0), np.full(300, 50.0), rig, unstable=True)


def test_a_model_in_discrete_time_needs_the_sampling_time_of_the_law(tmp_path: Path) -> None:
    import armrig

    fields = {"input": "pump", "output": "level", "input_unit": "V", "unit": "cm"}
    fit = armrig.Fit.of_channel(B=[0, 0.5], F=[1, -0.95], nk=1, Ts=1.0, **fields)
    fit.save(tmp_path / "tank.json")
    rig = _tank(tmp_path, 'file = "tank.json"\noffset = [2.0]')

    found = rehearse_control(_tank_law(), np.full(400, 10.0), rig)

    assert 9.5 < _range(found, "level")[1] < 14
    with pytest.raises(InputError, match=r"the law has Ts = 0.5 s, and the model in tank.json has"):
        rehearse_control(_tank_law(Ts_us=500_000), np.full(400, 10.0), rig)


def test_a_rig_rests_where_its_description_says(tmp_path: Path) -> None:
    """The model has the difference from rest, also during its dead time of 3 s."""
    model = "A = [[-0.05]]\nB = [[0.5]]\nC = [[1.0]]\noffset = [2.0]\ndelay_s = 3.0"
    rig = _tank(tmp_path, model, rest_v=1.0)
    still = _tank_law(B=((0.0,) * 3,) * 2, C=(0.0, 0.0), D=0.0, u0=1.0)

    at_rest = rehearse_control(still, np.zeros(200), rig)
    above = rehearse_control(replace(still, u0=2.0), np.zeros(4), rig)

    assert _range(at_rest, "level") == pytest.approx((2.0, 2.0), abs=0.011)  # 10 bits
    assert _range(above, "level") == pytest.approx((2.0, 2.5), abs=0.02)


def test_the_duty_and_the_converter_have_their_resolutions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.03 V are 2 steps of 5/256 V; a reading of 10 bits is a multiple of 64 counts."""
    readings: list[float] = []
    observe = control_rehearsal.observe

    def observe_and_note(*args: Any) -> Any:
        readings.append(args[3][0] / 0.001)
        return observe(*args)

    monkeypatch.setattr(control_rehearsal, "observe", observe_and_note)
    rig = _tank(tmp_path, "A = [[-0.05]]\nB = [[0.5]]\nC = [[1.0]]\noffset = [2.0]")
    law = _tank_law(B=((0.0,) * 3,) * 2, C=(0.0, 0.0), D=0.0, u0=0.03)

    found = rehearse_control(law, np.zeros(400), rig, latch=Latch(pwm_bits=8))

    assert _range(found, "level")[1] == pytest.approx(2.0 + 10 * 2 * 5 / 256, rel=1e-4)
    np.testing.assert_allclose(np.array(readings) / 64, np.round(np.array(readings) / 64))
    assert len({*readings}) > 3


def test_own_equations_have_the_rest_before_the_run(tmp_path: Path) -> None:
    """The voltage at the pin acts after the dead time of 3 s; 1 V is the rest."""
    text = EQUATIONS.replace("0.2 * u[0]", "0.2 * (u[0] - 1)").replace("={},", "={}, delay=3.0,")
    (tmp_path / "tank.py").write_text(text)
    rig = _tank(tmp_path, 'file = "tank.py"\noffset = [2.0]', rest_v=1.0)
    still = _tank_law(B=((0.0,) * 3,) * 2, C=(0.0, 0.0), D=0.0, u0=1.0)

    low, high = _range(rehearse_control(still, np.zeros(20), rig), "level")

    assert high - low < 0.01


def test_the_slew_and_the_limits_of_the_latch_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    latch = Latch(rest_code=0, pwm_bits=8, code_max=20_000, slew=1000)
    codes, _ = _rehearsed_input(
        monkeypatch, arm_law(), reference=STEP, described=ARM, latch=latch, unstable=True
    )

    assert np.abs(np.diff([0, *codes])).max() == 1000
    assert max(codes) == 20_000


def test_a_law_of_an_output_without_a_model_is_refused() -> None:
    with pytest.raises(InputError, match="the law uses alpha, and the rig's model has no alpha"):
        rehearse_control(arm_law(), STEP, ARM, arm_removed=True)


def test_a_dead_time_of_too_many_samples_is_refused() -> None:
    law = _heater_law(Ts_us=5_000)
    with pytest.raises(InputError, match=r"15 s is 3000 samples, and the stability .* longer Ts"):
        rehearse_control(law, np.full(50, 5.0), builtin("heater"))
