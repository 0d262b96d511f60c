"""What the dashboard tells its page of an odd rig and its recordings: it is in `said.txt`."""

from __future__ import annotations

from pathlib import Path

from said import assert_said


def test_what_the_page_is_told_of_an_odd_rig_is_what_it_was_told(tmp_path: Path) -> None:
    """Recordings, previews, a rig's state: none begins at 0, none is whole, nothing is default."""
    (tmp_path / "recordings").mkdir()

    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
