"""Setpoints kept ahead of a device that paces itself: frames and their times, from built states."""

from __future__ import annotations

import pytest
from armrig_core.commands.codes import GapCode
from armrig_core.rig.volts import code_of, device_code, volts_of
from armrig_daemon import pipe
from armrig_daemon.decisions import gaps, outcomes, setpoints, step
from armrig_daemon.decisions.budget import PING_INTERVAL_US
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.requests import MAX_REMEMBERED_FRAMES, send
from armrig_daemon.decisions.state import (
    ActiveRun,
    DecisionState,
    Emit,
    Ordered,
    Phase,
    Publish,
    Queue,
    Received,
    RequestKind,
    Send,
    Tick,
    Unechoed,
)
from armrig_daemon.pipe import Answer, Gap, RunEnded, RunStarted
from armrig_protocol import messages as wire
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import SETPOINTS_PER_FRAME, TYPES, Flag
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import (
    RUN,
    Decided,
    armed,
    awaiting,
    changed,
    device_sample,
)
from tests.daemon.virtual_bench import MS, codes

N = SETPOINTS_PER_FRAME
NOW = 5_000 * MS
CODES = [500 + i for i in range(1000)]
ORDER: pipe.Run = changed(RUN, scheduled=True)
SMALL = code_of(1.0)


def _state(
    samples: int = 1000, *, base: int = 0, held: int = 0, sent: int = 0, moved_ns: int = NOW
) -> DecisionState:
    """Return a state in which a run's queue is being filled."""
    state = armed().loop.state
    data = b"".join(u.to_bytes(2, "little") for u in CODES[:samples])
    run = ActiveRun("r", data, -1, scheduled=True)
    queue = Queue(ORDER, base, held, sent, moved_ns, NOW)
    return changed(state, run=run, queue=queue, scheduled=True, beats=())


def _running(due: int = 10, samples: int = 100, **fields: object) -> DecisionState:
    """Return a state in which the device plays the run, from k 200 on."""
    state = _state(samples, base=due, held=samples, sent=samples)
    assert state.run is not None
    run = changed(state.run, k_first=200, due=due, t_zero_ns=NOW)
    known = {
        "phase": Phase.ACTIVE,
        "last_reported_k": 199 + due,
        "absent": (),
        "k": 190,
        "tick_ns": NOW,
    }
    playing = changed(state, run=run, device_state=int(DeviceState.RUN), **known)
    return changed(playing, **{"last_round_trip_ns": NOW, "ping_ns": NOW, **fields})


def _frames(actions: list) -> list[tuple[int, int]]:
    """Return (k0, n) of the frames of setpoints; each has the run's codes, then zeros."""
    found = []
    for action in actions:
        assert isinstance(action, Send)
        for m in feed(b"", action.data)[1]:
            assert isinstance(m, wire.Setpoints)
            assert m.u == (*CODES[m.k0 : m.k0 + m.n], *[0] * (N - m.n))
            assert m.zero == 0
            found.append((m.k0, m.n))
    return found


def _received(message: wire.Message) -> Received:
    return Received(b"\0" + encode(message))


IS_IDLE = _received(wire.Ack(int(DeviceState.IDLE), 0, 0, 0, 1))
"""Any frame of a device that has stopped."""


# -- filling -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("samples", "base", "held", "sent", "frames"),
    [
        (1000, 0, 0, 0, [(N * i, N) for i in range(8)]),
        (1000, 0, 0, 480, [(480, N)]),  # room for 512: 8 places are too few for a frame
        (1000, 0, 0, 504, []),
        (1000, 16, 16, 504, [(504, N)]),
        (1000, 15, 15, 504, []),
        (30, 0, 0, 0, [(0, N), (24, 6)]),  # the last of a run goes as it is
        (30, 0, 0, 30, []),
        (N, 0, 0, 0, [(0, N)]),
        (1, 0, 0, 0, [(0, 1)]),
    ],
)
def test_a_refill_fills_the_free_places_of_the_queue(
    samples: int, base: int, held: int, sent: int, frames: list[tuple[int, int]]
) -> None:
    state = _state(samples, base=base, held=held, sent=sent)

    after, actions = step.carry_out(NOW, setpoints.refill(state, NOW))

    assert _frames(actions) == frames
    assert after.queue.sent == sent + sum(n for _, n in frames)


