"""Devices that report a wrong value in a field of a frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from armrig_protocol.messages import (
    TYPES,
    WATCHDOG_MAX_MS,
    Ack,
    Arm,
    CalReply,
    Capability,
    Cause,
    ClearFault,
    Code,
    ConfigReply,
    Event,
    Exchange,
    Flag,
    HelloReply,
    Message,
    Pong,
    Sample,
    Setpoints,
    Start,
    State,
    Status,
    Stop,
)

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice, changed_answers


def _of_a_refusal(m: Message) -> bool:
    return isinstance(m, ConfigReply) and bool(m.code and m.nonce)


def _is_ack(m: Message, kind: type[Message], code: Code) -> bool:
    return isinstance(m, Ack) and (m.of_type, m.code) == (TYPES[kind], code)


FIELDS: dict[str, tuple[Callable[[Any], dict[str, int]], str]] = {
    "CAL: the mean is below the least": (
        lambda m: {"mean_256": m.least * 256 - 1} if isinstance(m, CalReply) and m.least else {},
        "CAL_R reports n readings",
    ),
    "CAL: one reading has a variance": (
        lambda m: {"variance_256": 1} if isinstance(m, CalReply) and m.n == 1 else {},
        "CAL_R reports n readings",
    ),
    "CAL: no variance though readings differ": (
        lambda m: {"variance_256": 0} if isinstance(m, CalReply) and m.channel == 1 else {},
        "CAL_R reports n readings",
    ),
    "CONFIG: another Ts in force after a refusal": (
        lambda m: {"ts_us": m.ts_us + 1} if _of_a_refusal(m) else {},
        "A CONFIG with a wrong value",
    ),
    "CONFIG: a code more after a refusal": (
        lambda m: {"u_min": m.u_min + 1} if _of_a_refusal(m) else {},
        "A CONFIG with a wrong value",
    ),
    "CONFIG: an older nonce after a refusal": (
        lambda m: {"nonce": m.nonce ^ 1} if _of_a_refusal(m) else {},
        "has a new nonce",
    ),
    "CONFIG: another sum in force after a refusal": (
        lambda m: {"config_crc": m.config_crc ^ 1} if _of_a_refusal(m) else {},
        "A CONFIG with a wrong value",
    ),
    "CONFIG: a Ts in IDLE": (
        lambda m: {"ts_us": 5} if isinstance(m, ConfigReply) and m.state == State.IDLE else {},
        "STOP leads from",
    ),
    "HELLO_R: a token in IDLE": (
        lambda m: {"token": 7} if isinstance(m, HelloReply) and m.state == State.IDLE else {},
        "Only CLEAR_FAULT",
    ),
    "SAMPLE: a reading near the rail is told as one at it": (
        lambda m: {"y0": 100} if isinstance(m, Sample) else {},
        "consecutive samples at a rail",
    ),
    "SAMPLE: the code before is the code now": (
        lambda m: {"u_km1": m.u_k} if isinstance(m, Sample) else {},
        "code of the applied duty",
    ),
    "SAMPLE: the code before is kept in IDLE": (
        lambda m: {"u_km1": 9} if isinstance(m, Sample) and m.state == State.IDLE else {},
        "every state but RUN",
    ),
    "SAMPLE: a frame number in IDLE": (
        lambda m: {"u_seq": 9} if isinstance(m, Sample) and m.state == State.IDLE else {},
        "every state but RUN",
    ),
    "SAMPLE: of a fault the state before": (
        lambda m: {"state": State.RUN} if isinstance(m, Sample) and m.state == State.FAULT else {},
        "accepted in any state",
    ),
    "SAMPLE: the last CRC_ERR is told again": (
        lambda m: {"flags": m.flags | Flag.CRC_ERR} if isinstance(m, Sample) else {},
        "reported once, by CRC_ERR",
    ),
    "SAMPLE: a code less is queued": (
        lambda m: {"queued": max(0, m.queued - 1)} if isinstance(m, Sample) else {},
        "The queue has no gaps",
    ),
    "SAMPLE: a loss that was none": (
        lambda m: {"flags": m.flags | Flag.RX_OVERFLOW} if isinstance(m, Sample) else {},
        "Bytes lost in a flood",
    ),
    "ACK of CLEAR_FAULT: STALE": (
        lambda m: {"code": Code.STALE} if _is_ack(m, ClearFault, Code.OK) else {},
        "Only CLEAR_FAULT",
    ),
    "ACK of ARM: STALE": (
        lambda m: {"code": Code.STALE} if _is_ack(m, Arm, Code.OK) else {},
        "the answer first",
    ),
    "ACK of START: the state before": (
        lambda m: {"state": State.ARMED} if _is_ack(m, Start, Code.OK) else {},
        "the answer first",
    ),
    "ACK of STOP: STALE": (
        lambda m: {"code": Code.STALE} if _is_ack(m, Stop, Code.OK) else {},
        "STOP leads from",
    ),
    "ACK of SETPOINTS: STALE in a wrong state": (
        lambda m: {"code": Code.STALE} if _is_ack(m, Setpoints, Code.WRONG_STATE) else {},
        "SETPOINTS in ARMED of exchange mode",
    ),
    "ACK of EXCHANGE: STALE in a wrong state": (
        lambda m: {"code": Code.STALE} if _is_ack(m, Exchange, Code.WRONG_STATE) else {},
        "EXCHANGE in RUN is answered",
    ),
    "ACK of an unknown type: another number": (
        lambda m: {"of_seq": m.of_seq ^ 1} if getattr(m, "code", 0) == Code.UNKNOWN_TYPE else {},
        "unknown type",
    ),
    "CAL: a reading less": (
        lambda m: {"n": m.n - 1} if isinstance(m, CalReply) else {},
        "CAL_R reports n readings",
    ),
    "CAL: the other channel": (
        lambda m: {"channel": 1 - m.channel} if isinstance(m, CalReply) else {},
        "CAL_R reports n readings",
    ),
    "CAL: IDLE in ESTOP": (
        lambda m: {"state": State.IDLE} if isinstance(m, CalReply) and m.state else {},
        "During CAL",
    ),
    "CONFIG: another slew": (
        lambda m: {"slew": 1} if isinstance(m, ConfigReply) and m.slew == 30_000 else {},
        "CONFIG_R contains",
    ),
    "CONFIG: u_rest is refused": (
        lambda m: (
            {"code": Code.BAD_VALUE} if isinstance(m, ConfigReply) and m.u_rest == 100 else {}
        ),
        "u_rest other than 0 needs an enable line; otherwise",
    ),
    "CONFIG: scheduled mode is refused": (
        lambda m: (
            {"code": Code.UNSUPPORTED}
            if isinstance(m, ConfigReply) and m.mode and m.ts_us == 10_000
            else {}
        ),
        "Scheduled mode is accepted",
    ),
    "CONFIG: the longest watchdog is refused": (
        lambda m: (
            {"code": Code.BAD_VALUE}
            if isinstance(m, ConfigReply) and m.watchdog_ms == WATCHDOG_MAX_MS
            else {}
        ),
        "The least and largest",
    ),
    "CONFIG: the longest Ts is refused": (
        lambda m: (
            {"code": Code.BAD_VALUE}
            if isinstance(m, ConfigReply) and m.ts_us == 0xFFFF_FFFF
            else {}
        ),
        "The least and largest",
    ),
    "CONFIG: u_min = u_max is refused": (
        lambda m: (
            {"code": Code.BAD_VALUE}
            if isinstance(m, ConfigReply) and m.u_min == m.u_max == 7
            else {}
        ),
        "The least and largest",
    ),
    "CONFIG: 8 conversions are refused": (
        lambda m: (
            {"code": Code.BAD_VALUE} if isinstance(m, ConfigReply) and m.oversampling == 8 else {}
        ),
        "2 (m - 1)",
    ),
    "CONFIG: 2 conversions are not offered": (
        lambda m: (
            {"code": Code.UNSUPPORTED}
            if isinstance(m, ConfigReply) and m.oversampling == 2 and not m.code
            else {}
        ),
        "2 (m - 1)",
    ),
    "EVENT: another state before READY": (
        lambda m: {"was": State.FAULT} if isinstance(m, Event) and m.state == State.READY else {},
        "the answer first",
    ),
    "EVENT: a time ahead": (
        lambda m: {"t_us": (m.t_us + 50_000) & 0xFFFF_FFFF} if isinstance(m, Event) else {},
        "The time in an EVENT",
    ),
    "EVENT: the end is 1.2 ms late": (
        lambda m: (
            {"t_us": (m.t_us + 1_200) & 0xFFFF_FFFF}
            if isinstance(m, Event) and m.cause == Cause.END
            else {}
        ),
        "the last input is held for one Ts",
    ),
    "EVENT: ESTOP without a cause": (
        lambda m: {"cause": 0} if isinstance(m, Event) and m.state == State.ESTOP else {},
        "ESTOP leads from any state",
    ),
    "EVENT: a fault without the code": (
        lambda m: {"detail": 0} if isinstance(m, Event) else {},
        "leads to FAULT(RANGE); only an EVENT",
    ),
    "HELLO_R: another token in ESTOP": (
        lambda m: (
            {"token": m.token ^ 1} if isinstance(m, HelloReply) and m.state == State.ESTOP else {}
        ),
        "ESTOP leads from any state",
    ),
    "HELLO_R: another boot in READY": (
        lambda m: (
            {"boot_id": m.boot_id ^ 0x1_0000}
            if isinstance(m, HelloReply) and m.state == State.READY
            else {}
        ),
        "Random bytes",
    ),
    "HELLO_R: READY in IDLE": (
        lambda m: (
            {"state": State.READY} if isinstance(m, HelloReply) and m.state == State.IDLE else {}
        ),
        "If opening the port resets",
    ),
    "HELLO_R: no CAL is offered": (
        lambda m: (
            {"capabilities": m.capabilities & ~Capability.CAL} if isinstance(m, HelloReply) else {}
        ),
        "CAL_R reports n readings",
    ),
    "PONG: host_ns of 32 bits": (
        lambda m: {"host_ns": m.host_ns & 0xFFFF_FFFF} if isinstance(m, Pong) else {},
        "in any pieces",
    ),
    "SAMPLE: another boot": (
        lambda m: {"boot": m.boot ^ 1} if isinstance(m, Sample) else {},
        "low half of boot_id",
    ),
    "SAMPLE: CRC_ERR is not told": (
        lambda m: {"flags": m.flags & ~Flag.CRC_ERR} if isinstance(m, Sample) else {},
        "reported once, by CRC_ERR",
    ),
    "SAMPLE: WATCHDOG is not told": (
        lambda m: {"flags": m.flags & ~Flag.WATCHDOG} if isinstance(m, Sample) else {},
        "a silence of the host",
    ),
    "SAMPLE: each is late in a run": (
        lambda m: (
            {"flags": m.flags | Flag.TICK_LATE}
            if isinstance(m, Sample) and m.state == State.RUN and m.queued
            else {}
        ),
        "within 1 us of t_0",
    ),
    "SAMPLE: each second time is 20 ms earlier": (
        lambda m: (
            {"t_us": (m.t_us - 20_000 * (m.k & 1)) & 0xFFFF_FFFF} if isinstance(m, Sample) else {}
        ),
        "t_us never goes backwards",
    ),
    "SAMPLE: no code in RUN": (
        lambda m: {"u_k": 0} if isinstance(m, Sample) and 39_900 < m.u_k < 40_100 else {},
        "every state but RUN",
    ),
    "STATUS: another boot": (
        lambda m: {"boot": m.boot ^ 1} if isinstance(m, Status) else {},
        "low half of boot_id",
    ),
    "STATUS: a frame dropped each second": (
        lambda m: {"tx_dropped": m.uptime_ms // 1000} if isinstance(m, Status) else {},
        "At 1 kHz",
    ),
    "STATUS: more frames than came": (
        lambda m: {"frames": 2 * m.frames} if isinstance(m, Status) else {},
        "STATUS counts",
    ),
}


def _change(patch: Patch, wrong: Callable[[Any], dict[str, int]]) -> None:
    changed_answers(patch, lambda m: m._replace(**wrong(m)))


SPOILT: dict[str, SpoiltDevice] = {
    how: SpoiltDevice(partial(_change, wrong=wrong), found_by)
    for how, (wrong, found_by) in FIELDS.items()
}
