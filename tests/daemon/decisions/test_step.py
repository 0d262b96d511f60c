"""The core's own decisions: ticks, beats and ends, from states built for each."""

from __future__ import annotations

import msgspec
import pytest
from armrig_core.volts import code_of
from armrig_daemon import pipe
from armrig_daemon.config import Config
from armrig_daemon.decisions import step as core_step
from armrig_daemon.decisions import trace
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.gaps import MOST_ABSENT, note, tell_missing
from armrig_daemon.decisions.requests import motor
from armrig_daemon.decisions.state import (
    Absent,
    ActiveRun,
    Link,
    LinkDown,
    LinkUp,
    Phase,
    Received,
    Repace,
    Sent,
    ServiceGone,
    State,
    Tick,
    Unechoed,
    Want,
)
from armrig_daemon.decisions.stopping import end_run
from armrig_daemon.pipe import Gap, Log, RunEnded, RunStarted
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol.frame import encode
from armrig_protocol.messages import MAX_UNECHOED, Exchange, Hello, Stop
from armrig_protocol.messages import State as DeviceState
from decision_states import Decided, armed, awaiting, changed, driven, rested
from virtual_bench import LEASE, MS, Bench, codes

TS = 10 * MS


def _tick(state: State, now_ns: int, ahead: int = 1) -> Decided:
    return Decided(state, now_ns, Tick(state.k + ahead, now_ns - 5))


def _code(decided: Decided) -> int:
    """Return the code that is sent; there is one EXCHANGE."""
    (found,) = [m for m in decided.sent if isinstance(m, Exchange)]
    return found.u


def test_at_the_start_nothing_is_known() -> None:
    """No device, no time, no sample; Ts is that of the rules."""
    rules = rested().loop.state.rules

    state = core_step.start(rules)

    assert (state.rules, state.ts_us, state.pace_us) == (rules, rules.ts_us, rules.ts_us)
    known = {"rules", "pace_us", "phase"}
    unknown = {f: getattr(state, f) for f in state.__struct_fields__ if f not in known}
    assert {f for f, value in unknown.items() if value} == {"k", "told"}
    assert (state.k, state.told, state.phase) == (-1, -1, Phase.INIT)


# -- when it wants to be woken -------------------------------------------------------------------


def test_the_core_wants_to_be_woken_for_its_request_or_for_the_device_s_watchdog() -> None:
    """A third of the watchdog after the last frame, so that two may be lost."""
    state = changed(rested().loop.state, any_ns=1000)

    assert core_step.wake_ns(state) == 1000 + 100 * MS // 3
    assert core_step.wake_ns(awaiting(state, Want.STOP, sent_ns=7)) == 7 + 20 * MS


def test_before_the_first_tick_none_was_missed() -> None:
    """Wherever k begins, and however long ago the start was."""
    state = core_step.start(rested().loop.state.rules)

    first = Decided(state, 10_000 * MS, Tick(7, 9_999 * MS)).state

    assert (first.k, first.tick_ns, first.absent) == (7, 10_000 * MS, ())


@pytest.mark.parametrize("cut", [1, 7, 20, 35])
def test_a_frame_may_come_in_pieces(cut: int) -> None:
    """Wherever the line cuts it, it is one message."""
    bench = rested()
    reply = bench.loop.state.device
    assert reply is not None
    data = b"\0" + encode(reply._replace(state=int(DeviceState.IDLE)))
    state = awaiting(bench.loop.state, Want.HELLO)

    first = Decided(state, bench.ports.now, Received(data[:cut]))
    second = Decided(first.state, bench.ports.now, Received(data[cut:]))

    assert (first.sent, len(second.sent)) == ([], 1)
    assert second.state.link.pending == b""


def test_noise_between_frames_is_told_and_costs_nothing() -> None:
    """The message behind it is taken."""
    bench = rested()
    reply = bench.loop.state.device
    assert reply is not None
    data = b"noise\0" + encode(reply._replace(state=int(DeviceState.IDLE)))

    decided = Decided(awaiting(bench.loop.state, Want.HELLO), bench.ports.now, Received(data))

    assert [log.level for log in decided.told(Log)] == ["debug"]
    assert len(decided.sent) == 1


