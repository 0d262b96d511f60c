"""CAL: readings of one channel and their statistics (PROTOCOL.md, section 5)."""

from __future__ import annotations

from typing import NamedTuple

from armrig_protocol.messages import TYPES, Cal, CalReply, Code, Message, State

from armrig_daemon.emulator.clock import U32
from armrig_daemon.emulator.firmware import UNNUMBERED, Firmware, PendingCal

MOST_READINGS = 1024


class Statistics(NamedTuple):
    """Statistics of the readings, as in CAL_R."""

    mean_256: int
    variance_256: int
    least: int
    greatest: int


def statistics(codes: list[int]) -> Statistics:
    """Return mean and variance in units of 1/256, ties rounded up; with one reading, variance 0."""
    n, total = len(codes), sum(codes)
    pairs = n * (n - 1)
    spread = n * sum(code * code for code in codes) - total * total
    return Statistics(
        mean_256=(256 * total + n // 2) // n,
        variance_256=min((256 * spread + pairs // 2) // pairs, U32) if pairs else 0,
        least=min(codes),
        greatest=max(codes),
    )


def cal(fw: Firmware, now_ns: int, m: Cal) -> list[Message]:
    """Request the conversions of CAL; the answer follows after the last conversion."""
    taken = fw.cal is not None or fw.pending
    if fw.state not in (State.IDLE, State.READY) or taken:
        return [fw.answer(TYPES[Cal], m.seq, Code.WRONG_STATE)]
    if m.channel > 1 or m.zero or not 1 <= m.n <= MOST_READINGS:
        return [fw.answer(TYPES[Cal], m.seq, Code.BAD_VALUE)]
    fw.cal = PendingCal(fw.clock.device_ns(now_ns), m.channel, m.n)
    return []


def answer(fw: Firmware, codes: list[int]) -> Message:
    """Return CAL_R, and release the converter for samples."""
    if fw.cal is None:
        raise RuntimeError("no CAL is in progress")
    channel, fw.cal = fw.cal.channel, None
    return CalReply(fw.state, UNNUMBERED, channel, 0, len(codes), *statistics(codes))
