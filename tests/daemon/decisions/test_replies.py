"""Messages of a device, and the core's reactions."""

from __future__ import annotations

import pytest
from armrig_daemon.decisions import setpoints, step
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import device_facts
from armrig_daemon.decisions.state import DecisionState, Phase, RequestKind, RoundTrip, Wakeup
from armrig_daemon.pipe import Log
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES, Cause, Code
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import (
    OURS,
    RUN,
    Decided,
    armed,
    awaiting,
    changed,
    driven,
    heard,
    rested,
)
from tests.daemon.virtual_bench import MS


def _event(state: DecisionState, **fields: int) -> wire.Event:
    """Return an EVENT of the device that is met, into the state that it is in."""
    zero = wire.Event._make([0] * len(wire.Event._fields))
    known = {"state": state.link.device_state, "boot": state.device.boot_id & 0xFFFF}
    return zero._replace(**{**known, **fields})


# -- round trips ---------------------------------------------------------------------------------


def _pong(state: DecisionState, **fields: int) -> wire.Pong:
    known = {"state": state.link.device_state, "seq": 0, "host_ns": state.link.ping_ns}
    return wire.Pong(**{**known, "rx_us": 100, "tx_us": 150, **fields})


def test_ack_of_the_awaited_request_proves_a_round_trip() -> None:
    """S4: an ACK of another frame, or a refusal, proves nothing."""
    bench = rested()
    now = bench.ports.now
    fresh = changed(bench.loop.state, last_round_trip_ns=now - 40 * MS)
    state = awaiting(fresh, RequestKind.ARM, sent_ns=now - 3 * MS)
    seq = state.asked.seq
    ack = wire.Ack(int(DeviceState.READY), 0, TYPES[wire.Arm], int(Code.OK), seq)

    assert heard(bench, ack, state).state.link.last_round_trip_ns == now - 3 * MS
    younger = changed(state, last_round_trip_ns=now - 1 * MS)
    assert heard(bench, ack, younger).state.link.last_round_trip_ns == now - 1 * MS
    for other in (
        ack._replace(of_seq=seq + 1),
        ack._replace(of_type=TYPES[wire.Stop]),
        ack._replace(code=int(Code.STALE)),
    ):
        assert heard(bench, other, state).state.link.last_round_trip_ns == now - 40 * MS


def test_the_answer_to_the_newest_ping_proves_a_round_trip() -> None:
    """S4: the round trip is as old as the question."""
    bench = rested()
    now = bench.ports.now
    state = changed(bench.loop.state, ping_ns=now - 7 * MS, last_round_trip_ns=now - 40 * MS)

    younger = heard(bench, _pong(state), state)
    older = heard(bench, _pong(state), changed(state, last_round_trip_ns=now - 1 * MS))

    assert younger.of(RoundTrip) == [RoundTrip(7 * MS)]
    assert younger.state.link.last_round_trip_ns == now - 7 * MS
    assert younger.state.clock.compared_ns == now
    assert older.state.link.last_round_trip_ns == now - 1 * MS


def test_answer_to_an_older_ping_proves_no_round_trip() -> None:
    """S4: a burst after a pause must not count as fresh."""
    bench = rested()
    state = changed(bench.loop.state, ping_ns=bench.ports.now - 7 * MS)

    decided = heard(bench, _pong(state, host_ns=state.link.ping_ns - 1), state)

    assert decided.actions == []
    assert decided.state == state


def test_status_frame_causes_no_action() -> None:
    bench = rested()
    decided = heard(bench, wire.Status._make([int(DeviceState.READY)] + [0] * 13))

    assert decided.actions == []


# -- a reset of the device -----------------------------------------------------------------------


def test_the_identity_of_a_device_is_hexadecimal_and_constant() -> None:
    device = wire.HelloReply(DeviceState.IDLE, 9, *range(40, 40 + len(wire.HelloReply._fields) - 2))

    facts = device_facts(device)

    assert {*device._fields} - {*facts} == {"state", "seq", "token", "cause"}
    assert {key for key, value in facts.items() if isinstance(value, str)} == {
        "uid",
        "boot_id",
        "schema",
        "firmware",
    }
    for key, value in facts.items():
        assert value == (f"{getattr(device, key):x}" if isinstance(value, str) else value)
        assert isinstance(value, str) or value == getattr(device, key)
    assert device_facts(None) == {}


def test_a_device_restart_before_its_configuration_causes_a_new_hello() -> None:
    bench = rested()
    state = changed(bench.loop.state, phase=Phase.INIT)

    decided = heard(bench, _event(state, boot=(state.device.boot_id + 1) & 0xFFFF), state)

    assert (decided.state.phase, decided.state.device) == (Phase.INIT, None)
    assert [type(m) for m in decided.sent] == [wire.Hello]
    assert [log.message for log in decided.told(Log)] == ["the device was reset"]
    assert [s.phase for s in decided.told(StateRecord)] == ["init"]


