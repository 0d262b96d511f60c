"""The commands check, greybox, split, simulate and integrate: good input, bad input, JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from armrig.cli import main


def facts(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> Any:
    """Return the command's JSON output."""
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the command's output for a person."""
    assert main(arguments) == 0
    return capsys.readouterr().out


def test_the_matrices_say_of_which_parameters_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert said(["model"], capsys).startswith("A and B with the parameters of the handout:\n")
    changed = said(["model", "--set", "J_1=0.0034", "--set", "K_lin=2.38"], capsys)
    assert changed.startswith("A and B with J_1=0.0034, K_lin=2.38:\n")
    table = changed.partition("A step of 1 V")[0]
    assert max(map(len, table.splitlines())) <= 80


def test_check_finds_no_feedback_and_no_delay(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The level is 0.1 %, because p is 0.009 for this recording."""
    recording, figure = str(three_recordings[1]), tmp_path / "check.png"
    arguments = ["check", recording, "--level", "0.001"]

    text = said([*arguments, "--verbose", "--plot", str(figure)], capsys)
    found = facts(arguments, capsys)

    assert found["open_loop"]["feedback"] is False
    assert found["open_loop"]["p_value"] >= 0.001
    assert (found["delay"]["nk"], found["delay"]["delay"]) == (1, 0)
    assert found["delay"]["integrator"] is True
    assert "the data do not contradict open loop" in text
    assert "no input delay" in text
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_greybox_gives_the_parameters_of_the_arm(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Within three deviations of the handout's."""
    arguments = ["greybox", str(three_recordings[1]), "--free", "J_1"]  # alpha selects the model
    arguments += ["--free", "J_2"]

    text = said(arguments, capsys)
    J = facts(arguments, capsys)["parameters"]

    for name, truth in (("J_1", 1.7e-3), ("J_2", 4.8e-3)):
        assert abs(J[name]["value"] - truth) < 3 * J[name]["std"] < 0.02 * truth
        assert J[name]["unit"] == "kg m²"
        assert f"{J[name]['value']:.5g}" in text


def test_split_gives_each_part_and_the_law(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The exponent of the deviation against N is -1/2."""
    arguments = ["split", str(three_recordings[1]), "--model", "arm", "--parts", "1,2"]

    text = said([*arguments, "-v"], capsys)
    found = facts(arguments, capsys)

    assert [s["parts"] for s in found["splits"]] == [1, 2]
    assert len(found["splits"][1]["values"]) == 2
    assert found["exponent"] == pytest.approx(-0.5, abs=0.1)
    assert "half the information" in text


def test_simulate_holds_the_physics_against_a_recording(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    recording = str(three_recordings[1])

    right = facts(["simulate", recording], capsys)["models"]
    wrong = facts(["simulate", recording, "--set", "K_lin=1.4"], capsys)["models"]

    assert [m["model"] for m in right] == ["physics"]
    assert [m["model"] for m in wrong] == ["handout", "K_lin=1.4"]
    assert right[0]["rms_error"] == wrong[0]["rms_error"] < 0.006 < wrong[1]["rms_error"]
    assert right[0]["figures"]["antiresonance"]["value"] == pytest.approx(15.74, abs=0.02)


@pytest.mark.exhaustive
def test_simulate_takes_saved_models_too(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import armrig

    data = armrig.load(three_recordings[1]).dataset()
    armrig.oe(data, nb=4, nf=4, integrator=True).save(tmp_path / "mine.json")
    arguments = ["simulate", str(three_recordings[2]), "--model", str(tmp_path / "mine.json")]

    text = said([*arguments, "-v"], capsys)

    assert [m["model"] for m in facts(arguments, capsys)["models"]] == ["mine", "physics"]
    assert "anti-resonance [rad/s]" in text
    assert "mine and physics" in text


def test_simulate_without_a_recording_answers_a_step(capsys: pytest.CaptureFixture[str]) -> None:
    assert facts(["simulate"], capsys)["steady_speed"] == pytest.approx(1.8623, abs=1e-4)
    other = facts(["simulate", "--set", "N=32"], capsys)["steady_speed"]
    assert other == pytest.approx(2 * 1.8623, abs=2e-4)
    assert "initial slope 98.40" in said(["simulate"], capsys)
    assert "no back-EMF" in said(["simulate", "-v"], capsys)


def test_integrate_separates_stable_from_unstable(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A step on either side of AB(2)'s limit; the trapezoidal rule has none."""
    figure = tmp_path / "solution.png"
    arguments = ["integrate", "--h", "0.02", "--h", "0.04", "--method", "ab2"]
    arguments += ["--method", "trapezoidal"]

    text = said([*arguments, "--plot", str(figure)], capsys)
    rows = facts(arguments, capsys)["rows"]

    assert [row["stable"] for row in rows] == [True, False, True, True]
    assert rows[1]["error"] > 1 > rows[0]["error"]
    assert rows[2]["limit"] is None
    assert text.count("UNSTABLE") == 1
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_integrate_recommends_a_step_for_each_method(capsys: pytest.CaptureFixture[str]) -> None:
    found = facts(["integrate", "--tolerance", "0.01", "--span", "1"], capsys)

    assert len(found["rows"]) == 5
    assert all(row["stable"] and row["error"] <= 0.01 for row in found["rows"])


@pytest.mark.parametrize(("volts", "told"), [("2.5", False), ("20", True), ("-2.6", True)])
def test_an_amplitude_that_no_rig_takes_is_reported_as_simulated(
    volts: str, told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """The amplitude is allowed: assignment 4 integrates a model and plays nothing."""
    step = ["--h", "0.02", "--method", "ab2"]

    assert main(["integrate", "--amplitude", volts, *step]) == 0

    said = (
        f"--amplitude {volts}: the sinusoid is only simulated, never played; the rig takes 0 to 5 V"
    )
    assert (said in capsys.readouterr().err) == told


@pytest.mark.parametrize(
    ("arguments", "message", "code"),
    [
        (["check", "F", "--level", "2"], "level=2.0 must lie between 0 and 1", 1),
        (["check", "nothing.mcap"], "nothing.mcap: No such file", 1),
        (["check", "F", "--plot", "F"], "is an input file", 1),
        (["check", "F", "--plot", "a.xyz"], "a.xyz: the name of a figure ends in one of", 1),
        (["greybox", "F", "--plot", "F"], "is an input file", 1),
        (["split", "F", "--plot", "F"], "is an input file", 1),
        (["simulate", "F", "--plot", "F"], "is an input file", 1),
        (["greybox", "F", "--free", "J_9"], "free='J_9' is none of J_1", 1),
        (["greybox", "F", "--model", "chassis"], "alpha moves: the arm was attached", 1),
        (["greybox", "F", "--set", "J_1"], "--set J_1: give NAME=VALUE", 2),
        (["split", "F", "--parts", "1,x"], "--parts '1,x': give whole numbers", 2),
        (["split", "F", "--parts", "0"], "parts=0 must be an integer >= 1", 1),
        (["simulate", "--set", "J_2=-1"], "J_2=-1.0 must be finite and > 0", 1),
        (["simulate", "--model", "m.json"], "--model needs a recording", 2),
        (["integrate", "--method", "rk4"], "method='rk4' is none of forward_euler", 1),
        (["integrate", "--h", "0"], "--h 0: a step is > 0", 2),
        (["integrate", "--h", "1e-9"], "at most 2000000", 2),
        (["integrate", "--omega", "-1"], "omega=-1.0 must be finite and > 0", 1),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else None,
)
def test_what_cannot_be_done_is_reported_in_one_line(
    arguments: list[str],
    message: str,
    code: int,
    three_recordings: tuple[Path, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    recording = three_recordings[1]
    before = recording.read_bytes()

    assert main([str(recording) if x == "F" else x for x in arguments]) == code

    told = capsys.readouterr()
    assert told.out == ""
    assert message in told.err
    assert told.err.count("\n") == 1
    assert recording.read_bytes() == before
