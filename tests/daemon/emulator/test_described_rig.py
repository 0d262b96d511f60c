"""The emulated rig of a description moves as its matrices, or as its model's file, say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig_core.commands.rehearsal import rehearse_outputs
from armrig_core.errors import FileError, InputError, OperationError
from armrig_core.rig.description import Description, builtin, read_description, require_model
from armrig_core.rig.saved_model import read_system
from armrig_daemon.emulator.described_rig import DescribedRig

RC = builtin("rc")
HEATER = builtin("heater")
MS = 1_000_000


def moved(description: Description, u: Any, step_ns: int) -> list[float]:
    """Return output 0 after each step at the voltages u."""
    rig, found = DescribedRig(description, np.random.default_rng(1)), []
    output = next(iter(description.outputs.values()))
    for volts in u:
        rig.advance(volts, step_ns)
        fraction = rig.wiper(0)
        assert fraction is not None
        found.append(output.value(65536 * fraction))
    return found


def test_a_step_of_the_circuit_has_its_two_time_constants() -> None:
    t = np.arange(1, 101) * 0.01

    y = moved(RC, [3.0] * 100, 10 * MS)

    exact = 3 * (1 - (15 * np.exp(-8 * t) - 8 * np.exp(-15 * t)) / 7)
    assert y == pytest.approx(exact, abs=1e-9)


def test_the_circuit_at_rest_is_away_from_the_rails() -> None:
    """A sample at a rail has no value, and a rig that rests at a rail is not armed."""
    rest = DescribedRig(RC, np.random.default_rng(1)).wiper(0)

    assert rest == pytest.approx(0.5 / 6, abs=1e-4)


def test_the_motion_does_not_depend_on_the_division_of_time() -> None:
    coarse, fine = moved(RC, [2.0] * 5, 20 * MS), moved(RC, [2.0] * 100, MS)

    assert coarse == pytest.approx(fine[19::20], abs=1e-12)


def test_the_input_of_the_heater_acts_after_its_dead_time() -> None:
    text = HEATER.text.replace(b"noise = [0.05, 0.05]", b"")
    y = moved(Description.of(text), [5.0] * 30, 1000 * MS)

    assert y[:15] == pytest.approx([23.0] * 15)
    assert y[15] > 23.01


def test_the_reading_of_a_nonlinear_sensor_is_the_inverse_of_its_points() -> None:
    """The output is between two points of the table: 25 degC and 45 % of 0.599 degC/%."""
    text = builtin("heatshield").text.replace(b"noise = [0.05]", b"")

    y = moved(Description.of(text), [2.25] * 6, 1_000_000 * MS)

    assert y[-1] == pytest.approx(25 + 0.599 * 45, abs=0.01)


def test_the_rehearsal_agrees_with_the_emulator() -> None:
    u = [0.0, 4.0, 1.0, 5.0] * 25
    y = moved(RC, u, 10 * MS)

    found = rehearse_outputs(u, 0.01, RC).outputs

    assert found["y"][:2] == pytest.approx((0.0, max(y)))  # type: ignore[index]


def test_a_run_that_would_leave_a_limit_is_refused_with_output_value_and_time() -> None:
    limited = Description.of(RC.text.replace(b'unit = "V"', b'unit = "V"\nhigh = 4.0', 1))

    with pytest.raises(InputError, match=r"takes y from 0 to 5 V: y\.high = 4 is reached at u\["):
        rehearse_outputs([5.0] * 100, 0.01, limited)
    rehearse_outputs([3.9] * 100, 0.01, limited)


def saved(path: Path, **changes: Any) -> Path:
    """Write y(t) = 0.5 y(t-1) + 0.25 u(t-1) as `armrig identify --save` does."""
    form = {"kind": "polynomials", "A": [[[1.0]]], "B": [[[0.0, 0.25]]], "F": [[[1.0, -0.5]]]}
    content = {"format": "armrig model", "outputs": ["y"], "input_units": ["V"], "Ts": 0.01}
    path.write_text(json.dumps(content | {"form": form} | changes))
    return path


def test_a_saved_model_is_emulated_at_its_own_sampling_time(tmp_path: Path) -> None:
    saved(tmp_path / "model.json")
    text = RC.text.partition(b"[model]")[0] + b'[model]\nfile = "model.json"\n'
    (tmp_path / "own.toml").write_bytes(text)
    own = read_description(tmp_path / "own.toml")

    y = moved(own, [4.0] * 4, 10 * MS)

    assert y == pytest.approx([1.0, 1.5, 1.75, 1.875])
    with pytest.raises(InputError, match=r"model\.json has Ts = 0\.01 s"):
        rehearse_outputs([1.0] * 5, 0.02, own)


def test_a_model_saved_with_an_offset_is_emulated_with_its_values_at_rest(tmp_path: Path) -> None:
    """With u0 = -2 V and the gain 0.5 the output rests at 1."""
    saved(tmp_path / "model.json", free=[{"transients": [0.0], "offset": -2.0}])
    text = RC.text.partition(b"[model]")[0] + b'[model]\nfile = "model.json"\n'
    (tmp_path / "own.toml").write_bytes(text)
    own = read_description(tmp_path / "own.toml")

    assert moved(own, [4.0] * 4, 10 * MS) == pytest.approx([2.0, 2.5, 2.75, 2.875])
    assert rehearse_outputs([0.0] * 5, 0.01, own).outputs["y"][:2] == (1.0, 1.0)


EQUATIONS = """
import armrig, os, sys, time
import numpy as np

