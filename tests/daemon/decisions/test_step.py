"""The core's own decisions: ticks, beats and ends, from states built for each."""

from __future__ import annotations

import sys
from collections import Counter
from functools import reduce
from operator import or_
from pathlib import Path
from types import FrameType

import msgspec
import pytest
from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_core.rig.volts import code_of
from armrig_daemon.config import Config
from armrig_daemon.decisions import gaps, trace
from armrig_daemon.decisions import step as core_step
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import motor
from armrig_daemon.decisions.state import (
    ActiveRun,
    DecisionState,
    Emit,
    LinkDown,
    LinkState,
    LinkUp,
    Phase,
    Queue,
    Received,
    RequestKind,
    Sent,
    SetPeriod,
    Tick,
    Unechoed,
)
from armrig_daemon.pipe import Answer, Gap, Log, RunEnded, RunStarted
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol.frame import encode
from armrig_protocol.messages import MAX_UNECHOED, Exchange, Hello, Stop
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import RUN, Decided, armed, awaiting, changed, driven, rested
from tests.daemon.virtual_bench import MS, Bench, codes

TS = 10 * MS


def _tick(state: DecisionState, now_ns: int, ahead: int = 1) -> Decided:
    return Decided(state, now_ns, Tick(state.k + ahead, now_ns - 5))


def _code(decided: Decided) -> int:
    (found,) = [m for m in decided.sent if isinstance(m, Exchange)]
    return found.u


def test_initial_state_of_the_core_knows_no_device() -> None:
    rules = rested().loop.state.rules

    state = core_step.start(rules)

    assert (state.rules, state.ts_us, state.pace_us) == (rules, rules.ts_us, rules.ts_us)
    known = {"rules", "pace_us", "phase"}
    unknown = {f: getattr(state, f) for f in state.__struct_fields__ if f not in known}
    assert {f for f, value in unknown.items() if value} == {"k", "last_reported_k"}
    assert (state.k, state.last_reported_k, state.phase) == (-1, -1, Phase.INIT)


# -- when it wants to be woken -------------------------------------------------------------------


def test_wake_time_is_the_retry_of_the_request_or_a_third_of_the_watchdog() -> None:
    """A third of the watchdog after the last frame, so that two may be lost."""
    state = changed(rested().loop.state, last_send_ns=1000)

    assert core_step.wake_ns(state) == 1000 + 100 * MS // 3
    assert core_step.wake_ns(awaiting(state, RequestKind.STOP, sent_ns=7)) == 7 + 20 * MS


def test_first_tick_reports_no_missed_tick() -> None:
    state = core_step.start(rested().loop.state.rules)

    first = Decided(state, 10_000 * MS, Tick(7, 9_999 * MS)).state

    assert (first.k, first.tick_ns, first.absent) == (7, 10_000 * MS, ())


def test_noise_between_frames_is_reported_and_loses_no_frame() -> None:
    bench = rested()
    reply = bench.loop.state.device
    data = b"noise\0" + encode(reply._replace(state=int(DeviceState.IDLE)))

    decided = Decided(
        awaiting(bench.loop.state, RequestKind.HELLO), bench.ports.now, Received(data)
    )

    assert [log.level for log in decided.told(Log)] == ["debug"]
    assert len(decided.sent) == 1


def test_a_restored_link_starts_with_a_hello() -> None:
    bench = driven()
    old = changed(bench.loop.state, pending=b"abc", seq=77, last_round_trip_ns=5)

    decided = Decided(old, bench.ports.now, LinkUp())

    (hello,) = decided.sent
    assert isinstance(hello, Hello)
    after = decided.state
    assert hello.seq == 0
    assert after.link == LinkState(seq=1, last_send_ns=bench.ports.now)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "driven"),
        ({"device_state": int(DeviceState.READY)}, "at 0 V, as the device reports"),
        ({"fault": Fault(Id.STALE, "no answer")}, "stop sent, but not confirmed; its watchdog"),
        ({"link": None}, "not known: the device does not answer; its watchdog stops it"),
        ({"device": None}, "not known: the device does not answer; its watchdog stops it"),
    ],
)
def test_state_of_the_motor_in_words(change: dict[str, object], words: str) -> None:
    state = driven().loop.state

    assert motor(changed(state, **change)).startswith(words)
    if not change:
        assert motor(awaiting(state, RequestKind.STOP)) == "stop sent, not confirmed yet"
        assert motor(awaiting(state, RequestKind.START)) == "driven"


