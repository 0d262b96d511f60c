"""A sample in answer to an EXCHANGE, and a sample that the device makes by itself."""

from __future__ import annotations

import pytest
from armrig_core.commands.codes import GapCode
from armrig_core.rig.volts import code_of, device_code
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon import pipe
from armrig_daemon.decisions import replies
from armrig_daemon.decisions.clockmap import ClockMap
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    Emit,
    Phase,
    Publish,
    RequestKind,
    RoundTrip,
    Sent,
    Unechoed,
)
from armrig_daemon.pipe import Answer, Gap, Log, RunEnded, RunStarted
from armrig_protocol.messages import Flag, Setpoints, Stop
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import (
    Decided,
    awaiting,
    changed,
    device_sample,
    driven,
    heard,
    rested,
)
from tests.daemon.virtual_bench import LEASE, MS, Bench, codes

RUN, UNDERRUN = int(Flag.RUN), int(Flag.UNDERRUN)
LATCHED = Fault(Id.LEASE, "ran out")


def _asked(bench: Bench, ms: float = 21) -> DecisionState:
    """Return the state after two exchanges that nothing answered."""
    bench.ports.from_device = lambda data: b""
    bench.run_for(ms)
    assert len(bench.loop.state.link.sent) == 2
    return bench.loop.state


def _playing() -> Bench:
    """Return a rig in the middle of a scheduled run at 2 V."""
    bench = Bench()
    bench.play([2.0] * 400, 5_000)
    bench.run_for(400)
    assert bench.loop.state.link.device_state == DeviceState.RUN
    return bench


def _duty(state: DecisionState, code: int) -> int:
    """Return the code after rounding to the device's duty."""
    return device_code(code, state.device.pwm_bits)


def _answer(bench: Bench, now: DecisionState, at: int = 0, **fields: int) -> Decided:
    """Return what follows from the answer to an EXCHANGE."""
    return heard(bench, device_sample(now, k=now.link.sent[at].k)._replace(**fields), now)


def _due(bench: Bench, now: DecisionState, ahead: int = 0, **fields: int) -> Decided:
    """Return what follows from the sample of the run that is due next, or one `ahead` of it."""
    u = _duty(now, now.run.code(0))
    known = {"k": now.run.due + ahead, "flags": RUN, "u_k": u, "u_km1": u, "echo": now.link.seq - 1}
    return heard(bench, device_sample(now)._replace(**{**known, **fields}), now)


def _published(decided: Decided) -> list[Sample]:
    return [a.sample for a in decided.of(Publish)]


def _order(decided: Decided, *kinds: type) -> list[str]:
    """Return the names of the actions and records of these kinds, in the order of the actions."""

    def thing(action: Action) -> object:
        return action.record if isinstance(action, Emit) else action

    return [type(t).__name__ for t in map(thing, decided.actions) if isinstance(t, kinds)]


# -- what the device applied (S5) ----------------------------------------------------------------


@pytest.mark.parametrize("flags", [0, UNDERRUN, RUN, RUN | UNDERRUN])
def test_wrong_code_in_an_exchange_is_a_fault_with_any_flag(flags: int) -> None:
    """S5: only a device with a queue can run out of setpoints."""
    bench = driven()
    state = _asked(bench)
    commanded = _duty(state, state.link.sent[0].code) if flags & RUN else 0

    wrong = _answer(bench, state, u_k=commanded + 64, flags=flags)
    right = _answer(bench, state, u_k=commanded, flags=flags)

    assert wrong.state.fault.id is Id.APPLIED
    assert f"but code {state.link.sent[0].code} was commanded" in wrong.state.fault.cause
    assert [type(m) for m in wrong.sent] == [Stop]
    assert right.state.fault is None


def test_wrong_code_of_a_run_in_a_fault_repeats_the_stop() -> None:
    """S5, S6: the device still drives by its own queue, so each such sample causes a STOP."""
    bench = _playing()
    latched = changed(bench.loop.state, phase=Phase.FAULT, fault=LATCHED)
    stopping = awaiting(latched, RequestKind.STOP, tries=4, sent_ns=bench.ports.now)

    wrong = _due(bench, stopping, u_k=9)
    right = _due(bench, stopping)

    assert [type(m) for m in wrong.sent] == [Stop]
    assert wrong.state.phase is Phase.FAULT
    assert wrong.state.asked.tries == 1
    assert right.sent == []
    assert right.state.fault == LATCHED


