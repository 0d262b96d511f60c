"""Remarks of commands about recordings before their use."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.cli.recorded_data import loaded
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
