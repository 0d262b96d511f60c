"""What the wire can carry: the shortest sampling time for a baud rate, in either mode."""

from __future__ import annotations

from math import ceil

from armrig_core.errors import InputError
from armrig_protocol.frame import wire_length
from armrig_protocol.messages import SETPOINTS_PER_FRAME, Exchange, Ping, Pong, Sample, Setpoints

BITS_PER_BYTE = 10  # 8N1
CONVERSION_US = (
    104  # ATmega328P: 13 clocks of the ADC at 125 kHz; a device tells its own in HELLO_R
)
PING_US = 25_000
"""How often a scheduled run asks for the device's clock, in µs."""
_SPARE = 1.1  # room for EVENT and for what is sent again


def exchange_us(baud: int, conversion_us: float = CONVERSION_US, oversampling: int = 1) -> int:
    """Return the shortest sampling time of exchange mode, in µs.

    A tick carries the request, `oversampling` conversions of each channel and the answer, one after
    the other.
    """
    length = wire_length(Exchange) + wire_length(Sample)
    return ceil(length * BITS_PER_BYTE / baud * 1e6 + 2 * oversampling * conversion_us)


def scheduled_us(baud: int, conversion_us: float = CONVERSION_US, oversampling: int = 1) -> int:
    """Return the shortest sampling time of scheduled mode, in µs.

    Each direction counts by itself: a sample one way, a share of a frame of setpoints the other,
    and a question for the clock now and then; and the converter must have been read.
    """
    byte_us = BITS_PER_BYTE / baud * 1e6
    up = wire_length(Sample) * byte_us / (1 - wire_length(Pong) * byte_us / PING_US)
    share = wire_length(Setpoints) / SETPOINTS_PER_FRAME
    down = share * byte_us / (1 - wire_length(Ping) * byte_us / PING_US)
    return ceil(max(_SPARE * up, _SPARE * down, 2 * oversampling * conversion_us))


def check(
    ts_us: int,
    baud: int,
    conversion_us: float = CONVERSION_US,
    *,
    scheduled: bool = False,
    oversampling: int = 1,
) -> None:
    """Raise ValueError, with the sampling time that would do, where `ts_us` cannot fit."""
    least = (scheduled_us if scheduled else exchange_us)(baud, conversion_us, oversampling)
    if ts_us < least:
        mode = "scheduled" if scheduled else "exchange"
        averaged, fewer = "", ""
        if oversampling > 1:
            averaged = f" with [device] oversampling = {oversampling}"
            fewer = ", or less oversampling"
        raise InputError(
            f"Ts={ts_us / 1e6:g} s cannot be carried at {baud} baud in {mode} mode{averaged}: "
            f"at least {least / 1e6:g} s, or a higher baud rate{fewer}"
        )
