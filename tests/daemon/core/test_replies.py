"""What a device says, and what the core makes of it."""

from __future__ import annotations

import pytest
from armrig_core.telemetry import Sample
from armrig_core.volts import code_of
from armrig_daemon.core import sampling, setpoints
from armrig_daemon.core.clockmap import ClockMap
from armrig_daemon.core.faults import Fault, Id
from armrig_daemon.core.state import (
    Beat,
    Exit,
    LinkDown,
    Phase,
    Publish,
    RoundTrip,
    Sent,
    State,
    Want,
)
from armrig_daemon.core.state import Heard as HeardFrame
from armrig_daemon.pipe import Gap, Log, Play, RunEnded
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol.messages import (
    TYPES,
    Ack,
    Arm,
    Cause,
    Code,
    Event,
    Flag,
    Hello,
    Keepalive,
    Pong,
    Start,
    Status,
    Stop,
)
from armrig_protocol.messages import State as DeviceState
from core_states import (
    PLAY,
    Decided,
    armed,
    awaiting,
    device_sample,
    driven,
    heard,
    rested,
)
from msgspec.structs import replace
from virtual_bench import LEASE, MS, Bench, codes


def _event(state: State, **fields: int) -> Event:
    """Return an EVENT of the device that is met, into the state that it is in."""
    assert state.device is not None
    zero = Event._make([0] * len(Event._fields))
    known = {"state": state.device_state, "boot": state.device.boot_id & 0xFFFF}
    return zero._replace(**{**known, **fields})


# -- round trips ---------------------------------------------------------------------------------


def _pong(state: State, **fields: int) -> Pong:
    known = {"state": state.device_state, "seq": 0, "host_ns": state.ping_ns}
    return Pong(**{**known, "rx_us": 100, "tx_us": 150, **fields})


def test_an_ack_of_the_very_request_proves_a_round_trip() -> None:
    """S4: one of another frame, or a refusal, does not; nor does it make younger what was older."""
    bench = rested()
    now = bench.ports.now
    fresh = replace(bench.loop.state, fresh_ns=now - 40 * MS)
    state = awaiting(fresh, Want.ARM, sent_ns=now - 3 * MS)
    assert state.asked is not None
    seq = state.asked.seq
    ack = Ack(int(DeviceState.READY), 0, TYPES[Arm], int(Code.OK), seq)

    assert heard(bench, ack, state).state.fresh_ns == now - 3 * MS
    younger = replace(state, fresh_ns=now - 1 * MS)
    assert heard(bench, ack, younger).state.fresh_ns == now - 1 * MS
    for other in (
        ack._replace(of_seq=seq + 1),
        ack._replace(of_type=TYPES[Stop]),
        ack._replace(code=int(Code.STALE)),
    ):
        assert heard(bench, other, state).state.fresh_ns == now - 40 * MS


def test_the_answer_to_the_newest_ping_proves_a_round_trip() -> None:
    """S4: as old as the question is; it never makes younger what was proved before."""
    bench = rested()
    now = bench.ports.now
    state = replace(bench.loop.state, ping_ns=now - 7 * MS, fresh_ns=now - 40 * MS)

    younger = heard(bench, _pong(state), state)
    older = heard(bench, _pong(state), replace(state, fresh_ns=now - 1 * MS))

    assert younger.of(RoundTrip) == [RoundTrip(7 * MS)]
    assert younger.state.fresh_ns == now - 7 * MS
    assert younger.state.compared_ns == now
    assert older.state.fresh_ns == now - 1 * MS


def test_an_answer_to_an_older_ping_says_nothing_of_now() -> None:
    """S4: a burst after a pause must not count as fresh."""
    bench = rested()
    state = replace(bench.loop.state, ping_ns=bench.ports.now - 7 * MS)

    decided = heard(bench, _pong(state, host_ns=state.ping_ns - 1), state)

    assert decided.actions == []
    assert decided.state == state


def test_a_message_that_needs_no_answer_has_none() -> None:
    """STATUS is for a person."""
    bench = rested()
    decided = heard(bench, Status._make([int(DeviceState.READY)] + [0] * 13))

    assert decided.actions == []


# -- a reset of the device -----------------------------------------------------------------------


