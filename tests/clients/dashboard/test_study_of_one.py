"""What the page is told of one recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.dashboard.study_of_one import curves
from armrig.recordings.loading import load


@pytest.mark.parametrize(("start", "k"), [(0.995, 100), (1.999, -1), (1e6, -1)])
def test_a_part_without_a_sample_is_the_next_one_or_the_last(
    three_recordings: tuple[Path, Path, Path], start: float, k: int
) -> None:
    """A zoom between two samples, or behind the last, which is a sampling time before the end."""
    path = three_recordings[0]
    recording = load(path)
    shown = curves(path, start, start + 0.001)

    assert shown["u"][0] == [pytest.approx(recording.t[k])]
    assert shown["u"][1] == shown["u"][2] == [pytest.approx(recording.u[k], abs=1e-4)]
