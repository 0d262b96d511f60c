"""What the wire can carry: the shortest sampling time for a baud rate."""

from __future__ import annotations

from math import ceil

from armrig_protocol.frame import wire_length
from armrig_protocol.messages import Exchange, Sample

BITS_PER_BYTE = 10  # 8N1
CONVERSION_US = (
    104  # ATmega328P: 13 clocks of the ADC at 125 kHz; a device tells its own in HELLO_R
)


def exchange_us(baud: int, conversion_us: float = CONVERSION_US) -> int:
    """Return the shortest sampling time of exchange mode, in µs.

    A tick carries the request, two conversions and the answer, one after the other.
    """
    length = wire_length(Exchange) + wire_length(Sample)
    return ceil(length * BITS_PER_BYTE / baud * 1e6 + 2 * conversion_us)


def check_exchange(ts_us: int, baud: int, conversion_us: float = CONVERSION_US) -> None:
    """Raise ValueError, with the rate that would do, where `ts_us` cannot fit."""
    least = exchange_us(baud, conversion_us)
    if ts_us < least:
        msg = (
            f"Ts={ts_us / 1e6:g} s cannot be carried at {baud} baud: "
            f"at least {least / 1e6:g} s, or a higher baud rate"
        )
        raise ValueError(msg)