def test_a_sample_that_was_made_before_its_exchange_came_is_no_answer_to_it() -> None:
    """S4: it answers a repeated frame with the k of the newest EXCHANGE."""
    bench = driven()
    state = _asked(bench)
    at = len(state.link.sent) - 1
    seq = state.link.sent[at].seq

    earlier = _answer(bench, state, at, echo=(seq - 1) & 0xFFFF)
    answered = _answer(bench, state, at, echo=seq)

    assert earlier.state.link.sent == state.link.sent
    assert answered.state.link.sent == ()


# -- what a sample proves of the line (S4) -------------------------------------------------------


def test_the_age_of_an_exchange_counts_from_its_request() -> None:
    """S4: the answer was sent after its question, whenever it comes."""
    bench = driven()
    state = _asked(bench)
    first, now = state.link.sent[0], bench.ports.now

    decided = _answer(bench, state, u_k=_duty(state, first.code), flags=RUN)

    assert first.sent_ns < now
    assert (decided.state.link.last_round_trip_ns, decided.state.sampled_ns) == (
        first.sent_ns,
        first.sent_ns,
    )
    assert decided.of(RoundTrip) == [RoundTrip(now - first.sent_ns)]
    (publish,) = decided.of(Publish)
    assert (publish.sample.t_host_ns, publish.queued) == (first.sent_ns, -1)


def test_the_age_of_a_scheduled_sample_counts_from_its_echoed_frame() -> None:
    """S4: only its echo proves that the device receives the frames."""
    bench = _playing()
    now = bench.ports.now
    state = bench.loop.state
    seq = (state.link.seq - 1) & 0xFFFF
    state = changed(
        state, beats=(Unechoed(seq, now - 7 * MS),), last_round_trip_ns=now - 40 * MS, sampled_ns=1
    )

    deaf = _due(bench, state, echo=(seq - 1) & 0xFFFF, queued=5)
    hears = _due(bench, state, echo=seq, queued=5)

    assert (deaf.state.link.last_round_trip_ns, deaf.state.sampled_ns) == (now - 40 * MS, now)
    assert (hears.state.link.last_round_trip_ns, hears.state.sampled_ns) == (now - 7 * MS, now)
    assert hears.of(RoundTrip) == []
    (publish,) = hears.of(Publish)
    assert (publish.sample.t_host_ns, publish.queued) == (now, 5)


def test_an_echo_of_an_unsent_frame_voids_an_exchange_and_stops_a_run() -> None:
    """S4."""
    bench, playing = driven(), _playing()
    state, run = _asked(bench), playing.loop.state

    answered = _answer(
        bench, state, u_k=_duty(state, state.link.sent[0].code), flags=RUN, echo=state.link.seq
    )
    played = _due(playing, run, echo=run.link.seq + 20)

    assert (answered.actions, answered.state.link.sent) == ([], state.link.sent)
    assert len(_published(played)) == 1
    assert played.state.fault.id is Id.STATE
    assert type(played.sent[-1]) is Stop


def test_an_echo_of_the_very_next_frame_stops_a_run() -> None:
    """S4: setpoints follow each sample; then an old echo looks like an echo of this session."""
    bench = _playing()
    state = bench.loop.state
    assert state.run is not None
    sends_more = changed(state, queue=changed(state.queue, sent=state.queue.held))

    decided = _due(bench, sends_more, echo=state.link.seq, queued=24)

    assert decided.state.fault.id is Id.STATE
    assert f"received frame {state.link.seq}, but this daemon sends {state.link.seq} next" in (
        decided.state.fault.cause
    )
    assert [type(m) for m in decided.sent] == [Stop]
    assert len(_published(decided)) == 1