@pytest.mark.parametrize(("after_ns", "again"), [(30 * MS, False), (30 * MS + 1, True)])
def test_unconfirmed_setpoints_are_sent_again(after_ns: int, again: bool) -> None:
    state = _state(100, base=0, held=24, sent=100, moved_ns=NOW - after_ns)

    after, actions = step.carry_out(NOW, setpoints.refill(state, NOW))

    assert _frames(actions) == ([(24, N), (48, N), (72, N), (96, 4)] if again else [])
    assert (after.queue.sent, after.queue.held) == (100, 24)
    assert after.queue.moved_ns == (NOW if again else NOW - after_ns)


@pytest.mark.parametrize(("sent", "moved_ns"), [(24, NOW), (48, 7)])
def test_time_to_resend_counts_from_the_first_unconfirmed_frame(sent: int, moved_ns: int) -> None:
    state = _state(100, base=0, held=24, sent=sent, moved_ns=7)
    with_nothing_late = changed(state, queue=changed(state.queue, moved_ns=7))

    after, _ = step.carry_out(NOW, setpoints.refill(with_nothing_late, 7 + 30 * MS))

    assert after.queue.moved_ns == (7 + 30 * MS if moved_ns == NOW else 7)


@pytest.mark.parametrize(
    "change",
    [{"queue": None}, {"run": None}, {"device": None}, {"phase": Phase.FAULT}],
)
def test_refill_without_a_playable_run_sends_nothing(change: dict[str, object]) -> None:
    state = changed(_state(), **change)

    assert step.carry_out(NOW, setpoints.refill(state, NOW)) == (state, [])
    stopping = awaiting(_state(), RequestKind.STOP)
    assert step.carry_out(NOW, setpoints.refill(stopping, NOW)) == (stopping, [])


@pytest.mark.parametrize(
    ("volts", "trips"),
    [([1.0, 2.0], False), ([1.0, 2.1], True), ([1.1], True), ([1.0] * 24 + [2.1], True)],
)
def test_a_frame_outside_the_limits_is_not_sent(volts: list[float], trips: bool) -> None:
    """S1."""
    state = _state()
    run = ActiveRun("r", codes(*volts), -1, scheduled=True)
    limited = changed(state, run=run, rules=changed(state.rules, slew=SMALL + 1))

    after, actions = step.carry_out(NOW, setpoints.refill(limited, NOW))

    sent = [m for a in actions if isinstance(a, Send) for m in feed(b"", a.data)[1]]
    assert (after.fault is not None) == trips
    assert any(isinstance(m, wire.Stop) for m in sent) == trips
    whole = [m.n for m in sent if isinstance(m, wire.Setpoints)]
    assert whole == ([len(volts)] if not trips else [24] if len(volts) > 24 else [])
    if after.fault is not None:
        at = 24 if len(volts) > 24 else 0
        assert after.fault == Fault(
            Id.LIMITS, f"a voltage from u[{at}] on is not within the limits"
        )


def test_a_run_begins_by_filling_the_queue_at_0_v() -> None:
    state = changed(_state(), run=None, queue=None)

    after, actions = step.carry_out(NOW, setpoints.begin(state, NOW, ORDER))

    assert after.run == ActiveRun("r", ORDER.codes, -1, scheduled=True)
    assert after.run.due == 0
    assert after.queue == Queue(ORDER, 0, 0, 2, NOW, NOW)
    assert [(m.k0, m.n) for a in actions for m in feed(b"", a.data)[1]] == [(0, 2)]


# -- what the device says it holds ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("samples", "queued", "starts"),
    [(1000, 487, False), (1000, 488, True), (30, 29, False), (30, 30, True)],
)
def test_a_run_starts_when_less_than_a_frame_of_its_queue_is_free(
    samples: int, queued: int, starts: bool
) -> None:
    state = _state(samples, sent=samples)

    after, _ = step.carry_out(NOW, setpoints.note_queue(state, NOW, 0, queued))

    asks = after.asked is not None and after.asked.want is RequestKind.START
    assert asks == starts
    if after.asked is not None:
        assert after.asked.order == ORDER
    busy, _ = step.carry_out(
        NOW, setpoints.note_queue(awaiting(state, RequestKind.ARM), NOW, 0, queued)
    )
    assert busy.asked.want is RequestKind.ARM


@pytest.mark.parametrize(("after_ns", "gives_up"), [(2_000 * MS, False), (2_000 * MS + 1, True)])
def test_a_run_is_abandoned_if_its_queue_is_not_full_within_2_s(
    after_ns: int, gives_up: bool
) -> None:
    state = _state(sent=512, moved_ns=NOW + after_ns)

    after, _ = step.carry_out(NOW, setpoints.note_queue(state, NOW + after_ns, 0, 3))

    stops = after.asked is not None and after.asked.want is RequestKind.STOP
    assert stops == gives_up
    assert after.outcome == ("the device does not take the setpoints" if gives_up else "")


