"""--from and --to, wherever a recording is read, and recordings that ended early."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from armrig.cli import app
from armrig.cli.recorded_data import load_recordings
from armrig.data.dataset import Dataset
from armrig.data.time_range import between
from armrig_core.recording_file.manifest import Outcome

from tests.clients.made_recordings import manifest, recorded, turning, written

WHOLE = {"report", "calibrate"}
"""Commands of whole runs: a report and a calibration use no part."""


def _commands() -> dict[str, set[str]]:
    """Return the options of every command that reads recordings, by its name."""
    group: Any = typer.main.get_command(app())
    options = {
        name: {option for p in command.params for option in p.opts}
        for name, command in group.commands.items()
    }
    return {name: known for name, known in options.items() if "--calibration" in known}


def test_every_command_that_reads_a_recording_accepts_a_part_of_it() -> None:
    found = _commands()

    assert len(found) > 8
    lacking = {name for name, known in found.items() if not {"--from", "--to"} <= known}
    assert lacking <= WHOLE


@pytest.mark.parametrize(("t", "k"), [(0.07, 7), (0.57, 57), (0.065, 7), (0.071, 8)])
def test_a_part_begins_and_ends_at_the_sample_due_at_its_time(t: float, k: int) -> None:
    """0.07 / 0.01 is 7 plus a rounding error."""
    data = Dataset(u=np.arange(100.0), y=np.zeros(100), Ts=0.01)

    assert between(data, t, None).u[0] == k
    assert len(between(data, None, t)) == k


def test_the_end_of_a_part_is_not_reported_as_an_early_end_of_its_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    samples = turning([30_000 + 40 * (k % 50) for k in range(200)])
    stopped = recorded(samples, manifest=manifest(k_first=0, samples=400), outcome=None)
    file = written(tmp_path, stopped)

    for part in ({}, {"stop": 1.0}, {"start": 0.1}):
        load_recordings([file], None, **part)
        assert ("ended early" in capsys.readouterr().err) == (not part)


@pytest.mark.parametrize(
    ("asked", "outcome", "said"),
    [
        (600, "stopped by root", "ended early, after 300 of 600 samples: stopped by root\n"),
        (300, "complete", ""),
        (0, "the rig went away", ""),
    ],
)
def test_a_command_warns_before_it_uses_a_run_that_ended_early(
    asked: int, outcome: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = Outcome(outcome=outcome, samples=300, missing=0)
    data = recorded(
        turning([30_000 + 40 * (k % 50) for k in range(300)]),
        manifest=manifest(samples=asked),
        outcome=ended,
    )
    path = written(tmp_path, data)

    load_recordings([path], None)

    told = capsys.readouterr().err
    assert told == (f"armrig: {path.name} {said}" if said else "")