def late(t, does):
    if np.any(t > 0.06): does()

def f(t, x, u, p):
    return [(u[0] - x[0]) / p.tau]

tau = armrig.Parameter(0.1, "s", low=0)
model = armrig.Ode(f=f, output=lambda t, x, u, p: x[0], states=["v"], parameters={"tau": tau})
"""


def own_equations(folder: Path, old: str = "", new: str = "") -> Path:
    """Write a description with own equations, in which `new` replaces `old`."""
    (folder / "rc.py").write_text(EQUATIONS.replace(old, new, 1))
    text = RC.text.partition(b"[model]")[0] + b'[model]\nfile = "rc.py"\noffset = [0.5]\n'
    (folder / "own.toml").write_bytes(text)
    return folder / "own.toml"


def test_own_equations_are_emulated_and_rehearsed(tmp_path: Path) -> None:
    own = read_description(own_equations(tmp_path))

    y = moved(own, [2.0] * 4, 50 * MS)
    rehearsal = rehearse_outputs([2.0] * 4, 0.05, own)

    exact = 0.5 + 2 * (1 - np.exp(-0.5 * np.arange(1, 5)))
    assert y == pytest.approx(exact, abs=1e-5)
    assert rehearsal.outputs["y"][:2] == pytest.approx((0.5, exact[-1]), abs=1e-5)
    model, system = require_model(own)
    assert system.process is not None
    system.process.close()
    assert (model.offset, system.A[0][0]) == ([0.5], pytest.approx(-10.0))


def test_the_description_of_a_recording_runs_no_code(tmp_path: Path) -> None:
    own = own_equations(tmp_path, "import armrig", "open('ran', 'w')\nimport armrig")

    attached = Description.of(own.read_bytes())

    with pytest.raises(InputError, match="cannot be emulated without"):
        require_model(attached)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("tau = ", "1 / 0\ntau = ", "line 11: ZeroDivisionError"),
        ("tau = ", "sys.exit(3)\ntau = ", "line 11: SystemExit: 3"),
        ("tau = ", "raise KeyboardInterrupt\ntau = ", "line 11: KeyboardInterrupt"),
        ("tau = ", "os._exit(3)\ntau = ", "the process ended after t = 0 s"),
        ("tau = ", "time.sleep(99)\ntau = ", "took more than 2 s"),
        ("tau = ", "while True: os.write(3, b'1' * 65536)\ntau = ", "wrote too much"),
        (
            "    return",
            "    if np.any(t > 0.06): 1 / 0\n    return",
            r"at t = 0\.05 s, x = \[0\.78",
        ),
        ("    return", "    if np.any(t > 0.06): sys.exit()\n    return", "raised SystemExit"),
        (
            "    return",
            "    if np.any(t > 0.06): time.sleep(99)\n    return",
            r"from t = 0\.05 s on",
        ),
        ("x[0]) / p", "np.where(t > 0.06, np.nan, x[0])) / p", r"at t = 0\.05 s.*do not follow"),
        ("p: x[0]", "p: np.where(t > 0.06, np.nan, x[0])", r"at t = 0\.05 s.*not finite"),
        ("p: x[0]", "p: None", "returns a value that is not finite"),
        ("tau = ", "os.fork() or time.sleep(60)\n1 / 0\ntau = ", "ZeroDivisionError"),
        ("p: x[0]", "p: [x[0], x[0]]", "returns 2 values; the rig has 1 output, y"),
    ],
)
def test_a_bad_model_file_ends_in_a_sentence(
    old: str, new: str, error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for s in ("START_S", "ANSWER_S"):
        monkeypatch.setattr(f"armrig_core.rig.equations_file._{s}", 2.0 if "sleep" in new else 30.0)
    own = read_description(own_equations(tmp_path, old, new))

    with pytest.raises((InputError, OperationError), match=error):
        moved(own, [2.0] * 4, 50 * MS)


MATRICES = {
    "kind": "matrices",
    "nk": [1],
    "A": [[0.5]],
    "B": [[1.0]],
    "C": [[1.0]],
    "D": [[0.0]],
}
POLYNOMIALS = {"kind": "polynomials", "A": [[[1.0]]], "B": [[[0.0, 1.0]]], "F": [[[1.0, -0.5]]]}


def test_a_saved_process_is_emulated_with_its_dead_time(tmp_path: Path) -> None:
    """After 2 s of dead time, 3 V/V and 10 s: F = s + 0.1, B = 0.3."""
    form = {"kind": "transfer function", "B": [[[0.3]]], "F": [[[1.0, 0.1]]], "delay": 2.0}
    saved(tmp_path / "model.json", Ts=0.0, form=form)
    text = RC.text.partition(b"[model]")[0] + b'[model]\nfile = "model.json"\n'
    (tmp_path / "own.toml").write_bytes(text)
    own = read_description(tmp_path / "own.toml")

    y = moved(own, [1.0] * 30, 1000 * MS)

    t = np.arange(1, 31)
    assert y == pytest.approx(3 * (1 - np.exp(-np.maximum(t - 2, 0) / 10)), abs=1e-9)
    assert rehearse_outputs([1.0] * 30, 1.0, own).outputs["y"][1] == pytest.approx(y[-1])


def test_the_reading_of_a_model_that_grows_to_infinity_is_an_end_of_the_range() -> None:
    """An inf or NaN ends no emulator: the daemon has to see a sensor at its end."""
    text = RC.text.partition(b"[model]")[0]
    text += b"[model]\nA = [[1e4]]\nB = [[1.0]]\nC = [[1.0]]\nunstable = true\n"

    with np.errstate(all="ignore"):
        rig = DescribedRig(Description.of(text), np.random.default_rng(1))
        rig.advance(5.0, 1000 * MS)

    assert rig.wiper(0) in {-1.0, 2.0}


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"format": "other"}, "no model; `armrig identify --save` writes"),
        ({"outputs": ["T1"]}, "a model of T1; the rig has one input and the outputs y"),
        ({"form": {"kind": "polynomials"}}, "a damaged model"),
        ({"form": POLYNOMIALS | {"B": [[[1.0]]]}}, r"the input acts at once \(nk=0\)"),
        ({"form": POLYNOMIALS | {"F": [[[2.0, 1.0]]]}}, "a damaged model"),
        ({"form": POLYNOMIALS | {"A": [[[1.0] * 10**5]]}}, "has 100000 states; 1 to 400"),
        ({"form": MATRICES | {"A": [[0.1, 0.2], [0.3]]}}, "a damaged model"),
        ({"form": MATRICES | {"A": [["x"]]}}, "a damaged model"),
        ({"form": MATRICES | {"B": [[1.0], [1.0]]}}, "a damaged model"),
        ({"form": MATRICES | {"A": [[0.0]] * 401}}, "has 401 states; 1 to 400"),
        ({"Ts": 1e-9}, "Ts = 1e-09 s: at least 0.0001 s"),
        ({"Ts": -1.0}, "Ts = -1 s"),
        (
            {"form": {"kind": "transfer function", "B": [[[1]]], "F": [[[1, 1]]], "delay": -1}},
            "dam",
        ),
    ],
)
def test_a_file_that_cannot_be_emulated_is_refused(
    tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    with pytest.raises(FileError, match=why):
        read_system(saved(tmp_path / "m.json", **changes), ["y"])


def test_a_file_that_is_nested_too_deeply_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text('{"format": "armrig model", "form": ' + "[" * 10**5)

    with pytest.raises(FileError, match="a damaged model"):
        read_system(tmp_path / "m.json", ["y"])


CENTRED = b"""[rig]
name = "centred"
[input]
name = "armature"
per_volt = 4.8
offset = -12.0
rest_v = 2.5
[outputs.y]
unit = "rad/s"
zero_counts = 32768.0
per_count = 0.006
[model]
"""


def test_a_model_of_the_inputs_own_value_is_emulated_from_its_rest(tmp_path: Path) -> None:
    """3 rad/s per V of the armature and 1 s; 1 V at the pin is 4.8 V of the armature."""
    form = {"kind": "transfer function", "B": [[[3.0]]], "F": [[[1.0, 1.0]]], "delay": 0.0}
    found = {}
    for name in ("armature", "u"):  # a model of u has the voltage at the pin
        saved(tmp_path / "model.json", Ts=0.0, form=form, inputs=[name], input_units=["V"])
        (tmp_path / "own.toml").write_bytes(CENTRED + b'file = "model.json"\noffset = [0.0]\n')
        own = read_description(tmp_path / "own.toml")
        found[name] = moved(own, [3.5] * 20, 1000 * MS)[-1]
        assert moved(own, [2.5] * 3, 1000 * MS) == pytest.approx([0.0] * 3)
        assert rehearse_outputs([3.5] * 20, 1.0, own).outputs["y"][1] == pytest.approx(found[name])

    assert found == pytest.approx({"armature": 3 * 4.8, "u": 3.0}, rel=1e-6)


def test_own_equations_see_the_voltage_at_the_pin_from_rest_on(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "import armrig\n"
        "model = armrig.Ode(lambda t, x, u, p: [u[0] - 2.5 - x[0]], states=['x'], parameters={},\n"
        "    output=lambda t, x, u, p: x[0])\n"
    )
    (tmp_path / "own.toml").write_bytes(CENTRED + b'file = "own.py"\ndelay_s = 2.0\n')
    own = read_description(tmp_path / "own.toml")

    y = moved(own, [3.5] * 20, 1000 * MS)

    assert y[:2] == pytest.approx([0.0, 0.0], abs=1e-9)  # before the dead time is over, it rests
    assert y[-1] == pytest.approx(1.0, rel=1e-5)
