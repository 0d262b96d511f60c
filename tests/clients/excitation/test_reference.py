"""References of runs in control: levels, files, dither and lengths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from armrig.excitation.reference import level_s, profile_of, reference_of
from armrig_core.control.control_law import ControlLaw, LawOutput, Monitor, Reference
from armrig_core.errors import ArmrigError

LAW = ControlLaw(
    Ts_us=1_000_000,
    outputs=(LawOutput(name="T1", unit="degC"),),
    reference=Reference(name="T1", unit="degC", low=20.0, high=60.0),
    A=(),
    B=(),
    C=(),
    D=1.0,
    x0=(),
)


def monitored(pole: float, *, delay: int = 0, prelude: int = 50) -> ControlLaw:
    monitor = Monitor(
        A=((pole, 0.1), (0.0, 1.0)),
        B=(1.0, 0.0),
        C=((1.0, 0.0),),
        L=((0.1,), (0.0,)),
        x0=(0.0, 0.0),
        deviations=(0.1,),
        settling=(True,),
        input_delay=delay,
        prelude=prelude,
        forward=(1.0, 0.0),
    )
    fields = {name: getattr(LAW, name) for name in LAW.__struct_fields__}
    return ControlLaw(**{**fields, "monitor": monitor})


def test_a_step_goes_from_a_quarter_to_the_half_of_the_range() -> None:
    profile = profile_of(LAW, "step")

    assert profile[:3] == ("step", 30.0, 40.0)
    assert reference_of(profile, 5, 1.0, "degC").tolist() == [30, 30, 40, 40, 40]
    assert reference_of(profile, 5, 1.0, "degC", at=4.0).tolist() == [30, 30, 30, 30, 40]


def test_a_staircase_goes_up_and_down() -> None:
    profile = profile_of(LAW, "staircase", low=20.0, high=60.0, levels=3)

    r = reference_of(profile, 10, 1.0, "degC")

    assert r.tolist() == [20, 20, 40, 40, 60, 60, 40, 40, 20, 20]


def test_a_dither_switches_around_the_level() -> None:
    profile = profile_of(LAW, "step", low=30.0, high=40.0, dither=0.5, seed=3)

    r = reference_of(profile, 400, 1.0, "degC")

    assert set(r) == {29.5, 30.5, 39.5, 40.5}
    assert np.array_equal(r, reference_of(profile, 400, 1.0, "degC"))


@pytest.mark.parametrize("head", ["", "r\n", "t,r\n"])
def test_a_file_has_its_own_length(head: str, tmp_path: Path) -> None:
    rows = ["0,21", "1,22.5", "2,23"] if "t" in head else ["21", "22.5", "23"]
    file = tmp_path / "r.csv"
    file.write_text(head + "\n".join(rows) + "\n")

    profile = profile_of(LAW, str(file))

    assert reference_of(profile, 0, 1.0, "degC").tolist() == [21, 22.5, 23]


def test_times_of_a_file_that_are_not_those_of_the_law_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.csv"
    file.write_text("t,r\n0,21\n2,22\n")

    with pytest.raises(ArmrigError, match="t=2 s, but Ts=1 s gives 1 s"):
        reference_of(profile_of(LAW, str(file)), 0, 1.0, "degC")


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"low": 10.0}, "the law allows 20 to 60"),
        ({"high": 60.0, "dither": 1.0}, "the law allows 20 to 60"),
        ({"low": 40.0, "high": 40.0}, "high 40 degC: must be above the lowest level, 40 degC"),
        ({"dither": -1.0}, "must be 0 or more"),
        ({"dither": float("nan")}, "must be 0 or more"),
    ],
)
def test_levels_outside_the_range_of_the_law_are_refused(
    options: dict[str, float], error: str
) -> None:
    with pytest.raises(ArmrigError, match=error):
        profile_of(LAW, "step", **options)


def test_levels_with_a_file_are_refused() -> None:
    with pytest.raises(ArmrigError, match=r"--low and --high with the file r\.csv"):
        profile_of(LAW, "r.csv", low=30.0)


def test_a_level_lasts_five_time_constants_of_the_plant() -> None:
    slow = level_s(monitored(np.exp(-1 / 175), delay=15))
    fast = level_s(monitored(0.5))
    prelude = level_s(monitored(0.5, prelude=200))

    assert slow == pytest.approx(5 * 175 + 15)
    assert fast == 150.0
    assert prelude == 400.0
    assert level_s(LAW) is None
