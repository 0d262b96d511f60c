"""Scheduled mode in virtual time: what the rules of `conformance/` do not reach."""

from __future__ import annotations

from itertools import pairwise

import pytest
from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import frame
from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Cause, Flag, Mode, State, Underrun
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.daemon.emulator.emulated_host import (
    BAUD,
    CONFIG,
    CONVERSION_NS,
    HOLD_NS,
    MS,
    QUIET,
    SAMPLE_NS,
    US,
    Host,
    S,
    bytes_of,
    events,
    only,
)

TS_NS = 500 * US
SCHEDULED: dict[str, int] = {**CONFIG, "mode": Mode.SCHEDULED, "ts_us": 500, "watchdog_ms": 250}
INSTANT = EmulatorSettings(model_baud=False, boot_ms=5.0, adc_noise_v=0.0, pwm_bits=0, adc_bits=0)
NOISE = [(7919 * k + 5) % 65536 for k in range(4000)]


def in_state(state: State, emulated: EmulatorSettings = QUIET, **config: int) -> Host:
    """Return a host whose device is in `state` with a configuration of this mode."""
    return Host(emulated).reach(state, **{**SCHEDULED, **config})


def samples(messages: list[wire.Message]) -> list[wire.Sample]:
    """Return the samples among them."""
    return [m for m in messages if isinstance(m, wire.Sample)]


def until(host: Host, t_ns: int) -> list[wire.Message]:
    """Return what comes until `t_ns`; the host keeps quiet."""
    return host.wait(t_ns - host.now_ns)


def fed(host: Host, dt_ns: int) -> list[wire.Message]:
    """Return what comes within `dt_ns`, with a KEEPALIVE every 50 ms."""
    came: list[wire.Message] = []
    end_ns = host.now_ns + dt_ns
    while host.now_ns < end_ns:
        host.put(wire.Keepalive)
        came += host.wait(min(50 * MS, end_ns - host.now_ns))
    return came


# ------------------------------------------------------------------ the mode and its frame


@pytest.mark.parametrize(
    ("frames", "trips"),
    [
        ([(0, [150])], False),
        ([(0, [151])], True),
        ([(0, [49])], True),
        ([(0, [150, 200])], False),
        ([(0, [150, 201])], True),
        ([(0, [150]), (1, [200])], False),
        ([(0, [150]), (1, [201])], True),
        ([(0, [150, 200]), (1, [200, 251])], True),
        ([(1, [65535])], False),  # after a gap: no step is known
    ],
)
def test_a_step_of_more_than_slew_trips(frames: list[tuple[int, list[int]]], trips: bool) -> None:
    host = in_state(State.ARMED, slew=50, u_rest=100)

    for k0, u in frames:
        host.supply(k0, u)
    answers = host.wait(3 * MS)

    assert events(answers) == ([(State.ARMED, State.FAULT, Cause.SLEW)] if trips else [])
    if trips:
        assert only(wire.Event, answers).detail == frames[-1][1][-1]


@pytest.mark.parametrize(
    ("k0", "u", "trips"),
    [(5, [50], False), (5, [51], True), (4, [60, 50], False), (4, [60, 51], True)],
)
def test_after_an_underrun_the_slew_counts_from_the_voltage_of_the_motor(
    k0: int, u: list[int], trips: bool
) -> None:
    host = in_state(State.ARMED, INSTANT, slew=50)
    host.supply(0, [40, 80])
    t_0 = host.put(wire.Start, k_stop=0) + TS_NS
    until(host, t_0 + 5 * TS_NS)

    host.supply(k0, u)
    until(host, t_0 + 6 * TS_NS)

    assert host.device.state is (State.FAULT if trips else State.RUN)


# ------------------------------------------------------------------ the queue


