"""Deadlines are absolute; a missed one is skipped."""

from __future__ import annotations

from armrig_daemon.loop.loop import TickSchedule, change_pace
from hypothesis import given
from hypothesis import strategies as st

PACE = TickSchedule(period_ns=1000, origin_ns=5000, k_origin=0)


def test_deadlines_do_not_drift() -> None:
    assert [PACE.due_ns(k) for k in (0, 1, 1_000_000)] == [5000, 6000, 1_000_005_000]


def test_a_tick_in_time_keeps_its_number() -> None:
    assert PACE.current(3, PACE.due_ns(3)) == 3
    assert PACE.current(3, PACE.due_ns(3) + 999) == 3


@given(st.integers(0, 10**6), st.integers(0, 10**9))
def test_the_newest_due_tick_is_executed(k: int, late_ns: int) -> None:
    now = PACE.due_ns(k) + late_ns

    done = PACE.current(k, now)

    assert 0 <= now - PACE.due_ns(done) < PACE.period_ns


def test_a_changed_period_begins_one_period_from_now() -> None:
    pace = change_pace(PACE, k=7, period_ns=300, now_ns=20_000)

    assert [pace.due_ns(k) for k in (7, 8)] == [20_300, 20_600]


@given(st.integers(0, 10**6))
def test_renumbered_tick_keeps_the_phase(now_ns: int) -> None:
    pace = change_pace(PACE, k=70, period_ns=1000, now_ns=now_ns)

    ahead_ns = pace.due_ns(70) - now_ns
    assert 0 <= ahead_ns < 1000
    assert (pace.due_ns(70) - PACE.due_ns(0)) % 1000 == 0
