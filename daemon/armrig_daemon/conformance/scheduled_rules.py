"""Rules of section 6: SETPOINTS, the queue and scheduled mode."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from armrig_core.process.printable import plural
from armrig_core.rig.volts import device_code
from armrig_protocol import messages as wire
from armrig_protocol.messages import (
    SETPOINTS_PER_FRAME,
    Capability,
    Cause,
    Code,
    Flag,
    Mode,
    State,
    Underrun,
)

from armrig_daemon.conformance.exchange_rules import expect_watchdog, interval_us
from armrig_daemon.conformance.host import Broken, LineHost, only
from armrig_daemon.conformance.rule import NotTried, codes, expect, expect_trip, kinds, rule

TS_US = 5_000
NOISE = [(7_919 * k + 5_003) % 60_000 for k in range(2_000)]
_PLACES = SETPOINTS_PER_FRAME
_JITTER_US = 1
_MAX_END_LATE_US = 1_000


class Took(NamedTuple):
    """Messages of a run, from START to its end."""

    samples: list[wire.Sample]
    end: wire.Event
    started: tuple[int, int]
    """Device times of the PINGs before and after START, in µs."""


def arm_scheduled(host: LineHost, **config: int) -> None:
    """Bring the device to ARMED in scheduled mode."""
    if not host.known.capabilities & Capability.SCHEDULED:
        raise NotTried("the device offers no scheduled mode")
    host.reach(State.ARMED, **{"mode": Mode.SCHEDULED, "ts_us": TS_US, **config})


def put_setpoints(host: LineHost, k0: int, u: list[int], **fields: int) -> int:
    """Send one frame of setpoints; return its seq."""
    padded = (*u, *(0,) * (_PLACES - len(u)))
    contents = {"k0": k0, "n": len(u), "zero": 0, **fields}
    return host.put(wire.Setpoints, u=padded, **contents)


def fill(host: LineHost, u: list[int]) -> list[int]:
    """Send setpoints from index 0 on, in full frames; return the seq of each setpoint's frame."""
    seqs: list[int] = []
    for k0 in range(0, len(u), _PLACES):
        part = u[k0 : k0 + _PLACES]
        seqs += [put_setpoints(host, k0, part)] * len(part)
    answers = host.fence()
    expect(not answers, answers)
    return seqs


def run_to_end(host: LineHost, k_stop: int) -> Took:
    """Start a run, and return its messages up to its end."""
    host.fence()
    before = host.rx_us
    host.put(wire.Start, k_stop=k_stop)
    messages = host.fence()
    started = (before, host.rx_us)
    limit_ms = 2 * k_stop * TS_US / 1000 + 3_000

    def ends(m: wire.Message) -> bool:
        return isinstance(m, wire.Event) and m.was == State.RUN

    messages += host.alive(limit_ms, ends)
    events = [m for m in messages if isinstance(m, wire.Event) and m.was == State.RUN]
    if not events:
        raise Broken(f"the run did not end; {plural(len(messages), 'frame')} came")
    return Took([m for m in messages if isinstance(m, wire.Sample)], events[0], started)


def queue_length(host: LineHost) -> int:
    """Return the number of setpoints in the queue of an armed device."""
    return host.sample().queued


@rule(6, "The queue has no gaps: setpoints after a gap are ignored, equal setpoints add nothing")
def _holes(host: LineHost) -> None:
    arm_scheduled(host)
    for k0, u, wanted in (
        (0, [1, 2, 3], 3),
        (3, [4], 4),
        (1, [2, 3], 4),
        (2, [3, 4, 5, 6], 6),
        (7, [8], 6),
    ):
        put_setpoints(host, k0, u)
        answers = host.fence()
        expect(not answers, answers)
        held = queue_length(host)
        expect(held == wanted, f"{held} queued after k0={k0}, n={len(u)}, not {wanted}")


@rule(6, "Setpoints that differ from the queue's are answered BAD_VALUE; the queue does not change")
def _disagree(host: LineHost) -> None:
    arm_scheduled(host)
    fill(host, [1_000, 2_000, 3_000])
    for wrong in ([9, 2_000, 3_000], [1_000, 2_000, 9_000], [1_000, 9, 3_000, 4_000]):
        put_setpoints(host, 0, wrong)
        answers = host.fence()
        expect(codes(answers) == [Code.BAD_VALUE] and len(answers) == 1, answers)
    expect(queue_length(host) == 3, f"{queue_length(host)} queued, not 3")
    bits = host.known.pwm_bits
    got = [m.u_k for m in run_to_end(host, 4).samples]
    wanted = [device_code(u, bits) for u in (1_000, 2_000, 3_000)]
    expect(got == [*wanted, 0], f"u_k {got}, not {[*wanted, 0]}")