def test_an_echo_of_an_unsent_frame_stops_a_run_before_its_setpoints() -> None:
    """S4: also for a run that the device has just been armed for."""
    bench = _playing()
    state = bench.loop.state
    play = pipe.Run(order=9, lease=LEASE, n=0, run_id="r", codes=codes(1.0))
    arming = awaiting(
        changed(state, phase=Phase.ARMED, run=None, queue=None), RequestKind.ARM, play
    )
    sample = device_sample(state, flags=RUN)._replace(state=DeviceState.ARMED)

    ours = heard(bench, sample._replace(echo=state.link.seq - 1), arming)
    foreign = heard(bench, sample._replace(echo=state.link.seq), arming)

    assert [type(m) for m in ours.sent] == [Setpoints]
    assert [type(m) for m in foreign.sent] == [Stop]
    assert foreign.told(Answer)[0].error.startswith("not begun: the device has received frame")
    assert foreign.state.link.last_round_trip_ns == state.link.last_round_trip_ns


def test_clocks_are_compared_only_by_exchanges() -> None:
    bench, playing = driven(), _playing()
    state = changed(_asked(bench), compared_ns=0)
    run = changed(playing.loop.state, compared_ns=0)

    answered = _answer(bench, state, u_k=_duty(state, state.link.sent[0].code), flags=RUN)

    assert answered.state.clock.compared_ns == bench.ports.now
    assert _due(playing, run).state.clock.compared_ns == 0


# -- which k it has (L2) -------------------------------------------------------------------------


def test_an_exchange_whose_k_was_reported_as_a_gap_is_not_reported_again() -> None:
    """L2."""
    bench = driven()
    state = _asked(bench)
    told = changed(state, last_reported_k=state.link.sent[0].k)

    decided = _answer(bench, told, u_k=0, flags=RUN)

    assert decided.actions == []
    assert decided.state.link.sent == told.link.sent[1:]
    assert decided.state.link.last_round_trip_ns == told.link.last_round_trip_ns


def test_a_repeated_sample_of_a_run_still_reports_its_echo() -> None:
    """L2: the sample is published once."""
    bench = _playing()
    state = bench.loop.state
    seq = (state.link.seq - 1) & 0xFFFF
    state = changed(state, beats=(Unechoed(seq, 17),), last_round_trip_ns=5)

    decided = _due(bench, state, k=state.run.due - 1, echo=seq)

    assert decided.actions == []
    assert decided.state.link.last_round_trip_ns == 17


# -- the order of what follows -------------------------------------------------------------------


def test_an_exchange_publishes_its_sample_before_it_ends_its_run() -> None:
    """L2: published first."""
    bench = rested()
    bench.play([1.0] * 400, scheduled=False)
    bench.run_for(100)
    state = awaiting(_asked(bench), RequestKind.STOP)

    decided = _answer(bench, state, state=int(DeviceState.IDLE))

    assert _order(decided, Publish, RunEnded)[0] == "Publish"
    assert "RunEnded" in _order(decided, RunEnded)
    assert state.link.sent[0].k not in [g.k_first for g in decided.told(Gap)]


def test_the_first_sample_of_a_run_starts_it_and_is_published_after_the_start() -> None:
    bench = _playing()
    state = bench.loop.state
    order = pipe.Run(order=9, lease=LEASE, n=0, run_id="r", codes=state.run.codes, scheduled=True)
    run = changed(state.run, k_first=-1, due=0)
    armed = changed(state, run=run, phase=Phase.ARMED, device_state=int(DeviceState.ARMED))
    starting = awaiting(armed, RequestKind.START, order, sent_ns=bench.ports.now)

    decided = _due(bench, starting, k=0, state=int(DeviceState.RUN))

    assert _order(decided, RunStarted, Publish) == ["RunStarted", "Publish"]
    assert [s.k for s in _published(decided)] == [starting.k + 1]


# -- answers to exchanges ------------------------------------------------------------------------


