"""Messages of clients at an odd rig, word for word; they are in `said.txt`."""

from __future__ import annotations

from pathlib import Path

from tests.clients.said import assert_said


def test_what_is_said_of_an_odd_rig_is_what_was_said(tmp_path: Path) -> None:
    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
