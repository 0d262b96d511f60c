"""Intervals and calls of the recorder, which a test replaces."""

from __future__ import annotations

import pytest

from tests.core.recording_file.made import Setter


@pytest.fixture
def pace(monkeypatch: pytest.MonkeyPatch) -> Setter:
    """Return a function that sets the recorder's intervals, in s: `FLUSH_S=0.0`."""

    def set_to(**intervals_s: float) -> None:
        for name, value in intervals_s.items():
            monkeypatch.setattr(f"armrig_core.recording_file.recorder.{name}", value)

    return set_to


@pytest.fixture
def instead(monkeypatch: pytest.MonkeyPatch) -> Setter:
    """Return a function that replaces calls of the part that is written: `fsync=full`."""

    def replace(**calls: object) -> None:
        for name, call in calls.items():
            where = "os." if name in ("fsync", "fdatasync", "lstat") else ""
            where += "RecordingPart." if name in ("flush", "sync", "_write_pending") else ""
            monkeypatch.setattr(f"armrig_core.recording_file.recording_part.{where}{name}", call)

    return replace