@pytest.mark.parametrize(
    ("base", "queued", "held", "moved", "sent"),
    [(3, 30, 33, True, 50), (3, 21, 24, False, 50), (3, 60, 63, True, 63), (3, 10, 13, False, 50)],
)
def test_the_queue_level_follows_the_newest_sample_of_the_device(
    base: int, queued: int, held: int, moved: bool, sent: int
) -> None:
    state = _state(50, base=0, held=24, sent=50, moved_ns=7)

    after, _ = step.carry_out(
        NOW, setpoints.note_queue(changed(state, phase=Phase.FAULT), NOW, base, queued)
    )

    known = (after.queue.base, after.queue.held, after.queue.sent, after.queue.moved_ns)
    assert known == (base, held, sent, NOW if moved else 7)


@pytest.mark.parametrize("gone", ["queue", "run"])
def test_queue_report_without_a_run_is_ignored(gone: str) -> None:
    state = changed(_state(), **{gone: None})
    assert step.carry_out(NOW, setpoints.note_queue(state, NOW, 5, 6)) == (state, [])


def test_refill_follows_a_queue_report() -> None:
    state = changed(_state(held=512, sent=512), phase=Phase.ACTIVE)

    _, actions = step.carry_out(NOW, setpoints.note_queue(state, NOW, 48, 464))

    assert _frames(actions) == [(512, N), (536, N)]


# -- looking after it ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("since_ns", "pings"), [(PING_INTERVAL_US * 1000, 1), (PING_INTERVAL_US * 1000 - 1, 0)]
)
def test_ping_interval_of_a_scheduled_run(since_ns: int, pings: int) -> None:
    state = _running(ping_ns=NOW - since_ns)

    after, actions = step.carry_out(NOW, setpoints.tick(state, NOW))

    sent = [m for a in actions if isinstance(a, Send) for m in feed(b"", a.data)[1]]
    assert [m.host_ns for m in sent if isinstance(m, wire.Ping)] == [NOW] * pings
    assert after.link.ping_ns == (NOW if pings else NOW - since_ns)


def test_stop_is_repeated_while_the_device_drives_after_a_trip() -> None:
    """S6: the device gets neither setpoint nor PING meanwhile."""
    latched = _running(phase=Phase.FAULT, ping_ns=0)

    after, actions = step.carry_out(NOW, setpoints.tick(latched, NOW))
    waiting = step.carry_out(NOW, setpoints.tick(after, NOW))

    sent = [m for a in actions if isinstance(a, Send) for m in feed(b"", a.data)[1]]
    assert [type(m) for m in sent] == [wire.Stop]
    assert waiting == (after, [])


def test_tick_of_a_scheduled_run_sends_ping() -> None:
    state = _running(ping_ns=0)

    decided = Decided(state, NOW + 30 * MS, Tick(state.k + 3, NOW + 30 * MS))

    assert {type(m) for m in decided.sent} == {wire.Ping}
    assert decided.state.absent == ()


def test_the_number_of_stored_frames_without_an_echo_is_bounded() -> None:
    """R1: only where the device paces is the echo the only proof."""
    state = _running()
    for _ in range(MAX_REMEMBERED_FRAMES + 3):
        state, _ = send(state, NOW, b"x")
    last = (state.link.seq - 1) & 0xFFFF

    assert len(state.link.beats) == MAX_REMEMBERED_FRAMES
    assert state.link.beats[-1] == Unechoed(last, NOW)
    assert send(changed(state, scheduled=False, beats=()), NOW, b"x")[0].link.beats == ()
    assert send(changed(state, seq=0xFFFF), NOW, b"x")[0].link.seq == 0
    assert state.link.last_send_ns == NOW


def test_no_setpoint_is_sent_without_a_link() -> None:
    state = changed(_running(), link=None)

    assert send(state, NOW, b"x") == (state, [])


# -- its samples ---------------------------------------------------------------------------------


def test_a_sample_of_the_run_is_published_with_its_k() -> None:
    state = changed(_running(), t_us=(5 << 32) - 1)
    u = device_code(CODES[10], 10)
    sample = device_sample(
        state, k=10, u_k=u, u_km1=7, flags=int(Flag.RUN), queued=44, t_us=123, y0=5
    )

    after, actions = step.handle_sample(state, NOW + 3, sample)

    (published,) = [a for a in actions if isinstance(a, Publish)]
    s = published.sample
    assert (s.k, s.t_host_ns, s.counts_0, published.queued) == (210, NOW + 3, 5, 44)
    assert (s.u_cmd_v, s.u_applied_v) == (volts_of(CODES[10]), volts_of(u))
    assert (after.last_reported_k, after.applied, after.t_us) == (210, u, (5 << 32) + 123)
    assert after.run.due == 11
    assert (after.queue.base, after.queue.held) == (11, 55)
    assert after.fault is None


