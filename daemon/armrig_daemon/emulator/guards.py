"""Guards over the readings in RUN: readings at a rail, too many turns (PROTOCOL.md, section 7)."""

from __future__ import annotations

import msgspec
from armrig_protocol.messages import Cause

from armrig_daemon.emulator.sensors import at_rail

_TURN_CODES = 1 << 16
_NONE = Cause.NONE


class Guards(msgspec.Struct, frozen=True, gc=False):
    """State of the guards since START."""

    rails: tuple[int, int] = (0, 0)
    """Numbers of consecutive samples at a rail, for each channel."""
    turned: int = 0
    """Net rotation of channel 0 since START, in counts."""
    y0: int | None = None
    """Last reading of channel 0; None before the first reading."""


NOTHING_SEEN = Guards()


def watch(guards: Guards, y0: int, y1: int, *, rail_ticks: int, turns: int) -> tuple[Guards, Cause]:
    """Return the state of the guards after a sample, and the cause of a fault or NONE.

    `y0` and `y1` are the readings of the channels. `rail_ticks` is the number of consecutive
    samples at a rail that causes a fault. `turns` is the rotation since START, in either direction,
    that causes a fault, in hundredths of a turn. 0 disables a guard.
    """
    last = y0 if guards.y0 is None else guards.y0
    turned = guards.turned + (y0 - last + _TURN_CODES // 2) % _TURN_CODES - _TURN_CODES // 2
    first, second = guards.rails
    rails = (first + 1 if at_rail(y0) else 0, second + 1 if at_rail(y1) else 0)
    cause = _NONE
    if rail_ticks and max(rails) >= rail_ticks:
        cause = Cause.ADC_RAIL
    elif turns and abs(turned) * 100 >= turns * _TURN_CODES:
        cause = Cause.REV_LIMIT
    return Guards(rails, turned, y0), cause