def test_a_link_that_comes_up_begins_anew() -> None:
    """HELLO, with seq 0; what was half read or on its way belonged to another line."""
    bench = driven()
    old = changed(bench.loop.state, pending=b"abc", seq=77, fresh_ns=5)

    decided = Decided(old, bench.ports.now, LinkUp())

    (hello,) = decided.sent
    assert isinstance(hello, Hello)
    after = decided.state
    assert hello.seq == 0
    assert after.link == Link(seq=1, any_ns=bench.ports.now)


def test_a_daemon_whose_service_is_gone_stops_and_ends() -> None:
    """Nobody is left who could tell it to."""
    bench = driven()

    decided = Decided(bench.loop.state, bench.ports.now, ServiceGone())

    assert [type(m) for m in decided.sent] == [Stop]
    assert decided.state.quitting
    assert decided.state.outcome == "the daemon was ended"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "driven"),
        ({"device_state": int(DeviceState.READY)}, "at 0 V, says the device"),
        ({"fault": Fault(Id.STALE, "no answer")}, "told to stop, but not confirmed; its watchdog"),
        ({"link": None}, "not known, for the device does not answer; its watchdog stops it"),
        ({"device": None}, "not known, for the device does not answer; its watchdog stops it"),
    ],
)
def test_what_is_known_of_the_motor_is_said_as_it_is(change: dict[str, object], words: str) -> None:
    """Never more than the device has said."""
    state = driven().loop.state

    assert motor(changed(state, **change)).startswith(words)
    if not change:
        assert motor(awaiting(state, Want.STOP)) == "told to stop, not confirmed yet"
        assert motor(awaiting(state, Want.START)) == "driven"


def test_a_port_that_cannot_be_opened_is_told_to_whoever_asks() -> None:
    """Whether it was lost or never there; not to open it is no fault where nothing turned."""
    state = core_step.start(Config().rules())

    decided = Decided(state, 0, LinkDown("/dev/ttyACM0 cannot be opened: it is not there"))

    [said] = decided.told(StateRecord)
    assert said.phase == "init"
    assert said.line.startswith("no rig is there, and the daemon waits for it")
    [log] = decided.told(Log)
    assert (log.level, log.message) == (
        "warning",
        "no link: /dev/ttyACM0 cannot be opened: it is not there",
    )
    assert decided.sent == []


# -- a tick --------------------------------------------------------------------------------------


def test_a_tick_sends_one_exchange_and_remembers_it() -> None:
    """With its k, its code and its times."""
    bench = driven()
    state, now = bench.loop.state, bench.ports.now + TS

    decided = _tick(state, now)

    (frame,) = decided.sent
    assert isinstance(frame, Exchange)
    assert (frame.k, frame.u, frame.seq) == (state.k + 1, code_of(1.0), state.link.seq)
    kept = Sent(state.link.seq, state.k + 1, now - 5, now, code_of(1.0))
    assert decided.state.link.sent == (*state.link.sent, kept)
    assert (decided.state.k, decided.state.tick_ns) == (state.k + 1, now)


def test_k_wraps_on_the_wire_and_nowhere_else() -> None:
    """32 bits of it are sent."""
    bench = rested()
    state = changed(bench.loop.state, k=(1 << 32) + 4, told=(1 << 32) + 4)

    decided = _tick(state, bench.ports.now + TS)

    assert [m.k for m in decided.sent if isinstance(m, Exchange)] == [5]
    assert decided.state.link.sent[-1].k == (1 << 32) + 5


def test_no_tick_sends_anything_without_a_device() -> None:
    """Time goes on all the same; T1: but for the question who is there, when it is due."""
    state = rested().loop.state
    nobody = changed(state, device=None)
    asked = awaiting(nobody, Want.HELLO, sent_ns=state.tick_ns)
    for gone in (changed(state, link=None), asked):
        decided = _tick(gone, state.tick_ns + TS)
        assert decided.actions == []
        assert decided.state.k == state.k + 1
    for gone, now_ns in ((nobody, state.tick_ns + TS), (asked, state.tick_ns + 100 * MS)):
        decided = _tick(gone, now_ns)
        assert [type(m) for m in decided.sent] == [Hello]
        assert decided.state.asked is not None