def test_a_sample_answers_its_exchange_and_abandons_earlier_ones() -> None:
    """L2: the first is a gap, with the voltage that was commanded."""
    bench = driven()
    first, second = _asked(bench).link.sent
    held, t_us = code_of(1.0), bench.loop.state.t_us + 5
    sample = device_sample(
        bench.loop.state, k=second.k, u_k=held, u_km1=held, flags=int(Flag.RUN), t_us=t_us
    )

    decided = heard(bench, sample)

    (gap,) = decided.told(Gap)
    assert (gap.k_first, gap.count, gap.code) == (first.k, 1, GapCode.FRAME_LOST)
    assert (gap.t_from_ns, gap.t_to_ns) == (first.sent_ns, bench.ports.now)
    (published,) = _published(decided)
    asked = (second.k, second.sched_ns, second.sent_ns)
    assert (published.k, published.t_sched_ns, published.t_host_ns) == asked
    assert decided.of(RoundTrip) == [RoundTrip(bench.ports.now - second.sent_ns)]
    after = decided.state
    assert (after.link.sent, after.link.last_round_trip_ns, after.last_reported_k) == (
        (),
        second.sent_ns,
        second.k,
    )
    assert (after.applied, after.t_us) == (held, t_us)


@pytest.mark.parametrize("known", [True, False])
def test_old_sample_with_an_awaited_k_is_ignored(known: bool) -> None:
    """S5: the k began again, and an old sample is repeated."""
    bench = driven()
    state = _asked(bench)
    state = state if known else changed(state, sampled_ns=0)
    sample = device_sample(state, k=state.link.sent[0].k, t_us=(state.t_us - 1) & 0xFFFFFFFF)

    decided = heard(bench, sample, state)

    assert len(_published(decided)) == (not known)


def test_sample_without_an_exchange_is_ignored() -> None:
    bench = rested()
    state = _asked(bench)

    decided = heard(bench, device_sample(state, k=state.link.sent[-1].k + 1))

    assert decided.actions == []
    link = decided.state.link
    assert decided.state == changed(state, pending=link.pending, device_seq=link.device_seq)


def test_sample_with_an_echo_of_an_unsent_frame_is_ignored() -> None:
    """S4: a repeated old EXCHANGE caused it, with the k of an exchange on its way."""
    bench = rested()
    state, now = bench.loop.state, bench.ports.now
    ours = Sent(state.link.seq - 1, state.last_reported_k + 1, now, now, 0)
    state = changed(state, sent=(ours,), last_round_trip_ns=now - 40 * MS)
    sample = device_sample(state, k=ours.k, echo=ours.seq)

    assert heard(bench, sample, state).state.link.last_round_trip_ns == now
    old = heard(bench, sample._replace(echo=state.link.seq + 3), state)
    assert old.state.link.last_round_trip_ns == now - 40 * MS
    assert old.state.link.sent == (ours,)
    assert old.of(Publish) == []


def test_sample_of_an_unknown_device_is_ignored() -> None:
    """S4: the sample proves nothing about the next device."""
    bench = rested()
    state = _asked(bench)
    sample = device_sample(state, k=state.link.sent[0].k)
    unmet = changed(state, device=None)

    decided = heard(bench, sample, unmet)

    assert decided.actions == []
    link = decided.state.link
    assert decided.state == changed(unmet, pending=link.pending, device_seq=link.device_seq)


@pytest.mark.parametrize(("u_k", "trips"), [(0, False), (1, True)])
def test_at_rest_the_device_applies_nothing(u_k: int, trips: bool) -> None:
    """S5: outside RUN 0 is expected, whatever the code of the exchange was."""
    bench = rested()
    state = _asked(bench)

    decided = heard(bench, device_sample(state, k=state.link.sent[0].k, u_k=u_k))

    assert (decided.state.fault is not None) == trips
    if decided.state.fault is not None:
        assert decided.state.fault.id is Id.APPLIED


def test_applied_code_is_compared_with_the_rounded_code() -> None:
    """S5: 10 bits of duty round the code."""
    bench = driven()
    state = _asked(bench)
    held = state.link.sent[0].code
    coarse = changed(state, device=state.device._replace(pwm_bits=10))

    as_sent = heard(
        bench, device_sample(state, k=state.link.sent[0].k, u_k=held, flags=int(Flag.RUN)), coarse
    )

    assert f"applied code {held}, but code {held} was commanded" in as_sent.state.fault.cause