@rule(6, "The queue has the capacity in HELLO_R; further setpoints are dropped without an answer")
def _capacity(host: LineHost) -> None:
    arm_scheduled(host)
    queue = host.known.queue
    fill(host, NOISE[: queue + _PLACES])
    held = queue_length(host)
    expect(held == queue, f"{held} queued, {queue} in HELLO_R")


@rule(6, "The queue holds entries of at most `queue`/8 frames, even if the frames are short")
def _frames(host: LineHost) -> None:
    arm_scheduled(host)
    most = host.known.queue // 8
    for k in range(most + 1):
        put_setpoints(host, k, [k])
    answers = host.fence()
    expect(not answers, answers)
    held = queue_length(host)
    expect(
        held == most,
        f"{held} queued of {plural(most + 1, 'frame')} with one setpoint each, not {most}",
    )


@rule(6, "SETPOINTS with n = 0, n > 24, or `zero` other than 0 is answered BAD_VALUE")
def _bad(host: LineHost) -> None:
    arm_scheduled(host)
    for fields in ({"n": 0}, {"n": _PLACES + 1}, {"n": 255}, {"zero": 1}):
        put_setpoints(host, 0, [1, 2], **fields)
        answers = host.fence()
        expect(codes(answers) == [Code.BAD_VALUE] and len(answers) == 1, answers)
        expect(queue_length(host) == 0, "entries in the queue")


@rule(
    6,
    "A frame with a code outside [u_min, u_max] leads to FAULT(RANGE); padding is ignored",
)
def _range(host: LineHost) -> None:
    arm_scheduled(host, u_max=30_000)
    put_setpoints(host, 0, [1, 2])
    padded = (1, 2, 3, *(65_535,) * (_PLACES - 3))
    host.put(wire.Setpoints, k0=0, n=3, zero=0, u=padded)
    answers = host.fence()
    expect(not answers and queue_length(host) == 3, answers)
    _trips(host, 3, [4, 30_001], Cause.RANGE, 30_001)


@rule(6, "A step above `slew` between indices leads to FAULT(SLEW); before index 0, u is u_rest")
def _slew(host: LineHost) -> None:
    for frames, detail in (
        ([(0, [101])], 101),
        ([(0, [100, 201])], 201),
        ([(0, [100, 200]), (2, [301])], 301),
    ):
        host.to_idle()
        arm_scheduled(host, slew=100)
        for k0, u in frames[:-1]:
            put_setpoints(host, k0, u)
        _trips(host, *frames[-1], Cause.SLEW, detail)


def _trips(host: LineHost, k0: int, u: list[int], cause: Cause, detail: int) -> None:
    put_setpoints(host, k0, u)
    expect_trip(host.fence(), State.ARMED, cause, detail)


@rule(6, "Sample k applies u[k], the voltage of index k in the first frame that contains index k")
def _alignment(host: LineHost) -> None:
    arm_scheduled(host)
    n = min(host.known.queue, 120)
    seqs = fill(host, NOISE[:n])
    took = run_to_end(host, n)
    ks = [m.k for m in took.samples]
    expect(
        ks == list(range(n)),
        f"k of {plural(len(ks), 'sample')}, {ks[:3]} ... {ks[-3:]}, not 0 ... {n - 1}",
    )
    bits = host.known.pwm_bits
    for m in took.samples:
        reported = (m.u_k, m.u_seq, m.queued)
        wanted = (device_code(NOISE[m.k], bits), seqs[m.k], n - 1 - m.k)
        expect(reported == wanted, f"k={m.k}: u_k, u_seq, queued {reported}, not {wanted}")
    for a, b in pairwise(took.samples):
        expect(b.u_km1 == a.u_k, f"u_km1 {b.u_km1} after u_k {a.u_k}")


@rule(6, "Sample k is triggered within 1 us of t_0 + k Ts; t_0 is one Ts after START")
def _time(host: LineHost) -> None:
    arm_scheduled(host)
    n = min(host.known.queue, 200)
    fill(host, [0] * n)
    took = run_to_end(host, n)
    t_0 = took.samples[0].t_us
    for m in took.samples:
        off_us = interval_us(t_0, m.t_us) - (m.k - took.samples[0].k) * TS_US
        expect(abs(off_us) <= _JITTER_US, f"k={m.k}: {off_us} us off")
        expect(not m.flags & Flag.TICK_LATE, [m])
    first, last = took.started
    early = interval_us(first, t_0 - took.samples[0].k * TS_US)
    span = interval_us(first, last)
    expect(TS_US <= early <= span + TS_US, f"t_0 {early} us after a PING, START within {span} us")