@pytest.mark.parametrize("by", ["event", "sample"])
def test_a_device_that_starts_anew_at_rest_is_met_again(by: str) -> None:
    """T1: no fault, for nothing turned; a sample tells it where the EVENT was lost."""
    bench = rested()
    state = bench.loop.state
    assert state.device is not None
    boot = (state.device.boot_id + 1) & 0xFFFF
    news = _event(state, boot=boot) if by == "event" else device_sample(state, boot=boot)

    decided = heard(bench, news)

    assert (decided.state.phase, decided.state.device) == (Phase.INIT, None)
    assert decided.state.sent == ()
    assert decided.state.device_state == 0
    assert [type(m) for m in decided.sent] == [Hello]
    assert [log.message for log in decided.told(Log)] == ["the device was reset"]
    assert [s.phase for s in decided.told(StateRecord)] == ["init"]


@pytest.mark.parametrize("by", ["event", "sample"])
def test_a_device_that_starts_anew_while_it_drives_is_a_fault(by: str) -> None:
    """S6: it knows nothing of us, and so do not we of it."""
    bench = driven()
    state = bench.loop.state
    assert state.device is not None
    boot = (state.device.boot_id + 1) & 0xFFFF
    news = _event(state, boot=boot) if by == "event" else device_sample(state, boot=boot)

    decided = heard(bench, news)

    assert decided.state.fault == Fault(Id.RESET, "the device was reset")
    assert decided.state.device is None
    assert decided.state.asked is not None
    assert decided.state.asked.want is Want.HELLO


def test_a_reset_of_the_device_leaves_a_latched_fault_as_it_is() -> None:
    """The first cause is the one that is told."""
    bench = rested()
    state = replace(bench.loop.state, phase=Phase.FAULT, fault=Fault(Id.LEASE, "ran out"))
    assert state.device is not None

    decided = heard(bench, _event(state, boot=(state.device.boot_id + 1) & 0xFFFF), state)

    assert decided.state.fault == Fault(Id.LEASE, "ran out")
    assert decided.state.phase is Phase.FAULT
    assert decided.told(Log) == []


# -- events --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cause", "detail", "words"),
    [
        (int(Cause.WATCHDOG), 0, "WATCHDOG"),
        (int(Cause.RANGE), 123, "RANGE, code 123"),
        (250, 0, "250"),
    ],
)
def test_a_device_that_latches_is_told_with_its_own_cause(
    cause: int, detail: int, words: str
) -> None:
    """S6: by its name where it has one, and the code that it refused."""
    bench = driven()
    event = _event(bench.loop.state, cause=cause, detail=detail, token=7)
    event = event._replace(state=int(DeviceState.FAULT))

    decided = heard(bench, event)

    assert decided.state.fault == Fault(Id.DEVICE, f"the device stopped by itself: {words}")
    assert decided.state.token == 7
    assert decided.state.device_state == DeviceState.FAULT


def test_a_device_that_latches_after_our_own_trip_gives_its_token_only() -> None:
    """A reset needs it; the cause is known already."""
    bench = rested()
    state = replace(bench.loop.state, phase=Phase.FAULT, fault=Fault(Id.LEASE, "ran out"))
    event = _event(state, token=7)._replace(state=int(DeviceState.FAULT))

    decided = heard(bench, event, state)

    assert decided.state.fault == Fault(Id.LEASE, "ran out")
    assert decided.state.token == 7


# -- samples -------------------------------------------------------------------------------------


def _lost(bench: Bench, ms: float = 21) -> State:
    """Return the state after two exchanges that nothing answered."""
    bench.ports.from_device = lambda data: b""
    bench.run_for(ms)
    assert len(bench.loop.state.sent) == 2
    return bench.loop.state


def _sent() -> Sent:
    return Sent(1, 2, 3, 4, 5)


def _published(decided: Decided) -> list[Sample]:
    return [a.sample for a in decided.of(Publish)]