@pytest.mark.parametrize("ahead", [1, 2, 4])
def test_ticks_that_were_skipped_are_remembered_with_their_number(ahead: int) -> None:
    """L2: they are told before the next sample, and why."""
    bench = rested()
    state, now = bench.loop.state, bench.ports.now + ahead * TS

    absent = _tick(state, now, ahead).state.absent

    if ahead == 1:
        assert absent == ()
    else:
        expected = Absent(state.k + 1, ahead - 1, "the host was late", None, state.tick_ns, now)
        assert absent == (expected,)


@pytest.mark.parametrize(("waiting", "sends"), [(MAX_UNECHOED - 1, 1), (MAX_UNECHOED, 0)])
def test_no_more_exchanges_wait_than_are_allowed(waiting: int, sends: int) -> None:
    """S4: the one too many is a gap of one."""
    bench = rested()
    state = bench.loop.state
    sent = tuple(Sent(0, state.k - i, 0, 0, 0) for i in range(waiting))

    decided = _tick(changed(state, sent=sent), bench.ports.now + TS)

    assert len(decided.sent) == sends
    reasons = [(a.k, a.n, a.reason) for a in decided.state.absent]
    assert reasons == ([] if sends else [(state.k + 1, 1, "the device was late")])


@pytest.mark.parametrize(("late_ns", "fault"), [(50 * MS, None), (50 * MS + 1, Id.PAUSE)])
def test_a_pause_is_one_from_its_limit_on(late_ns: int, fault: Id | None) -> None:
    """S4: 50 ms at Ts 10 ms, counted from the last tick."""
    bench = driven()
    state = changed(bench.loop.state, fresh_ns=bench.ports.now + late_ns)

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
    """3, 5 and 5 Ts where those are longer; a device that paces itself has its watchdog's time."""
    rules = rested().loop.state.rules

    assert rules.age_ns(ts_us) == age_ms * MS
    assert rules.pause_ns(ts_us) == pause_ms * MS
    assert rules.lease_ns(ts_us) == lease_ms * MS
    assert rules.age_ns(ts_us, scheduled=True) == rules.pause_ns(ts_us, scheduled=True) == 100 * MS


@pytest.mark.parametrize(("age_ns", "stale"), [(50 * MS, False), (50 * MS + 1, True)])
def test_a_round_trip_is_stale_from_its_limit_on(age_ns: int, stale: bool) -> None:
    """S4: STOP in that very tick where the motor may turn; at rest the device is asked for."""
    driving, resting = driven(), rested()
    now = driving.ports.now + TS
    trip = _tick(changed(driving.loop.state, fresh_ns=now - age_ns, sent=()), now)
    now = resting.ports.now + TS
    waiting = changed(resting.loop.state, fresh_ns=now - age_ns, sent=(Sent(0, 0, 0, 0, 0),))
    ask = _tick(waiting, now)

    assert [type(m) for m in trip.sent] == [Stop if stale else Exchange]
    assert [type(m) for m in ask.sent] == [Hello if stale else Exchange]
    if stale:
        assert trip.state.fault is not None
        assert trip.state.fault.id is Id.STALE
        assert trip.state.reason == "no answer from the device for 50 ms"
        (log,) = ask.told(Log)
        assert log.message == "no answer from the device for 50 ms; asking who is there"
        assert log.t_host_ns == now
        assert (ask.state.device, ask.state.phase, ask.state.link.sent) == (None, Phase.INIT, ())


def test_a_stale_device_that_is_being_asked_already_is_not_asked_twice() -> None:
    """The retry does it; and a latched fault stays latched."""
    bench = rested()
    old = changed(bench.loop.state, fresh_ns=bench.ports.now - 60 * MS)
    asking = awaiting(old, Want.CONFIGURE)
    latched = changed(old, phase=Phase.FAULT)

    again = _tick(asking, bench.ports.now + TS)

    assert again.actions == []
    assert again.state.asked == asking.asked
    assert _tick(latched, bench.ports.now + TS).state.phase is Phase.FAULT


