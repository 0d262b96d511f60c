"""The guard over the supply (PROTOCOL.md, section 7), in virtual time."""

from __future__ import annotations

import pytest
from armrig_protocol import messages as wire
from armrig_protocol.messages import Cause, Flag, State
from msgspec.structs import replace

from tests.daemon.emulator.emulated_host import MS, QUIET, US, Host, events, only

LOW = replace(QUIET, supply_v=3.999)
SAGS = replace(QUIET, brown_out_s=0.33)  # BOOT ends at 5 ms: measured at 305 ms, and at 405 ms


def alive(host: Host, until_ns: int) -> list[wire.Message]:
    """Return what comes until then, with a KEEPALIVE every 20 ms."""
    came: list[wire.Message] = []
    while host.now_ns < until_ns:
        host.put(wire.Keepalive)
        came += host.wait(min(20 * MS, until_ns - host.now_ns))
    return came


@pytest.mark.parametrize("state", [State.ARMED, State.RUN])
def test_a_falling_supply_stops_the_motor_in_states_that_may_drive_it(state: State) -> None:
    """The measurement is repeated every 100 ms: FAULT(VCC_LOW), with the mV as detail."""
    host = Host(SAGS).reach(state)
    if state is State.RUN:
        host.ask(wire.Exchange, k=1, u=60_000)

    assert not events(alive(host, 404 * MS))
    event = only(wire.Event, alive(host, 410 * MS))

    assert (event.was, event.state, event.cause) == (state, State.FAULT, Cause.VCC_LOW)
    assert event.detail == 3500
    assert event.t_us == 405_000
    assert host.device.board.volts == 0.0


def test_a_supply_of_4_v_is_sufficient() -> None:
    """The limit is 4000 mV."""
    host = Host(replace(QUIET, supply_v=4.0)).reach(State.RUN)

    assert not events(alive(host, 300 * MS))
    assert not only(wire.Sample, host.ask(wire.Exchange, k=1, u=0)).flags & Flag.VCC_LOW


def test_a_supply_measurement_delays_no_sample() -> None:
    host = Host(SAGS).reach(State.RUN)
    alive(host, 405 * MS - 300 * US)

    host.put(wire.Exchange, k=1, u=0)  # taken in 140 us before the measurement is due
    came = host.wait(3 * MS)

    sample, event = only(wire.Sample, came), only(wire.Event, came)
    assert not sample.flags & (Flag.TICK_LATE | Flag.VCC_LOW)
    assert event.t_us == sample.t_us + 104
    assert event.t_us > 405_000


def test_a_restored_supply_clears_the_flag_but_not_the_fault() -> None:
    host = Host(SAGS).reach(State.RUN)
    alive(host, 410 * MS)
    assert host.device.state is State.FAULT
    host.device.board._browns_out = False
    host.wait(200 * MS)

    assert not only(wire.Sample, host.ask(wire.Exchange, k=1, u=0)).flags & Flag.VCC_LOW
    assert host.device.state is State.FAULT
    host.ask(wire.Start, k_stop=0)
    assert host.device.state is State.FAULT


@pytest.mark.parametrize("state", [State.IDLE, State.READY])
def test_a_low_supply_at_rest_is_reported_without_a_fault(state: State) -> None:
    host = Host(LOW).reach(state)

    assert only(wire.Sample, host.ask(wire.Exchange, k=2, u=0)).flags & Flag.VCC_LOW
    assert host.device.state is state