def test_a_port_that_cannot_be_opened_is_reported_in_each_refusal() -> None:
    state = core_step.start(Config().rules())

    decided = Decided(state, 0, LinkDown("/dev/ttyACM0 cannot be opened: it is not there"))

    [said] = decided.told(StateRecord)
    assert said.phase == "init"
    assert said.line.startswith("no rig is connected, and the daemon waits for one")
    [log] = decided.told(Log)
    assert (log.level, log.message) == (
        "warning",
        "no link: /dev/ttyACM0 cannot be opened: it is not there",
    )
    assert decided.sent == []


# -- a tick --------------------------------------------------------------------------------------


def test_a_tick_sends_one_exchange_and_stores_it() -> None:
    bench = driven()
    state, now = bench.loop.state, bench.ports.now + TS

    decided = _tick(state, now)

    (frame,) = decided.sent
    assert isinstance(frame, Exchange)
    assert (frame.k, frame.u, frame.seq) == (state.k + 1, code_of(1.0), state.link.seq)
    answered = state.link.device_seq
    kept = Sent(state.link.seq, state.k + 1, now - 5, now, code_of(1.0), answered)
    assert decided.state.link.sent == (*state.link.sent, kept)
    assert (decided.state.k, decided.state.tick_ns) == (state.k + 1, now)


def test_k_wraps_on_the_wire_and_nowhere_else() -> None:
    bench = rested()
    state = changed(bench.loop.state, k=(1 << 32) + 4, last_reported_k=(1 << 32) + 4)

    decided = _tick(state, bench.ports.now + TS)

    assert [m.k for m in decided.sent if isinstance(m, Exchange)] == [5]
    assert decided.state.link.sent[-1].k == (1 << 32) + 5


def test_a_tick_without_a_device_sends_no_frame() -> None:
    """T1: only the HELLO is sent when it is due."""
    state = rested().loop.state
    nobody = changed(state, device=None)
    asked = awaiting(nobody, RequestKind.HELLO, sent_ns=state.tick_ns)
    for gone in (changed(state, link=None), asked):
        decided = _tick(gone, state.tick_ns + TS)
        assert decided.actions == []
        assert decided.state.k == state.k + 1
    for gone, now_ns in ((nobody, state.tick_ns + TS), (asked, state.tick_ns + 100 * MS)):
        decided = _tick(gone, now_ns)
        assert [type(m) for m in decided.sent] == [Hello]
        assert decided.state.asked is not None


@pytest.mark.parametrize("ahead", [1, 2, 4])
def test_skipped_ticks_are_stored_with_their_number(ahead: int) -> None:
    """L2: they are reported before the next sample, with the reason."""
    bench = rested()
    state, now = bench.loop.state, bench.ports.now + ahead * TS

    absent = _tick(state, now, ahead).state.absent

    if ahead == 1:
        assert absent == ()
    else:
        expected = gaps.missing(state.k + 1, ahead - 1, GapCode.HOST_LATE, None, state.tick_ns, now)
        assert absent == (expected,)


@pytest.mark.parametrize(("waiting", "sends"), [(MAX_UNECHOED - 1, 1), (MAX_UNECHOED, 0)])
def test_the_number_of_unanswered_exchanges_is_bounded(waiting: int, sends: int) -> None:
    """S4: the next one is a gap of one sample."""
    bench = rested()
    state = bench.loop.state
    sent = tuple(Sent(0, state.k - i, 0, 0, 0) for i in range(waiting))

    decided = _tick(changed(state, sent=sent), bench.ports.now + TS)

    assert len(decided.sent) == sends
    reasons = [(a.k, a.n, a.reason_code) for a in decided.state.absent]
    assert reasons == ([] if sends else [(state.k + 1, 1, GapCode.DEVICE_LATE)])


@pytest.mark.parametrize(("late_ns", "fault"), [(50 * MS, None), (50 * MS + 1, Id.PAUSE)])
def test_pause_above_its_limit_is_a_fault(late_ns: int, fault: Id | None) -> None:
    """S4: 50 ms at Ts 10 ms, counted from the last tick."""
    bench = driven()
    state = changed(bench.loop.state, last_round_trip_ns=bench.ports.now + late_ns)

    decided = _tick(state, state.tick_ns + late_ns)

    assert (decided.state.fault.id if decided.state.fault else None) == fault
    if fault is not None:
        assert decided.state.reason == "the host paused for 50 ms"


