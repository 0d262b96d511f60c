"""Devices that report a wrong value in a field of a frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES, WATCHDOG_MAX_MS, Cause, Code, Flag, State

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice, changed_answers


def _is_ack(m: wire.Message, kind: type[wire.Message], code: Code) -> bool:
    return isinstance(m, wire.Ack) and (m.of_type, m.code) == (TYPES[kind], code)


FIELDS: dict[str, tuple[Callable[[Any], dict[str, int]], str]] = {
    "SAMPLE: the code before is kept in IDLE": (
        lambda m: {"u_km1": 9} if isinstance(m, wire.Sample) and m.state == State.IDLE else {},
        "every state but RUN",
    ),
    "SAMPLE: a code less is queued": (
        lambda m: {"queued": max(0, m.queued - 1)} if isinstance(m, wire.Sample) else {},
        "The queue has no gaps",
    ),
    "SAMPLE: a loss that was none": (
        lambda m: {"flags": m.flags | Flag.RX_OVERFLOW} if isinstance(m, wire.Sample) else {},
        "Bytes lost in a flood",
    ),
    "ACK of SETPOINTS: STALE in a wrong state": (
        lambda m: {"code": Code.STALE} if _is_ack(m, wire.Setpoints, Code.WRONG_STATE) else {},
        "SETPOINTS in ARMED of exchange mode",
    ),
    "ACK of an unknown type: another number": (
        lambda m: {"of_seq": m.of_seq ^ 1} if getattr(m, "code", 0) == Code.UNKNOWN_TYPE else {},
        "unknown type",
    ),
    "CAL: a reading less": (
        lambda m: {"n": m.n - 1} if isinstance(m, wire.CalReply) else {},
        "CAL_R reports n readings",
    ),
    "CONFIG: u_rest is refused": (
        lambda m: (
            {"code": Code.BAD_VALUE} if isinstance(m, wire.ConfigReply) and m.u_rest == 100 else {}
        ),
        "u_rest other than 0 needs an enable line; otherwise",
    ),
    "CONFIG: scheduled mode is refused": (
        lambda m: (
            {"code": Code.UNSUPPORTED}
            if isinstance(m, wire.ConfigReply) and m.mode and m.ts_us == 10_000
            else {}
        ),
        "Scheduled mode is accepted",
    ),
    "CONFIG: the longest watchdog is refused": (
        lambda m: (
            {"code": Code.BAD_VALUE}
            if isinstance(m, wire.ConfigReply) and m.watchdog_ms == WATCHDOG_MAX_MS
            else {}
        ),
        "The least and largest",
    ),
    "EVENT: a time ahead": (
        lambda m: {"t_us": (m.t_us + 50_000) & 0xFFFF_FFFF} if isinstance(m, wire.Event) else {},
        "The time in an EVENT",
    ),
    "EVENT: the end is 1.2 ms late": (
        lambda m: (
            {"t_us": (m.t_us + 1_200) & 0xFFFF_FFFF}
            if isinstance(m, wire.Event) and m.cause == Cause.END
            else {}
        ),
        "the last input is held for one Ts",
    ),
    "PONG: host_ns of 32 bits": (
        lambda m: {"host_ns": m.host_ns & 0xFFFF_FFFF} if isinstance(m, wire.Pong) else {},
        "in any pieces",
    ),
    "SAMPLE: another boot": (
        lambda m: {"boot": m.boot ^ 1} if isinstance(m, wire.Sample) else {},
        "low half of boot_id",
    ),
    "SAMPLE: CRC_ERR is not told": (
        lambda m: {"flags": m.flags & ~Flag.CRC_ERR} if isinstance(m, wire.Sample) else {},
        "reported once, by CRC_ERR",
    ),
    "SAMPLE: each second time is 20 ms earlier": (
        lambda m: (
            {"t_us": (m.t_us - 20_000 * (m.k & 1)) & 0xFFFF_FFFF}
            if isinstance(m, wire.Sample)
            else {}
        ),
        "t_us never goes backwards",
    ),
    "STATUS: a frame dropped each second": (
        lambda m: {"tx_dropped": m.uptime_ms // 1000} if isinstance(m, wire.Status) else {},
        "At 1 kHz",
    ),
    "STATUS: more frames than came": (
        lambda m: {"frames": 2 * m.frames} if isinstance(m, wire.Status) else {},
        "STATUS counts",
    ),
}


def _change(patch: Patch, wrong: Callable[[Any], dict[str, int]]) -> None:
    changed_answers(patch, lambda m: m._replace(**wrong(m)))


SPOILT: dict[str, SpoiltDevice] = {
    how: SpoiltDevice(partial(_change, wrong=wrong), found_by)
    for how, (wrong, found_by) in FIELDS.items()
}
