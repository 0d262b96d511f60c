"""Remarks of commands about recordings before their use."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.cli import main
from armrig.cli.recorded_data import loaded
from armrig_core.calibration import Calibration, Driver
from armrig_core.manifest import Outcome

from tests.clients.made_recordings import manifest, recorded, turning, written

TURNING = turning([30_000 + 40 * (k % 50) for k in range(300)])


@pytest.mark.parametrize(
    ("asked", "outcome", "said"),
    [
        (600, "stopped by root", "ended early, after 300 of 600 samples: stopped by root\n"),
        (300, "complete", ""),
        (0, "the rig went away", ""),
    ],
)
def test_a_run_that_ended_early_is_named_before_it_is_used(
    asked: int, outcome: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = Outcome(outcome=outcome, samples=300, missing=0)
    data = recorded(TURNING, manifest=manifest(samples=asked), outcome=ended)
    path = written(tmp_path, data)

    loaded([path], None)

    told = capsys.readouterr().err
    assert told == (f"armrig: {path.name} {said}" if said else "")
    loaded([path], None, start=1.0)
    assert "ended early" not in capsys.readouterr().err


def test_a_report_names_recordings_of_different_calibrations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armrig.report.handout_study.handout_study", lambda *_, **__: None)
    monkeypatch.setattr("armrig.report.handout.handout_report", lambda *_, **__: None)
    other = Calibration(driver=Driver(gain=1.1))
    kinds = {"step": other, "blackbox": Calibration(), "greybox": Calibration()}
    files = [
        str(
            written(
                tmp_path,
                recorded(TURNING, manifest=manifest(experiment=kind), calibration=calibration),
                f"{kind}.mcap",
            )
        )
        for kind, calibration in kinds.items()
    ]

    assert main(["report", "--handout", *files, "-o", str(tmp_path / "report.pdf")]) == 0

    assert "2 different calibrations (step.mcap; blackbox.mcap" in capsys.readouterr().err
