"""From HELLO to a running motor and back: what each answer, and each that stays away, leads to."""

from __future__ import annotations

import pytest
from armrig_core.rig.emulated import EMULATOR_UID
from armrig_core.rig.volts import code_of
from armrig_daemon import pipe
from armrig_daemon.decisions import effects, orders, outcomes, requests
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import NO_DEVICE
from armrig_daemon.decisions.state import (
    DecisionState,
    Image,
    Phase,
    RequestKind,
    SetPeriod,
    Tick,
    Wakeup,
)
from armrig_daemon.pipe import Answer, Log, Reset
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol import messages as wire
from armrig_protocol.frame import config_crc
from armrig_protocol.messages import TYPES, Capability, Code, Mode, Underrun
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from tests.daemon.decision_states import (
    ARM,
    OURS,
    RUN,
    SET,
    Decided,
    armed,
    awaiting,
    changed,
    driven,
    heard,
    ordered,
    rested,
)
from tests.daemon.virtual_bench import LEASE, MS, Bench

HALF = code_of(2.5)
RETRY_MS = dict.fromkeys(RequestKind, 50) | {RequestKind.HELLO: 100, RequestKind.STOP: 20}


# -- retries -------------------------------------------------------------------------------------


@pytest.mark.parametrize("want", list(RequestKind))
def test_a_request_is_repeated_exactly_at_its_retry_time(want: RequestKind) -> None:
    bench = armed()
    state = awaiting(bench.loop.state, want, ARM, ts_us=10_000)
    due_ns = RETRY_MS[want] * MS

    early = Decided(state, due_ns - 1, Wakeup())
    late = Decided(state, due_ns, Wakeup())

    assert early.actions == []
    assert early.state == state
    kinds = dict(
        zip(
            RequestKind,
            [wire.Hello, wire.Config, wire.Arm, wire.Start, wire.Stop, wire.ClearFault],
            strict=True,
        )
    )
    (sent,) = late.sent
    assert type(sent) is kinds[want]
    asked = late.state.asked
    assert (asked.tries, asked.order, asked.sent_ns) == (2, ARM, due_ns)
    assert (asked.seq, sent.state) == (sent.seq, 0)


@pytest.mark.parametrize("want", [want for want in RequestKind if want is not RequestKind.HELLO])
def test_a_request_is_tried_five_times(want: RequestKind) -> None:
    bench = armed()
    fourth = awaiting(bench.loop.state, want, ARM, tries=4)

    assert len(Decided(fourth, 50 * MS, Wakeup()).sent) == 1
    given_up = Decided(awaiting(bench.loop.state, want, ARM, tries=5), 50 * MS, Wakeup())
    (answer,) = given_up.told(Answer)
    assert answer.error == f"the device does not answer {want}"


def test_retry_without_a_request_does_nothing() -> None:
    state = rested().loop.state

    assert state.asked is None
    assert requests.retry(state, 1 << 60) == (state, [])


# -- requests that fail --------------------------------------------------------------------------


def test_the_lease_counts_from_the_command_and_not_from_the_start_of_the_run() -> None:
    """S2: a START that was repeated does not make the old command younger."""
    bench = armed()
    now, state = bench.ports.now, bench.loop.state
    assert state.lease is not None
    given = changed(
        state, lease=changed(state.lease, renewed_ns=now - 90 * MS), last_round_trip_ns=now
    )
    ack = wire.Ack(int(DeviceState.RUN), 0, TYPES[wire.Start], int(Code.OK), OURS)

    started = heard(bench, ack, awaiting(given, RequestKind.START, SET, sent_ns=now))
    fresh = changed(
        started.state, last_round_trip_ns=now + 10 * MS, tick_ns=now + 10 * MS, service_ns=now
    )
    held = Decided(fresh, now + 10 * MS, Tick(state.k + 1, now))
    over = Decided(fresh, now + 10 * MS + 1, Tick(state.k + 1, now))

    assert started.state.phase is Phase.ACTIVE
    assert [(m.u, m.state) for m in held.sent] == [(SET.code, 0)]
    assert [type(m) for m in over.sent][:1] == [wire.Stop]
    assert over.state.fault == Fault(Id.LEASE, "the lease ran out: no command from its holder")


# -- the device's state --------------------------------------------------------------------------