def test_a_sample_answers_its_own_exchange_and_gives_up_those_before() -> None:
    """L2: the first is a gap, with the voltage that was commanded."""
    bench = driven()
    first, second = _lost(bench).sent
    held, t_us = code_of(1.0), bench.loop.state.t_us + 5
    sample = device_sample(
        bench.loop.state, k=second.k, u_k=held, u_km1=held, flags=int(Flag.RUN), t_us=t_us
    )

    decided = heard(bench, sample)

    (gap,) = decided.told(Gap)
    assert (gap.k_first, gap.count, gap.reason) == (first.k, 1, "a frame was lost")
    assert (gap.t_from_ns, gap.t_to_ns) == (first.sent_ns, bench.ports.now)
    (published,) = _published(decided)
    assert (published.k, published.t_sched_ns, published.t_host_ns) == second[1:4]
    assert decided.of(RoundTrip) == [RoundTrip(bench.ports.now - second.sent_ns)]
    after = decided.state
    assert (after.sent, after.fresh_ns, after.told) == ((), second.sent_ns, second.k)
    assert (after.applied, after.t_us) == (held, t_us)


@pytest.mark.parametrize("known", [True, False])
def test_a_sample_of_before_is_none_though_its_k_is_awaited(known: bool) -> None:
    """S5: the k began anew, and an old sample is played again; of a new link any stamp is new."""
    bench = driven()
    state = _lost(bench)
    state = state if known else replace(state, sampled_ns=0)
    sample = device_sample(state, k=state.sent[0].k, t_us=(state.t_us - 1) & 0xFFFFFFFF)

    decided = heard(bench, sample, state)

    assert len(_published(decided)) == (not known)


def test_a_sample_of_no_exchange_of_ours_is_none() -> None:
    """An old burst, or the echo of another host: nothing is published, nothing proved."""
    bench = rested()
    state = _lost(bench)

    decided = heard(bench, device_sample(state, k=state.sent[-1].k + 1))

    assert decided.actions == []
    assert decided.state == replace(state, pending=decided.state.pending)


def test_a_sample_that_has_heard_what_we_have_not_sent_is_none() -> None:
    """S4: an old EXCHANGE that was played again asked for it, under the k of ours on its way."""
    bench = rested()
    state, now = bench.loop.state, bench.ports.now
    ours = Sent(state.seq - 1, state.told + 1, now, now, 0)
    state = replace(state, sent=(ours,), fresh_ns=now - 40 * MS)
    sample = device_sample(state, k=ours.k, echo=ours.seq)

    assert heard(bench, sample, state).state.fresh_ns == now
    old = heard(bench, sample._replace(echo=state.seq + 3), state)
    assert old.state.fresh_ns == now - 40 * MS
    assert old.state.sent == (ours,)
    assert old.of(Publish) == []


def test_a_sample_of_a_device_that_is_not_met_is_none() -> None:
    """S4: it proves nothing of whoever will be met next."""
    bench = rested()
    state = _lost(bench)
    sample = device_sample(state, k=state.sent[0].k)
    unmet = replace(state, device=None)

    decided = heard(bench, sample, unmet)

    assert decided.actions == []
    assert decided.state == replace(unmet, pending=decided.state.pending)


@pytest.mark.parametrize(("u_k", "trips"), [(0, False), (1, True)])
def test_at_rest_the_device_applies_nothing(u_k: int, trips: bool) -> None:
    """S5: outside RUN 0 is what is expected, whatever the code of the exchange was."""
    bench = rested()
    state = _lost(bench)

    decided = heard(bench, device_sample(state, k=state.sent[0].k, u_k=u_k))

    assert (decided.state.fault is not None) == trips
    if decided.state.fault is not None:
        assert decided.state.fault.id is Id.APPLIED


def test_the_duty_of_the_device_is_what_it_is_compared_with() -> None:
    """S5: 10 bits of duty round the code; the code itself would be another."""
    bench = driven()
    state = _lost(bench)
    held = state.sent[0].code
    assert state.device is not None
    coarse = replace(state, device=state.device._replace(pwm_bits=10))

    as_sent = heard(
        bench, device_sample(state, k=state.sent[0].k, u_k=held, flags=int(Flag.RUN)), coarse
    )

    assert as_sent.state.fault is not None
    assert f"applied code {held} where {held} was commanded" in as_sent.state.fault.cause