# -- events --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cause", "detail", "words"),
    [
        (int(Cause.WATCHDOG), 0, "WATCHDOG, it received nothing from this host in time"),
        (int(Cause.RANGE), 123, "RANGE, a voltage was outside its limits (code 123)"),
        (int(Cause.VCC_LOW), 3900, "VCC_LOW, its supply is too low (3900 mV)"),
        (int(Cause.REQUEST), 0, "REQUEST"),
        (250, 0, "250"),
    ],
)
def test_a_latched_device_is_reported_with_its_cause(cause: int, detail: int, words: str) -> None:
    """S6: by its name if it has one, and the code that it refused."""
    bench = driven()
    event = _event(bench.loop.state, cause=cause, detail=detail, token=7)
    event = event._replace(state=int(DeviceState.FAULT))

    decided = heard(bench, event)

    text = f"the device stopped by itself: {words}"
    assert decided.state.fault == Fault(Id.DEVICE, text, cause)
    assert decided.told(StateRecord)[-1].device_cause == cause
    assert decided.state.link.token == 7
    assert decided.state.link.device_state == DeviceState.FAULT


@pytest.mark.parametrize(
    ("at", "waits"),
    [(DeviceState.FAULT, False), (DeviceState.ESTOP, False), (DeviceState.RUN, True)],
)
def test_a_refused_stop_of_a_latched_device_does_not_cause_a_fault(
    at: DeviceState, waits: bool
) -> None:
    """S6: the fault stays; while the device drives, STOP is sent again."""
    bench = driven()
    latched = changed(bench.loop.state, phase=Phase.FAULT, fault=Fault(Id.DEVICE, "REV_LIMIT"))
    state = awaiting(latched, RequestKind.STOP)
    refusal = wire.Ack(int(at), 0, TYPES[wire.Stop], int(Code.WRONG_STATE), OURS)

    decided = heard(bench, refusal, state)

    assert decided.told(Log) == []
    assert decided.sent == []
    assert (decided.state.asked is not None) == waits
    assert decided.state.fault == latched.fault


def test_device_that_latches_after_a_trip_keeps_the_fault() -> None:
    bench = rested()
    state = changed(bench.loop.state, phase=Phase.FAULT, fault=Fault(Id.LEASE, "ran out"))
    event = _event(state, token=7)._replace(state=int(DeviceState.FAULT))

    decided = heard(bench, event, state)

    assert decided.state.fault == Fault(Id.LEASE, "ran out")
    assert decided.state.link.token == 7


# -- scheduled runs ------------------------------------------------------------------------------


def test_a_queue_report_without_a_device_starts_no_run() -> None:
    bench = armed()
    now = bench.ports.now
    filling, _ = step.carry_out(
        now, setpoints.begin(bench.loop.state, now, changed(RUN, scheduled=True))
    )

    gone, actions = step.carry_out(
        now, setpoints.note_queue(changed(filling, device=None), now, 0, 2)
    )
    there, (start,) = step.carry_out(now, setpoints.note_queue(filling, now, 0, 2))

    assert (gone.asked, actions) == (None, [])
    assert there.asked.want is RequestKind.START
    assert isinstance(start.data, bytes)


def test_a_start_carries_the_length_of_the_run() -> None:
    bench = armed()
    now = bench.ports.now
    filling, _ = step.carry_out(
        now, setpoints.begin(bench.loop.state, now, changed(RUN, scheduled=True))
    )

    started, _ = step.carry_out(now, setpoints.note_queue(filling, now, 0, 2))

    assert started.asked is not None
    (start,) = Decided(started, now + 50 * MS, Wakeup()).sent
    assert isinstance(start, wire.Start)
    assert start.k_stop == 2


# -- the link ------------------------------------------------------------------------------------


def test_no_keepalive_precedes_the_tick_that_stops() -> None:
    """S2: a wakeup precedes the tick after a pause, and would feed the watchdog again."""
    bench = driven()
    state, now = bench.loop.state, bench.ports.now
    lease = state.lease
    assert lease is not None
    lease_ns, pause_ns = state.rules.lease_ns(state.ts_us), state.rules.pause_ns(state.ts_us)

    for paused_ns, run_out_ns, keeps in (
        (pause_ns, lease_ns, True),
        (pause_ns + 1, lease_ns, False),
        (pause_ns, lease_ns + 1, False),
    ):
        held = changed(lease, renewed_ns=now - run_out_ns)
        paused = changed(state, tick_ns=now - paused_ns, lease=held)
        assert bool(Decided(paused, now, Wakeup()).sent) == keeps
    plays = changed(state, lease=changed(lease, renewed_ns=now - lease_ns - 1), run=RUN)
    assert Decided(changed(plays, tick_ns=now), now, Wakeup()).sent