@pytest.mark.parametrize("id_", [Id.LINK, Id.DEVICE, Id.FIRMWARE])
def test_the_cause_of_a_latched_device_replaces_that_of_an_earlier_fault(id_: Id) -> None:
    bench = rested()
    device = bench.loop.state.device
    lost = changed(bench.loop.state, device=None, phase=Phase.FAULT, fault=Fault(id_, "before"))
    reply = device._replace(state=int(DeviceState.ESTOP))

    decided = heard(bench, reply, awaiting(lost, RequestKind.HELLO))

    assert decided.state.fault == Fault(Id.DEVICE, "the device is in ESTOP")
    assert [log.fields for log in decided.told(Log)] == [{"cause": Id.DEVICE}]
    assert [s.reason for s in decided.told(StateRecord)] == ["the device is in ESTOP"]


def _one_sent(bench: Bench) -> tuple:
    bench.ports.from_device = lambda data: b""
    bench.run_for(11)
    return bench.loop.state.link.sent


@pytest.mark.parametrize("state", [s for s in DeviceState if s != DeviceState.IDLE])
def test_a_fault_is_cleared_when_the_device_is_idle(state: DeviceState) -> None:
    """S6."""
    bench = rested()
    at = changed(bench.loop.state, phase=Phase.FAULT, device_state=int(DeviceState.FAULT))
    at = awaiting(at, RequestKind.CLEAR, Reset(order=8))

    waiting, _ = effects.note_state(at, bench.ports.now, int(state))
    _, follow = effects.note_state(at, bench.ports.now, int(DeviceState.IDLE))

    assert waiting.asked == at.asked
    assert follow == [outcomes.Ask(RequestKind.HELLO, Reset(order=8))]


@pytest.mark.parametrize("state", list(DeviceState))
def test_stop_is_confirmed_by_a_state_without_voltage(state: DeviceState) -> None:
    bench = driven()
    at = awaiting(bench.loop.state, RequestKind.STOP)

    after, _ = effects.note_state(at, bench.ports.now, int(state))

    drives = state in (DeviceState.ARMED, DeviceState.RUN)
    assert (after.asked == at.asked) == drives
    assert (after.lease is None) != drives


# -- HELLO ---------------------------------------------------------------------------------------


def _met(bench: Bench, before: DecisionState, **fields: int) -> Decided:
    """Return what follows from a HELLO_R."""
    device = bench.loop.state.device
    reply = device._replace(**{"state": int(DeviceState.IDLE), **fields})
    return heard(bench, reply, before)


def test_round_trip_of_hello_counts_from_the_request() -> None:
    """S4: the age of the round trip counts from the question."""
    bench = rested()
    waiting = _one_sent(bench)
    greeting = awaiting(changed(bench.loop.state, sent=waiting), RequestKind.HELLO, sent_ns=123)

    met = _met(bench, greeting, token=99, state=int(DeviceState.READY))

    assert met.state.link.last_round_trip_ns == 123
    assert met.state.link.sent == ()
    assert met.state.link.token == 99
    assert met.state.link.device_state == DeviceState.READY
    assert [type(m) for m in met.sent] == [wire.Config]


def test_a_restarted_device_has_a_new_clock() -> None:
    bench = rested()
    bench.run_for(1000)
    greeting = awaiting(bench.loop.state, RequestKind.HELLO)
    boot_id = bench.loop.state.clock.boot_id

    same, other = _met(bench, greeting).state, _met(bench, greeting, boot_id=boot_id + 1).state

    assert same.clock == bench.loop.state.clock
    assert same.t_us == bench.loop.state.t_us != 0
    assert (other.clock.map.weight, other.t_us, other.clock.device_us) == (0, 0, 0)
    assert other.clock.boot_id == boot_id + 1
    assert same.sampled_ns == bench.loop.state.sampled_ns != 0
    assert other.sampled_ns == 0


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"version": 9}, "speaks version 9"),
        ({"schema": 0xABC}, "schema 00000abc"),
        ({"full_scale_mv": 5001}, "full scale is 5001 mV"),
        ({"capabilities": 2}, "no exchange mode"),
        ({"pwm_bits": 0}, "0 bits"),
        ({"pwm_bits": 17}, "17 bits"),
        ({"state": int(DeviceState.FAULT)}, "is in FAULT"),
        ({"state": int(DeviceState.ESTOP)}, "is in ESTOP"),
    ],
)
def test_a_device_that_cannot_be_driven_is_latched_and_reported_once(
    fields: dict[str, int], complaint: str
) -> None:
    bench = rested()

    once = _met(bench, awaiting(bench.loop.state, RequestKind.HELLO), **fields)
    again = _met(bench, awaiting(once.state, RequestKind.HELLO, Reset(order=8)), **fields)

    assert complaint in once.state.fault.cause
    assert once.state.phase is Phase.FAULT
    assert once.sent == again.sent == []
    assert [log.level for log in once.told(Log)] == ["error"]
    assert len(once.told(StateRecord)) == 1
    assert [a.error for a in again.told(Answer)] == [once.state.fault.cause]
    assert again.told(Log) == []