@pytest.mark.parametrize(("silent_ns", "trips"), [(3000 * MS, False), (3000 * MS + 1, True)])
def test_a_service_is_frozen_from_its_limit_on(silent_ns: int, trips: bool) -> None:
    """Through it goes every stop."""
    bench = driven()
    now = bench.ports.now + TS
    rules = changed(bench.loop.state.rules, service_ns=3000 * MS)
    decided = _tick(changed(bench.loop.state, rules=rules, service_ns=now - silent_ns), now)

    assert (decided.state.fault is not None) == trips


@pytest.mark.parametrize(("allowed", "trips"), [(0, False), (2, True), (3, True), (4, False)])
def test_as_many_missed_ticks_as_are_asked_for_stop_the_motor(allowed: int, trips: bool) -> None:
    """Three in a row here; 0 goes on."""
    bench = driven()
    now = bench.ports.now + 4 * TS
    rules = changed(bench.loop.state.rules, stop_after=allowed)
    decided = _tick(changed(bench.loop.state, rules=rules, fresh_ns=now), now, ahead=4)

    assert (decided.state.fault is not None) == trips
    if trips:
        assert decided.state.reason == f"3 ticks in a row were missed: {allowed} are allowed"


# -- the code ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("held_ns", "u"), [(100 * MS, code_of(1.0)), (100 * MS + 1, 0)])
def test_a_voltage_held_by_hand_lives_as_long_as_its_lease(held_ns: int, u: int) -> None:
    """S2: and then trips."""
    bench = driven()
    now = bench.ports.now + TS
    assert bench.loop.state.lease is not None
    lease = changed(bench.loop.state.lease, renewed_ns=now - held_ns)

    decided = _tick(changed(bench.loop.state, lease=lease), now)

    assert _code(decided) == u
    assert (decided.state.fault is not None) == (u == 0)


@pytest.mark.parametrize(("held_ns", "gives_back"), [(10_000 * MS, False), (10_000 * MS + 1, True)])
def test_an_armed_rig_is_given_back_after_10_s(held_ns: int, gives_back: bool) -> None:
    """At 0 V, and no fault."""
    bench = armed()
    now = bench.ports.now + TS
    assert bench.loop.state.lease is not None
    lease = changed(bench.loop.state.lease, renewed_ns=now - held_ns)

    decided = _tick(changed(bench.loop.state, lease=lease), now)

    assert _code(decided) == 0
    assert any(isinstance(m, Stop) for m in decided.sent) == gives_back
    assert len(decided.told(Log)) == gives_back


@pytest.mark.parametrize("phase", [Phase.SAFE, Phase.ARMED, Phase.FAULT])
def test_outside_active_the_code_is_0(phase: Phase) -> None:
    """S5: whatever is left of the last command."""
    bench = driven()
    state = changed(bench.loop.state, phase=phase, device_state=int(DeviceState.READY))

    assert _code(_tick(state, bench.ports.now + TS)) == 0


def test_behind_a_stop_and_without_a_lease_the_code_is_0() -> None:
    """S5: active by its name only."""
    bench = driven()
    now = bench.ports.now + TS

    assert _code(_tick(awaiting(bench.loop.state, Want.STOP, sent_ns=now), now)) == 0
    assert _code(_tick(changed(bench.loop.state, lease=None), now)) == 0
    assert _code(_tick(awaiting(bench.loop.state, Want.CLEAR, sent_ns=now), now)) == code_of(1.0)


# -- an experiment of the host -------------------------------------------------------------------


def _playing(volts: list[float], due: int, k_first: int | None = None) -> tuple[Bench, State]:
    """Return a state in which `due` samples of a run have been asked for."""
    bench = driven()
    state = bench.loop.state
    first = state.k + 1 - due if k_first is None else k_first
    run = ActiveRun("r", codes(*volts), first, due=due)
    return bench, changed(state, run=run, code=0, outcome="")


def test_the_first_sample_of_a_run_gives_it_its_k() -> None:
    """And is told with all that a recording needs."""
    bench, state = _playing([1.0, 2.0], 0, -1)
    now = bench.ports.now + TS

    decided = _tick(state, now)

    expected = RunStarted(run_id="r", k_first=state.k + 1, count=2, t_host_ns=now)
    assert decided.told(RunStarted) == [expected]
    assert _code(decided) == code_of(1.0)
    assert decided.state.run is not None
    assert (decided.state.run.k_first, decided.state.run.due) == (state.k + 1, 1)


