"""Limits of files, for tests."""

from __future__ import annotations

import pytest
from armrig.data.files import table


@pytest.fixture
def _little_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a file unpack to 1 MiB."""
    monkeypatch.setattr(table, "room", lambda _: 1 << 20)
