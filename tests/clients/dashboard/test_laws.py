"""Laws that a person chooses on the page, and the plans of their runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from armrig.dashboard.experiments import ExperimentRequest, plan_of, previewed
from armrig.dashboard.laws import law_rows, read_law
from armrig.excitation.reference import level_s
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference
from armrig_core.errors import ArmrigError
from armrig_core.rig.description import builtin
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon
from tests.core.control.laws import arm_law, arm_monitor

STATUS = FakeDaemon("there").status()
MONITORED = arm_law(monitor=arm_monitor(), hi=3.2, design={"method": "place"})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give a folder with a law, a law without a monitor, and files that are none of this rig."""
    heater = (LawOutput(name="T1", unit="degC"), LawOutput(name="alpha", unit="rad"))
    texts = {
        "good.json": MONITORED.text,
        "blind.json": arm_law().text,
        "heater.json": replace(MONITORED, outputs=heater).text,
        "input.json": replace(MONITORED, input="power").text,
        "model.json": b"{}",
        "noise.json": b"\xff\x00",
    }
    for name, text in texts.items():
        (tmp_path / name).write_bytes(text)
    (tmp_path / "late.json").symlink_to(tmp_path / "good.json")
    return tmp_path


def test_each_file_that_is_no_law_for_the_rig_has_its_reason(folder: Path) -> None:
    rows = {row["file"]: row for row in law_rows(folder, STATUS)}

    whys = {file: row["why"] for file, row in rows.items()}
    assert (whys["good.json"], whys["blind.json"]) == ("", "")
    assert whys["heater.json"].startswith("the law uses T1, and the rig has theta_1, alpha")
    assert whys["input.json"].startswith("the law drives power, and the rig's input is u")
    assert whys["model.json"] == "no control law: Object missing required field `Ts_us`"
    assert whys["noise.json"].startswith("no control law: ")
    assert "there is no such file" in whys["late.json"]
    good = rows["good.json"]
    assert (good["method"], good["levels"], good["monitored"]) == ("place", (2.0, 4.0), True)
    assert good["reference"] == Reference(name="velocity", unit="rad/s", low=0.0, high=8.0)
    assert not rows["blind.json"]["monitored"]


def test_a_law_whose_sampling_time_the_rig_cannot_have_has_its_reason(folder: Path) -> None:
    """The rig may be blind for 1 s, so its samples are at most 0.2 s apart."""
    text = builtin("heater").text.decode()
    assert "blind_s = 10" in text
    blind = replace(STATUS, description=text.replace("blind_s = 10", "blind_s = 1"))
    slow = ControlLaw(
        Ts_us=500_000,
        input="power",
        outputs=(LawOutput(name="T1", unit="degC"),),
        reference=Reference(name="T1", unit="degC", low=20.0, high=60.0),
        A=(),
        B=(),
        C=(),
        D=0.1,
        x0=(),
    )
    (folder / "slow.json").write_bytes(slow.text)

    (why,) = [row["why"] for row in law_rows(folder, blind) if row["file"] == "slow.json"]

    assert why.startswith("the law has Ts = 0.5 s, and the run ")


@pytest.mark.parametrize("file", ["../good.json", "good.txt", "none.json", "", "late.json"])
def test_no_other_file_is_read(folder: Path, file: str) -> None:
    (folder / "good.txt").write_bytes(MONITORED.text)

    with pytest.raises(ArmrigError, match="there is no such file"):
        read_law(folder, file)


def test_a_plan_in_control_is_that_of_the_command(folder: Path) -> None:
    plan = plan_of(
        ExperimentRequest(
            kind="control", law="good.json", reference="staircase", levels=3, name="x"
        ),
        "Ada",
        folder,
    )

    seconds = level_s(MONITORED)
    assert seconds
    assert (plan.experiment, plan.law, plan.unmonitored) == ("control-x", MONITORED, False)
    assert (plan.Ts, plan.pacing, plan.dead_man, plan.owner) == (0.01, "exchange", 1.0, "Ada")
    assert plan.seconds == pytest.approx(5 * seconds)
    assert plan.details == {"reference": "staircase", "low": 2.0, "high": 4.0, "levels": 3}
    assert plan.make(5, 0.01).tolist() == [2, 3, 4, 3, 2]


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ({"law": "blind.json", "seconds": 2.0}, "type unmonitored to allow this law"),
        ({"law": "blind.json", "seconds": 2.0, "word": "yes"}, "type unmonitored"),
        ({"law": "blind.json", "word": "unmonitored"}, "the law has no model of the plant"),
        ({"law_sha256": "00"}, "good.json has changed since it was shown: choose the law again"),
        ({"r_high": 9.0}, "the law allows 0 to 8"),
        ({"r_low": 4.0, "r_high": 3.0}, "must be above the lowest level, 4 rad/s"),
        ({"Ts": 0.02}, "the law has Ts = 0.01 s"),
        ({"law": "heater.json"}, "design the law for these outputs"),
    ],
)
def test_a_run_in_control_is_refused_in_its_preview(
    folder: Path, asked: dict[str, Any], why: str
) -> None:
    experiment = ExperimentRequest(**{"kind": "control", "law": "good.json"} | asked)

    with pytest.raises(ArmrigError, match=why):
        previewed(experiment, STATUS, STATUS.described, folder)


def test_the_word_allows_a_law_without_a_monitor(folder: Path) -> None:
    asked = ExperimentRequest(kind="control", law="blind.json", seconds=2.0, word="unmonitored")

    assert plan_of(asked, "Ada", folder).unmonitored


def test_the_preview_of_a_run_in_control_is_its_reference(folder: Path) -> None:
    sha256 = MONITORED.sha256
    asked = ExperimentRequest(kind="control", law="good.json", seconds=0.04, law_sha256=sha256)

    found = previewed(asked, STATUS, STATUS.described, folder)

    assert (found.N, found.Ts, found.reference) == (4, 0.01, MONITORED.reference)
    assert found.curve[1] == [2, 2, 4, 4]
    assert (
        found.rehearsal == "not rehearsed here: the daemon rehearses the closed loop at the start"
    )


def test_a_file_that_cannot_be_read_has_its_reason(folder: Path) -> None:
    os.truncate(folder / "model.json", 1 << 19)

    (why,) = [row["why"] for row in law_rows(folder, STATUS) if row["file"] == "model.json"]

    assert "more than the 262144 B allowed" in why
