"""The next line after each command, which the command line accepts."""

from __future__ import annotations

import re
import shlex
from functools import cache
from pathlib import Path
from typing import Any

import armrig
import pytest
import typer
from armrig.cli import app, main
from armrig.cli.next_step import (
    NEXT,
    counterpart,
    free_name,
    next_line,
    option_for_rig,
)
from armrig.excitation import telegraph
from armrig.recordings.files.origin import Origin
from armrig.rig.collection import Collected
from armrig_core.recording_file.manifest import Outcome
from armrig_core.rig.calibration import Calibration, Potentiometer

from tests.clients.made_recordings import manifest, of_the_arm, recorded, sample, written

VALUES: dict[str, Any] = {
    "answers": " --answers reasons.toml",
    "sinusoid": " --omega 5 --amplitude 2",
    "file": "F.mcap",
    "port": "/dev/ttyACM0",
    "estimation": "F.mcap",
    "validation": "F2.mcap",
    "files": " F.mcap F2.mcap",
    "model": "model.json",
    "design": "design.json",
    "options": "--structure oe --nb 4 --nf 4 --nk 1 --integrator",
    "validate": " --validate F2.mcap",
    "Ts": 0.005,
    "seconds": 30.0,
    "switching": " --a 0.005",
    "part": " --from 1",
    "rig": " --rig 2",
    "given": " --signal theta_1",
    "report": "report.pdf",
    "questions": "reasons.toml",
    "again": " --Ts 0.002 --at 1.8 --seconds 11 --name first-again",
}


@cache
def _command_line() -> Any:
    return typer.main.get_command(app())


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, three_recordings: Any) -> Path:
    """Give a folder with a telegraph's recording and its validation."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(folder))
    monkeypatch.chdir(tmp_path)
    put(folder, "blackbox", "0000000a", at="130000")
    of = {"validation_of": "0000000a"}
    put(folder, "blackbox-validation", "0000000b", at="130000", details=of)
    return folder


def put(
    folder: Path,
    experiment: str,
    run_id: str,
    at: str = "140000",
    outcome: str = "",
    calibration: Calibration = Calibration(),  # noqa: B008 - frozen
    **of: Any,
) -> None:
    """Write a recording of ten samples under the daemon's name for it."""
    about = manifest(experiment=experiment, run_id=run_id, **of)
    ended = {"outcome": Outcome(outcome=outcome, samples=10, missing=0)} if outcome else {}
    samples = [sample(k) for k in range(10)]
    data = recorded(samples, manifest=about, calibration=calibration, **ended)
    written(folder, data, f"1-{experiment}-20261120T{at}-{run_id}.mcap")


