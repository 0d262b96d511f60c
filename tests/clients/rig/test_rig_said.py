"""Messages of clients at an odd rig, word for word; they are in `said.txt`."""

from __future__ import annotations

from pathlib import Path

from tests.clients.said import assert_said


def test_messages_about_an_odd_rig_are_the_stored_texts(tmp_path: Path) -> None:
    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
