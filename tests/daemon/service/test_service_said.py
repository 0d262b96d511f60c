"""Messages of a service at its limits, word for word; they are in `said.txt`."""

from __future__ import annotations

from pathlib import Path

from tests.clients.said import assert_said


def test_sentences_of_the_service_are_those_stored(tmp_path: Path) -> None:
    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