def test_a_run_that_has_begun_at_k_0_does_not_begin_again() -> None:
    """Its next tick is its second sample; scheduled, the host sends nothing in its place."""
    bench, state = _playing([1.0, 2.0], 1, 0)
    state = changed(state, k=0, told=0)
    scheduled = changed(state, run=changed(state.run, scheduled=True))  # type: ignore[type-var]
    resting = changed(scheduled, device_state=int(DeviceState.READY))

    assert _code(_tick(state, bench.ports.now + TS)) == code_of(2.0)
    assert _tick(state, bench.ports.now + TS).told(RunStarted) == []
    assert _tick(resting, bench.ports.now + TS).sent == []


@pytest.mark.parametrize(("due", "u"), [(0, 1.0), (1, 2.0), (2, 3.0)])
def test_each_tick_of_a_run_has_its_own_u(due: int, u: float) -> None:
    """S5: and is counted as asked for."""
    bench, state = _playing([1.0, 2.0, 3.0], due)

    decided = _tick(state, bench.ports.now + TS)

    assert _code(decided) == code_of(u)
    assert decided.state.run is not None
    assert decided.state.run.due == due + 1
    assert decided.told(RunStarted) == []


def test_behind_its_last_sample_a_run_is_complete() -> None:
    """0 V in that very tick, and a STOP; all its samples are due even where ticks were missed."""
    bench, state = _playing([1.0, 2.0, 3.0], 3)
    assert state.run is not None
    missed = changed(state, run=changed(state.run, due=1))

    for at in (state, missed):
        decided = _tick(at, bench.ports.now + TS)
        assert _code(decided) == 0
        assert any(isinstance(m, Stop) for m in decided.sent)
        assert (decided.state.outcome, decided.state.run.due) == ("complete", 3)  # type: ignore[union-attr]


def test_a_run_that_leaves_the_limits_is_stopped_at_0_v() -> None:
    """S1: by its slew from the sample before, which at its start is standstill."""
    for volts, due, trips in (([1.0, 2.1], 1, True), ([1.0, 2.0], 1, False), ([1.1], 0, True)):
        bench, state = _playing(volts, due)
        rules = changed(state.rules, slew=code_of(1.0) + 1)
        decided = _tick(changed(state, rules=rules), bench.ports.now + TS)

        assert (decided.state.fault is not None) == trips
        assert _code(decided) == (0 if trips else code_of(volts[due]))


def test_samples_of_a_run_that_never_come_are_told_before_its_end() -> None:
    """L2: those that were asked for, and none of those behind."""
    bench, state = _playing([1.0] * 5, 3)
    assert state.run is not None
    first = state.run.k_first
    waiting = tuple(Sent(i, first + i, 0, 100 + i, code_of(1.0)) for i in (1, 2, 3))
    told = changed(state, told=first, sent=waiting, absent=())

    after, actions = end_run(told, 999)

    records = [a.record for a in actions]
    assert [(r.k_first, r.count, r.reason) for r in records[:-1]] == [
        (first + 1, 1, "a frame was lost"),
        (first + 2, 1, "a frame was lost"),
    ]
    assert isinstance(records[-1], RunEnded)
    assert after.link.sent == waiting[2:]
    assert (after.told, after.run, after.outcome) == (first + 2, None, "")
    assert bench.volts > 0


# -- gaps ----------------------------------------------------------------------------------------


def _told(state: State, end: int, u_before: int | None = None) -> list[tuple[int, int, float]]:
    _, actions = tell_missing(state, end, 777, u_before)
    gaps = [a.record for a in actions]
    assert all(isinstance(g, Gap) for g in gaps)
    return [(g.k_first, g.count, round(g.u_held_v, 3)) for g in gaps]


