"""Rules of section 7: the guards of a device."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Cause, Flag, State

from armrig_daemon.conformance.byte_rules import (
    UNKNOWN_TYPE,
    bad_frames,
    frame_bytes,
    header,
    next_status,
)
from armrig_daemon.conformance.exchange_rules import expect_watchdog
from armrig_daemon.conformance.host import BOOT_MS, Broken, LineHost, only
from armrig_daemon.conformance.rule import NotTried, expect, rule

_RAIL_CODES = 64
_SUPPLY_LOW_MV = 4_000


@rule(7, "KEEPALIVE and any other accepted frame feeds the watchdog")
def _fed(host: LineHost) -> None:
    host.reach(State.RUN, watchdog_ms=250)
    messages = host.alive(500)
    expect(not messages and host.state == State.RUN, messages)
    for _ in range(8):
        messages = [*host.listen(40), *host.ask(wire.Keepalive)]
        expect(not messages and host.state == State.RUN, messages)


@rule(7, "`rail_ticks` consecutive samples at a rail lead to FAULT(ADC_RAIL) after the last sample")
def _rails(host: LineHost) -> None:
    host.reach(State.RUN, rail_ticks=4)
    in_a_row = [0, 0]
    for _ in range(8):
        sample = host.sample(0)
        rails = [not _RAIL_CODES <= y < 65_536 - _RAIL_CODES for y in (sample.y0, sample.y1)]
        flags = bool(sample.flags & Flag.ADC0_RAIL), bool(sample.flags & Flag.ADC1_RAIL)
        expect(list(flags) == rails, f"y0 {sample.y0}, y1 {sample.y1}, flags 0x{sample.flags:04x}")
        in_a_row = [n + 1 if at_rail else 0 for n, at_rail in zip(in_a_row, rails, strict=True)]
        messages = host.fence()
        tripped = [m for m in messages if isinstance(m, wire.Event)]
        expect(bool(tripped) == (max(in_a_row) == 4), messages)
        if tripped:
            expect(tripped[0].cause == Cause.ADC_RAIL and sample.state == State.FAULT, messages)
            return
    raise NotTried(
        "no potentiometer stays at a rail: turn the first into its dead band, or unplug one"
    )


@rule(7, "If `rail_ticks` and `turns` are 0, no reading leads to FAULT")
def _no_guard(host: LineHost) -> None:
    host.reach(State.RUN)
    for _ in range(30):
        expect(host.sample(0).state == State.RUN, f"state {host.state}")


@rule(7, "If the motor stands still, there is no FAULT(REV_LIMIT), and REV_LIMIT is not set")
def _still(host: LineHost) -> None:
    host.reach(State.RUN, turns=50)
    for _ in range(30):
        sample = host.sample(0)
        is_flagged = sample.flags & Flag.REV_LIMIT
        expect(sample.state == State.RUN and not is_flagged, [sample])


def _bites(
    host: LineHost, watchdog_ms: int, fed_us: int, send: Callable[[], object] | None = None
) -> list[wire.Message]:
    """Wait for FAULT(WATCHDOG), sending again and again; return the messages up to this fault."""
    messages: list[wire.Message] = []
    for _ in range(40 + watchdog_ms // 2):
        if send is not None:
            send()
        messages += host.listen(50 if send is None else 8)
        if any(isinstance(m, wire.Event) for m in messages):
            break
    else:
        raise Broken(f"no FAULT(WATCHDOG) after a silence of more than {watchdog_ms} ms")
    expect_watchdog(only(wire.Event, messages), fed_us, watchdog_ms)
    sample = host.sample(0)
    is_flagged = bool(sample.flags & Flag.WATCHDOG)
    expect(sample.u_k == 0 and is_flagged, [sample])
    return messages


@rule(
    7,
    "In ARMED and RUN, a silence of the host of `watchdog_ms` trips FAULT(WATCHDOG) within 1 ms",
    silent=True,
)
def _watchdog(host: LineHost) -> None:
    for state in (State.ARMED, State.RUN):
        for watchdog_ms in (20, 100, 250):
            host.enter(state, watchdog_ms=watchdog_ms)
            _bites(host, watchdog_ms, host.rx_us)


@rule(7, "HELLO, spoilt, stale and unknown frames do not feed the watchdog", silent=True)
def _non_feeding_frames(host: LineHost) -> None:
    for kind in ("HELLO", "spoilt", "stale", "unknown"):
        host.enter(State.RUN, watchdog_ms=60)
        fed_us, newest = host.rx_us, host.seq
        ahead = (newest + 1) & 0xFFFF
        sends: dict[str, Callable[[], object]] = {
            "HELLO": partial(host.put, wire.Hello, version=VERSION, schema=SCHEMA_HASH),
            "spoilt": partial(host.write, bad_frames(host)[0]),
            "stale": partial(host.write, frame_bytes(header(0x13, newest))),
            "unknown": partial(host.write, frame_bytes(header(UNKNOWN_TYPE, ahead))),
        }
        messages = _bites(host, 60, fed_us, sends[kind])
        replied = any(isinstance(m, wire.HelloReply) for m in messages)
        expect(replied == (kind == "HELLO"), f"{kind}: {'a' if replied else 'no'} HELLO_R")


@rule(7, "In IDLE and READY, at 0 V, the watchdog is off", silent=True)
def _idle(host: LineHost) -> None:
    for state in (State.IDLE, State.READY):
        host.enter(state, watchdog_ms=20)
        messages = [*host.listen(100), *host.fence()]
        expect(not messages and host.state == state, messages)


@rule(
    7,
    "If the host disappears, the motor is at 0 V, whether or not the port resets the device",
    silent=True,
)
def _left_alone(host: LineHost) -> None:
    host.reach(State.RUN, watchdog_ms=100)
    host.sample(20_000)
    before = host.known.boot_id
    host.reopen(400)
    after = host.hello(BOOT_MS)
    host.fence()
    wanted = State.FAULT if after.boot_id == before else State.IDLE
    expect(after.state == wanted, f"state {after.state}, not {wanted.name}")
    expect(host.sample(20_000).u_k == 0, "a code that is not 0")


@rule(
    7,
    "STATUS reports the supply once a second, and VCC_LOW is set if the supply is below 4000 mV",
    silent=True,
)
def _supply(host: LineHost) -> None:
    first = next_status(host)
    second = next_status(host)
    apart = second.uptime_ms - first.uptime_ms
    expect(990 <= apart <= 1_010, f"{apart} ms between two STATUS")
    low = 0 < second.vcc_mv < _SUPPLY_LOW_MV
    sample: wire.Sample = host.sample()
    expect(bool(sample.flags & Flag.VCC_LOW) == low, f"{second.vcc_mv} mV, [{sample.flags:04x}]")
    expect(second.stack_free >= 128, f"{second.stack_free} B of stack left")