@pytest.mark.parametrize(
    ("back_us", "taken"),
    [(-1, True), (0, True), (1, False), (1 << 30, False), (1 - (1 << 31), True), (1 << 31, False)],
)
def test_sample_of_an_earlier_run_is_ignored(back_us: int, taken: bool) -> None:
    """S5: within one boot it has the number that is due, and an older stamp."""
    state = changed(_running(), t_us=(5 << 32) + 2_000)
    sample = device_sample(
        state, k=10, u_k=device_code(CODES[10], 10), flags=int(Flag.RUN), t_us=2_000 - back_us
    )
    sample = sample._replace(t_us=sample.t_us & 0xFFFFFFFF)

    after, actions = step.handle_sample(state, NOW, sample)

    assert bool(actions) == taken
    assert (after == state) != taken


@pytest.mark.parametrize("k", [9, 100, 99, 10])
def test_only_outstanding_samples_belong_to_the_run(k: int) -> None:
    state = _running()
    u = device_code(CODES[k], 10)
    sample = device_sample(state, k=k, u_k=u, flags=int(Flag.RUN))

    _, actions = step.handle_sample(state, NOW, sample)

    assert bool([a for a in actions if isinstance(a, Publish)]) == (k in (10, 99))


@pytest.mark.parametrize("k_first", [-1, 0])
def test_a_run_may_begin_at_k_0(k_first: int) -> None:
    state = _running(due=0)
    assert state.run is not None
    first = changed(state, run=changed(state.run, k_first=k_first), last_reported_k=-1)
    u = device_code(CODES[0], 10)

    _, actions = step.handle_sample(
        first, NOW, device_sample(state, k=0, u_k=u, flags=int(Flag.RUN))
    )

    assert [a.sample.k for a in actions if isinstance(a, Publish)] == [0] * (k_first == 0)


@pytest.mark.parametrize(
    "change",
    [{"run": None}, {"device": None}, {"run": ActiveRun("r", codes(1.0), -1, scheduled=True)}],
)
def test_sample_before_the_start_of_a_run_is_ignored(change: dict[str, object]) -> None:
    state = _running()
    sample = device_sample(state, k=10, flags=int(Flag.RUN))
    without = changed(state, **change)

    assert step.handle_sample(without, NOW, sample) == (without, [])


@pytest.mark.parametrize("bits", [8, 10, 16])
@pytest.mark.parametrize("steps", [-1, 0, 1])
def test_a_duty_one_step_from_the_setpoint_trips(bits: int, steps: int) -> None:
    """S5: another voltage than the commanded one, however small the difference."""
    state = _running()
    state = changed(state, device=state.device._replace(pwm_bits=bits))
    u = device_code(CODES[10] + steps * (1 << 16 - bits), bits)

    after, actions = step.handle_sample(
        state, NOW, device_sample(state, k=10, u_k=u, flags=int(Flag.RUN))
    )

    assert [a.sample.u_applied_v for a in actions if isinstance(a, Publish)] == [volts_of(u)]
    assert (after.fault is not None) == (steps != 0)
    if after.fault is not None:
        assert after.fault.id is Id.APPLIED
        assert f"applied code {u}, but code {CODES[10]} was commanded" in after.fault.cause


def test_the_applied_code_of_a_sample_outside_run_is_not_checked() -> None:
    state = _running()
    after, _ = step.handle_sample(state, NOW, device_sample(state, k=10, u_k=1, flags=0))

    assert after.fault is None


def _told_at_the_end(state: DecisionState) -> list[Gap]:
    _, actions = gaps.end_run(state, NOW, complete=True)
    return [a.record for a in actions if isinstance(a, Emit) and isinstance(a.record, Gap)]


def test_end_of_a_run_reports_the_missing_samples() -> None:
    """L2: each with the voltage of its own setpoint, as the duty gives it."""
    state = _running(due=97)

    told = _told_at_the_end(state)

    assert [(g.k_first, g.count, g.code) for g in told] == [
        (200 + i, 1, GapCode.FRAME_LOST) for i in (97, 98, 99)
    ]
    assert [g.u_held_v for g in told] == [volts_of(device_code(CODES[i], 10)) for i in (97, 98, 99)]
    assert gaps.end_run(state, NOW, complete=True)[1][-1].record.outcome == "complete"
    stopped = changed(state, outcome="stopped")
    assert gaps.end_run(stopped, NOW, complete=True)[1][-1].record.outcome == "stopped"