def test_what_was_held_in_a_gap_is_told_piece_by_piece() -> None:
    """L2: the code before it, then that of each exchange that was lost."""
    state = changed(rested().loop.state, told=9, applied=code_of(1.0), absent=())
    lost = Absent(12, 1, "a frame was lost", code_of(2.0), 1, 2)
    late = Absent(13, 3, "the host was late", None, 3, 4)

    known = note(note(state, late), lost)

    assert _told(state, 10) == []
    assert _told(known, 17) == [(10, 2, 1.0), (12, 1, 2.0), (13, 3, 2.0), (16, 1, 2.0)]
    assert _told(known, 14) == [(10, 2, 1.0), (12, 1, 2.0), (13, 1, 2.0)]


def test_the_sample_behind_a_gap_says_what_was_held_last() -> None:
    """u_km1: but not over more samples than it can speak for."""
    state = changed(rested().loop.state, told=9, applied=code_of(1.0), absent=())
    three = note(state, Absent(10, 3, "lost", code_of(2.0), 1, 2))
    one = note(state, Absent(10, 1, "lost", code_of(2.0), 1, 2))

    assert _told(state, 13, code_of(3.0)) == [(10, 3, 3.0)]
    assert _told(three, 13, code_of(3.0)) == [(10, 3, 2.0)]
    assert _told(one, 11, code_of(3.0)) == [(10, 1, 3.0)]


def test_what_lies_behind_a_sample_is_kept_for_the_next() -> None:
    """Ticks may have been skipped while it was on its way."""
    state = changed(rested().loop.state, told=9, absent=())
    before, across, behind = (Absent(k, 2, "late", None, 1, 2) for k in (10, 11, 12))
    known = note(note(note(state, before), across), behind)

    after, _ = tell_missing(known, 12, 777)

    assert (after.told, after.absent) == (11, (across, behind))


def test_before_the_first_sample_nothing_is_missed() -> None:
    """The count begins with what comes first."""
    state = changed(rested().loop.state, told=-1, absent=(Absent(3, 1, "late", None, 1, 2),))

    after, actions = tell_missing(state, 7, 777)

    assert (after.told, after.absent, actions) == (6, (), [])


def test_the_pieces_of_an_outage_are_bounded() -> None:
    """R1: the newest are kept."""
    state = changed(rested().loop.state, absent=())
    for k in range(MOST_ABSENT + 5):
        state = note(state, Absent(k, 1, "late", None, 0, 0))

    assert [state.absent[0].k, state.absent[-1].k] == [5, MOST_ABSENT + 4]
    assert len(state.absent) == MOST_ABSENT


# -- the end of a scheduled run ------------------------------------------------------------------


def _scheduled(due: int, phase: Phase, now_after_ns: int = 0) -> tuple[State, list[object]]:
    """Return what the end of a run of 10 samples at Ts 10 ms leaves."""
    state = changed(rested().loop.state, phase=phase, outcome="why", absent=(), told=99 + due)
    run = ActiveRun("r", codes(*[1.0] * 10), 100, scheduled=True, due=due, t_zero_ns=1000 * MS)
    beats = (Unechoed(1, 2),)
    after, actions = end_run(changed(state, run=run, beats=beats, k=500), 1000 * MS + now_after_ns)
    assert after.link.beats == ()
    return after, list(actions)


@pytest.mark.parametrize(
    ("now_after_ns", "missing"),
    [(0, 0), (19 * MS, 0), (20 * MS, 1), (55 * MS, 4), (10_000 * MS, 8)],
)
def test_a_trip_tells_what_the_device_would_have_sampled_by_now(
    now_after_ns: int, missing: int
) -> None:
    """L2: t_zero + i Ts is past for so many more than the two that came; at most the run's."""
    after, actions = _scheduled(2, Phase.FAULT, now_after_ns)

    gaps = [a.record for a in actions if isinstance(getattr(a, "record", None), Gap)]  # type: ignore[attr-defined]
    assert [(g.k_first, g.count, g.reason) for g in gaps] == [(102, missing, "why")] * bool(missing)
    assert after.told == 101 + missing
    assert after.k == 101 + missing
    assert [a for a in actions if isinstance(a, Repace)] == [Repace(10_000, 102 + missing)]


