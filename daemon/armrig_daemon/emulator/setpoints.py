"""Effect of SETPOINTS (PROTOCOL.md, section 6)."""

from __future__ import annotations

from armrig_protocol.messages import (
    SETPOINTS_PER_FRAME,
    TYPES,
    Cause,
    Code,
    Message,
    Setpoints,
    State,
)

from armrig_daemon.emulator.firmware import Firmware


def setpoints(fw: Firmware, now_ns: int, m: Setpoints) -> list[Message]:
    """Put the setpoints into the queue; do not answer valid setpoints, even if they are dropped."""
    if fw.queue is None:
        return [fw.answer(TYPES[Setpoints], m.seq, Code.WRONG_STATE)]
    if not 1 <= m.n <= SETPOINTS_PER_FRAME or m.zero:
        return [fw.answer(TYPES[Setpoints], m.seq, Code.BAD_VALUE)]
    cause, code = fw.queue.violation(m)
    if cause is not Cause.NONE:
        return [fw.enter(now_ns, State.FAULT, cause, detail=code)]
    if not fw.queue.add(m):
        return [fw.answer(TYPES[Setpoints], m.seq, Code.BAD_VALUE)]
    return []
