"""A control law is refused with what came, what is allowed and what to do."""

from __future__ import annotations

import re
from math import inf, nan
from pathlib import Path
from typing import Any

import msgspec
import pytest
from armrig_core.control.control_law import (
    ControlLaw,
    LawOutput,
    Reference,
    Tracking,
    load_law,
)
from armrig_core.errors import FileError, InputError
from armrig_core.rig.description import Description, builtin

from tests.core.control.laws import arm_law, arm_monitor

ARM = builtin("arm")
REFERENCE = {"name": "velocity", "unit": "rad/s"}
ALPHA = LawOutput(name="alpha", unit="rad")
BAD_LAWS: dict[str, tuple[dict[str, Any], str]] = {
    "nine states": (
        {"A": ((0.0,) * 9,) * 9, "B": ((0.0,) * 4,) * 9, "C": (0.0,) * 9, "x0": (0.0,) * 9},
        "the law has 9 states; at most 8 are allowed: design it with a model of lower order",
    ),
    "rows": ({"A": ((0.0,) * 5,) * 4}, "A has 4 x 5 numbers; with 5 states in x0 and 2 outputs "),
    "ragged": (
        {"B": ((0.0,) * 4,) * 4 + ((0.0,),)},
        "B has 5 x 1 or 4 numbers; .* must have 5 x 4",
    ),
    "no rows": ({"A": ()}, "A has 0 x 0 numbers"),
    "wide C": ({"C": (0.0,) * 6}, "C has 1 x 6 numbers; .* it must have 1 x 5"),
    "F": ({"F": ((0.0,) * 5,)}, "F has 1 x 5 numbers; .* it must have 2 x 5"),
    "tracking": (
        {"tracking": Tracking(row=(0.0,) * 5, most=1.0, samples=3)},
        "tracking.row has 1 x 5 numbers; .* it must have 1 x 7",
    ),
    "not finite": (
        {"C": (nan,) * 5},
        "C of the law has the number nan; all numbers must be finite: repeat the design",
    ),
    "infinite x0": ({"x0": (0.0, inf, 0.0, 0.0, 0.0)}, "x0 of the law has the number inf"),
    "infinite range": (
        {"reference": Reference(**REFERENCE, low=0, high=inf)},
        "reference of the law",
    ),
    "infinite y0": ({"outputs": (LawOutput(name="alpha", unit="rad", y0=-inf), ALPHA)}, "outputs"),
    "infinite bound": (
        {"tracking": Tracking(row=(0.0,) * 7, most=inf, samples=3)},
        "tracking of the law has the number inf",
    ),
    "limits": ({"lo": 3.0, "hi": 3.0}, "lo = 3 V must be below hi = 3 V"),
    "limit": ({"lo": nan}, "lo = nan V must be below hi = 5 V"),
    "escape sequence": (
        {"reference": Reference(name="\x1b[31m", unit="V", low=0.0, high=1.0)},
        "a name or a unit of the law must be printable",
    ),
    "long design": (
        {"design": {"method": "x" * 70_000}},
        "design has 70013 B; at most 65536 B are allowed",
    ),
    "range": (
        {"reference": Reference(**REFERENCE, low=2.0, high=1.0)},
        "reference.low = 2 must be at most high = 1",
    ),
    "twice": ({"outputs": (ALPHA, ALPHA)}, "outputs: alpha is given twice; give each output once"),
    "turning y0": (
        {"outputs": (LawOutput(name="theta_1", unit="rad", turning=True, y0=1.0), ALPHA)},
        "theta_1 turns, so its y0 must be 0, not 1",
    ),
    "turning without F": (
        {"F": None},
        "theta_1 turns through a dead band, so the law needs F, its prediction of the output, or a "
        "monitor",
    ),
    "monitor's states": (
        {"monitor": arm_monitor(x0=(0.0,) * 11)},
        "the monitor has 11 states; at most 10 are allowed: use a model of lower order",
    ),
    "monitor.A": (
        {"monitor": arm_monitor(A=((0.0,) * 5,) * 4)},
        "monitor.A has 4 x 5 numbers; with 5 states in x0 and 2 outputs it must have 5 x 5",
    ),
    "monitor.x0": (
        {"monitor": arm_monitor(x0=(0.0,) * 4)},
        "monitor.A has 5 x 5 numbers; with 4 states in x0 and 2 outputs it must have 4 x 4",
    ),
    "monitor.B": ({"monitor": arm_monitor(B=(0.0,) * 4)}, "monitor.B has 1 x 4 .* have 1 x 5"),
    "monitor.C": ({"monitor": arm_monitor(C=((0.0,) * 5,))}, "monitor.C has 1 x 5 .* have 2 x 5"),
    "monitor.L": (
        {"monitor": arm_monitor(L=((0.0, 0.0),) * 4 + ((0.0,),))},
        "monitor.L has 5 x 1 or 2 numbers; .* it must have 5 x 2",
    ),
    "monitor.deviations": (
        {"monitor": arm_monitor(deviations=(1.0,))},
        "monitor.deviations has 1 x 1 numbers; .* it must have 1 x 2",
    ),
    "monitor.settling": (
        {"monitor": arm_monitor(settling=(True,) * 3)},
        "monitor.settling has 1 x 3 numbers; .* it must have 1 x 2",
    ),
    **{
        f"deviation {s:g}": (
            {"monitor": arm_monitor(deviations=(1.0, s))},
            f"monitor.deviations are 1, {s:g}: each must be above 0",
        )
        for s in (0.0, -1.0)
    },
    **{
        f"infinite monitor.{key}": (
            {"monitor": arm_monitor(**{key: value})},
            f"monitor.{name} of the law has the number",
        )
        for key, name, value in (
            ("A", "A", ((inf,) * 5,) * 5),
            ("B", "B", (nan,) * 5),
            ("C", "C", ((inf,) * 5,) * 2),
            ("L", "L", ((nan, 0.0),) * 5),
            ("x0", "x0", (0.0, 0.0, 0.0, 0.0, inf)),
            ("deviations", "deviations", (1.0, nan)),
            ("u0", "forward", -inf),
            ("forward", "forward", (0.0, inf)),
        )
    },
}


