"""Rules of section 5: oversampling and CAL."""

from __future__ import annotations

from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES, Capability, Code, Flag, State

from armrig_daemon.conformance.configuration_rules import ts_min_us
from armrig_daemon.conformance.exchange_rules import (
    ROUNDED_US,
    SAMPLE_LIMIT_MS,
    interval_us,
    trigger,
)
from armrig_daemon.conformance.host import PATIENCE_MS, Broken, LineHost, only
from armrig_daemon.conformance.rule import NotTried, behaviour_text, codes, expect, rule

_MAX_OVERSAMPLING = 32


# ---------------------------------------------------------------- oversampling


def _oversample(host: LineHost) -> int:
    """Configure the largest possible oversampling; return the number of conversions per reading."""
    for m in (_MAX_OVERSAMPLING, 8, 4, 2):
        if host.configure(oversampling=m, ts_us=ts_min_us(host, m) + 10_000).code == Code.OK:
            return m
    raise NotTried("the device offers no oversampling")


@rule(5, "With oversampling m, t_us is (2 m - 1) `skew_us` after the EXCHANGE")
def _mean_time(host: LineHost) -> None:
    for _ in range(5):
        m = _oversample(host)
        at, end = trigger(host, m)
        # `skew_us` is rounded up by less than 1 us.
        in_time = -ROUNDED_US - 2 * m <= at <= end + ROUNDED_US
        expect(in_time, f"the first {at} us after a PING, the next PING at {end} us; m={m}")


@rule(5, "A second EXCHANGE waits, and its SAMPLE has the flag TICK_LATE; a third one is lost")
def _waiting(host: LineHost) -> None:
    m = _oversample(host)
    messages: list[wire.Message] = []
    for _ in range(5):
        host.fence()
        k = host.sample().k
        host.k += 3
        host.put_together([wire.Exchange(0, 0, k + i, 0) for i in (1, 2, 3)])
        messages = [*host.listen(SAMPLE_LIMIT_MS), *host.fence()]
        got = [x for x in messages if isinstance(x, wire.Sample)]
        if [bool(x.flags & Flag.TICK_LATE) for x in got] == [False, True]:
            apart = interval_us(got[0].t_us, got[1].t_us)
            expect(apart >= 2 * m * (host.known.skew_us - 1), f"{apart} us apart with m={m}")
            again = host.exchange(0, k=k + 3)  # the third was not accepted, so its k is still new
            expect(isinstance(again, wire.Sample), [again])
            return
    expect(False, messages)  # five attempts failed: the line cannot be the reason


@rule(5, "If RUN ends before the latch, SAMPLE reports the new state and u_k = 0")
def _overtaken(host: LineHost) -> None:
    m = _oversample(host)
    config = {"oversampling": m, "ts_us": ts_min_us(host, m) + 10_000}
    messages: list[wire.Message] = []
    for _ in range(5):
        host.enter(State.RUN, **config)
        host.k += 1
        host.put_together([wire.Exchange(0, 0, host.k, 30_000), wire.Stop(0, 0)])
        messages = [*host.listen(SAMPLE_LIMIT_MS), *host.fence()]
        sample = only(wire.Sample, messages)
        if sample.state == State.RUN:
            continue  # the line separated the frames
        reported = (sample.state, sample.u_k, sample.u_seq)
        expect(reported == (State.IDLE, 0, 0), [sample])
        return
    raise Broken(behaviour_text(messages))


# ---------------------------------------------------------------- CAL


def _need_cal(host: LineHost) -> None:
    if not host.known.capabilities & Capability.CAL:
        for state in (State.IDLE, State.READY, State.ARMED):
            host.enter(state)
            answers = host.ask(wire.Cal, channel=0, zero=0, n=1)
            expect(codes(answers) == [Code.UNSUPPORTED], answers)
        raise NotTried("the device offers no CAL")


def _cal_reply(host: LineHost, channel: int, n: int) -> wire.CalReply:
    host.put(wire.Cal, channel=channel, zero=0, n=n)
    return only(
        wire.CalReply, host.until(lambda m: isinstance(m, wire.CalReply), "CAL_R", 4 * PATIENCE_MS)
    )


@rule(5, "CAL_R reports n readings of one channel, with statistics that are possible")
def _cal(host: LineHost) -> None:
    _need_cal(host)
    for channel in (0, 1):
        for n in (1, 2, 100, 1024):
            it = _cal_reply(host, channel, n)
            expect((it.channel, it.zero, it.n) == (channel, 0, n), f"{it}")
            expect(it.least * 256 <= it.mean_256 <= it.greatest * 256, f"{it}")
            # The variance is largest if half of the readings are at each end.
            most = 256 * (it.greatest - it.least) ** 2 * n / (4 * max(n - 1, 1)) + 1
            expect(it.variance_256 <= (most if n > 1 else 0), f"{it}")
            spreads = it.greatest > it.least + 64
            expect(it.variance_256 > 0 or not spreads, f"{it}")


@rule(5, "CAL with n = 0, n > 1024, an unknown channel, or `zero` not 0 is answered BAD_VALUE")
def _cal_bounds(host: LineHost) -> None:
    _need_cal(host)
    for channel, zero, n in ((0, 0, 0), (0, 0, 1025), (2, 0, 1), (0, 1, 1)):
        answers = host.ask(wire.Cal, channel=channel, zero=zero, n=n)
        expect(codes(answers) == [Code.BAD_VALUE], answers)


@rule(5, "During CAL, another CAL, EXCHANGE and ARM are answered WRONG_STATE; CAL continues")
def _cal_meanwhile(host: LineHost) -> None:
    _need_cal(host)
    host.reach(State.READY)
    host.put(wire.Cal, channel=0, zero=0, n=1024)
    busy: list[wire.Message] = host.ask(wire.Cal, channel=1, zero=0, n=1)
    busy += host.ask(wire.Exchange, k=1, u=0) + host.ask(wire.Arm)
    if any(isinstance(m, wire.CalReply) for m in busy):
        raise Broken("the host was held up: its next requests arrived after CAL_R")
    expect(codes(busy) == [Code.WRONG_STATE] * 3 and len(busy) == 3, busy)
    host.reach(State.ESTOP)
    replies = host.until(lambda m: isinstance(m, wire.CalReply), "CAL_R", 4 * PATIENCE_MS)
    expect(replies[-1].state == State.ESTOP, f"state {replies[-1].state} in CAL_R")
    expect(TYPES[wire.Cal] not in [m.of_type for m in replies if isinstance(m, wire.Ack)], replies)
