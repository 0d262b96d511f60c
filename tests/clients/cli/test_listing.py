"""The table of `armrig ls`, for any folder and any file in it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.rig import live_rigs
from armrig.rig.live_rigs import LiveRig
from armrig_core.commands import StatusReport
from armrig_core.manifest import Outcome

from tests.clients.made_recordings import manifest, recorded, sample, written


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
    fields = dict.fromkeys(("reason", "owner", "version", "endpoint", "recordings"), "")
    fields |= {"u_min": 0.0, "u_max": 5.0, "device": {}, "host": {}, "last_run": None} | why
    rig = LiveRig(rig="7", endpoint="unix:x", status=StatusReport(rig="7", Ts=0.01, **fields))
    monkeypatch.setattr(live_rigs, "live_rigs", lambda _: ("unix:x", [rig]))

    assert main(["ls", "--live"]) == 0

    assert capsys.readouterr().out.splitlines()[1].split("  ")[-1].strip() == shown


def test_a_folder_that_is_named_is_listed_by_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """@NAME searches only the user's own folder."""
    synced = tmp_path / "from the lab"
    synced.mkdir()
    path = written(synced, recording(experiment="blackbox-monday"))
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path / "own"))

    assert main(["ls", str(synced)]) == 0
    told = capsys.readouterr()
    assert main(["ls", str(synced), "--json"]) == 0

    assert told.out.splitlines()[1].startswith(f"{path}  blackbox")
    assert told.err.splitlines() == [
        f"in {synced}",
        f"next: armrig info '{path}'",
    ]
    found = json.loads(capsys.readouterr().out)
    assert (found["folder"], found["recordings"][0]["recording"]) == (str(synced), str(path))


def test_each_recording_has_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a\nb.mcap", f"{'x' * 200}.mcap", "plain.mcap"):
        written(tmp_path, recording(experiment="y" * 3000), name)

    assert main(["ls", str(tmp_path)]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert any(line.startswith(rf"{tmp_path}/a\nb.mcap ") for line in lines)
    [plain] = [line for line in lines if "plain" in line]
    assert len(plain.removeprefix(str(tmp_path))) < 140


def test_an_outcome_has_a_column_of_its_own(
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
def test_a_name_that_is_no_text_is_reported_to_programs(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = os.fsdecode(bytes(tmp_path) + b"/a\xff.mcap")
    Path(path).write_bytes(recording())

    assert main([command, str(tmp_path) if command == "ls" else path, "--json"]) in (0, 1)

    found = json.loads(capsys.readouterr().out)
    if command == "verify":
        assert found["recording"] == f"{tmp_path}/a\\udcff.mcap"


def test_what_is_not_whole_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
