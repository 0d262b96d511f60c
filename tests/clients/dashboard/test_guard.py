"""What opens a dashboard."""

from __future__ import annotations

import time

from armrig.dashboard.guard import Pass


def test_a_pass_opens_once() -> None:
    """And a wrong one takes nothing from it."""
    once = Pass("right", until_s=time.monotonic() + 60)

    assert [once.opens(code) for code in (b"wrong", b"right", b"right")] == [False, True, False]


def test_a_pass_ends() -> None:
    """A browser that never came leaves no door open."""
    assert not Pass("right", until_s=time.monotonic() - 1).opens(b"right")