@pytest.mark.parametrize("late", [False, True])
def test_a_setpoint_is_in_time_until_the_latch(late: bool) -> None:
    """A nanosecond after the latch it is late."""
    host = in_state(State.ARMED, INSTANT)
    t_0 = host.put(wire.Start, k_stop=0) + TS_NS

    until(host, t_0 + HOLD_NS - 1)
    host.now_ns += 1 + late
    host.supply(0, [1000, 2000])
    first, second = samples(until(host, t_0 + 2 * TS_NS - CONVERSION_NS))

    assert (first.u_k, bool(first.flags & Flag.UNDERRUN)) == (0 if late else 1000, late)
    assert (second.u_k, bool(second.flags & Flag.UNDERRUN)) == (2000, False)


def test_indices_wrap_with_k() -> None:
    host = in_state(State.ARMED, INSTANT)
    fw = host.device._fw
    host.put(wire.Start, k_stop=0)
    host.wait(300 * US)
    # As after 24.8 days.
    last = 2**32 - 3
    fw.timer.first_ns -= last * fw.timer.period_ns
    fw.timer.k = fw.queue.next = last

    host.supply(last, [1, 2, 3, 4])
    got = samples(host.wait(700 * US))
    host.supply(1, [5, 6, 7])
    got += samples(host.wait(4 * MS))

    assert [m.k for m in got[:6]] == [last, last + 1, last + 2, 0, 1, 2]
    assert [m.u_k for m in got[:6]] == [1, 2, 3, 4, 5, 6]


# ------------------------------------------------------------------ time


