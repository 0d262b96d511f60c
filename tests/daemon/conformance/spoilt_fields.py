"""Devices that report a wrong value in a field of a frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from armrig_protocol.messages import (
    CalReply,
    ConfigReply,
    Flag,
    HelloReply,
    Message,
    Sample,
    State,
    Status,
)

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice, changed_answers


def _of_a_refusal(m: Message) -> bool:
    return isinstance(m, ConfigReply) and bool(m.code and m.nonce)


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