@rule(6, "With k_stop, the last input is held for one Ts; then EVENT(RUN to IDLE, END) follows")
def _check_end(host: LineHost) -> None:
    arm_scheduled(host)
    fill(host, [1_000] * 10)
    took = run_to_end(host, 5)
    expect(
        [m.k for m in took.samples] == list(range(5)),
        f"{plural(len(took.samples), 'sample')}, not 5",
    )
    end = took.end
    expect((end.state, end.cause) == (State.IDLE, Cause.END), [end])
    held = interval_us(took.samples[-1].t_us, end.t_us) - host.known.hold_us
    is_in_time = TS_US - 2 <= held <= TS_US + _MAX_END_LATE_US
    expect(is_in_time, f"the last input was held for {held} us")
    expect(host.configure(ts_us=0).config_crc == 0, "a configuration after the end")


@rule(6, "An empty queue sets UNDERRUN, and latches u_rest (ZERO) or holds the last code (HOLD)")
def _underrun(host: LineHost) -> None:
    bits = host.known.pwm_bits
    last = device_code(30_000, bits)
    for policy, hold, codes_ in (
        (Underrun.ZERO, 9, [0, 0, 0, 0, 0]),
        (Underrun.HOLD, 2, [last, last, 0, 0, 0]),
        (Underrun.HOLD, 0, [0, 0, 0, 0, 0]),
    ):
        host.to_idle()
        arm_scheduled(host, underrun=policy, hold=hold)
        fill(host, [10_000, 20_000, 30_000])
        took = run_to_end(host, 8)
        flagged = [bool(m.flags & Flag.UNDERRUN) for m in took.samples]
        expect(flagged == [False] * 3 + [True] * 5, f"UNDERRUN at {flagged}")
        got = [m.u_k for m in took.samples[3:]]
        expect(got == codes_, f"{policy.name} {hold}: u_k {got}, not {codes_}")


@rule(6, "Setpoints before `next` are dropped, and `next` advances during an underrun")
def _late(host: LineHost) -> None:
    arm_scheduled(host)
    host.put(wire.Start, k_stop=0)
    first = host.until(lambda m: isinstance(m, wire.Sample) and m.k >= 3, "SAMPLE 3")[-1]
    k0 = getattr(first, "k", 0) - 2
    put_setpoints(host, k0, [9_000] * _PLACES)
    messages = host.alive(_PLACES * TS_US / 1000 + 100)
    got = {m.k: m for m in messages if isinstance(m, wire.Sample)}
    wanted = device_code(9_000, host.known.pwm_bits)
    driven = [k for k, m in got.items() if m.u_k == wanted]
    expect(bool(driven), "no sample had a setpoint that was in time")
    expect(k0 + 2 < min(driven), f"sample {min(driven)} had a setpoint that was late")
    expect(max(driven) == k0 + _PLACES - 1, f"sample {max(driven)} was the last with a setpoint")


@rule(6, "Repeated setpoints before `next` of an empty queue cause no step in u, and no answer")
def _late_repeat(host: LineHost) -> None:
    ramp = [1_000, 2_000, 3_000]  # steps of `slew`; a step to the padding, 0, would be too large
    arm_scheduled(host, slew=1_000, underrun=Underrun.HOLD, hold=255)
    fill(host, ramp)
    messages: list[wire.Message] = host.ask(wire.Start)
    for _ in range(12):
        messages += host.until(lambda m: isinstance(m, wire.Sample), "SAMPLE")
        put_setpoints(host, max(0, getattr(messages[-1], "k", 0) + 1 - len(ramp)), ramp)
    messages += host.fence()
    others = [m for m in messages if not isinstance(m, wire.Sample)]
    expect(kinds(others) == [wire.Ack, wire.Event] and host.state == State.RUN, others)


@rule(6, "EXCHANGE in RUN is answered WRONG_STATE; after a run, the queue is empty")
def _exchange(host: LineHost) -> None:
    arm_scheduled(host)
    fill(host, [500] * 48)
    host.ask(wire.Start)
    answers = [m for m in host.ask(wire.Exchange, k=1, u=0) if not isinstance(m, wire.Sample)]
    expect(codes(answers) == [Code.WRONG_STATE], answers)
    host.ask(wire.Stop)
    expect(host.state == State.IDLE, f"state {host.state} after STOP")
    host.listen(30)
    arm_scheduled(host)
    expect(queue_length(host) == 0, "the queue of the run before")


@rule(6, "Queued setpoints do not feed the watchdog", silent=True)
def _queue_feeds_nothing(host: LineHost) -> None:
    arm_scheduled(host, watchdog_ms=100)
    fill(host, [1_000] * 96)
    host.ask(wire.Start)
    host.fence()
    fed = host.rx_us
    messages = host.until(lambda m: isinstance(m, wire.Event), "FAULT(WATCHDOG)")
    expect_watchdog(only(wire.Event, messages[-1:]), fed, 100)