def test_the_first_sample_comes_one_ts_after_start() -> None:
    """The trigger of theta_1 is at t_0 + k Ts, that of alpha before it, the latch 12 µs later."""
    host = in_state(State.ARMED)
    host.supply(0, [65535, 0])
    host.wait(1 * MS)

    t_r = host.put(wire.Start, k_stop=0)
    answers = host.wait(2 * MS)

    assert [type(m) for m in answers] == [
        wire.Ack,
        wire.Event,
        wire.Sample,
        wire.Sample,
        wire.Sample,
    ][: len(answers)]
    heard = [h for h in host.heard if isinstance(h.message, wire.Sample)]
    first, second = (h.message for h in heard[:2])
    assert isinstance(first, wire.Sample)
    assert isinstance(second, wire.Sample)
    t_0 = t_r + TS_NS
    assert (first.k, first.t_us, first.u_k) == (0, t_0 // US, 65535)
    assert (second.k, second.t_us, second.u_k) == (1, (t_0 + TS_NS) // US, 0)
    assert heard[0].t_ns == t_0 + CONVERSION_NS + SAMPLE_NS
    on, off = host.changes[-2:]
    assert on == Change(t_0 + HOLD_NS, 5.0, State.RUN, Cause.REQUEST)
    assert off == Change(t_0 + TS_NS + HOLD_NS, 0.0, State.RUN, Cause.REQUEST)


@pytest.mark.parametrize("ppm", [0.5, 100.0, -500.0])
def test_nothing_drifts_by_the_device_s_clock(ppm: float) -> None:
    """t_us is t_0 + k Ts to the µs; in given time each Ts takes 1 + ppm 1e-6."""
    quiet = EmulatorSettings(baud=BAUD, boot_ms=5.0, adc_noise_v=0, pwm_bits=0, clock_ppm=ppm)
    host = in_state(State.ARMED, quiet)
    host.changes.clear()
    host.supply(0, [65535 * (k % 2) for k in range(24)])
    t_r = host.put(wire.Start, k_stop=0)

    got = samples(fed(host, 2 * S))

    assert len(got) > 3990
    t_0_ns = t_r * 10**9 // (10**9 + round(ppm * 1000)) + TS_NS
    assert [m.t_us for m in got] == [(t_0_ns + m.k * TS_NS) // US for m in got]
    assert [m.k for m in got] == list(range(len(got)))
    ons = [c.t_ns for c in host.changes]
    assert len(ons) == 24
    stretch = 1 + ppm * 1e-6
    for i, t_ns in enumerate(ons):
        expected = t_r + (TS_NS * (2 + i) + HOLD_NS) * stretch
        assert t_ns == pytest.approx(expected, abs=2)


def test_a_sample_during_a_busy_converter_is_late_and_the_next_is_not() -> None:
    """Two EXCHANGEs just before START keep it for 416 µs; alpha is due after 396 µs."""
    host = in_state(State.ARMED, INSTANT)
    t_r = host.now_ns
    for k in (1, 2):
        host.put(wire.Exchange, k=k, u=0)
    host.put(wire.Start, k_stop=0)

    *asked, first, second = samples(host.wait(2 * MS))[:4]

    assert (first.k, bool(first.flags & Flag.TICK_LATE)) == (0, True)
    assert (second.k, bool(second.flags & Flag.TICK_LATE)) == (1, False)
    assert first.t_us == (t_r + 4 * CONVERSION_NS + CONVERSION_NS) // US
    assert second.t_us == (t_r + 2 * TS_NS) // US
    # RUN has begun meanwhile, with u_rest, which no SETPOINTS brought.
    assert [(m.k, m.u_seq) for m in asked] == [(1, 0), (2, 0)]
    assert only(wire.Status, fed(host, 1 * S)).late == 2  # and the EXCHANGE that waited


# ------------------------------------------------------------------ what is latched


@pytest.mark.parametrize(
    ("policy", "hold", "latched"),
    [
        (Underrun.ZERO, 3, [5, 6, 2, 2, 2, 2]),
        (Underrun.HOLD, 3, [5, 6, 6, 6, 6, 2]),
        (Underrun.HOLD, 0, [5, 6, 2, 2, 2, 2]),
    ],
)
def test_an_empty_queue_follows_the_underrun_policy(
    policy: int, hold: int, latched: list[int]
) -> None:
    host = in_state(State.ARMED, u_rest=2, underrun=policy, hold=hold)
    host.supply(0, [5, 6])
    seq = host.seq
    host.put(wire.Start, k_stop=6)

    got = samples(host.wait(10 * MS))

    assert [m.u_k for m in got] == latched
    assert [bool(m.flags & Flag.UNDERRUN) for m in got] == [False] * 2 + [True] * 4
    assert [m.u_seq for m in got] == [0 if u == 2 else seq for u in latched]
    assert [m.queued for m in got] == [1, 0, 0, 0, 0, 0]
    assert only(wire.Status, host.wait(1 * S)).underruns == 4


def test_hold_counts_again_after_each_setpoint() -> None:
    host = in_state(State.ARMED, INSTANT, underrun=Underrun.HOLD, hold=2)
    t_0 = host.put(wire.Start, k_stop=9) + TS_NS
    got: list[wire.Sample] = []
    for k in range(0, 9, 3):
        host.supply(k, [100 + k])
        got += samples(until(host, t_0 + (k + 2) * TS_NS + 300 * US))
    got += samples(until(host, t_0 + 9 * TS_NS))

    assert [m.u_k for m in got] == [100, 100, 100, 103, 103, 103, 106, 106, 106]


def test_run_begins_with_the_rest_voltage() -> None:
    host = in_state(State.ARMED, u_rest=1000)
    host.supply(0, [2000])
    t_r = host.put(wire.Start, k_stop=0)

    first, second = samples(host.wait(2 * MS))[:2]

    assert [c.t_ns for c in host.changes[-3:]] == [
        t_r,
        t_r + TS_NS + HOLD_NS,
        t_r + 2 * TS_NS + HOLD_NS,
    ]
    assert (first.u_km1, first.u_k) == (1000, 2000)
    assert (second.u_km1, second.u_k, second.u_seq) == (2000, 1000, 0)


def test_a_sample_under_way_when_the_run_ends_reports_its_end() -> None:
    for at_ns, u_km1 in ((HOLD_NS - 1, 500), (HOLD_NS + 1, 500)):
        host = in_state(State.ARMED, INSTANT)
        host.supply(0, [500, 60_000, 60_000])
        t_1 = host.put(wire.Start, k_stop=0) + 2 * TS_NS
        until(host, t_1 + at_ns)
        host.changes.clear()

        host.put(wire.Stop)
        answers = host.wait(5 * MS)

        (sample,) = samples(answers)
        assert (sample.k, sample.state, sample.u_k, sample.u_seq) == (1, State.IDLE, 0, 0)
        assert sample.queued == 0
        assert sample.u_km1 == (u_km1 if at_ns > HOLD_NS else 0)
        assert [c.volts for c in host.changes] == [0.0]


def test_a_scheduled_sample_does_not_use_up_the_place_of_a_later_exchange() -> None:
    host = in_state(State.ARMED, INSTANT)
    until(host, host.put(wire.Start, k_stop=0) + TS_NS + HOLD_NS)

    host.put(wire.Stop)
    host.put(wire.Exchange, k=7, u=0)
    host.put(wire.Exchange, k=8, u=0)

    assert [m.k for m in samples(host.wait(5 * MS))] == [0, 7, 8]


# ------------------------------------------------------------------ guards


def test_the_counts_of_turns_and_rails_start_at_0_in_each_run() -> None:
    host = Host()
    for _ in range(3):
        host.reach(State.ARMED, **{**SCHEDULED, "turns": 25, "ts_us": 3000})
        host.supply(0, [65535] * 20)
        host.put(wire.Start, k_stop=40)
        assert events(fed(host, 150 * MS))[-1] == (State.RUN, State.IDLE, Cause.END)


# ------------------------------------------------------------------ properties

U = [(40_503 * (k + 1)) % 60_001 for k in range(200)]
FRAMES = st.lists(
    st.tuples(
        st.sampled_from(["next", "again", "old", "skip", "lost", "spoilt"]),
        st.integers(1, 24),
        st.integers(0, 8 * MS),
    ),
    min_size=1,
    max_size=40,
)


@settings(max_examples=40)
@given(FRAMES, st.sampled_from(list(Underrun)), st.integers(0, 5), st.randoms())
def test_each_u_k_is_correct_or_flagged_under_any_fault_of_the_frames(
    frames: list[tuple[str, int, int]], policy: int, hold: int, rng: object
) -> None:
    host = in_state(State.ARMED, u_max=60_000, underrun=policy, hold=hold)
    brought: dict[int, range] = {}
    sent: list[bytes] = []
    k0 = 0
    host.put(wire.Start, k_stop=150)
    for what, n, dt_ns in frames:
        start = max(0, k0 - 30) if what == "again" else k0 + 5 if what == "skip" else k0
        u = U[start : start + n]
        if what == "old" and sent:
            host.device.receive(host.now_ns, sent[n % len(sent)])  # the same bytes: stale
        elif u:
            host.seq += 1
            data = frame.encode(
                wire.Setpoints(0, host.seq, start, len(u), 0, (*u, *(0,) * (24 - len(u))))
            )
            brought[host.seq] = range(start, start + len(u))
            sent.append(data)
            if what == "spoilt":
                data = data[:9] + bytes([data[9] ^ 1 or 2]) + data[10:]
            if what != "lost":
                host.device.receive(host.now_ns, data)
            if what == "next":
                k0 += len(u)
        host.wait(dt_ns)
    fed(host, 100 * MS)

    got = [m for m in samples([h.message for h in host.heard]) if m.state == State.RUN]
    assert [m.k for m in got] == list(range(150))
    for m in got:
        if not m.flags & Flag.UNDERRUN:
            assert m.u_k == U[m.k]
            assert m.k in brought[m.u_seq]
        elif m.u_k:  # held
            assert policy == Underrun.HOLD
            assert m.u_k == m.u_km1
    assert all(b.u_km1 == a.u_k for a, b in pairwise(got))
    assert all(0 <= c.volts <= 5 * 60_000 / 65_535 for c in host.changes)
    assert all(c.volts == 0 or c.state is State.RUN for c in host.changes)
    assert host.device.state is State.IDLE
    assert host.device.board.volts == 0.0


COMMANDS = st.one_of(
    st.binary(min_size=1, max_size=20),
    st.sampled_from(
        [
            wire.Keepalive(0, 0),
            wire.Stop(0, 0),
            wire.Estop(0, 0),
            wire.Start(0, 0, 0, 0),
            wire.Start(0, 0, 5, 0),
            wire.Ping(0, 0, 5),
            wire.Hello(0, 0, VERSION, SCHEMA_HASH),
            wire.Config(0, 0, **SCHEDULED),
            wire.Config(0, 0, **CONFIG),
            wire.Arm(0, 0, 0, 0, 0),
            wire.ClearFault(0, 0, 0),
        ]
    ),
    st.builds(lambda u: wire.Exchange(0, 0, 0, u), st.integers(0, 65535)),
    st.builds(
        lambda k0, n: wire.Setpoints(0, 0, k0, n, 0, (*U[k0 : k0 + n], *(0,) * (24 - n))),
        st.integers(0, 40),
        st.integers(0, 24),
    ),
)
SCRIPT = st.lists(st.tuples(st.integers(0, 20 * MS), COMMANDS), max_size=40)


def opening(mode: Mode) -> list[tuple[int, bytes | wire.Message]]:
    """Return the way to RUN; in exchange mode SETPOINTS are refused."""
    return [
        (1 * MS, wire.Hello(0, 0, VERSION, SCHEMA_HASH)),
        (1 * MS, wire.Config(0, 0, **{**SCHEDULED, "mode": mode})),
        (1 * MS, wire.Arm(0, 0, 0, 0, 0)),
        (1 * MS, wire.Setpoints(0, 0, 0, 24, 0, tuple(U[:24]))),
        (1 * MS, wire.Start(0, 0, 0, 0)),
    ]


@settings(max_examples=25)
@given(
    SCRIPT,
    st.lists(st.integers(0, 1 * S), max_size=20),
    st.sampled_from([0.0, 123.4]),
    st.sampled_from(list(Mode)),
)
def test_the_same_bytes_at_the_same_times_give_the_same_answers(
    script: list[tuple[int, bytes | wire.Message]], looks: list[int], ppm: float, mode: Mode
) -> None:
    """S1, S3: 0 to 5 V, in RUN only, and 0 V a watchdog after the last bytes."""
    emulated = EmulatorSettings(baud=BAUD, boot_ms=5, seed=3, clock_ppm=ppm)
    sent = bytes_of(emulated, opening(mode) + script)
    outputs = []
    for extra in ([], looks):
        changes: list[Change] = []
        device = Device(emulated, 0, changes.append)
        replies = []
        acts = sorted([*sent, *((t, b"") for t in extra)], key=lambda a: a[0])
        for t_ns, data in acts:
            replies += device.advance(t_ns)
            device.receive(t_ns, data)
        last_ns = t_ns + device.rx_backlog_ns(t_ns)
        outputs.append((replies + device.advance(2 * S), changes))

    assert outputs[0] == outputs[1]
    assert all(0 <= c.volts <= 5 and (c.volts == 0 or c.state is State.RUN) for c in changes)
    assert device.board.volts == 0.0
    assert all(c.t_ns <= last_ns + 251 * MS for c in changes)


@settings(max_examples=30)
@given(SCRIPT, st.sampled_from([0.0, 500.0, -500.0]), st.booleans(), st.sampled_from(list(Mode)))
def test_visible_time_is_early_enough_for_every_frame(
    script: list[tuple[int, bytes | wire.Message]], ppm: float, model_baud: bool, mode: Mode
) -> None:
    emulated = EmulatorSettings(baud=BAUD, boot_ms=5, clock_ppm=ppm, model_baud=model_baud)
    device = Device(emulated, 0)
    for t_ns, data in [*bytes_of(emulated, opening(mode) + script), (1 * S, b"")]:
        while (due_ns := device.visible_ns()) < t_ns:
            early = device.advance(due_ns - 1)
            assert all(left >= due_ns for left, _ in early)
            device.advance(due_ns)
        device.advance(t_ns)
        device.receive(t_ns, data)
