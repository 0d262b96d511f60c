"""What stands behind the bar of a run."""

from __future__ import annotations

from typing import Any, NamedTuple

from armrig.rig.progress import TimingNote
from made_recordings import sample


class Missing(NamedTuple):
    """What a gap record says of the samples."""

    k_first: int
    count: int


def test_missing_counts_what_the_recording_counts() -> None:
    """Samples of the run: a gap that begins before it, or ends after it, counts with its part."""
    arrived: list[list[Any]] = [[sample(k) for k in (100, 101)]]
    gaps: list[list[Any]] = [[Missing(95, 3), Missing(102, 2), Missing(108, 5), Missing(111, 1)]]
    note = TimingNote(
        10, lambda: arrived.pop() if arrived else [], lambda: gaps.pop() if gaps else [], list
    )

    assert "missing 4" in note()