@pytest.mark.parametrize(("changes", "sentence"), BAD_LAWS.values(), ids=BAD_LAWS)
def test_a_law_that_cannot_be_evaluated_is_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        arm_law(**changes)


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("Ts_us", 4_999, "Expected `int` >= 5000 - at `$.Ts_us`"),
        ("Ts_us", 1_000_001, "Expected `int` <= 1000000 - at `$.Ts_us`"),
        ("hi", 5.1, "Expected `float` <= 5.0 - at `$.hi`"),
        ("lo", -0.1, "Expected `float` >= 0.0 - at `$.lo`"),
        ("slew", -1.0, "Expected `float` >= 0.0 - at `$.slew`"),
        ("input_delay", 201, "Expected `int` <= 200 - at `$.input_delay`"),
        ("most_blind", 0, "Expected `int` >= 1 - at `$.most_blind`"),
        ("outputs", [], "Expected `array` of length >= 1 - at `$.outputs`"),
        ("C", [None] * 5, "Expected `float`, got `null` - at `$.C[0]`"),
        ("gain", 1.0, "Object contains unknown field `gain`"),
        ("x0", [0.0] * 9, "the law has 9 states"),
    ],
)
def test_a_file_with_a_value_that_is_not_allowed_is_refused(
    key: str, value: object, sentence: str
) -> None:
    text = msgspec.json.encode({**msgspec.to_builtins(arm_law()), key: value})

    with pytest.raises(InputError, match=f"^no control law: {re.escape(sentence)}"):
        ControlLaw.of(text)


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("prelude", -1, "Expected `int` >= 0 - at `$.monitor.prelude`"),
        ("prelude", 10_001, "Expected `int` <= 10000 - at `$.monitor.prelude`"),
        ("input_delay", -1, "Expected `int` >= 0 - at `$.monitor.input_delay`"),
        ("input_delay", 201, "Expected `int` <= 200 - at `$.monitor.input_delay`"),
        ("forward", [1.0], "Expected `array` of length 2 - at `$.monitor.forward`"),
        ("settling", [0, 1], "Expected `bool`, got `int` - at `$.monitor.settling[0]`"),
        ("gates", 2, "Object contains unknown field `gates` - at `$.monitor`"),
    ],
)
def test_a_file_with_a_monitor_that_is_not_allowed_is_refused(
    key: str, value: object, sentence: str
) -> None:
    fields = msgspec.to_builtins(arm_law(monitor=arm_monitor()))
    fields["monitor"][key] = value

    with pytest.raises(InputError, match=f"^no control law: {re.escape(sentence)}"):
        ControlLaw.of(msgspec.json.encode(fields))


def test_a_monitor_of_ten_states_and_a_turning_output_without_F_are_allowed() -> None:
    row = (0.0,) * 10
    large = {"A": (row,) * 10, "B": row, "C": (row, row), "L": ((0.0, 0.0),) * 10, "x0": row}

    law = arm_law(F=None, monitor=arm_monitor(**large, prelude=10_000, input_delay=200))

    assert ControlLaw.of(law.text) == law


