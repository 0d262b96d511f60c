"""Devices that report a wrong value in a field of a frame."""

from __future__ import annotations

from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES, WATCHDOG_MAX_MS, Cause, Code, Flag, State

from tests.daemon.conformance.spoiling import SpoiltDevices

SPOILT = SpoiltDevices()
SPOILT.answer(
    "SAMPLE: the code before is kept in IDLE",
    "every state but RUN",
    wire.Sample,
    lambda m: {"u_km1": 9},
    lambda m: m.state == State.IDLE,
)
SPOILT.answer(
    "SAMPLE: a code less is queued",
    "The queue has no gaps",
    wire.Sample,
    lambda m: {"queued": max(0, m.queued - 1)},
)
SPOILT.answer(
    "SAMPLE: a loss that was none",
    "Bytes lost in a flood",
    wire.Sample,
    lambda m: {"flags": m.flags | Flag.RX_OVERFLOW},
)
SPOILT.answer(
    "ACK of SETPOINTS: STALE in a wrong state",
    "SETPOINTS in ARMED of exchange mode",
    wire.Ack,
    lambda m: {"code": Code.STALE},
    lambda m: (m.of_type, m.code) == (TYPES[wire.Setpoints], Code.WRONG_STATE),
)
SPOILT.answer(
    "ACK of an unknown type: another number",
    "unknown type",
    wire.Ack,
    lambda m: {"of_seq": m.of_seq ^ 1},
    lambda m: m.code == Code.UNKNOWN_TYPE,
)
SPOILT.answer(
    "CAL: a reading less", "CAL_R reports n readings", wire.CalReply, lambda m: {"n": m.n - 1}
)
SPOILT.answer(
    "CONFIG: u_rest is refused",
    "u_rest other than 0 needs an enable line; otherwise",
    wire.ConfigReply,
    lambda m: {"code": Code.BAD_VALUE},
    lambda m: m.u_rest == 100,
)
SPOILT.answer(
    "CONFIG: scheduled mode is refused",
    "Scheduled mode is accepted",
    wire.ConfigReply,
    lambda m: {"code": Code.UNSUPPORTED},
    lambda m: m.mode and m.ts_us == 10_000,
)
SPOILT.answer(
    "CONFIG: the longest watchdog is refused",
    "The least and largest",
    wire.ConfigReply,
    lambda m: {"code": Code.BAD_VALUE},
    lambda m: m.watchdog_ms == WATCHDOG_MAX_MS,
)
SPOILT.answer(
    "EVENT: a time ahead",
    "The time in an EVENT",
    wire.Event,
    lambda m: {"t_us": (m.t_us + 50_000) & 0xFFFF_FFFF},
)
SPOILT.answer(
    "EVENT: the end is 1.2 ms late",
    "the last input is held for one Ts",
    wire.Event,
    lambda m: {"t_us": (m.t_us + 1_200) & 0xFFFF_FFFF},
    lambda m: m.cause == Cause.END,
)
SPOILT.answer(
    "PONG: host_ns of 32 bits",
    "in any pieces",
    wire.Pong,
    lambda m: {"host_ns": m.host_ns & 0xFFFF_FFFF},
)
SPOILT.answer(
    "SAMPLE: another boot", "low half of boot_id", wire.Sample, lambda m: {"boot": m.boot ^ 1}
)
SPOILT.answer(
    "SAMPLE: CRC_ERR is not told",
    "reported once, by CRC_ERR",
    wire.Sample,
    lambda m: {"flags": m.flags & ~Flag.CRC_ERR},
)
SPOILT.answer(
    "SAMPLE: each second time is 20 ms earlier",
    "t_us never goes backwards",
    wire.Sample,
    lambda m: {"t_us": (m.t_us - 20_000 * (m.k & 1)) & 0xFFFF_FFFF},
)
SPOILT.answer(
    "STATUS: a frame dropped each second",
    "At 1 kHz",
    wire.Status,
    lambda m: {"tx_dropped": m.uptime_ms // 1000},
)
SPOILT.answer(
    "STATUS: more frames than came",
    "STATUS counts",
    wire.Status,
    lambda m: {"frames": 2 * m.frames},
)
