"""Checks and attachments of a planned run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_core.commands.commands import LastRun, RunRequest
from armrig_core.commands.rehearsal import rehearse
from armrig_daemon.config import ArmSettings, Config, Limits
from armrig_daemon.service.host.host_facts import check_directory
from armrig_daemon.service.runs import Runs

from tests.daemon.service.opened_run import open_run

REQUEST = RunRequest(lease="a" * 32, n=1, u=[0.0] * 10 + [4.0] * 90)


def _runs(directory: Path, config: Config) -> Runs:
    return Runs(config, directory, lambda: None)


@pytest.mark.parametrize(
    ("limits", "complaint"),
    [
        (Limits(revolutions=0.1), r"theta_1\.turns = 0.1 is reached at u\["),
        (Limits(alpha_rad=0.01), r"alpha\.low = -0.01 is reached at u\[10\]"),
        (Limits(u_max_v=3.0), r"u\[10\]=4 V is outside 0 … 3 V"),
        (Limits(slew_v=1.0), r"u\[10\] steps by 4 V: at most 1 V"),
    ],
)
def test_an_input_outside_a_limit_is_refused_and_nothing_is_planned(
    limits: Limits, complaint: str, tmp_path: Path
) -> None:
    runs = _runs(tmp_path, Config(limits=limits))

    for _ in range(2):
        with pytest.raises(ValueError, match=complaint):
            open_run(runs, REQUEST, 0.01)
    assert runs.last is None


def test_the_reply_contains_the_rehearsal_on_the_configured_rig(tmp_path: Path) -> None:
    arm = ArmSettings(J_2=0.01)

    _, answer = open_run(_runs(tmp_path, Config(arm=arm)), REQUEST, 0.02, start_rad=1.0)

    expected = rehearse(REQUEST.u, 0.02, parameters=arm.parameters(), theta_1_rad=1.0)
    assert answer.rehearsal == expected
    assert expected != rehearse(REQUEST.u, 0.02, theta_1_rad=1.0)


def test_a_rig_without_its_arm_has_no_predicted_deflection(tmp_path: Path) -> None:
    config = Config(arm=ArmSettings(removed=True), limits=Limits(alpha_rad=0.001))

    _, answer = open_run(_runs(tmp_path, config), REQUEST, 0.01)

    assert answer.rehearsal is not None
    assert answer.rehearsal.alpha_rad == 0.0


@pytest.mark.parametrize(
    ("error", "moved", "disturbed"),
    [
        ("", "", ""),
        ("", "it was moved away", "it was moved away"),
        ("the disk is full", "it was moved", "the disk is full"),
    ],
)
def test_the_state_of_the_current_recording_is_reported(
    error: str, moved: str, disturbed: str, tmp_path: Path
) -> None:
    runs = Runs(Config(), tmp_path, lambda: None)
    recording: Any = SimpleNamespace(
        **{"kept": tmp_path / "a.mcap.active", "samples": 9, "synced": 4, "error": error},
        **{"moved": moved, "look": lambda: None},
    )
    runs._recording = recording
    runs._last = LastRun(run_id="r", recording="", finished=False, samples=0, outcome="")

    ending = runs.recording_failure()
    assert (ending.text if ending else "") == disturbed
    if ending is not None:
        code = OutcomeCode.RECORDING if disturbed == error else OutcomeCode.MOVED
        assert ending.code == code
    assert runs.last is not None
    assert (runs.last.samples, runs.last.synced) == (9, 4)
    assert runs.run_id == "r"


@pytest.mark.parametrize(("synced", "has_lost"), [(9, False), (4, True)])
def test_the_state_counts_recordings_that_lost_samples(
    synced: int, has_lost: bool, tmp_path: Path
) -> None:
    """The exit code of the daemon reports it; a disk is looked at without a report of its own."""
    runs = Runs(Config(), tmp_path, lambda: None)
    recording: Any = SimpleNamespace(
        **{"kept": tmp_path / "a.mcap.active", "samples": 9, "synced": synced},
        **{"error": "", "done": False},
    )

    def look() -> None:
        recording.error, recording.done = "the disk did not answer", True

    recording.look = look
    runs._finishing = recording
    runs._last = LastRun(run_id="r", recording="", finished=False, samples=0, outcome="")

    assert runs.completion_line() == ("error", "the disk did not answer")
    assert runs.has_lost == has_lost
    assert runs.is_idle
    last = runs.last
    assert last is not None
    assert (last.outcome, last.samples) == ("the disk did not answer", synced)
    assert (last.code, last.finished, last.is_complete) == (OutcomeCode.RECORDING, True, False)


def test_a_directory_without_room_is_reported_before_the_run(tmp_path: Path) -> None:
    assert check_directory(tmp_path / "new" / "er", 1000) is None
    small = check_directory(tmp_path, 10**18)
    assert small is not None
    assert small.code == RefusalCode.NO_ROOM
    assert "MB free" in small.error
    file = tmp_path / "file"
    file.touch()
    missing = check_directory(file / "below", 1)
    assert missing is not None
    assert "set [recording] directory" in missing.error
