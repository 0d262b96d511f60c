"""Recordings by name: `@last`, `@NAME`, `@NAME/validation`, and the list of `armrig ls`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.cli.recorded_data import load_recordings
from armrig.cli.results import write_plot
from armrig.plots.captions import sign
from armrig.recordings.files.recording_names import answering_among, path_of_name, short_name
from armrig.recordings.files.recording_summary import summary_of
from armrig_core.recording_file.manifest import Outcome
from matplotlib.figure import Figure

from tests.clients.made_recordings import manifest, recorded, sample, written

BEGUN = {
    "step": ("13:00:00", "0000000a", {}),
    "blackbox-monday": ("13:10:00", "0000000b", {}),
    "blackbox-validation-monday": ("13:20:00", "0000000c", {"validation_of": "0000000b"}),
    "blackbox": ("13:30:00", "0000000d", {}),
    "blackbox-validation": ("13:40:00", "0000000e", {"validation_of": "0000000d"}),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a folder of five recordings; one more is being written."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(folder))
    for experiment in BEGUN:
        put(folder, experiment)
    data = of_run("step", "0000000f", "14:00:00", {})
    written(folder, data[:-30], "1-step-20261120T140000-0000000f.mcap.active")
    return folder


def put(folder: Path, experiment: str, **other: str) -> Path:
    """Write a recording of an experiment under the daemon's name for it, and return its path."""
    at, run_id, details = BEGUN[experiment]
    at, run_id = other.get("at", at), other.get("run_id", run_id)
    stamp = f"20261120T{at.replace(':', '')}"
    data = of_run(experiment, run_id, at, details)
    return written(folder, data, f"1-{experiment}-{stamp}-{run_id}.mcap")


def of_run(
    experiment: str, run_id: str, at: str, details: dict[str, str], outcome: str = "complete"
) -> bytes:
    """Return a recording of ten samples, two of which are missing."""
    about = manifest(
        experiment=experiment,
        run_id=run_id,
        started=f"2026-11-20T{at}+01:00",
        details=details,
    )
    ended = Outcome(outcome=outcome, samples=8, missing=2)
    return recorded([sample(k) for k in range(8)], manifest=about, outcome=ended)