def test_what_is_applied_after_a_trip_is_no_second_fault() -> None:
    """The motor is on its way to 0 V already."""
    bench = rested()
    state = replace(_lost(bench), phase=Phase.FAULT, fault=Fault(Id.LEASE, "ran out"))

    decided = heard(bench, device_sample(state, k=state.sent[0].k, u_k=9), state)

    assert decided.state.fault == Fault(Id.LEASE, "ran out")


# -- scheduled runs ------------------------------------------------------------------------------


def _playing(ms: float = 400) -> Bench:
    bench = Bench()
    assert not bench.take(5_000).error
    run = codes(*[2.0] * 400)
    bench.order(Play(order=9, lease=LEASE, n=0, run_id="r", codes=run, scheduled=True))
    bench.run_for(ms)
    assert bench.loop.state.device_state == DeviceState.RUN
    return bench


def _due(bench: Bench, state: State, ahead: int = 0, **fields: int) -> Decided:
    """Return what follows from the sample that is due next, or one `ahead` of it."""
    assert state.run is not None
    u = state.run.code(0)
    known = {"k": state.run.due + ahead, "flags": int(Flag.RUN), "u_km1": u, "echo": state.seq}
    return heard(bench, device_sample(state, **{**known, **fields}), state)


def test_without_a_map_of_the_clocks_a_sample_was_due_by_the_time_of_the_start() -> None:
    """t_zero + i Ts: until eight exchanges have told more."""
    bench = _playing()
    state = replace(bench.loop.state, clock=ClockMap())
    run = state.run
    assert run is not None

    (sample,) = _published(_due(bench, state))

    assert sample.t_sched_ns == run.t_zero_ns + run.due * 5_000_000
    assert sample.k == run.k_first + run.due


@pytest.mark.parametrize("known", [7, 8])
def test_eight_exchanges_make_a_map(known: int) -> None:
    """One fewer, and the start's own time is better."""
    bench = _playing()
    state = bench.loop.state
    trips = state.clock.round_trips
    few = replace(state, clock=state.clock._replace(round_trips=trips[:1] * known))
    run = state.run
    assert run is not None

    (sample,) = _published(_due(bench, few, t_us=state.t_us + 5_000 & 0xFFFFFFFF))

    assert (sample.t_sched_ns == run.t_zero_ns + run.due * 5_000_000) == (known < 8)


@pytest.mark.parametrize(
    ("flags", "u", "trips"),
    [
        (Flag.RUN, 0, True),
        (Flag.RUN | Flag.UNDERRUN, 0, False),
    ],
)
def test_another_code_than_the_run_s_is_a_fault_but_for_an_underrun(
    flags: Flag, u: int, trips: bool
) -> None:
    """S5: where no setpoint was there the device says so, and the policy's code is told."""
    bench = _playing()
    decided = _due(bench, bench.loop.state, flags=int(flags), u_k=u)

    assert (decided.state.fault is not None) == trips
    if trips:
        assert decided.state.fault is not None
        assert decided.state.fault.id is Id.APPLIED
    else:
        assert "no setpoint was there" in decided.told(Log)[0].message


def test_a_sample_that_is_ahead_tells_of_those_before_it() -> None:
    """L2: each with the voltage of its own setpoint."""
    bench = _playing()
    run = bench.loop.state.run
    assert run is not None

    decided = _due(bench, bench.loop.state, ahead=3)

    gaps = decided.told(Gap)
    first = run.k_first + run.due
    assert [(g.k_first, g.count) for g in gaps] == [(first + i, 1) for i in range(3)]
    assert all(g.u_held_v == pytest.approx(2.0, abs=0.003) for g in gaps)
    assert decided.state.run is not None
    assert decided.state.run.due == run.due + 4


@pytest.mark.parametrize("ahead", [-1, 1000])
def test_a_sample_twice_or_behind_the_end_is_none(ahead: int) -> None:
    """It has been published, or belongs to no run of ours."""
    bench = _playing()

    assert _published(_due(bench, bench.loop.state, ahead=ahead)) == []


