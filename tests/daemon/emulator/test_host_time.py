"""The clock of an emulated device while its process is stalled."""

from __future__ import annotations

import pytest
from armrig_daemon.emulator.host_time import LOOK_NS, STALL_NS, HostTime, StallReports
from armrig_protocol.messages import Cause, Exchange, State
from hypothesis import given
from hypothesis import strategies as st

from tests.daemon.emulator.emulated_host import MS, Host, S

WATCHDOG_MS = 100
stalls = st.lists(
    st.tuples(st.integers(0, 60 * MS), st.integers(0, 500 * MS)), min_size=1, max_size=20
)
"""For each wait: how long it was meant to be, and how much longer it was."""


def test_clock_without_tolerance_is_the_host_clock() -> None:
    time = HostTime(5, tolerates_stalls=False)

    assert time.emulation_ns(700 * MS) == 700 * MS
    assert time.look_ns(10**18) == 10**18
    assert time.held_up_ns == 0


def test_stall_above_10_ms_is_removed_from_the_clock() -> None:
    time = HostTime(0, tolerates_stalls=True)

    assert time.emulation_ns(40 * MS, due_ns=35 * MS) == 40 * MS
    assert time.emulation_ns(300 * MS, due_ns=50 * MS) == 60 * MS
    assert time.held_up_ns == 240 * MS
    assert time.monotonic_ns(60 * MS) == 300 * MS
    assert time.emulation_ns(301 * MS) == 61 * MS


def test_the_clock_is_read_at_bounded_intervals() -> None:
    time = HostTime(0, tolerates_stalls=True)

    assert time.look_ns(10**18) == LOOK_NS
    assert time.look_ns(3) == 3
    given_ns = time.emulation_ns(300 * MS, due_ns=50 * MS)
    assert given_ns < 300 * MS
    assert time.look_ns(10**18) == given_ns + LOOK_NS


@given(stalls)
def test_the_emulated_time_grows_by_each_wait_and_at_most_10_ms_of_delay(
    waits: list[tuple[int, int]],
) -> None:
    """The time grows by each wait as planned, and by at most 10 ms of delay."""
    time, now_ns, before_ns, owed_ns = HostTime(0, tolerates_stalls=True), 0, 0, 0
    for wait_ns, late_ns in waits:
        due_ns = before_ns + wait_ns
        now_ns += wait_ns + late_ns
        given_ns = time.emulation_ns(now_ns, due_ns)
        assert given_ns - before_ns == wait_ns + min(late_ns, STALL_NS)
        owed_ns += max(0, late_ns - STALL_NS)
        before_ns = given_ns
    assert time.held_up_ns == owed_ns == now_ns - before_ns


@given(stalls)
def test_a_stall_does_not_change_the_watchdog_period_on_the_device_clock(
    waits: list[tuple[int, int]],
) -> None:
    host, fed_ns = _running()
    time = HostTime(fed_ns, tolerates_stalls=True)
    now_ns = given_ns = fed_ns
    for wait_ns, late_ns in [*waits, *[(10 * MS, 0)] * 20]:
        due_ns = time.look_ns(given_ns + wait_ns)
        now_ns = max(now_ns, time.monotonic_ns(due_ns)) + late_ns
        given_ns = time.emulation_ns(now_ns, due_ns)
        host.device.advance(given_ns)

    tripped = host.changes[-1]
    assert (tripped.cause, tripped.volts) == (Cause.WATCHDOG, 0.0)
    assert tripped.t_ns == fed_ns + WATCHDOG_MS * MS


@pytest.mark.parametrize(("tolerates", "state"), [(True, State.RUN), (False, State.FAULT)])
def test_a_frame_received_during_a_stall_precedes_the_watchdog(
    tolerates: bool, state: State
) -> None:
    """A stall of 2 s, and in it a frame; the watchdog is 0.1 s."""
    host, fed_ns = _running()
    time = HostTime(fed_ns, tolerates_stalls=tolerates)

    due_ns = time.look_ns(host.device.visible_ns())
    given_ns = time.emulation_ns(fed_ns + 2 * S, due_ns)
    host.device.advance(given_ns)
    host.now_ns = given_ns
    host.ask(Exchange, k=1, u=30_000)

    assert host.device.state is state


def _running() -> tuple[Host, int]:
    """Return a host that drives the device by hand, and when its last frame has come."""
    host = Host().reach(State.RUN, watchdog_ms=WATCHDOG_MS)
    fed_ns = host.put(Exchange, k=0, u=20_000)
    host.device.advance(fed_ns)
    return host, fed_ns


def test_stalls_are_summed_and_reported_once_a_second() -> None:
    reported: list[int] = []
    stalls = StallReports(reported.append)

    for held_up_ms, now_ms in [(0, 0), (30, 500), (50, 1499), (50, 1500), (50, 9000), (90, 9001)]:
        stalls.update(held_up_ms * MS, now_ms * MS)

    assert reported == [30 * MS, 20 * MS, 40 * MS]
