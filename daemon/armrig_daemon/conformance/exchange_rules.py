"""Section 5: exchange mode, oversampling, CAL."""

from __future__ import annotations

from armrig_core.volts import applied_code
from armrig_protocol.messages import (
    TYPES,
    Ack,
    Arm,
    Cal,
    CalReply,
    Capability,
    Cause,
    Code,
    Event,
    Exchange,
    Flag,
    Message,
    Ping,
    Pong,
    Sample,
    State,
)

from armrig_daemon.conformance.configuration_rules import ts_min_us
from armrig_daemon.conformance.host import PATIENCE_MS, Broken, Host, only
from armrig_daemon.conformance.rule import NotTried, codes, expect, kinds, rule, shown

_U32 = 0xFFFF_FFFF
_LONG_MS = 30
"""Longer than any sample that might come though none should."""
_ROUNDED_US = 3
_MANY = 32


def elapsed(from_us: int, to_us: int) -> int:
    """Return the device time from one stamp to another, negative where it went back, in µs."""
    return (to_us - from_us + (1 << 31)) % (1 << 32) - (1 << 31)


def _trigger(host: Host, m: int) -> tuple[int, int]:
    """Return when the first conversion was triggered, and a PING behind the EXCHANGE had come.

    Both from when a PING before it had come; the three go out as one piece.
    """
    host.k = k = host.sample().k + 1
    first, exchange, last = Ping(0, 0, 1 << 62), Exchange(0, 0, k, 0), Ping(0, 0, (1 << 62) + 1)
    host.put_together([first, exchange, last])
    came = host.until(lambda x: isinstance(x, Sample) and x.k == k, "SAMPLE")
    came += host.fence()
    rx_us = {x.host_ns: x.rx_us for x in came if isinstance(x, Pong)}
    if rx_us.keys() != {first.host_ns, last.host_ns}:
        raise Broken(shown(came))
    before = rx_us[first.host_ns]
    t_us = only(Sample, came).t_us - (2 * m - 1) * host.known.skew_us
    return elapsed(before, t_us), elapsed(before, rx_us[last.host_ns])


@rule(5, "t_us is theta_1's trigger, `skew_us` behind alpha's, which follows the EXCHANGE")
def _time(host: Host) -> None:
    for _ in range(10):
        at, end = _trigger(host, 1)
        expect(
            -_ROUNDED_US <= at <= end + _ROUNDED_US, f"alpha {at} us behind a PING, {end} the next"
        )


@rule(5, "k is newer than the last k, or the frame is ACK(STALE); behind a HELLO it may be any")
def _k(host: Host) -> None:
    host.sample(k=100)
    for k in (100, 99, 100 + 2**31):
        stale = host.exchange(0, k=k)
        expect(isinstance(stale, Ack) and stale.code == Code.STALE, [stale])
    host.sample(k=100 + 2**31 - 1)
    host.sample(k=1)  # modulo 2^32 it is newer
    host.hello()
    host.fence()
    host.sample(k=1)


@rule(5, "u_k is the code that the duty stands for, u_km1 the one before, u_seq the frame's seq")
def _latched(host: Host) -> None:
    host.reach(State.RUN)
    before = 0
    for u in (0, 1, 31, 32, 33, 12_345, 32_767, 32_768, 65_503, 65_534, 65_535, 100, 0):
        sample = host.sample(u)
        code = applied_code(u, host.known.pwm_bits)
        told = (sample.u_k, sample.u_km1, sample.u_seq)
        expect(told == (code, before, host.seq), f"u={u}: u_k, u_km1, u_seq {told}")
        before = code


@rule(
    5, "In RUN a u outside [u_min, u_max] is FAULT(RANGE): the EVENT alone answers, with the code"
)
def _range(host: Host) -> None:
    for u in (99, 40_001, 65_535, 0):
        host.to_idle()
        host.reach(State.RUN, u_min=100, u_max=40_000, u_rest=_rest(host, 200))
        host.sample(30_000)
        _trips(host, u, Cause.RANGE)


@rule(5, "Both ends of the range are inside of it")
def _bounds(host: Host) -> None:
    host.reach(State.RUN, u_min=100, u_max=40_000, u_rest=_rest(host, 200))
    for u in (40_000, 100):
        host.sample(u)


@rule(
    5, "A change of more than `slew` from the last code taken is FAULT(SLEW), of just so much not"
)
def _slew(host: Host) -> None:
    host.reach(State.RUN, slew=100)
    for u in (100, 200, 300, 400, 300, 200, 100, 0, 50, 150, 250):
        host.sample(u)
    _trips(host, 351, Cause.SLEW)
    host.to_idle()
    host.reach(State.RUN, slew=100)
    _trips(host, 101, Cause.SLEW)


def _trips(host: Host, u: int, cause: Cause) -> None:
    came = [host.exchange(u), *host.listen(_LONG_MS), *host.fence()]
    expect(kinds(came) == [Event], came)
    event = only(Event, came)
    told = (event.was, event.state, event.cause, event.detail)
    expect(told == (State.RUN, State.FAULT, cause, u), f"{told}")
    sample = host.sample(0)
    expect((sample.u_k, sample.state) == (0, State.FAULT), [sample])


@rule(5, "Outside RUN u is not looked at")
def _unlooked(host: Host) -> None:
    host.reach(State.ARMED, u_max=100, slew=1)
    for u in (65_535, 0):
        expect(host.sample(u).state == State.ARMED, f"state {host.state}")


@rule(5, "Within a boot t_us never goes backwards")
def _order(host: Host) -> None:
    last = host.sample().t_us
    for _ in range(50):
        t_us = host.sample().t_us
        expect(elapsed(last, t_us) > 0, f"{t_us} behind {last}")
        last = t_us


