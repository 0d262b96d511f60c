"""The Uno's binary with a full line, at its shortest Ts, at both speeds."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise

import pytest
from armrig_core.rig.volts import device_code, duty
from armrig_daemon.config import Config, DeviceTable
from armrig_daemon.decisions.budget import min_scheduled_us
from armrig_daemon.emulator.harness import Violation
from armrig_protocol import messages as wire
from armrig_protocol.frame import encode
from armrig_protocol.messages import SETPOINTS_PER_FRAME, Cause, Flag, Mode, State

from tests.daemon.test_scheduled_in_virtual_time import telegraph
from tests.firmware.harness_orders import figures
from tests.firmware.test_uno_runs import (
    LATCH_NS,
    UnoBench,
    assert_complete,
    assert_on_the_pin,
)
from tests.firmware.uno_host import BAUD, MS, PERIOD_NS, Host, powered
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")
BUILDS = needs("avr-gcc")
FAST = 1_000_000
BAUDS = [BAUD, pytest.param(FAST, marks=BUILDS)]
LOST = {BAUD: set[Violation](), FAST: {Violation.RX_OVERRUN}}
HALF = 32768
N = 600


def _play(host: Host, u: list[int], ts_us: int) -> list[wire.Sample]:
    """Play a run during a flood that leaves no gap in the line to the device."""
    host.arm(mode=int(Mode.SCHEDULED), ts_us=ts_us, watchdog_ms=250)
    for k0 in range(0, 240, SETPOINTS_PER_FRAME):
        host.say(wire.Setpoints, k0, 24, 0, tuple(u[k0 : k0 + 24]))
        host.wait(2)
    host.say(wire.Start, len(u), host.last(wire.ConfigReply).nonce)
    sent = 240
    for _ in range(len(u) * ts_us // 1000 + 40):
        samples = host.of(wire.Sample)
        while sent < len(u) and sent + 24 <= len(samples) + 256:
            host.say(wire.Setpoints, sent, 24, 0, tuple(u[sent : sent + 24]))
            sent += 24
        while host.uno.rx_backlog_ns(host.now) < 2 * MS:
            host.say(wire.Keepalive)
        host.wait(1)
    return host.of(wire.Sample)


@pytest.mark.parametrize("baud", BAUDS)
def test_during_a_flood_every_sample_is_in_time_and_reports_the_pin(baud: int) -> None:
    rng = random.Random(3)
    u = [rng.randrange(65536) for _ in range(N)]
    with powered(baud=baud) as host:
        holds: list[int] = []
        host.uno.stuck = lambda t_ns, channel: holds.append(t_ns) if channel == 0 else None
        ts_us = host.hello().ts_min_us

        samples = _play(host, u, ts_us)

        assert [s.k for s in samples] == list(range(N))
        assert not any(s.flags & (Flag.TICK_LATE | Flag.TX_DROP) for s in samples)
        told = [s.u_k for s in samples]
        assert told == [0 if s.flags & Flag.UNDERRUN else device_code(u[s.k], 10) for s in samples]
        assert not any(s.flags & Flag.UNDERRUN for s in samples[:240])
        assert _at_the_pin(host, holds) == [duty(code, 10) for code in told]
        assert figures(host.uno.harness).boots == 1


def _at_the_pin(host: Host, holds: list[int]) -> list[int]:
    """Return the duty at the pin after each hold, one period of the PWM later."""
    duties, at, found = host.uno.duties, 0, []
    for hold_ns in holds:
        by_ns = hold_ns + PERIOD_NS + LATCH_NS
        while at + 1 < len(duties) and host.uno.ns(duties[at + 1].cycle) <= by_ns:
            at += 1
        found.append(duties[at].high)
    return found


@pytest.mark.parametrize("baud", BAUDS)
def test_the_load_of_the_daemon_costs_no_sample_at_the_shortest_ts(baud: int) -> None:
    """SETPOINTS, PING and STATUS are sent between the samples.

    At 1 Mbaud bytes are lost if many setpoints come at once, and come again.
    """
    bench = UnoBench(Config(device=DeviceTable(baud=baud, watchdog_ms=250)))
    try:
        told = bench.loop.state.device
        ts_us = max(told.ts_min_us, min_scheduled_us(baud, told.skew_us))
        volts = telegraph(2000)

        bench.run(volts, ts_us)

        assert_complete(bench, volts)
        assert_on_the_pin(bench, volts, ts_us)
        assert {v.what for v in bench.uno.violations} <= LOST[baud]
    finally:
        bench.uno.close()


@pytest.mark.parametrize("baud", BAUDS)
def test_each_gap_in_the_received_bytes_is_counted(baud: int) -> None:
    """The byte that found the ring full, and the overrun after it."""
    with powered(baud=baud) as host:
        host.hello()
        flood = b"".join(encode(wire.Stop(0, seq)) for seq in range(100, 400))

        host.put(flood)
        host.wait(150)
        host.say(wire.Ping, 1)
        host.wait(1000)

        lost = [v.cycle for v in host.uno.violations if v.what is Violation.RX_OVERRUN]
        byte = 160_000_000 // baud
        gaps = 1 + sum(later - earlier > 1.5 * byte for earlier, later in pairwise(lost))
        assert gaps > 3
        assert host.last(wire.Status).rx_lost == 2 * gaps


def _noise(host: Host, rng: random.Random) -> None:
    host.put(rng.randbytes(30))


def _frames_too_short(host: Host, rng: random.Random) -> None:
    host.put(b"\1\1\0" * 10)


@pytest.mark.parametrize("flood", [_noise, _frames_too_short])
@pytest.mark.parametrize("baud", BAUDS)
def test_a_flood_does_not_delay_the_watchdog(
    baud: int, flood: Callable[[Host, random.Random], None]
) -> None:
    """S3: bytes that are no frames come without a gap; 0 V in the watchdog and a millisecond."""
    rng = random.Random(4)
    with powered(baud=baud) as host:
        ts_us = host.hello().ts_min_us
        host.arm(mode=int(Mode.SCHEDULED), ts_us=ts_us, watchdog_ms=100)
        for k0 in range(0, 240, SETPOINTS_PER_FRAME):
            host.say(wire.Setpoints, k0, SETPOINTS_PER_FRAME, 0, (HALF,) * SETPOINTS_PER_FRAME)
            host.wait(2)
        fed_ns = host.say(wire.Start, 0, host.last(wire.ConfigReply).nonce)

        for _ in range(150):
            while host.uno.rx_backlog_ns(host.now) < 2 * MS:
                flood(host, rng)
            host.wait(1)
        host.wait(10)

        low_ns = host.uno.ns(figures(host.uno.harness).last_high)
        assert 99.9 * MS <= low_ns - fed_ns <= 101 * MS
        assert host.last(wire.Event).cause == Cause.WATCHDOG
        assert host.uno.state is State.FAULT
        assert figures(host.uno.harness).boots == 1