def test_a_run_that_leaves_the_limits_is_stopped_in_that_tick() -> None:
    """S1 and S5: STOP goes out before the EXCHANGE, which carries 0 V."""
    bench = driven()
    state = bench.loop.state
    run = ActiveRun("r", codes(1.0, 5.0), state.k, due=1)
    narrow = changed(state.rules, code_max=state.rules.code_max // 2)
    bench.ports.now += TS

    decided = _tick(changed(state, rules=narrow, run=run), bench.ports.now)

    assert decided.state.fault == Fault(Id.LIMITS, "u[1] is not within the limits")
    assert [(type(m), getattr(m, "u", 0)) for m in decided.sent] == [(Stop, 0), (Exchange, 0)]


@pytest.mark.parametrize("phase", [Phase.FAULT, Phase.SAFE])
def test_a_run_in_exchange_mode_ends_with_what_was_asked_for(phase: Phase) -> None:
    """L2: the device samples nothing that the host does not ask for; what is behind goes on."""
    state = changed(rested().loop.state, phase=phase, outcome="why", told=109, absent=())
    run = ActiveRun("r", codes(*[1.0] * 20), 100, due=12)
    sent = tuple(Sent(k, k, k, k, 0) for k in (110, 111, 112))

    after, actions = end_run(changed(state, run=run, sent=sent, k=112), 9_000 * MS)

    gaps = [a.record for a in actions if isinstance(getattr(a, "record", None), Gap)]  # type: ignore[attr-defined]
    assert [(g.k_first, g.count) for g in gaps] == [(110, 1), (111, 1)]
    assert (after.told, after.k, after.link.sent) == (111, 112, sent[2:])
    assert after.absent == ()


@pytest.mark.parametrize("k_first", [-1, 0, 1])
def test_a_run_that_has_begun_at_k_0_has_begun(k_first: int) -> None:
    """One that has not yet, has nothing to tell but its end."""
    run = ActiveRun("r", codes(1.0, 1.0), k_first, scheduled=True, due=1, t_zero_ns=0)
    state = changed(rested().loop.state, run=run, absent=(), told=-1, k=50)

    after, actions = end_run(state, 5 * MS)

    begun = [Repace(10_000, k_first + 1)] if k_first >= 0 else []
    assert [a for a in actions if isinstance(a, Repace)] == begun
    assert after.k == (k_first if begun else 50)
    assert after.told == (k_first if begun else -1)


def test_a_stop_in_good_order_tells_of_nothing_that_was_not_sampled() -> None:
    """The count goes on behind the last sample."""
    after, actions = _scheduled(2, Phase.SAFE, 10_000 * MS)

    assert [type(getattr(a, "record", a)) for a in actions] == [Repace, RunEnded]
    assert (after.k, after.told, after.run) == (101, 101, None)


# -- the trace -----------------------------------------------------------------------------------


def test_a_trace_of_a_kind_that_there_is_not_is_refused() -> None:
    """Of a newer release, say: rather no replay than a wrong one."""
    step = msgspec.msgpack.encode([(5, [(7, b"")], [])])

    with pytest.raises(msgspec.DecodeError, match="event of kind 7: 0 to 6 are known"):
        trace.steps_of(step)


def test_a_trace_leaves_the_codes_to_the_recording() -> None:
    """A million of them would not fit; with them the state is whole again, but for the lease."""
    _, state = _playing([1.0] * 100_000, 1)
    assert state.run is not None
    assert state.lease is not None

    written = trace.written_state(state)

    assert len(written) < trace.CHUNK
    restored = trace.restored(written, state.run.codes)
    assert restored.lease is not None
    assert restored.lease.lease != state.lease.lease
    assert changed(restored, lease=state.lease) == state
    assert trace.restored(trace.written_state(changed(state, run=None)), b"x").run is None


def test_a_run_that_is_ordered_while_another_ends_is_kept_out() -> None:
    """S5: the codes that are played are those of the run that was accepted."""
    bench, state = _playing([1.0, 2.0], 1)
    play = pipe.Run(order=5, lease=LEASE, n=90, run_id="s", codes=codes(4.0))
    bench.loop.state = state
    bench.order(play)
    bench.run_for(5)

    run = bench.loop.state.run
    assert run is not None
    assert run.run_id == "r"
