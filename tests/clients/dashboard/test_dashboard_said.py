"""Messages from the dashboard to its page about an odd rig."""

from __future__ import annotations

from pathlib import Path

from tests.clients.said import assert_said


def test_the_messages_to_the_page_of_an_unusual_rig_are_the_stored_ones(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()

    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
