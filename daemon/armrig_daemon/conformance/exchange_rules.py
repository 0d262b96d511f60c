"""Rules of section 5: exchange mode."""

from __future__ import annotations

from armrig_core.rig.volts import device_code
from armrig_protocol import messages as wire
from armrig_protocol.messages import Capability, Cause, Code, Flag, State

from armrig_daemon.conformance.host import Broken, LineHost, only
from armrig_daemon.conformance.rule import behaviour_text, expect, expect_trip, rule

SAMPLE_LIMIT_MS = 30
"""Time to wait for a sample, in ms; every sample arrives within this time."""
ROUNDED_US = 3
_MAX_EARLY_MS, _MAX_LATE_MS = 0.1, 1.0
"""Tolerances of the watchdog's time, in ms of the device's clock."""


def interval_us(from_us: int, to_us: int) -> int:
    """Return the device time between two stamps, in µs; negative if time went backwards."""
    return (to_us - from_us + (1 << 31)) % (1 << 32) - (1 << 31)


def expect_watchdog(event: wire.Event, fed_us: int, watchdog_ms: int) -> None:
    """Expect FAULT(WATCHDOG) `watchdog_ms` after the last frame that fed the watchdog."""
    expect((event.state, event.cause) == (State.FAULT, Cause.WATCHDOG), [event])
    ms = interval_us(fed_us, event.t_us) / 1000
    is_in_time = watchdog_ms - _MAX_EARLY_MS <= ms <= watchdog_ms + _MAX_LATE_MS
    expect(is_in_time, f"{ms:.2f} ms after the last frame, not {watchdog_ms}")


def trigger(host: LineHost, m: int) -> tuple[int, int]:
    """Return the time of the first conversion's trigger and the time of a later PING, in µs.

    Both times are relative to a PING before the EXCHANGE. The three frames are sent as one piece.
    """
    host.k = k = host.sample().k + 1
    first, exchange, last = (
        wire.Ping(0, 0, 1 << 62),
        wire.Exchange(0, 0, k, 0),
        wire.Ping(0, 0, (1 << 62) + 1),
    )
    host.put_together([first, exchange, last])
    messages = host.until(lambda x: isinstance(x, wire.Sample) and x.k == k, "SAMPLE")
    messages += host.fence()
    rx_us = {x.host_ns: x.rx_us for x in messages if isinstance(x, wire.Pong)}
    if rx_us.keys() != {first.host_ns, last.host_ns}:
        raise Broken(behaviour_text(messages))
    before = rx_us[first.host_ns]
    t_us = only(wire.Sample, messages).t_us - (2 * m - 1) * host.known.skew_us
    return interval_us(before, t_us), interval_us(before, rx_us[last.host_ns])


@rule(5, "EXCHANGE triggers channel 1; channel 0 is triggered `skew_us` later, at t_us")
def _time(host: LineHost) -> None:
    for _ in range(10):
        at, end = trigger(host, 1)
        in_time = -ROUNDED_US <= at <= end + ROUNDED_US
        expect(in_time, f"channel 1 {at} us after a PING, the next PING at {end} us")


@rule(5, "A k not newer than the last k is answered ACK(STALE); after a HELLO, any k is new")
def _k(host: LineHost) -> None:
    host.sample(k=100)
    for k in (100, 99, 100 + 2**31):
        stale = host.exchange(0, k=k)
        expect(isinstance(stale, wire.Ack) and stale.code == Code.STALE, [stale])
    host.sample(k=100 + 2**31 - 1)
    host.sample(k=1)  # modulo 2^32 it is newer
    host.hello()
    host.fence()
    host.sample(k=1)


@rule(5, "u_k is the code of the applied duty, u_km1 the code before, u_seq the frame's seq")
def _sample_codes(host: LineHost) -> None:
    host.reach(State.RUN)
    before = 0
    for u in (0, 1, 31, 32, 33, 12_345, 32_767, 32_768, 65_503, 65_534, 65_535, 100, 0):
        sample = host.sample(u)
        code = device_code(u, host.known.pwm_bits)
        reported = (sample.u_k, sample.u_km1, sample.u_seq)
        expect(reported == (code, before, host.seq), f"u={u}: u_k, u_km1, u_seq {reported}")
        before = code


@rule(5, "In RUN, a u outside [u_min, u_max] leads to FAULT(RANGE); only an EVENT answers it")
def _range(host: LineHost) -> None:
    for u in (99, 40_001, 65_535, 0):
        host.enter(State.RUN, u_min=100, u_max=40_000, u_rest=_rest(host, 200))
        host.sample(30_000)
        _trips(host, u, Cause.RANGE)


@rule(5, "Both ends of the range [u_min, u_max] are allowed")
def _bounds(host: LineHost) -> None:
    host.reach(State.RUN, u_min=100, u_max=40_000, u_rest=_rest(host, 200))
    for u in (40_000, 100):
        host.sample(u)


@rule(
    5,
    "A change above `slew` from the last code leads to FAULT(SLEW), a change of `slew` does not",
)
def _slew(host: LineHost) -> None:
    host.reach(State.RUN, slew=100)
    for u in (100, 200, 300, 400, 300, 200, 100, 0, 50, 150, 250):
        host.sample(u)
    _trips(host, 351, Cause.SLEW)
    host.enter(State.RUN, slew=100)
    _trips(host, 101, Cause.SLEW)


def _trips(host: LineHost, u: int, cause: Cause) -> None:
    messages = [host.exchange(u), *host.listen(SAMPLE_LIMIT_MS), *host.fence()]
    expect_trip(messages, State.RUN, cause, u)
    sample = host.sample(0)
    expect((sample.u_k, sample.state) == (0, State.FAULT), [sample])


@rule(5, "Outside RUN, u is ignored")
def _u_outside_run(host: LineHost) -> None:
    host.reach(State.ARMED, u_max=100, slew=1)
    for u in (65_535, 0):
        expect(host.sample(u).state == State.ARMED, f"state {host.state}")


@rule(5, "Within a boot, t_us never goes backwards")
def _order(host: LineHost) -> None:
    last = host.sample().t_us
    for _ in range(50):
        t_us = host.sample().t_us
        expect(interval_us(last, t_us) > 0, f"{t_us} after {last}")
        last = t_us


@rule(5, "A spoilt frame is reported once, by CRC_ERR in the next SAMPLE")
def _crc_flag(host: LineHost) -> None:
    host.sample()
    host.write(b"\x03\x01\x02\0")
    first, second = host.sample(), host.sample()
    expect(bool(first.flags & Flag.CRC_ERR), [first])
    expect(not second.flags & Flag.CRC_ERR, [second])


def _rest(host: LineHost, u: int) -> int:
    return u if host.known.capabilities & Capability.ENABLE_LINE else 0