def test_a_rig_that_rests_at_half_scale_needs_an_enable_line() -> None:
    bench = rested()
    rules = replace(bench.loop.state.rules, rest_code=HALF)
    state = awaiting(replace(bench.loop.state, rules=rules), RequestKind.HELLO)
    without = state.device.capabilities & ~Capability.ENABLE_LINE

    refused = _met(bench, state, capabilities=without)
    met = _met(bench, state, capabilities=without | Capability.ENABLE_LINE)

    assert "has no enable line" in refused.state.fault.cause
    assert refused.sent == []
    assert met.state.fault is None


_SHIELD = Image("tclab", 0x1234)
_ARM = Image("uno", 0, (0x1234, 0x4321))


@pytest.mark.parametrize(
    ("image", "firmware", "uid", "is_fit"),
    [
        (_SHIELD, 0x1234, 7, True),
        (_SHIELD, 0x4321, 7, False),
        (_SHIELD, 0, 7, False),
        (_SHIELD, 0, EMULATOR_UID, True),
        (_ARM, 0x4321, 7, False),
        (_ARM, 0, 7, False),
        (_ARM, 0x9999, 7, True),
    ],
)
def test_a_board_with_another_image_than_the_rig_needs_is_not_driven(
    image: Image, firmware: int, uid: int, is_fit: bool
) -> None:
    """Only an emulator has no image (0); one's own firmware is allowed at the arm's pins only."""
    bench = rested()
    state = awaiting(bench.loop.state, RequestKind.HELLO)
    rules = replace(state.rules, image=image)

    met = _met(bench, replace(state, rules=rules), firmware=firmware, uid=uid)

    assert (met.state.phase is Phase.FAULT) == (not is_fit)
    assert bool(met.sent) == is_fit
    if not is_fit:
        assert f"{firmware:08x}, is not the image {image.name}" in met.state.fault.cause
        assert f"`armrig flash --image {image.name}`" in met.state.fault.cause


# -- CONFIG --------------------------------------------------------------------------------------


def _reply(state: DecisionState, **fields: int) -> wire.ConfigReply:
    """Return the answer to the CONFIG that the state waits for."""
    (sent,) = Decided(state, state.asked.sent_ns + 50 * MS, Wakeup()).sent
    assert isinstance(sent, wire.Config)
    body = sent[2:]
    reply = wire.ConfigReply._make((3, 0, int(Code.OK), 0, config_crc(sent), *body, 77))
    return reply._replace(**fields)


@pytest.mark.parametrize("scheduled", [False, True])
def test_config_frame_contains_the_rules(scheduled: bool) -> None:
    """Rest at 0 V, and 0 V if a queue runs dry."""
    rules = changed(
        rested().loop.state.rules, code_min=9, code_max=60_000, slew=5, watchdog_ms=60, turns=7
    )
    rules = changed(rules, rail_ticks=8, oversampling=4)

    assert rules.config(2_000, 33, scheduled=scheduled) == wire.Config(
        state=0,
        seq=33,
        ts_us=2_000,
        u_min=0,
        u_max=60_000,
        u_rest=0,
        slew=5,
        watchdog_ms=60,
        mode=Mode.SCHEDULED if scheduled else Mode.EXCHANGE,
        underrun=Underrun.ZERO,
        hold=0,
        oversampling=4,
        rail_ticks=8,
        turns=7,
    )


def test_an_accepted_configuration_has_the_time_of_its_request() -> None:
    bench = rested()
    state = awaiting(
        bench.loop.state, RequestKind.CONFIGURE, ts_us=10_000, sent_ns=bench.ports.now - 7
    )

    decided = heard(bench, _reply(state), state)

    assert decided.state.configuration.asked_ns == bench.ports.now - 7


