"""A sleep of this computer is detected by a clock that continues during the sleep."""

from __future__ import annotations

import pytest
from armrig_core.process import standstill
from armrig_core.process.standstill import Standstill


def test_a_sleep_is_reported_once_and_a_short_delay_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([(100.0, 50.0), (107.9, 57.9), (137.9, 58.0), (138.9, 59.0), (148.9, 69.0)])
    monkeypatch.setattr(standstill, "_times_s", lambda: next(times))
    watched = Standstill()

    assert [watched.look() for _ in range(4)] == [
        *("", "this computer slept for 30 s", ""),
        "this computer slept, or this program was stopped, for 10 s",
    ]
