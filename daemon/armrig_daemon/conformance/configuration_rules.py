"""Rules of section 4: configuration."""

from __future__ import annotations

from armrig_protocol import messages as wire
from armrig_protocol.frame import config_crc
from armrig_protocol.messages import (
    WATCHDOG_MAX_MS,
    WATCHDOG_MIN_MS,
    Capability,
    Code,
    Mode,
    State,
)

from armrig_daemon.conformance.host import CONFIG, LineHost
from armrig_daemon.conformance.rule import NotTried, expect, rule


def ts_min_us(host: LineHost, m: int) -> int:
    """Return the shortest Ts with oversampling m, in µs."""
    return host.known.ts_min_us + 2 * (m - 1) * host.known.skew_us


@rule(4, "CONFIG_R contains the accepted values, and their CRC-32")
def _reply_contents(host: LineHost) -> None:
    config = {
        **CONFIG,
        "ts_us": 123_456,
        "u_min": 1_000,
        "u_max": 40_000,
        "slew": 30_000,
        "watchdog_ms": 77,
        "underrun": 1,
        "hold": 9,
        "rail_ticks": 300,
        "turns": 555,
    }
    reply = host.configure(**config)
    accepted = {name: getattr(reply, name) for name in config}
    expect(reply.code == Code.OK and accepted == config, f"{accepted}")
    crc = config_crc(wire.Config(0, 0, **config))
    expect(reply.config_crc == crc, f"config_crc {reply.config_crc:08x}, not {crc:08x}")


@rule(
    4,
    "A CONFIG with a wrong value is answered BAD_VALUE, and the last valid CONFIG stays in force",
)
def _bad_values(host: LineHost) -> None:
    shortest = host.known.ts_min_us
    in_force = host.configure(u_max=12_345)
    bad: tuple[dict[str, int], ...] = (
        {"ts_us": 0},
        {"ts_us": shortest - 1},
        {"u_min": 5, "u_max": 4},
        {"u_min": 10, "u_rest": 9},
        {"u_max": 10, "u_rest": 11},
        {"watchdog_ms": WATCHDOG_MIN_MS - 1},
        {"watchdog_ms": WATCHDOG_MAX_MS + 1},
        {"watchdog_ms": 0},
        {"mode": 2},
        {"underrun": 2},
        {"oversampling": 0},
    )
    for fields in bad:
        reply = host.configure(**fields)
        expect(reply.code == Code.BAD_VALUE, f"{fields}: {Code(reply.code).name}")
        expect(reply[4:] == in_force[4:], f"{fields}: another configuration in force")
        expect(host.state == State.READY, f"{fields}: state {host.state}")


@rule(4, "The least and largest `ts_us` and `watchdog_ms` are accepted, and also u_min = u_max")
def _limits(host: LineHost) -> None:
    good: tuple[dict[str, int], ...] = (
        {"ts_us": host.known.ts_min_us},
        {"watchdog_ms": WATCHDOG_MIN_MS},
        {"watchdog_ms": WATCHDOG_MAX_MS},
        {"u_min": 7, "u_max": 7},
        {"ts_us": 0xFFFF_FFFF},
    )
    for fields in good:
        reply = host.configure(**fields)
        expect(reply.code == Code.OK, f"{fields}: {Code(reply.code).name}")


@rule(4, "u_rest other than 0 needs an enable line; otherwise the answer is BAD_VALUE")
def _rest(host: LineHost) -> None:
    reply = host.configure(u_rest=100)
    has_line = host.known.capabilities & Capability.ENABLE_LINE
    expect(reply.code == (Code.OK if has_line else Code.BAD_VALUE), [reply])


@rule(4, "Each accepted CONFIG has a new nonce, not 0, even if its values are the same")
def _nonce(host: LineHost) -> None:
    seen: set[int] = set()
    for _ in range(5):
        for _ in range(2):
            nonce = host.configure().nonce
            expect(nonce != 0 and nonce not in seen, f"nonce {nonce} after {sorted(seen)}")
            seen.add(nonce)
            refused = host.configure(oversampling=0)
            expect(refused.nonce == nonce, f"nonce {refused.nonce} after a refusal")
        host.ask(wire.Stop)
    expect(host.configure(oversampling=0).nonce == 0, "a nonce in IDLE")


@rule(4, "Oversampling m needs Ts >= `ts_min_us` + 2 (m - 1) `skew_us`; or it is UNSUPPORTED")
def _oversampling_limit(host: LineHost) -> None:
    none = host.configure(oversampling=2, ts_us=100_000).code
    for m in (2, 3, 8):
        least = ts_min_us(host, m)
        reply = host.configure(oversampling=m, ts_us=least)
        if none == Code.UNSUPPORTED:
            expect(reply.code == Code.UNSUPPORTED, f"m={m}: {Code(reply.code).name}")
        elif reply.code != Code.UNSUPPORTED:
            expect(reply.code == Code.OK, f"m={m}, Ts {least} us: {Code(reply.code).name}")
        reply = host.configure(oversampling=m, ts_us=least - 1)
        expect(reply.code == Code.BAD_VALUE, f"m={m}, 1 us less: {Code(reply.code).name}")
    if none == Code.UNSUPPORTED:
        raise NotTried("the device offers no oversampling")


@rule(4, "Scheduled mode is accepted if it is offered; otherwise the answer is UNSUPPORTED")
def _mode(host: LineHost) -> None:
    reply = host.configure(mode=Mode.SCHEDULED)
    offered = host.known.capabilities & Capability.SCHEDULED
    expect(reply.code == (Code.OK if offered else Code.UNSUPPORTED), [reply])