def test_the_state_after_a_configuration_is_that_of_its_answer() -> None:
    """An old frame that was played again in between has reported RUN."""
    bench = rested()
    latest = changed(bench.loop.state.link, device_state=int(DeviceState.RUN))
    state = awaiting(changed(bench.loop.state, link=latest), RequestKind.CONFIGURE, ts_us=10_000)

    decided = heard(bench, _reply(state), state)

    assert [record.motor for record in decided.told(StateRecord)] == [
        "at 0 V, as the device reports"
    ]


def test_a_device_that_refuses_oversampling_is_reported_with_the_remedy() -> None:
    bench = rested()
    rules = changed(bench.loop.state.rules, oversampling=16)
    state = awaiting(
        changed(bench.loop.state, rules=rules), RequestKind.CONFIGURE, ARM, ts_us=10_000
    )

    decided = heard(bench, _reply(state, code=int(Code.UNSUPPORTED)), state)

    (answer,) = decided.told(Answer)
    assert answer.error == (
        "the device refuses the configuration: UNSUPPORTED; it may not permit [device] "
        "oversampling = 16, or not at Ts=0.01 s: lower the oversampling, or sample slower"
    )


@pytest.mark.parametrize("order", [Reset(order=5), ARM])
def test_an_accepted_configuration_is_in_force_from_then_on(order: pipe.Arm | Reset) -> None:
    """ARM carries its CRC and nonce; the pace is that of the new Ts.

    S4: the answer does not name its CONFIG, so it proves no round trip.
    """
    bench = rested()
    latched = changed(armed().loop.state, phase=Phase.FAULT, fault=Fault(Id.LEASE, "ran out"))
    state = awaiting(latched, RequestKind.CONFIGURE, order, ts_us=20_000, sent_ns=55)
    reply = _reply(state)

    decided = heard(bench, reply, state)

    after = decided.state
    assert (after.configuration.config_crc, after.configuration.nonce, after.ts_us) == (
        reply.config_crc,
        77,
        20_000,
    )
    assert after.link.last_round_trip_ns == (
        55 if isinstance(order, Reset) else latched.link.last_round_trip_ns
    )
    assert after.tick_ns == bench.ports.now
    assert decided.of(SetPeriod) == [SetPeriod(20_000, state.k + 1)]
    if isinstance(order, Reset):
        assert (after.phase, after.asked, decided.sent) == (Phase.SAFE, None, [])
        assert (after.fault, after.lease) == (None, None)
    else:
        (arm,) = decided.sent
        assert isinstance(arm, wire.Arm)
        assert (arm.config_crc, arm.nonce) == (reply.config_crc, 77)
        assert arm.boot_id == state.clock.boot_id


def test_scheduled_configuration_sets_the_host_period_to_10_ms() -> None:
    """The device paces; the daemon looks after it each 10 ms."""
    bench = armed()
    bench.loop.state = changed(bench.loop.state, ts_us=5_000, pace_us=5_000)
    scheduled = changed(RUN, scheduled=True)
    state = awaiting(
        bench.loop.state, RequestKind.CONFIGURE, scheduled, ts_us=5_000, scheduled=True
    )
    reply = _reply(state)
    assert reply.mode == Mode.SCHEDULED

    decided = heard(bench, reply, state)

    assert decided.state.scheduled
    assert decided.of(SetPeriod) == [SetPeriod(10_000, state.k + 1)]


def test_equal_period_is_not_set_again() -> None:
    bench = rested()
    state = awaiting(bench.loop.state, RequestKind.CONFIGURE, ts_us=10_000)

    assert heard(bench, _reply(state), state).of(SetPeriod) == []


def test_unrequested_config_reply_is_ignored() -> None:
    bench = rested()
    reply = _reply(awaiting(bench.loop.state, RequestKind.CONFIGURE, ts_us=20_000))

    for state in (bench.loop.state, awaiting(bench.loop.state, RequestKind.STOP)):
        decided = heard(bench, reply, state)
        assert (decided.actions, decided.state) == ([], state)


def test_a_late_answer_to_an_earlier_configuration_ends_no_run() -> None:
    bench = rested()
    state = changed(bench.loop.state, phase=Phase.ARMED)
    late = _reply(awaiting(state, RequestKind.CONFIGURE, ts_us=20_000))
    waiting = awaiting(state, RequestKind.CONFIGURE, ARM, ts_us=10_000, tries=4)

    passed_over = heard(bench, late, waiting)
    armed = heard(bench, _reply(waiting), passed_over.state)
    given_up = heard(
        bench, late, awaiting(state, RequestKind.CONFIGURE, ARM, ts_us=10_000, tries=5)
    )

    assert (passed_over.actions, passed_over.state) == ([], waiting)
    assert isinstance(armed.sent[0], wire.Arm)
    assert given_up.state.phase is Phase.FAULT


