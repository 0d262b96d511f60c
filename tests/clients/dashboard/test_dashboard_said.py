"""Messages from the dashboard to its page about an odd rig, and about a model of a recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.clients.said import assert_said

HERE = Path(__file__).parent


def test_the_messages_to_the_page_of_an_odd_rig_are_those_stored(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()

    assert_said(HERE / "said.txt", tmp_path)


@pytest.mark.exhaustive
def test_the_message_of_a_model_is_the_one_stored(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()

    assert_said(HERE / "said_of_a_model.txt", tmp_path)
