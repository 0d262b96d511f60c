"""Bytes that a stalled reader has not taken yet."""

from __future__ import annotations

from armrig_daemon.emulator.line import CAPACITY_BYTES, Backlog
from hypothesis import given
from hypothesis import strategies as st


@given(st.lists(st.binary(min_size=1, max_size=9)), st.lists(st.integers(1, 9)))
def test_backlog_keeps_order_for_any_cuts(frames: list[bytes], cuts: list[int]) -> None:
    backlog, left = Backlog(), b""
    for frame in frames:
        backlog.put(frame)
    assert backlog.waiting_bytes == sum(map(len, frames))

    for cut in cuts:
        taken = backlog.first()[:cut]
        if taken:
            left += taken
            backlog.remove_first(len(taken))
    while piece := backlog.first():
        left += piece
        backlog.remove_first(len(piece))

    assert left == b"".join(frames)
    assert backlog.waiting_bytes == backlog.dropped_frames == 0


def test_64_kib_are_kept_then_whole_frames_are_dropped_and_counted() -> None:
    backlog = Backlog()
    for _ in range(CAPACITY_BYTES // 36):
        backlog.put(b"x" * 36)
    assert backlog.dropped_frames == 0

    backlog.put(b"y" * 36)
    backlog.put(b"z" * (CAPACITY_BYTES % 36))
    backlog.put(b"z")

    assert (backlog.dropped_frames, backlog.dropped_bytes) == (2, 37)
    assert backlog.waiting_bytes == CAPACITY_BYTES == 65_536


def test_a_cleared_backlog_is_empty() -> None:
    backlog = Backlog()
    backlog.put(b"abc")

    backlog.clear()

    assert (backlog.first(), backlog.waiting_bytes, backlog.dropped_frames) == (b"", 0, 0)