def test_an_arm_with_a_newer_nonce_is_tried_five_times() -> None:
    bench = rested()
    again = _reply(
        awaiting(bench.loop.state, RequestKind.CONFIGURE, ts_us=bench.loop.state.ts_us)
    )._replace(config_crc=bench.loop.state.configuration.config_crc)
    arming = awaiting(bench.loop.state, RequestKind.ARM, ARM, tries=4)

    fifth = heard(bench, again, arming)
    sixth = heard(bench, again, awaiting(bench.loop.state, RequestKind.ARM, ARM, tries=5))

    (arm,) = fifth.sent
    assert isinstance(arm, wire.Arm)
    assert arm.nonce == again.nonce
    assert (fifth.state.asked.tries, fifth.state.asked.order) == (5, ARM)
    assert sixth.actions == []


@pytest.mark.parametrize("change", [{"code": 1}, {"config_crc": 1}, {"nonce": None}])
def test_an_arm_ignores_the_reply_to_another_configuration(change: dict[str, int | None]) -> None:
    bench = rested()
    state = bench.loop.state
    own = _reply(awaiting(state, RequestKind.CONFIGURE, ts_us=state.ts_us))
    own = own._replace(config_crc=state.configuration.config_crc)
    same = {
        name: state.configuration.nonce if value is None else value
        for name, value in change.items()
    }

    decided = heard(bench, own._replace(**same), awaiting(state, RequestKind.ARM, ARM))

    assert decided.sent == []


# -- arming --------------------------------------------------------------------------------------


def test_a_sampling_time_that_the_device_cannot_convert_is_refused() -> None:
    bench = rested()
    device = bench.loop.state.device
    slow = changed(bench.loop.state, device=device._replace(ts_min_us=15_000))

    (refusal,) = ordered(bench, changed(ARM, ts_us=14_999), slow).told(Answer)
    allowed = ordered(bench, changed(ARM, ts_us=15_000), slow)

    assert refusal.error == "Ts=0.014999 s is too short for the device: at least 0.015 s"
    assert [type(m) for m in allowed.sent] == [wire.Config]


def test_a_sampling_time_that_holds_no_oversampled_reading_is_refused() -> None:
    bench = rested()
    state, device = bench.loop.state, bench.loop.state.device
    rules = changed(state.rules, oversampling=4)
    slow = changed(state, rules=rules, device=device._replace(ts_min_us=15_000))

    (refusal,) = ordered(bench, changed(ARM, ts_us=15_623), slow).told(Answer)
    allowed = ordered(bench, changed(ARM, ts_us=15_624), slow)
    (unpaced,) = ordered(bench, changed(ARM, ts_us=831), changed(state, rules=rules)).told(Answer)
    (by_host,) = ordered(bench, changed(ARM, ts_us=1871), changed(state, rules=rules)).sent

    assert refusal.error == "Ts=0.015623 s is too short for the device: at least 0.015624 s"
    assert [type(m) for m in allowed.sent] == [wire.Config]
    assert "scheduled mode with [device] oversampling = 4: at least 0.000832 s" in unpaced.error
    assert by_host.ts_us == rules.ts_us  # until the run, exchange mode: 1872 us


def test_the_owner_is_granted_the_limits() -> None:
    bench = rested()

    body = bench.arm(40_000).body

    assert body == {"lease": LEASE, "period_s": 0.2, "Ts": 0.04, "u_min": 0.0, "u_max": 5.0}
    assert (bench.loop.state.lease.n, bench.loop.state.lease.owner) == (-1, "a student")
    assert isinstance(bench.loop.state.device, wire.HelloReply)


def test_the_owner_is_granted_the_rest_of_a_rig_that_rests_at_half_scale() -> None:
    bench = rested()
    bench.loop.state = changed(
        bench.loop.state, rules=replace(bench.loop.state.rules, rest_code=HALF)
    )

    assert bench.arm().body["rest_v"] == 2.5


def test_nothing_is_armed_without_a_device() -> None:
    bench = rested()
    state = changed(bench.loop.state, device=None)

    after, (said,) = orders.begin_arming(state, ARM)

    assert after == state
    assert said.record.error == NO_DEVICE