@pytest.mark.parametrize("text", [b"", b"[]", b"{}", b"[" * 100_000, b'{"x0": 1e999}'])
def test_a_text_that_is_no_law_is_refused(text: bytes) -> None:
    with pytest.raises(InputError, match=r"^no control law: "):
        ControlLaw.of(text)


def test_a_law_in_a_file_is_the_law_that_was_written(tmp_path: Path) -> None:
    tracking = Tracking(row=(0.0,) * 7, most=1, samples=3)
    law = arm_law(design={"method": "LQG"}, tracking=tracking, monitor=arm_monitor())
    path = tmp_path / "law.json"
    path.write_bytes(law.text)

    assert load_law(path) == law
    assert load_law(path).sha256 == law.sha256
    assert arm_law(u0=1e-9).sha256 != arm_law().sha256
    watched = [arm_law(monitor=arm_monitor(prelude=n)) for n in (0, 1)]
    assert len({law.sha256 for law in [*watched, arm_law()]}) == 3


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    with pytest.raises(FileError, match=r"law.json: No such file"):
        load_law(path)

    path.write_text("{")
    with pytest.raises(FileError, match=r"law.json: no control law: Input data was truncated"):
        load_law(path)


@pytest.mark.parametrize("values", [[0.0, 8.1], [0.0, -0.1], [0.0, nan], [0.0, inf], [0.0, -inf]])
def test_a_reference_out_of_range_is_refused(values: list[float]) -> None:
    sentence = rf"r\[1\] = {values[1]:g} rad/s: the law allows 0 to 8; change this value, or "
    with pytest.raises(InputError, match=sentence):
        arm_law().check_reference(values)

    arm_law().check_reference([0.0, 8.0])


BAD_RIGS: dict[str, tuple[dict[str, Any], Description, dict[str, float], str]] = {
    "Ts": (
        {},
        ARM,
        {"Ts_us": 10_001},
        "Ts = 0.01 s, and the run 0.010001 s: run with the law's Ts",
    ),
    "input": ({"input": "Q1"}, ARM, {}, "the law drives Q1, and the rig's input is u: design the"),
    "output": ({}, builtin("chassis"), {}, "the law uses alpha, and the rig has theta_1: design "),
    "unit": (
        {
            "outputs": (
                LawOutput(name="theta_1", unit="rad", turning=True),
                LawOutput(name="alpha", unit="deg"),
            )
        },
        ARM,
        {},
        "the law's alpha is in deg, and the rig's in rad: design the law in the rig's unit",
    ),
    "turning": (
        {"outputs": (LawOutput(name="theta_1", unit="rad"), ALPHA)},
        ARM,
        {},
        "the law's theta_1 is in rad, and the rig's in rad, turning",
    ),
    "high": ({}, ARM, {"u_max_v": 4.0}, "limits are 0 to 5 V; the rig allows 0 to 4 V: narrow lo"),
    "low": ({}, ARM, {"u_min_v": 1.0}, "limits are 0 to 5 V; the rig allows 1 to 5 V"),
    "rest": ({"lo": 0.5}, ARM, {}, "0.5 to 5 V, and the rig rests at 0 V, which must lie between"),
}


@pytest.mark.parametrize(("changes", "rig", "run", "sentence"), BAD_RIGS.values(), ids=BAD_RIGS)
def test_a_law_of_another_rig_is_refused(
    changes: dict[str, Any], rig: Description, run: dict[str, float], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        _check(arm_law(**changes), rig, **run)


def test_a_law_within_the_limits_of_its_rig_is_accepted() -> None:
    _check(arm_law(hi=3.9), ARM, u_max_v=3.9)
    _check(_heater_law(hi=3.92), _q1(), u_max_v=5.0)

    with pytest.raises(InputError, match=r"0 to 5 V; the rig allows 0 to 3\.92 V"):
        _check(_heater_law(), _q1(), u_max_v=5.0)


def _q1() -> Description:
    return builtin("tclab")


def _heater_law(**changes: Any) -> ControlLaw:
    fields = {
        "input": "Q1",
        "outputs": (LawOutput(name="T1", unit="degC", y0=30.0),),
        "reference": Reference(name="T1", unit="degC", low=20.0, high=50.0),
        **{"A": (), "B": (), "C": (), "D": 0.05, "F": None, "x0": ()},
    }
    return arm_law(**{**fields, **changes})


def _check(
    law: ControlLaw,
    rig: Description,
    Ts_us: int = 10_000,
    u_min_v: float = 0.0,
    u_max_v: float = 5.0,
) -> None:
    law.check_rig(rig, Ts_us, u_min_v, u_max_v)