def read(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the id of the run that `armrig info` reads for a name."""
    assert main(["info", name, "--json"]) == 0
    return str(json.loads(capsys.readouterr().out)["manifest"]["run_id"])


@pytest.mark.parametrize(
    ("name", "run_id"),
    [
        ("@last", "0000000e"),
        ("@monday", "0000000b"),
        ("@blackbox-monday", "0000000b"),
        ("@monday/validation", "0000000c"),
        ("@0000000b/validation", "0000000c"),
        ("@blackbox", "0000000d"),
        ("@blackbox/validation", "0000000e"),
        ("@step", "0000000a"),
        ("@0000000c", "0000000c"),
        ("@1-step-20261120T130000-0000000a", "0000000a"),
    ],
)
def test_a_recording_can_be_selected_by_several_names(
    folder: Path, name: str, run_id: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert read(name, capsys) == run_id


def test_the_name_last_means_the_newest_complete_file(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written(folder, b"\x89MCAP0\r\nrest", "1-step-20261120T150000-00000010.mcap")
    old = folder / "1-step-20261120T130000-0000000a.mcap"
    old.touch()  # the newest to the file system

    assert read("@last", capsys) == "0000000e"


def test_a_name_prefers_a_complete_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for run_id, experiment in (("aaaaaaa1", "blackbox-monday"), ("aaaaaaa2", "step-cut")):
        data = of_run(experiment, run_id, "12:01:00", {}, outcome="stopped by A")
        written(folder, data, f"1-{experiment}-20261120T120100-{run_id}.mcap")

    assert read("@monday", capsys) == "0000000b"
    assert read("@cut", capsys) == "aaaaaaa2"
    assert main(["ls"]) == 0
    assert re.search(r"^@monday +blackbox", capsys.readouterr().out, re.MULTILINE)


def test_an_ambiguous_name_is_refused_with_the_list(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for n in range(1, 6):
        put(folder, "blackbox-monday", at=f"12:0{n}:00", run_id=f"aaaaaaa{n}")

    assert main(["identify", "@monday", "--structure", "arx"]) == 1

    told = capsys.readouterr().err
    assert "@monday may be any of 6 recordings, newest first: @0000000b, blackbox monday" in told
    assert "; @aaaaaaa5" in told
    assert "and 2 older ones" in told


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "@x"],
        ["replay", "@x"],
        ["identify", "@x", "--structure", "arx"],
        ["identify", "data.csv", "--structure", "arx", "--validate", "@x"],
        ["validate", "@x", "--model", "model.json"],
        ["compare", "@x", "F2"],
        ["compare", "F.mcap", "@x"],
        ["check", "@x"],
        ["greybox", "@x"],
        ["split", "@x"],
        ["simulate", "@x"],
        ["report", "@x"],
        ["calibrate", "--rest", "@x"],
        ["calibrate", "--turns", "@x"],
    ],
)
def test_every_command_with_a_recording_argument_accepts_a_name(
    folder: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1

    assert "@x: no finished recording in" in capsys.readouterr().err


def test_the_short_name_of_a_recording_is_unique(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    again = put(folder, "blackbox-monday", at="15:00:00", run_id="00000010")
    alone = put(tmp_path / "other", "step")
    known = [summary_of(path) for path in sorted(folder.glob("*.mcap"))]

    shown = {s.run_id: short_name(s, answering_among(known)) for s in known}

    assert shown == {
        "0000000a": "@0000000a",
        "0000000b": "@0000000b",
        "0000000c": "@monday/validation",
        "0000000d": "@0000000d",
        "0000000e": "@0000000d/validation",
        "00000010": "@00000010",
    }
    again.unlink()
    known = [s for s in known if s.path != again]
    [monday] = [s for s in known if s.run_id == "0000000b"]
    assert short_name(monday, answering_among(known)) == "@monday"
    assert short_name(summary_of(alone), answering_among(known)) == str(alone)


def test_the_folder_of_recordings_comes_from_the_configuration(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.delenv("ARMRIG_RECORDING_DIRECTORY")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "config" / "armrig").mkdir(parents=True)
    file = tmp_path / "config" / "armrig" / "armrig.toml"

    file.write_text(f'[recording]\ndirectory = "{folder}"\n[limits]\nu_max_v = 4.5\n')
    assert read("@last", capsys) == "0000000e"

    file.write_text("[recording]\ndirectory = 5\n")
    assert main(["info", "@last"]) == 1
    assert f"{file}: [recording] directory must be the path of" in capsys.readouterr().err


def test_ls_shows_the_estimation_recording_that_a_recording_validates(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ls"]) == 0
    plain = capsys.readouterr().out
    put(folder, "blackbox-validation", at="15:00:00", run_id="00000010")
    assert main(["ls"]) == 0
    named = capsys.readouterr().out.splitlines()
    next(folder.glob("*-0000000d.mcap")).unlink()
    assert main(["ls"]) == 0

    assert "validates" not in plain
    assert named[0].endswith("  started           validates")
    shown = {line.split()[0]: line.split()[-1] for line in named[1:]}
    assert (shown["@00000010"], shown["@0000000e"]) == ("@0000000d", "@0000000d")
    unknown = [line for line in capsys.readouterr().out.splitlines() if "not known" in line]
    assert [line.split()[0] for line in unknown] == ["@00000010", "@0000000e"]


@pytest.mark.parametrize(
    ("kind", "outcome", "said"),
    [
        ("step", "complete", "@first is already a complete recording; give another name"),
        ("blackbox", "complete", "give another name, such as --name first-3"),
        ("step", "stopped", "no reply from rig 1"),
    ],
)
def test_a_name_in_use_is_refused_before_connecting(
    kind: str,
    outcome: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path))
    for run_id, name in (("0000000a", "first"), ("0000000b", "first-2")):
        about = manifest(experiment=f"{kind}-{name}", run_id=run_id)
        ended = Outcome(outcome=outcome, samples=10, missing=0)
        data = recorded([sample(k) for k in range(10)], manifest=about, outcome=ended)
        written(tmp_path, data, f"1-{kind}-{name}-20261120T140000-{run_id}.mcap")
    nowhere = f"unixsock-stream/{tmp_path}/no.sock"

    assert main(["collect", "step", "--name", "first", "--connect", nowhere]) == 1

    told = capsys.readouterr().err
    assert said in told
    assert ("no reply" in told) == (outcome == "stopped")


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        ("@monday", "@monday: blackbox, 0.1 s, 2026-11-20 13:10:00"),
        (
            "@monday/validation",
            "@monday/validation: blackbox (validation), 0.1 s, 2026-11-20 13:20",
        ),
        ("@0000000b", "@0000000b is @monday, blackbox, 0.1 s, 2026-11-20 13:10:00"),
        ("@last", "@last is @0000000d/validation, blackbox (validation), 0.1 s, 2026"),
    ],
)
def test_an_answer_has_one_name_for_a_recording(
    folder: Path, typed: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", typed]) == 0

    first, *_, last = capsys.readouterr().err.splitlines()
    assert first.startswith(line)
    name = line.partition(" is ")[2].partition(",")[0] or typed
    assert last == f"next: armrig plot {name}"


def test_a_warning_and_a_figure_have_the_name_of_the_command_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = Figure().add_subplot()

    [recording] = load_recordings([path_of_name("@monday")], None)
    write_plot(folder / "a.svg", data=lambda ax: sign(drawn, recording.sha256))

    assert "armrig: @monday has 8 samples" in capsys.readouterr().err
    assert drawn.get_title("right") == "recording @monday"
