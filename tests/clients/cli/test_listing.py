"""The table of `armrig ls`, for any folder and any file in it; notes and ends in `armrig info`."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.rig import status
from armrig.rig.status import LiveRig
from armrig_core.recording_file.manifest import Outcome

from tests.clients.fake_daemon import status_report
from tests.clients.made_recordings import manifest, note, recorded, sample, written


def recording(**changes: object) -> bytes:
    """Return a recording."""
    return recorded([sample(k) for k in range(3)], manifest=manifest(**changes))


@pytest.mark.parametrize(
    ("why", "shown"),
    [
        ({"phase": "fault", "reason": "the port is gone"}, "the port is gone"),
        ({"phase": "init", "line": "no rig is connected"}, "no rig is connected"),
    ],
)
def test_a_rig_is_listed_with_the_reason_of_its_fault_or_its_silence(
    why: dict[str, str],
    shown: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rig = LiveRig(rig="7", endpoint="unix:x", status=status_report(**why))
    monkeypatch.setattr(status, "live_rigs", lambda _: ("unix:x", [rig]))

    assert main(["ls", "--live"]) == 0

    assert capsys.readouterr().out.splitlines()[1].split("  ")[-1].strip() == shown


def test_each_recording_has_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a\nb.mcap", f"{'x' * 200}.mcap", "plain.mcap"):
        written(tmp_path, recording(experiment="y" * 3000), name)

    assert main(["ls", str(tmp_path)]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert any(line.startswith(rf"{tmp_path}/a\nb.mcap ") for line in lines)
    [plain] = [line for line in lines if "plain" in line]
    assert len(plain.removeprefix(str(tmp_path))) < 140


def test_the_list_has_a_column_for_the_outcome(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path, recording(), "whole.mcap")

    assert main(["ls", str(tmp_path)]) == 0
    whole = capsys.readouterr().out.splitlines()
    ended = Outcome(outcome="stopped by bob", samples=1, missing=0)
    written(tmp_path, recorded([sample(0)], outcome=ended), "ended.mcap")
    assert main(["ls", str(tmp_path)]) == 0

    assert whole[0].endswith("started")
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.endswith("  outcome")
    assert sorted(row.rpartition("  ")[2] for row in rows) == ["complete", "stopped by bob"]


@pytest.mark.skipif(sys.platform == "win32", reason="names are text there")
@pytest.mark.parametrize("command", ["verify", "info", "ls"])
def test_a_file_name_that_is_not_text_is_escaped_in_json(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = os.fsdecode(bytes(tmp_path) + b"/a\xff.mcap")
    Path(path).write_bytes(recording())

    assert main([command, str(tmp_path) if command == "ls" else path, "--json"]) in (0, 1)

    found = json.loads(capsys.readouterr().out)
    if command == "verify":
        assert found["recording"] == f"{tmp_path}/a\\udcff.mcap"


def test_the_list_names_damaged_recordings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(5):
        written(tmp_path, recording()[:5000], f"{i}.mcap")

    assert main(["ls", str(tmp_path)]) == 0

    assert "and 2 more; `armrig info FILE` shows the damage" in " ".join(
        capsys.readouterr().err.split()
    )


def test_a_recording_whose_name_begins_with_an_at_sign_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path, recording(), "@last.mcap")
    monkeypatch.chdir(tmp_path)

    assert main(["info", "./@last.mcap"]) == 0

    assert "@last.mcap" in capsys.readouterr().out


def test_notes_are_listed_with_their_times_and_authors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    notes = [note(k, f"touched #{k}") for k in range(12)]
    path = str(written(tmp_path, recorded([*(sample(k) for k in range(40)), *notes])))

    assert main(["info", path]) == 0
    brief = capsys.readouterr().out
    assert main(["info", path, "--verbose"]) == 0
    full = capsys.readouterr().out

    assert re.search(r"^note +at 0\.09 s, Ada: touched #9\nnote +2 more; --verbose", brief, re.M)
    assert brief.count("touched") == 10
    assert re.search(r"^note +at 0\.11 s, Ada: touched #11$", full, re.M)


def test_info_distinguishes_a_cut_file_from_a_stopped_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = {"manifest": manifest(samples=40, k_first=0), "flush_every": 10}
    whole = recorded([sample(k) for k in range(40)], **run, outcome_first=True)
    left = recorded([sample(k) for k in range(40)], **run, outcome=None)

    assert main(["info", str(written(tmp_path, whole[:-200]))]) == 0
    of_whole = capsys.readouterr().out
    assert main(["info", str(written(tmp_path, left[:-400], "run.mcap.active"))]) == 0
    of_left = capsys.readouterr().out

    assert "of the run: complete; but the file is cut off" in of_whole
    assert re.search(r"samples +\d+ at 0.01 s, 0 missing", of_whole)
    assert "s of 0.4 s" in of_whole
    assert "the file is cut off before the outcome, or is still being written" in of_left