@pytest.mark.parametrize(
    ("ts_us", "age_ms", "pause_ms", "lease_ms"),
    [
        (10_000, 50, 50, 100),
        (16_666, 50, 83.33, 100),
        (20_000, 60, 100, 100),
        (50_000, 150, 250, 250),
    ],
)
def test_the_limits_grow_with_the_sampling_time(
    ts_us: int, age_ms: float, pause_ms: float, lease_ms: float
) -> None:
    """3, 5 and 5 Ts if those are longer; a device that paces itself has its watchdog's time."""
    rules = rested().loop.state.rules

    assert rules.age_ns(ts_us) == age_ms * MS
    assert rules.pause_ns(ts_us) == pause_ms * MS
    assert rules.lease_ns(ts_us) == lease_ms * MS
    assert rules.age_ns(ts_us, scheduled=True) == rules.pause_ns(ts_us, scheduled=True) == 100 * MS


@pytest.mark.parametrize(("age_ns", "stale"), [(50 * MS, False), (50 * MS + 1, True)])
def test_round_trip_above_its_limit_is_stale(age_ns: int, stale: bool) -> None:
    """S4: STOP in the same tick if the motor may turn; at rest the device gets a HELLO."""
    driving, resting = driven(), rested()
    now = driving.ports.now + TS
    trip = _tick(changed(driving.loop.state, last_round_trip_ns=now - age_ns, sent=()), now)
    now = resting.ports.now + TS
    waiting = changed(
        resting.loop.state, last_round_trip_ns=now - age_ns, sent=(Sent(0, 0, 0, 0, 0),)
    )
    ask = _tick(waiting, now)

    assert [type(m) for m in trip.sent] == [Stop if stale else Exchange]
    assert [type(m) for m in ask.sent] == [Hello if stale else Exchange]
    if stale:
        assert trip.state.fault.id is Id.STALE
        assert trip.state.reason == "no answer from the device for 50 ms"
        (log,) = ask.told(Log)
        assert log.message == "no answer from the device for 50 ms; sending HELLO"
        assert log.t_host_ns == now
        assert (ask.state.device, ask.state.phase, ask.state.link.sent) == (None, Phase.INIT, ())


def test_stale_device_gets_no_second_request() -> None:
    bench = rested()
    old = changed(bench.loop.state, last_round_trip_ns=bench.ports.now - 60 * MS)
    asking = awaiting(old, RequestKind.CONFIGURE)
    latched = changed(old, phase=Phase.FAULT)

    again = _tick(asking, bench.ports.now + TS)

    assert again.actions == []
    assert again.state.asked == asking.asked
    assert _tick(latched, bench.ports.now + TS).state.phase is Phase.FAULT


@pytest.mark.parametrize(("silent_ns", "trips"), [(3000 * MS, False), (3000 * MS + 1, True)])
def test_silence_of_the_service_above_its_limit_is_a_fault(silent_ns: int, trips: bool) -> None:
    bench = driven()
    now = bench.ports.now + TS
    rules = changed(bench.loop.state.rules, service_ns=3000 * MS)
    decided = _tick(changed(bench.loop.state, rules=rules, service_ns=now - silent_ns), now)

    assert (decided.state.fault is not None) == trips


@pytest.mark.parametrize(("allowed", "trips"), [(0, False), (2, True), (3, True), (4, False)])
def test_stop_after_missed_ticks_in_a_row(allowed: int, trips: bool) -> None:
    """Three in a row here; 0 disables the limit."""
    bench = driven()
    now = bench.ports.now + 4 * TS
    rules = changed(bench.loop.state.rules, stop_after=allowed)
    decided = _tick(changed(bench.loop.state, rules=rules, last_round_trip_ns=now), now, ahead=4)

    assert (decided.state.fault is not None) == trips
    if trips:
        assert decided.state.reason == f"3 ticks in a row were missed: {allowed} are allowed"


