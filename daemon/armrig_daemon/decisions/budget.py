"""Shortest sampling time that a baud rate permits, in exchange and in scheduled mode."""

from __future__ import annotations

from math import ceil

from armrig_core.errors import InputError
from armrig_protocol.frame import wire_length
from armrig_protocol.messages import SETPOINTS_PER_FRAME, Exchange, Ping, Pong, Sample, Setpoints

BITS_PER_BYTE = 10  # 8N1
CONVERSION_US = (
    104  # ATmega328P: 13 clocks of the ADC at 125 kHz; a device reports its value in HELLO_R
)
PING_INTERVAL_US = 25_000
"""Interval between requests for the device's clock in a scheduled run, in µs."""
_SPARE_FACTOR = 1.1  # room for EVENT and for repeated frames


def min_exchange_us(baud: int, conversion_us: float = CONVERSION_US, oversampling: int = 1) -> int:
    """Return the shortest sampling time of exchange mode, in µs.

    In each tick, three phases follow one after the other: the request, `oversampling` conversions
    of each channel, and the answer.
    """
    length = wire_length(Exchange) + wire_length(Sample)
    return ceil(length * BITS_PER_BYTE / baud * 1e6 + 2 * oversampling * conversion_us)


def min_scheduled_us(baud: int, conversion_us: float = CONVERSION_US, oversampling: int = 1) -> int:
    """Return the shortest sampling time of scheduled mode, in µs.

    The two directions of the line are independent. In each sampling time, a sample is sent to the
    host, and a setpoint to the device; one frame contains several setpoints. PING and PONG, which
    compare the clocks, need additional time. The conversions must also fit into the sampling time.
    """
    byte_us = BITS_PER_BYTE / baud * 1e6
    up = wire_length(Sample) * byte_us / (1 - wire_length(Pong) * byte_us / PING_INTERVAL_US)
    share = wire_length(Setpoints) / SETPOINTS_PER_FRAME
    down = share * byte_us / (1 - wire_length(Ping) * byte_us / PING_INTERVAL_US)
    return ceil(max(_SPARE_FACTOR * up, _SPARE_FACTOR * down, 2 * oversampling * conversion_us))


def check(
    ts_us: int,
    baud: int,
    conversion_us: float = CONVERSION_US,
    *,
    scheduled: bool = False,
    oversampling: int = 1,
) -> None:
    """Raise ValueError if `ts_us` is too short; the message names the shortest sampling time."""
    least = (min_scheduled_us if scheduled else min_exchange_us)(baud, conversion_us, oversampling)
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