def test_only_what_the_device_has_heard_proves_a_round_trip() -> None:
    """S4: the age is that of the newest frame whose echo has come."""
    bench = _playing()
    state = bench.loop.state
    older, newer = HeardFrame(0xFFFF, 11), HeardFrame(0, 22)
    waiting = replace(state, beats=(older, newer), fresh_ns=5)

    assert sampling.note_echo(waiting, 0xFFFE) == waiting
    half_a_round_away = replace(waiting, beats=(older,))
    assert sampling.note_echo(half_a_round_away, 0x7FFF) == half_a_round_away
    assert sampling.note_echo(waiting, 0xFFFF) == replace(waiting, beats=(newer,), fresh_ns=11)
    assert sampling.note_echo(waiting, 0) == replace(waiting, beats=(), fresh_ns=22)


def test_a_run_that_is_over_already_is_not_completed_again() -> None:
    """Whoever says so."""
    bench = rested()

    assert setpoints.complete(bench.loop.state, bench.ports.now) == (bench.loop.state, [])


def test_a_queue_without_a_device_starts_nothing() -> None:
    """It is gone: what it held says nothing any more."""
    bench = armed()
    now = bench.ports.now
    filling, _ = setpoints.begin(bench.loop.state, now, replace(PLAY, scheduled=True))

    gone, actions = setpoints.note_queue(replace(filling, device=None), now, 0, 2)
    there, (start,) = setpoints.note_queue(filling, now, 0, 2)

    assert (gone.asked, actions) == (None, [])
    assert there.asked is not None
    assert there.asked.want is Want.START
    assert isinstance(start.data, bytes)


def test_a_start_carries_the_length_of_the_run() -> None:
    """The device ends by itself, whatever becomes of us."""
    bench = armed()
    now = bench.ports.now
    filling, _ = setpoints.begin(bench.loop.state, now, replace(PLAY, scheduled=True))

    started, _ = setpoints.note_queue(filling, now, 0, 2)

    assert started.asked is not None
    (start,) = Decided(started, now + 50 * MS, Beat()).sent
    assert isinstance(start, Start)
    assert start.k_stop == 2


# -- the link ------------------------------------------------------------------------------------


def test_a_link_that_goes_while_the_daemon_ends_does_not_hold_it_up() -> None:
    """No STOP will be confirmed any more."""
    bench = driven()
    state = replace(bench.loop.state, quitting=True)

    decided = Decided(state, bench.ports.now, LinkDown("unplugged"))

    assert decided.actions == [Exit()]
    assert not decided.state.link_up


@pytest.mark.parametrize("phase", [Phase.SAFE, Phase.INIT, Phase.FAULT])
def test_a_link_that_goes_at_rest_is_no_fault(phase: Phase) -> None:
    """S6: what was latched stays so, the rest begins anew."""
    bench = rested()
    state = replace(bench.loop.state, phase=phase, pending=b"half a fra", sent=(_sent(),))

    decided = Decided(state, bench.ports.now, LinkDown("unplugged"))

    after = decided.state
    assert after.phase is (Phase.FAULT if phase is Phase.FAULT else Phase.INIT)
    assert (after.device, after.asked, after.sent, after.pending) == (None, None, (), b"")
    assert after.fault is None
    assert [log.message for log in decided.told(Log)] == ["no link: unplugged"]
    assert decided.told(RunEnded) == []


def test_nothing_keeps_a_motor_on_that_is_to_stop() -> None:
    """S4: no KEEPALIVE while it still drives; one at rest, for whoever listens there."""
    bench = driven()
    latched = replace(bench.loop.state, phase=Phase.FAULT)
    at_rest = replace(latched, device_state=int(DeviceState.IDLE))
    now = bench.ports.now

    silent = Decided(latched, now, Beat())
    assert silent.sent == []
    assert silent.state == replace(latched, any_ns=now)
    assert [type(m) for m in Decided(at_rest, now, Beat()).sent] == [Keepalive]
    assert Decided(replace(at_rest, link_up=False), now, Beat()).sent == []


def test_a_stop_is_a_stop_in_every_phase() -> None:
    """What is awaited decides, not the phase: no KEEPALIVE behind a STOP on its way."""
    bench = driven()
    state = awaiting(bench.loop.state, Want.STOP, sent_ns=bench.ports.now)

    again = Decided(state, bench.ports.now + 20 * MS, Beat())

    assert [type(m) for m in again.sent] == [Stop]