# -- the code ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("held_ns", "u"), [(100 * MS, code_of(1.0)), (100 * MS + 1, 0)])
def test_a_manual_voltage_is_held_as_long_as_its_lease(held_ns: int, u: int) -> None:
    """S2."""
    bench = driven()
    now = bench.ports.now + TS
    assert bench.loop.state.lease is not None
    lease = changed(bench.loop.state.lease, renewed_ns=now - held_ns)

    decided = _tick(changed(bench.loop.state, lease=lease), now)

    assert _code(decided) == u
    assert (decided.state.fault is not None) == (u == 0)


@pytest.mark.parametrize(("held_ns", "gives_back"), [(10_000 * MS, False), (10_000 * MS + 1, True)])
def test_an_unused_armed_rig_is_released_after_10_s(held_ns: int, gives_back: bool) -> None:
    bench = armed()
    now = bench.ports.now + TS
    assert bench.loop.state.lease is not None
    lease = changed(bench.loop.state.lease, renewed_ns=now - held_ns)

    decided = _tick(changed(bench.loop.state, lease=lease), now)

    assert _code(decided) == 0
    assert any(isinstance(m, Stop) for m in decided.sent) == gives_back
    assert len(decided.told(Log)) == gives_back


@pytest.mark.parametrize("phase", [Phase.SAFE, Phase.ARMED, Phase.FAULT])
def test_the_code_is_0_outside_the_active_phase(phase: Phase) -> None:
    """S5: whatever is left of the last command."""
    bench = driven()
    state = changed(bench.loop.state, phase=phase, device_state=int(DeviceState.READY))

    assert _code(_tick(state, bench.ports.now + TS)) == 0


def test_after_a_stop_and_without_a_lease_the_code_is_0() -> None:
    """S5."""
    bench = driven()
    now = bench.ports.now + TS

    assert _code(_tick(awaiting(bench.loop.state, RequestKind.STOP, sent_ns=now), now)) == 0
    assert _code(_tick(changed(bench.loop.state, lease=None), now)) == 0
    assert _code(_tick(awaiting(bench.loop.state, RequestKind.CLEAR, sent_ns=now), now)) == code_of(
        1.0
    )


# -- an experiment of the host -------------------------------------------------------------------


def _playing(
    volts: list[float], due: int, k_first: int | None = None
) -> tuple[Bench, DecisionState]:
    """Return a state in which `due` samples of a run have been requested."""
    bench = driven()
    state = bench.loop.state
    first = state.k + 1 - due if k_first is None else k_first
    run = ActiveRun("r", codes(*volts), first, due=due)
    return bench, changed(state, run=run, code=0, outcome="")


def test_the_first_sample_of_a_run_gives_it_its_k() -> None:
    bench, state = _playing([1.0, 2.0], 0, -1)
    now = bench.ports.now + TS

    decided = _tick(state, now)

    expected = RunStarted(run_id="r", k_first=state.k + 1, count=2, t_host_ns=now)
    assert decided.told(RunStarted) == [expected]
    assert _code(decided) == code_of(1.0)
    assert (decided.state.run.k_first, decided.state.run.due) == (state.k + 1, 1)


def test_a_run_that_has_begun_at_k_0_does_not_begin_again() -> None:
    bench, state = _playing([1.0, 2.0], 1, 0)
    state = changed(state, k=0, last_reported_k=0)
    scheduled = changed(state, run=changed(state.run, scheduled=True))
    resting = changed(scheduled, device_state=int(DeviceState.READY))

    assert _code(_tick(state, bench.ports.now + TS)) == code_of(2.0)
    assert _tick(state, bench.ports.now + TS).told(RunStarted) == []
    assert _tick(resting, bench.ports.now + TS).sent == []


@pytest.mark.parametrize(("due", "u"), [(0, 1.0), (1, 2.0), (2, 3.0)])
def test_each_tick_of_a_run_sends_the_u_of_its_k(due: int, u: float) -> None:
    """S5."""
    bench, state = _playing([1.0, 2.0, 3.0], due)

    decided = _tick(state, bench.ports.now + TS)

    assert _code(decided) == code_of(u)
    assert decided.state.run.due == due + 1
    assert decided.told(RunStarted) == []