def test_the_applied_code_after_a_trip_does_not_cause_a_second_fault() -> None:
    bench = rested()
    state = changed(_asked(bench), phase=Phase.FAULT, fault=Fault(Id.LEASE, "ran out"))

    decided = heard(bench, device_sample(state, k=state.link.sent[0].k, u_k=9), state)

    assert decided.state.fault == Fault(Id.LEASE, "ran out")


# -- samples of scheduled runs -------------------------------------------------------------------


@pytest.mark.parametrize("way_is_known", [False, True])
def test_schedule_of_a_sample_counts_from_the_start_without_a_clock_map(
    way_is_known: bool,
) -> None:
    bench = _playing()
    clock = bench.loop.state.clock.map._replace(weight=0.0) if way_is_known else ClockMap()
    state = changed(bench.loop.state, map=clock)
    run = state.run

    (sample,) = _published(_due(bench, state))

    assert sample.t_sched_ns == run.t_zero_ns + run.due * 5_000_000
    assert sample.k == run.k_first + run.due


@pytest.mark.parametrize("known", [7, 8])
def test_clock_map_needs_eight_exchanges_to_schedule_a_sample(known: int) -> None:
    """With one fewer, the start's own time is better."""
    bench = _playing()
    state = bench.loop.state
    trips = state.clock.map.round_trips
    few = changed(state, map=state.clock.map._replace(round_trips=trips[:1] * known))
    run = state.run

    (sample,) = _published(_due(bench, few, t_us=state.t_us + 5_000 & 0xFFFFFFFF))

    assert (sample.t_sched_ns == run.t_zero_ns + run.due * 5_000_000) == (known < 8)


@pytest.mark.parametrize(
    ("flags", "u", "trips"),
    [
        (Flag.RUN, 0, True),
        (Flag.RUN | Flag.UNDERRUN, 0, False),
        (Flag.RUN | Flag.UNDERRUN, 6554, False),
    ],
)
def test_a_wrong_code_in_a_run_is_a_fault_except_after_an_underrun(
    flags: Flag, u: int, trips: bool
) -> None:
    """S5: the device reports an underrun, and the policy's code is published."""
    bench = _playing()
    decided = _due(bench, bench.loop.state, flags=int(flags), u_k=u)

    assert (decided.state.fault is not None) == trips
    if trips:
        assert decided.state.fault.id is Id.APPLIED
    else:
        (sample,) = _published(decided)
        said = f"sample {sample.k} had no setpoint: its input was {u / 13107:.3g} V"
        assert decided.told(Log)[0].message == said


def test_a_sample_that_is_ahead_reports_the_missing_ones_before_it() -> None:
    """L2: each with the voltage of its own setpoint."""
    bench = _playing()
    run = bench.loop.state.run

    decided = _due(bench, bench.loop.state, ahead=3)

    gaps = decided.told(Gap)
    first = run.k_first + run.due
    assert [(g.k_first, g.count) for g in gaps] == [(first + i, 1) for i in range(3)]
    assert all(g.u_held_v == pytest.approx(2.0, abs=0.003) for g in gaps)
    assert decided.state.run.due == run.due + 4


def test_echo_proves_the_round_trip_of_its_frame() -> None:
    """S4: the age is that of the newest frame whose echo has come."""
    bench = _playing()
    state = bench.loop.state
    older, newer = Unechoed(0xFFFF, 11), Unechoed(0, 22)
    waiting = changed(state, beats=(older, newer), last_round_trip_ns=5)

    assert replies.note_echo(waiting, 0xFFFE) == (waiting, [])
    half_a_round_away = changed(waiting, beats=(older,))
    assert replies.note_echo(half_a_round_away, 0x7FFF)[0] == half_a_round_away
    first, _ = replies.note_echo(waiting, 0xFFFF)
    assert first == changed(waiting, beats=(newer,), last_round_trip_ns=11)
    both, _ = replies.note_echo(waiting, 0)
    assert both == changed(waiting, beats=(), last_round_trip_ns=22)
