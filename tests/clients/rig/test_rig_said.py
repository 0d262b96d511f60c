"""What is said to who works at a rig that is unlike others, word for word: it is in `said.txt`."""

from __future__ import annotations

from pathlib import Path

from said import assert_said


def test_what_is_said_of_an_odd_rig_is_what_was_said(tmp_path: Path) -> None:
    """Refusals, statuses, gaps, a host, a benchmark: of several things of unequal length."""
    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
