"""Devices that treat a request in another way than PROTOCOL.md."""

from __future__ import annotations

from typing import Any

from armrig_daemon.emulator import device, requests, transitions, uart
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol import messages as wire
from armrig_protocol.frame import Spoilt
from armrig_protocol.messages import TYPES, Code, State

from tests.daemon.conformance.spoiling import (
    Patch,
    SpoiltDevices,
    any_value,
    other_function,
)

SPOILT = SpoiltDevices()


def _accepts(patch: Patch, fields: dict[str, int]) -> None:
    """Check a CONFIG as if it had these fields."""
    other_function(
        patch,
        transitions,
        "check_config",
        lambda check, m, **limits: check(m._replace(**fields), **limits),
    )


_VALUES = "A CONFIG with a wrong value"
SPOILT.add("any watchdog is taken", _VALUES, _accepts, {"watchdog_ms": 100})
SPOILT.add("any range is taken", _VALUES, _accepts, {"u_min": 0, "u_max": 65_535})
SPOILT.add("any nonce starts", "START needs the nonce", any_value, "nonce", wire.Start)


@SPOILT.handler("CAL of any channel is taken", "CAL with n = 0, n > 1024", wire.Cal)
def _takes_cal(cal: Any, fw: Firmware, now_ns: int, m: wire.Cal) -> Any:
    return cal(fw, now_ns, m._replace(channel=0))


@SPOILT.handler("KEEPALIVE is answered", "in any state but", wire.Keepalive)
def _answers(keepalive: Any, fw: Firmware, now_ns: int, m: wire.Keepalive) -> Any:
    return keepalive(fw, now_ns, m) or [fw.answer(TYPES[wire.Keepalive], m.seq, Code.OK)]


@SPOILT.handler("ESTOP in ESTOP draws a token", "ESTOP in ESTOP", wire.Estop)
def _estop_in_estop(estop: Any, fw: Firmware, now_ns: int, m: wire.Estop) -> Any:
    fw.token ^= fw.state is State.ESTOP
    return estop(fw, now_ns, m)


@SPOILT.function("KEEPALIVE feeds nothing", "KEEPALIVE and any other", device, "handle")
def _keepalive_feeds_nothing(handle: Any, fw: Firmware, now_ns: int, received: Any) -> Any:
    fed_ns = fw.fed_ns
    made = handle(fw, now_ns, received)
    if isinstance(received, wire.Keepalive):
        fw.feed(fed_ns)
    return made


@SPOILT.function("32767 ahead is old", "32767 ahead is newer", requests, "is_newer")
def _narrow_newer(is_newer: Any, number: int, last: int | None, mask: int) -> bool:
    return last is None or 1 <= (number - last) & mask < mask // 2


@SPOILT.function("an old HELLO is stale", "HELLO is always accepted", device, "handle")
def _hello_needs_a_new_number(handle: Any, fw: Firmware, now_ns: int, received: Any) -> Any:
    with Patch.context() as inner:
        inner.setattr(requests, "MOTOR_MAY_TURN", tuple(State))
        made = handle(fw, now_ns, received)
    if any(isinstance(m, wire.HelloReply) for m in made):
        fw.k = None
    return made


@SPOILT.function("an empty frame is spoilt", "Empty frames", uart.decoder, "feed")
def _empty_is_spoilt(feed: Any, pending: bytes, data: bytes) -> Any:
    if (pending, data) == (b"", b"\0"):
        return b"", [Spoilt("length")]
    return feed(pending, data)