def test_after_its_last_sample_a_run_is_complete() -> None:
    bench, state = _playing([1.0, 2.0, 3.0], 3)
    assert state.run is not None
    missed = changed(state, run=changed(state.run, due=1))

    for at in (state, missed):
        decided = _tick(at, bench.ports.now + TS)
        assert _code(decided) == 0
        assert any(isinstance(m, Stop) for m in decided.sent)
        assert (decided.state.outcome, decided.state.run.due) == ("complete", 3)
        assert decided.state.outcome_code is OutcomeCode.COMPLETE


def test_a_run_that_leaves_the_limits_is_stopped_at_0_v() -> None:
    """S1: by its slew from the sample before, which at its start is standstill."""
    for volts, due, trips in (([1.0, 2.1], 1, True), ([1.0, 2.0], 1, False), ([1.1], 0, True)):
        bench, state = _playing(volts, due)
        rules = changed(state.rules, slew=code_of(1.0) + 1)
        decided = _tick(changed(state, rules=rules), bench.ports.now + TS)

        assert (decided.state.fault is not None) == trips
        assert _code(decided) == (0 if trips else code_of(volts[due]))


def test_lost_samples_of_a_run_are_reported_before_its_end() -> None:
    """L2: those that were requested, and no later ones."""
    bench, state = _playing([1.0] * 5, 3)
    first = state.run.k_first
    waiting = tuple(Sent(i, first + i, 0, 100 + i, code_of(1.0)) for i in (1, 2, 3))
    told = changed(state, last_reported_k=first, sent=waiting, absent=())

    after, actions = gaps.end_run(told, 999)

    records = [a.record for a in actions]
    assert [(r.k_first, r.count, r.code) for r in records[:-1]] == [
        (first + 1, 1, GapCode.FRAME_LOST),
        (first + 2, 1, GapCode.FRAME_LOST),
    ]
    assert isinstance(records[-1], RunEnded)
    assert after.link.sent == waiting[2:]
    assert (after.last_reported_k, after.run, after.outcome) == (first + 2, None, "")
    assert bench.volts > 0


# -- gaps ----------------------------------------------------------------------------------------


def _told(
    state: DecisionState, end: int, u_before: int | None = None
) -> list[tuple[int, int, float]]:
    _, actions = gaps.report_missing(state, end, 777, u_before)
    told = [a.record for a in actions]
    assert all(isinstance(g, Gap) for g in told)
    return [(g.k_first, g.count, round(g.u_held_v, 3)) for g in told]


def test_gap_is_reported_in_pieces_of_constant_voltage() -> None:
    """L2: first the previous code, then that of each lost exchange."""
    state = changed(rested().loop.state, last_reported_k=9, applied=code_of(1.0), absent=())
    lost = gaps.missing(12, 1, GapCode.FRAME_LOST, code_of(2.0), 1, 2)
    late = gaps.missing(13, 3, GapCode.HOST_LATE, None, 3, 4)

    known = gaps.note(gaps.note(state, late), lost)

    assert _told(state, 10) == []
    assert _told(known, 17) == [(10, 2, 1.0), (12, 1, 2.0), (13, 3, 2.0), (16, 1, 2.0)]
    assert _told(known, 14) == [(10, 2, 1.0), (12, 1, 2.0), (13, 1, 2.0)]


def test_the_sample_after_a_gap_has_the_code_held_last() -> None:
    state = changed(rested().loop.state, last_reported_k=9, applied=code_of(1.0), absent=())
    three = gaps.note(state, gaps.missing(10, 3, GapCode.FRAME_LOST, code_of(2.0), 1, 2))
    one = gaps.note(state, gaps.missing(10, 1, GapCode.FRAME_LOST, code_of(2.0), 1, 2))

    assert _told(state, 13, code_of(3.0)) == [(10, 3, 3.0)]
    assert _told(three, 13, code_of(3.0)) == [(10, 3, 2.0)]
    assert _told(one, 11, code_of(3.0)) == [(10, 1, 3.0)]
    assert _told(one, 14, code_of(3.0)) == [(10, 1, 2.0), (11, 3, 3.0)]
    assert _told(three, 14, code_of(3.0)) == [(10, 3, 2.0), (13, 1, 3.0)]


def test_missing_samples_after_a_reported_sample_stay_pending() -> None:
    state = changed(rested().loop.state, last_reported_k=9, absent=())
    before, across, behind = (
        gaps.missing(k, 2, GapCode.HOST_LATE, None, 1, 2) for k in (10, 11, 12)
    )
    known = gaps.note(gaps.note(gaps.note(state, before), across), behind)

    after, _ = gaps.report_missing(known, 12, 777)

    assert (after.last_reported_k, after.absent) == (11, (across, behind))


