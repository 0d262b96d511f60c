"""Devices that treat a request in another way than PROTOCOL.md."""

from __future__ import annotations

from functools import partial
from typing import Any

from armrig_daemon.emulator import device, requests, transitions, uart
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol import decoder
from armrig_protocol import messages as wire
from armrig_protocol.frame import Spoilt
from armrig_protocol.messages import TYPES, Code, State

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice, any_value, other_handler


def _accepts(patch: Patch, **fields: int) -> None:
    """Check a CONFIG as if it had these fields."""
    check = transitions.check_config
    patch.setattr(
        transitions,
        "check_config",
        lambda m, **limits: check(m._replace(**fields), **limits),
    )


def _takes_cal(patch: Patch, **fields: int) -> None:
    other_handler(patch, wire.Cal, lambda old: lambda fw, t, m: old(fw, t, m._replace(**fields)))


def _answers(patch: Patch, kind: type[wire.Message]) -> None:
    """Answer frames of a kind that need no answer."""
    other_handler(
        patch,
        kind,
        lambda old: lambda fw, t, m: old(fw, t, m) or [fw.answer(TYPES[kind], m.seq, Code.OK)],
    )


def _estop_in_estop(patch: Patch, *, code: Code, token: int) -> None:
    def other(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: wire.Estop) -> list[wire.Message]:
            if fw.state is not State.ESTOP:
                return old(fw, now_ns, m)
            fw.token ^= token
            return [fw.answer(TYPES[wire.Estop], m.seq, code)]

        return handler

    other_handler(patch, wire.Estop, other)


def _keepalive_feeds_nothing(patch: Patch) -> None:
    feed = Firmware.feed
    handle = requests.handle
    fed_by: list[Any] = [None]

    def handling(fw: Firmware, now_ns: int, received: Any) -> list[wire.Message]:
        fed_by[0] = received
        return handle(fw, now_ns, received)

    def feeding(self: Firmware, now_ns: int) -> None:
        if not isinstance(fed_by[0], wire.Keepalive):
            feed(self, now_ns)

    patch.setattr(device, "handle", handling)
    patch.setattr(Firmware, "feed", feeding)


def _narrow_newer(patch: Patch) -> None:
    def narrow(number: int, last: int | None, mask: int) -> bool:
        return last is None or 1 <= (number - last) & mask < mask // 2

    patch.setattr(requests, "is_newer", narrow)


def _hello_needs_a_new_number(patch: Patch) -> None:
    handle = requests.handle

    def handling(fw: Firmware, now_ns: int, received: Any) -> list[wire.Message]:
        with patch.context() as inner:
            inner.setattr(requests, "MOTOR_MAY_TURN", tuple(State))
            made = handle(fw, now_ns, received)
        if any(isinstance(m, wire.HelloReply) for m in made):
            fw.k = None
        return made

    patch.setattr(device, "handle", handling)


def _empty_is_spoilt(patch: Patch) -> None:
    feed = decoder.feed

    def counting(pending: bytes, data: bytes) -> Any:
        if (pending, data) == (b"", b"\0"):
            return b"", [Spoilt("length")]
        return feed(pending, data)

    patch.setattr(uart.decoder, "feed", counting)


_VALUES = "A CONFIG with a wrong value"
_BOUNDS = "CAL with n = 0, n > 1024"
SPOILT: dict[str, SpoiltDevice] = {
    "any watchdog is taken": SpoiltDevice(partial(_accepts, watchdog_ms=100), _VALUES),
    "any range is taken": SpoiltDevice(partial(_accepts, u_min=0, u_max=65_535), _VALUES),
    "any nonce starts": SpoiltDevice(
        partial(any_value, of=(wire.Start,), name="nonce"), "START needs the nonce"
    ),
    "CAL of any channel is taken": SpoiltDevice(partial(_takes_cal, channel=0), _BOUNDS),
    "KEEPALIVE is answered": SpoiltDevice(
        partial(_answers, kind=wire.Keepalive), "in any state but"
    ),
    "ESTOP in ESTOP draws a token": SpoiltDevice(
        partial(_estop_in_estop, code=Code.OK, token=1), "ESTOP in ESTOP"
    ),
    "KEEPALIVE feeds nothing": SpoiltDevice(_keepalive_feeds_nothing, "KEEPALIVE and any other"),
    "32767 ahead is old": SpoiltDevice(_narrow_newer, "32767 ahead is newer"),
    "an old HELLO is stale": SpoiltDevice(_hello_needs_a_new_number, "HELLO is always accepted"),
    "an empty frame is spoilt": SpoiltDevice(_empty_is_spoilt, "Empty frames"),
}