def report_of(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the arguments of the report that is proposed after an integration."""
    assert main(["integrate"]) == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("next: armrig report --handout ")
    return last.removeprefix("next: armrig report --handout ")


OPENED = {name for name, line in NEXT.items() if line.startswith("{opener}")}


@pytest.mark.parametrize("name", sorted(NEXT.keys() - OPENED))
def test_every_suggested_command_is_valid(name: str) -> None:
    words = shlex.split(NEXT[name].format(**VALUES))
    command = _command_line()

    assert words.pop(0) == "armrig"
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    command.make_context("armrig", words)  # raises where an option or a value is not taken


def test_the_report_uses_the_newest_step_pair_and_chassis_recordings(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(pair, "step-first", "0000000c")
    put(pair, "greybox-chassis", "0000000d")

    first = report_of(capsys)
    Path("report.pdf").touch()

    files = "@first @0000000a @0000000a/validation @chassis"
    assert first == f"{files} -o report.pdf"
    assert report_of(capsys) == f"{files} -o report-2.pdf"


@pytest.mark.parametrize(
    ("recorded_before", "expected"),
    [
        (None, "armrig lab --config chassis.toml"),
        ("greybox-chassis", "armrig greybox @chassis -o chassis.png"),
    ],
)
def test_the_next_command_records_the_chassis_without_the_arm(
    pair: Path,
    three_recordings: tuple[Path, ...],
    recorded_before: str | None,
    expected: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if recorded_before:
        put(pair, recorded_before, "0000000d")

    assert main(["check", str(three_recordings[1])]) == 0

    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == f"next: {expected}"
    assert any("remove the arm" in line for line in lines) == (recorded_before is None)


def test_the_next_command_after_the_chassis_is_the_integration(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = of_the_arm(telegraph(300, 0.05, seed=1), experiment="greybox-chassis")
    path = written(pair, data, "1-greybox-chassis-20261120T140000-0000000e.mcap")

    assert main(["check", str(path)]) == 0

    assert capsys.readouterr().err.splitlines()[-1] == "next: armrig integrate -o integrate.png"


def test_the_report_uses_complete_recordings_that_belong_together(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = [
        ("00000010", "step-first", "complete", {}),
        ("00000011", "step-again", "complete", {}),
        ("00000012", "step", "complete", {}),
        ("00000013", "step-late", "the rig tripped: stale", {}),
        ("00000014", "blackbox-fast", "stopped", {}),
        ("00000015", "blackbox-validation-fast", "complete", {"validation_of": "00000014"}),
        ("00000016", "blackbox-slow", "complete", {}),
        ("00000017", "blackbox-validation-slow", "complete", {"validation_of": "00000016"}),
    ]
    for second, (run_id, experiment, outcome, details) in enumerate(made):
        Ts = 0.02 if experiment == "blackbox-slow" else 0.01
        put(pair, experiment, run_id, f"1500{second:02}", outcome, details=details, Ts=Ts)

    assert report_of(capsys) == "@again @0000000a @0000000a/validation -o report.pdf"


def test_the_report_uses_recordings_of_one_calibration_and_the_answers(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = [
        ("00000020", "step-first", Calibration()),
        ("00000021", "step-again", Calibration(theta_1=Potentiometer(zero_counts=7.0))),
        ("00000022", "greybox-chassis", Calibration()),
    ]
    for second, (run_id, experiment, calibration) in enumerate(made):
        put(pair, experiment, run_id, f"1500{second:02}", calibration=calibration)
    Path("reasons.toml").touch()

    files = "@first @0000000a @0000000a/validation @chassis"
    assert report_of(capsys) == f"{files} --answers reasons.toml -o report.pdf"


def test_the_next_command_repeats_a_step_whose_rise_is_hidden(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import numpy as np

    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path))
    u = np.where(np.arange(500) < 100, 0.5, 4.5)
    for name, missing in (("hidden.mcap", slice(101, 105)), ("seen.mcap", slice(300, 304))):
        data = of_the_arm(u, experiment="step-first", missing=missing)
        assert main(["sampling", str(written(tmp_path, data, name))]) == 0
    hidden, seen = (x for x in capsys.readouterr().err.splitlines() if x.startswith("next: "))

    again = armrig.data_verdict(armrig.load(tmp_path / "hidden.mcap")).summary
    advised = re.search(r"Repeat with `(--at \S+ --seconds \d+)`", again)
    assert advised is not None
    wanted = f"next: armrig collect step --Ts 0.01 {advised[1]} --name first-again"
    assert hidden == wanted
    assert seen.startswith("next: armrig collect blackbox --Ts ")

    def collected(*_: object, **__: object) -> Collected:
        path = tmp_path / "hidden.mcap"
        verdict = armrig.data_verdict(armrig.load(path))
        return Collected(path, 500, 0.01, verdict, "0000000a", None)

    monkeypatch.setattr("armrig.rig.collection.collect", collected)
    assert main(["collect", "step", "--rig", "7", "--connect", "tcp/far:7447"]) == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == wanted.replace("step --Ts", "step --rig 7 --connect tcp/far:7447 --Ts")


def test_the_next_command_after_a_report_is_the_questions_then_the_answers(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "--questions", "reasons.toml"]) == 0

    fill, goes_on = capsys.readouterr().err.splitlines()
    assert fill == "fill in reasons.toml before the next command"
    files = "@0000000a @0000000a/validation --answers reasons.toml"
    assert goes_on == f"next: armrig report --handout {files} -o report.pdf"


@pytest.mark.parametrize(
    ("outcome", "Ts", "found"),
    [("complete", 0.01, True), ("stopped", 0.01, False), ("", 0.02, False)],
)
def test_a_pair_is_complete_and_has_one_sampling_time(
    pair: Path, outcome: str, Ts: float, *, found: bool
) -> None:
    next(pair.glob("*-validation-*")).unlink()
    of = {"validation_of": "0000000a"}
    put(pair, "blackbox-validation", "0000000c", outcome=outcome, details=of, Ts=Ts)
    [first, other] = (next(pair.glob(f"*{run_id}.mcap")) for run_id in ("0000000a", "0000000c"))

    names = ("@0000000a/validation", "@0000000a") if found else ("", "")
    assert (counterpart(first, "validation"), counterpart(other, "estimation")) == names


def test_the_report_uses_the_repetition_of_a_step(pair: Path) -> None:
    next(pair.glob("*-validation-*")).unlink()
    put(pair, "step-first", "0000000e")
    put(pair, "step-first-again", "0000000f")

    assert next_line("collect step", rig="") == "next: armrig sampling @first-again -o sampling.png"


@pytest.mark.parametrize(
    ("described", "wanted"),
    [
        (None, "plot @0000000a"),
        ("ab", "plot @0000000a"),
        ("cd", "collect blackbox --Ts 0.01 --seconds 30 --validation"),
    ],
)
def test_the_next_command_names_no_pair_of_another_rig(
    pair: Path, described: str | None, wanted: str
) -> None:
    for path in pair.iterdir():
        path.unlink()
    about: dict[str, Any] = {"description_sha256": "ab"}
    put(pair, "blackbox", "0000000a", at="130000", **about)
    details = {"validation_of": "0000000a"}
    put(pair, "blackbox-validation", "0000000b", at="130000", details=details, **about)
    origin = Origin(rig="1", description_sha256=described)
    asked: dict[str, Any] = {"Ts": 0.01, "seconds": 30, "switching": ""}

    assert next_line("collect pair", origin, **asked) == f"next: armrig {wanted}"


@pytest.mark.parametrize(
    ("described", "wanted"),
    [("ab", "sampling @first -o sampling.png"), ("cd", "collect step")],
)
def test_a_name_of_another_rig_is_not_given_again(pair: Path, described: str, wanted: str) -> None:
    for path in pair.iterdir():
        path.unlink()
    put(pair, "step-first", "0000000e", description_sha256="ab")

    found = next_line("collect step other", Origin(rig="1", description_sha256=described))

    assert found == f"next: armrig {wanted}"


def test_the_next_command_names_a_rig_and_endpoint_that_are_not_defaults() -> None:
    assert option_for_rig("1") == option_for_rig("1", None) == option_for_rig("1", "") == ""
    assert option_for_rig("7") == " --rig 7"
    assert option_for_rig("1", "tcp/a:1") == " --connect tcp/a:1"
    assert (
        option_for_rig("7", "unixsock-stream/my rig")
        == " --rig 7 --connect 'unixsock-stream/my rig'"
    )


def test_the_report_gets_the_first_unused_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = []
    for _ in range(3):
        found.append(free_name())
        Path(found[-1]).touch()
    Path("report.pdf").unlink()

    assert found == ["report.pdf", "report-2.pdf", "report-3.pdf"]
    assert free_name() == "report.pdf"