def test_no_gap_is_reported_before_the_first_sample() -> None:
    state = changed(
        rested().loop.state,
        last_reported_k=-1,
        absent=(gaps.missing(3, 1, GapCode.HOST_LATE, None, 1, 2),),
    )

    after, actions = gaps.report_missing(state, 7, 777)

    assert (after.last_reported_k, after.absent, actions) == (6, (), [])


def test_the_pieces_of_an_outage_are_bounded() -> None:
    """R1: the newest are kept."""
    state = changed(rested().loop.state, absent=())
    for k in range(gaps.MAX_MISSING_PIECES + 5):
        state = gaps.note(state, gaps.missing(k, 1, GapCode.HOST_LATE, None, 0, 0))

    assert [state.absent[0].k, state.absent[-1].k] == [5, gaps.MAX_MISSING_PIECES + 4]
    assert len(state.absent) == gaps.MAX_MISSING_PIECES


# -- the end of a scheduled run ------------------------------------------------------------------


def _scheduled(due: int, phase: Phase, now_after_ns: int = 0) -> tuple[DecisionState, list[object]]:
    """Return the actions at the end of a run of 10 samples at Ts 10 ms."""
    state = changed(
        rested().loop.state, phase=phase, outcome="why", absent=(), last_reported_k=99 + due
    )
    run = ActiveRun("r", codes(*[1.0] * 10), 100, scheduled=True, due=due, t_zero_ns=1000 * MS)
    beats = (Unechoed(1, 2),)
    after, actions = gaps.end_run(
        changed(state, run=run, beats=beats, k=500), 1000 * MS + now_after_ns
    )
    assert after.link.beats == ()
    return after, list(actions)


@pytest.mark.parametrize(
    ("now_after_ns", "missing"),
    [(0, 0), (19 * MS, 0), (20 * MS, 1), (55 * MS, 4), (10_000 * MS, 8)],
)
def test_trip_reports_the_samples_due_so_far_as_a_gap(now_after_ns: int, missing: int) -> None:
    """L2: t_zero + i Ts is past for more samples than the two that came."""
    after, actions = _scheduled(2, Phase.FAULT, now_after_ns)

    told = [a.record for a in actions if isinstance(getattr(a, "record", None), Gap)]
    assert [(g.k_first, g.count, g.reason, g.code) for g in told] == [
        (102, missing, "why", GapCode.FAULT)
    ] * bool(missing)
    assert after.last_reported_k == 101 + missing
    assert after.k == 101 + missing
    assert [a for a in actions if isinstance(a, SetPeriod)] == [SetPeriod(10_000, 102 + missing)]


