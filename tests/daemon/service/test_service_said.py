"""What a service says at the edges of its limits, word for word: it is in `said.txt`."""

from __future__ import annotations

from pathlib import Path

from said import assert_said


def test_what_a_service_says_at_its_edges_is_what_it_said(tmp_path: Path) -> None:
    """Of networks, lateness, readings, a log that repeats itself, signs and floods."""
    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