def test_the_voltage_of_a_lost_sample_is_not_rounded_without_a_device() -> None:
    told = _told_at_the_end(_running(due=98, device=None))

    assert [g.u_held_v for g in told] == [volts_of(code) for code in CODES[98:100]]


def test_only_the_last_pieces_of_a_long_outage_are_reported() -> None:
    """R1: the pieces are bounded."""
    state = _running(due=0, samples=1000)
    state = changed(state, run=changed(state.run, codes=codes(1.0) * 1500), sent=())

    told = _told_at_the_end(state)

    assert [(g.k_first, g.count) for g in told[:2]] == [(200, 500), (700, 1)]
    assert len(told) == 1 + gaps.MAX_MISSING_PIECES


@pytest.mark.parametrize(
    ("due", "after_ns", "is_over"),
    [(100, 0, True), (99, 1000 * MS - 1, False), (99, 1000 * MS, True), (0, 1000 * MS, True)],
)
def test_run_without_an_end_event_is_complete_after_its_duration(
    due: int, after_ns: int, is_over: bool
) -> None:
    state = _running(due=due)
    assert state.ts_us * state.run.samples == 1000_000

    decided = Decided(state, NOW + after_ns, IS_IDLE)

    assert (decided.state.fault is None) == is_over
    outcomes = [r.outcome for r in decided.told(RunEnded)]
    assert outcomes == (["complete"] if is_over else [])
    if is_over:
        assert decided.state.lease is None
        assert decided.state.asked.want is RequestKind.CONFIGURE


def test_a_run_ends_only_by_the_transition_from_run_to_idle() -> None:
    over = _running(due=100)

    for before, now in ((5, 3), (3, 2)):
        state = changed(over, device_state=before)
        decided = Decided(state, NOW, _received(wire.Ack(now, 0, 0, 0, 1)))
        assert decided.state.fault.id is Id.STATE


# -- the start -----------------------------------------------------------------------------------


def test_a_scheduled_run_has_started_when_the_device_runs() -> None:
    """Its first sample comes one Ts after START arrived."""
    state = changed(_state(100, held=100, sent=100), ts_us=5_000, k=41, last_round_trip_ns=0)
    state = changed(state, code=9, outcome="of the run before", beats=(Unechoed(1, 2),))
    asked = awaiting(state, RequestKind.START, ORDER, sent_ns=NOW)

    ack = wire.Ack(int(DeviceState.RUN), 0, TYPES[wire.Start], 0, asked.asked.seq)
    decided = Decided(asked, NOW + 2 * MS, _received(ack))

    (started,) = decided.told(RunStarted)
    assert (started.k_first, started.count, started.t_host_ns) == (42, 100, NOW + 2 * MS)
    assert [(a.order, a.body) for a in decided.told(Answer)] == [(73, {"done": True})]
    after = decided.state
    assert (after.run.k_first, after.run.t_zero_ns) == (42, NOW + 1 * MS + 5 * MS)
    assert after.phase is Phase.ACTIVE
    assert (after.code, after.outcome, after.link.beats) == (0, "", ())
    assert after.link.last_round_trip_ns == NOW
    assert after.queue.order is None
    assert after.lease is not None
    assert after.lease == state.lease


def test_a_trip_while_the_queue_is_filled_refuses_the_run() -> None:
    fault = Fault(Id.PAUSE, "the host paused")
    latched, _ = step.carry_out(NOW, (_state(), [outcomes.Trip(fault)]))
    assert latched.asked is not None

    later = Decided(latched, NOW + 5 * MS, IS_IDLE)

    assert [(a.order, a.error) for a in later.told(Answer)] == [(73, "the host paused")]
    assert [type(r).__name__ for r in later.told(RunEnded)] == ["RunEnded"]
    assert later.told(Gap) == []


def test_a_scheduled_run_is_prepared_by_a_stop_and_its_configuration() -> None:
    bench = armed()
    stop = Decided(bench.loop.state, NOW, Ordered(ORDER)).state
    assert stop.lease is not None

    configure = Decided(changed(stop, lease=changed(stop.lease, ts_us=900)), NOW, IS_IDLE)

    asked = configure.state.asked
    assert (asked.want, asked.order) == (RequestKind.CONFIGURE, ORDER)
    assert (asked.ts_us, asked.scheduled) == (900, True)
    assert configure.state.lease is not None
    assert not [a for a in configure.actions if isinstance(a, Emit)]
    assert not [m for m in configure.sent if isinstance(m, wire.Start)]