def test_a_run_that_leaves_the_limits_is_stopped_in_that_tick() -> None:
    """S1 and S5: STOP precedes the EXCHANGE, which carries 0 V."""
    bench = driven()
    state = bench.loop.state
    run = ActiveRun("r", codes(1.0, 5.0), state.k, due=1)
    narrow = changed(state.rules, code_max=state.rules.code_max // 2)
    bench.ports.now += TS

    decided = _tick(changed(state, rules=narrow, run=run), bench.ports.now)

    assert decided.state.fault == Fault(Id.LIMITS, "u[1] is not within the limits")
    assert [(type(m), getattr(m, "u", 0)) for m in decided.sent] == [(Stop, 0), (Exchange, 0)]


@pytest.mark.parametrize("phase", [Phase.FAULT, Phase.SAFE])
def test_run_in_exchange_mode_ends_with_the_last_requested_sample(phase: Phase) -> None:
    """L2: the device samples nothing that the host does not request."""
    state = changed(rested().loop.state, phase=phase, outcome="why", last_reported_k=109, absent=())
    run = ActiveRun("r", codes(*[1.0] * 20), 100, due=12)
    sent = tuple(Sent(k, k, k, k, 0) for k in (110, 111, 112))

    after, actions = gaps.end_run(changed(state, run=run, sent=sent, k=112), 9_000 * MS)

    told = [a.record for a in actions if isinstance(getattr(a, "record", None), Gap)]
    assert [(g.k_first, g.count) for g in told] == [(110, 1), (111, 1)]
    assert (after.last_reported_k, after.k, after.link.sent) == (111, 112, sent[2:])
    assert after.absent == ()


@pytest.mark.parametrize("k_first", [-1, 0, 1])
def test_a_run_that_began_at_k_0_restores_the_host_period(k_first: int) -> None:
    run = ActiveRun("r", codes(1.0, 1.0), k_first, scheduled=True, due=1, t_zero_ns=0)
    state = changed(rested().loop.state, run=run, absent=(), last_reported_k=-1, k=50)

    after, actions = gaps.end_run(state, 5 * MS)

    begun = [SetPeriod(10_000, k_first + 1)] if k_first >= 0 else []
    assert [a for a in actions if isinstance(a, SetPeriod)] == begun
    assert after.k == (k_first if begun else 50)
    assert after.last_reported_k == (k_first if begun else -1)


@pytest.mark.parametrize("run", [None, ActiveRun("r", RUN.codes, -1), ActiveRun("r", RUN.codes, 4)])
def test_the_outcome_of_a_run_does_not_carry_over_to_the_next(run: ActiveRun | None) -> None:
    state = changed(rested().loop.state, run=run)

    ended, done = gaps.end_run(state.ending_with("by hand", OutcomeCode.STOPPED), 0)

    told = [a.record for a in done if isinstance(a, Emit) and isinstance(a.record, RunEnded)]
    assert [(r.outcome, r.outcome_code) for r in told] == [("by hand", "stopped")] * bool(run)
    assert (ended.run, ended.outcome, ended.outcome_code) == (None, "", None)


@pytest.mark.parametrize(
    ("outcome", "error"), [("the lease ran out", "the lease ran out"), ("", "stopped")]
)
def test_a_run_that_never_began_is_refused_with_a_reason(outcome: str, error: str) -> None:
    state = changed(rested().loop.state, queue=Queue(RUN), outcome=outcome)

    state, done = gaps.end_run(state, 0)

    refusal = Answer(order=73, error=error, code=RefusalCode.OVERTAKEN)
    assert [a.record for a in done if isinstance(a, Emit)] == [refusal]
    assert (state.queue, state.outcome) == (None, "")


def test_an_orderly_stop_reports_no_gap_of_unsampled_ticks() -> None:
    after, actions = _scheduled(2, Phase.SAFE, 10_000 * MS)

    assert [type(getattr(a, "record", a)) for a in actions] == [SetPeriod, RunEnded]
    assert (after.k, after.last_reported_k, after.run) == (101, 101, None)


# -- the trace -----------------------------------------------------------------------------------


def test_trace_of_an_unknown_event_is_refused() -> None:
    step = msgspec.msgpack.encode([(5, [(7, b"")], [])])

    with pytest.raises(msgspec.DecodeError, match="event of kind 7: 0 to 6 are known"):
        trace.steps_of(step)


def test_a_trace_does_not_contain_the_codes_of_the_run() -> None:
    _, state = _playing([1.0] * 100_000, 1)

    written = trace.encode_state(state)

    assert len(written) < trace.CHUNK_BYTES
    restored = trace.decode_state(written, state.run.codes)
    assert restored.lease.lease != state.lease.lease
    assert changed(restored, lease=state.lease) == state
    assert trace.decode_state(trace.encode_state(changed(state, run=None)), b"x").run is None


@pytest.mark.parametrize("scheduled", [False, True])
def test_a_sample_enters_each_module_once(scheduled: bool) -> None:
    """The import contract forbids all other calls between these modules."""
    entered = [Counter[str]()]

    def count(frame: FrameType, what: str, _: object) -> None:
        code, caller = frame.f_code, frame.f_back and frame.f_back.f_code
        if code.co_name == "handle_sample":  # at the call, and at the return
            entered.append(Counter())
        elif what == "call" and caller and caller.co_filename == core_step.__file__:
            entered[-1][Path(code.co_filename).stem] += 1

    bench = armed()
    bench.order(changed(RUN, scheduled=scheduled, codes=codes(*[1.0] * 50)))
    sys.setprofile(count)
    bench.run_for(1000)
    sys.setprofile(None)

    most = reduce(or_, entered[1::2])
    assert {module for module, n in most.items() if n > 1} <= {"state", "step"}
    assert {"sampling", "gaps", "effects", "setpoints"} <= most.keys()