@rule(5, "A spoilt frame is told once, by CRC_ERR in the next SAMPLE")
def _crc_flag(host: Host) -> None:
    host.sample()
    host.write(b"\x03\x01\x02\0")
    first, second = host.sample(), host.sample()
    expect(bool(first.flags & Flag.CRC_ERR), [first])
    expect(not second.flags & Flag.CRC_ERR, [second])


def _rest(host: Host, u: int) -> int:
    return u if host.known.capabilities & Capability.ENABLE_LINE else 0


# ---------------------------------------------------------------- oversampling


def _oversample(host: Host) -> int:
    """Return how many conversions a reading has now, in READY."""
    for m in (_MANY, 8, 4, 2):
        if host.configure(oversampling=m, ts_us=ts_min_us(host, m) + 10_000).code == Code.OK:
            return m
    msg = "the device offers no oversampling"
    raise NotTried(msg)


@rule(5, "With oversampling m, t_us is (2 m - 1) `skew_us` behind the EXCHANGE")
def _mean_time(host: Host) -> None:
    for _ in range(5):
        m = _oversample(host)
        at, end = _trigger(host, m)
        # `skew_us` is rounded up: by less than 1 us each.
        in_time = -_ROUNDED_US - 2 * m <= at <= end + _ROUNDED_US
        expect(in_time, f"the first {at} us behind a PING, {end} the next; m={m}")


@rule(5, "A second EXCHANGE waits and is TICK_LATE; a third meanwhile is lost, and not taken in")
def _waiting(host: Host) -> None:
    m = _oversample(host)
    came: list[Message] = []
    for _ in range(5):
        host.fence()
        k = host.sample().k
        host.k += 3
        host.put_together([Exchange(0, 0, k + i, 0) for i in (1, 2, 3)])
        came = [*host.listen(_LONG_MS), *host.fence()]
        got = [x for x in came if isinstance(x, Sample)]
        if [bool(x.flags & Flag.TICK_LATE) for x in got] == [False, True]:
            apart = elapsed(got[0].t_us, got[1].t_us)
            expect(apart >= 2 * m * (host.known.skew_us - 1), f"{apart} us apart with m={m}")
            again = host.exchange(0, k=k + 3)  # the third's was not taken
            expect(isinstance(again, Sample), [again])
            return
    expect(False, came)  # five times: that was not the way, which may part them


# ---------------------------------------------------------------- CAL


def _need_cal(host: Host) -> None:
    if not host.known.capabilities & Capability.CAL:
        for state in (State.IDLE, State.READY, State.ARMED):
            host.to_idle()
            host.reach(state)
            came = host.ask(Cal, channel=0, zero=0, n=1)
            expect(codes(came) == [Code.UNSUPPORTED], came)
        msg = "the device offers no CAL"
        raise NotTried(msg)


def _cal_reply(host: Host, channel: int, n: int) -> CalReply:
    host.put(Cal, channel=channel, zero=0, n=n)
    return only(CalReply, host.until(lambda m: isinstance(m, CalReply), "CAL_R", 4 * PATIENCE_MS))


@rule(5, "CAL answers with n readings of one channel, and figures that can be")
def _cal(host: Host) -> None:
    _need_cal(host)
    for channel in (0, 1):
        for n in (1, 2, 100, 1024):
            it = _cal_reply(host, channel, n)
            expect((it.channel, it.zero, it.n) == (channel, 0, n), f"{it}")
            expect(it.least * 256 <= it.mean_256 <= it.greatest * 256, f"{it}")
            # The variance is largest where half of the readings lie at each end.
            most = 256 * (it.greatest - it.least) ** 2 * n / (4 * max(n - 1, 1)) + 1
            expect(it.variance_256 <= (most if n > 1 else 0), f"{it}")
            spreads = it.greatest > it.least + 64
            expect(it.variance_256 > 0 or not spreads, f"{it}")


@rule(5, "CAL with n of 0 or above 1024, another channel, or zero not 0 is BAD_VALUE")
def _cal_bounds(host: Host) -> None:
    _need_cal(host)
    for channel, zero, n in ((0, 0, 0), (0, 0, 1025), (2, 0, 1), (0, 1, 1)):
        came = host.ask(Cal, channel=channel, zero=zero, n=n)
        expect(codes(came) == [Code.BAD_VALUE], came)


@rule(5, "During CAL another CAL, EXCHANGE and ARM are WRONG_STATE; CAL goes on, also into ESTOP")
def _cal_meanwhile(host: Host) -> None:
    _need_cal(host)
    host.reach(State.READY)
    host.put(Cal, channel=0, zero=0, n=1024)
    busy: list[Message] = host.ask(Cal, channel=1, zero=0, n=1)
    busy += host.ask(Exchange, k=1, u=0) + host.ask(Arm)
    if any(isinstance(m, CalReply) for m in busy):
        msg = "CAL_R came before the host had asked for more: it was held up"
        raise Broken(msg)
    expect(codes(busy) == [Code.WRONG_STATE] * 3 and len(busy) == 3, busy)
    host.reach(State.ESTOP)
    came = host.until(lambda m: isinstance(m, CalReply), "CAL_R", 4 * PATIENCE_MS)
    expect(came[-1].state == State.ESTOP, f"state {came[-1].state} in CAL_R")
    expect(TYPES[Cal] not in [m.of_type for m in came if isinstance(m, Ack)], came)


RULES = (
    _time,
    _k,
    _latched,
    _range,
    _bounds,
    _slew,
    _unlooked,
    _order,
    _crc_flag,
)
READINGS = (
    _mean_time,
    _waiting,
    _cal,
    _cal_bounds,
    _cal_meanwhile,
)
