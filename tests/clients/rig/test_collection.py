"""What is said of a collection that somebody has ended."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from armrig.rig.collection import _interrupted_sentence
from armrig_core.commands import LastRun

NEW = LastRun(run_id="new", recording="new.mcap", finished=True, samples=7, outcome="stopped")
OLD = LastRun(run_id="old", recording="old.mcap", finished=True, samples=9, outcome="complete")


@pytest.mark.parametrize(
    ("before", "last", "said"),
    [
        (None, None, "nothing was recorded"),
        (OLD, OLD, "nothing was recorded"),
        (OLD, NEW, "the 7 samples until then are in new.mcap"),
        (None, NEW, "the 7 samples until then are in new.mcap"),
    ],
)
def test_an_interrupted_run_is_told_with_its_own_recording(
    before: LastRun | None, last: LastRun | None, said: str
) -> None:
    """The newest recording may be one of an earlier run."""
    rig: Any = SimpleNamespace(rig="1", status=lambda: SimpleNamespace(last_run=last))

    assert _interrupted_sentence(rig, before) == (
        f"interrupted: rig 1 was told to stop (0 V); {said}"
    )
