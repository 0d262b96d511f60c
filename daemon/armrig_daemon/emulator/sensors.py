"""Readings of the two potentiometers by the converter.

A wiper moves over `range_rad` of track. If the shaft can turn further, the rest of the turn is a
dead band. In the dead band the wiper has no contact. The pull-down resistor of the wiring guide
grounds the input, so the reading is 0 and has no noise. If the shaft cannot turn further, the wiper
stops at the end of its track.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, tau

import numpy as np

CODE_BITS = 16
RAIL_CODES = 64  # 1/1024 of the range of 65536 codes
REFERENCE_V = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatedPotentiometer:
    """A track and its wiper."""

    range_rad: float
    """Angle over which the wiper has contact with the track, in rad."""
    zero_rad: float
    """Angle from the track's beginning to the wiper when the shaft is at 0, in rad."""
    wraps: bool
    """True if the shaft can turn beyond the track's ends."""
    low: float = 0.0
    """Wiper's voltage at the track's beginning, as a fraction of the reference."""
    high: float = 1.0
    """Wiper's voltage at the track's end, as a fraction of the reference."""
    sign: float = 1.0
    """-1 if the wiper moves towards the track's beginning with increasing angle; otherwise 1."""


def wiper(pot: EmulatedPotentiometer, angle: float) -> float | None:
    """Return the wiper's voltage as a fraction of the reference; None in the dead band."""
    position = pot.sign * angle + pot.zero_rad
    if pot.wraps:
        position %= tau
        if position > pot.range_rad:
            return None
    elif position < 0.0:
        position = 0.0
    elif position > pot.range_rad:
        position = pot.range_rad
    return pot.low + (pot.high - pot.low) * (position / pot.range_rad)


def mean(codes: list[int]) -> int:
    """Return the reading of a channel: the mean of its conversions, ties rounded up.

    If any conversion is at a rail, the reading is the last conversion. The mean of readings at both
    ends of the track would be an angle at which the shaft never was.
    """
    n = len(codes)
    if n == 1 or any(map(at_rail, codes)):
        return codes[-1]
    return (sum(codes) + n // 2) // n


def at_rail(code: int) -> bool:
    """Return whether a reading is in the lowest or highest 1/1024 of the range."""
    return not RAIL_CODES <= code < (1 << CODE_BITS) - RAIL_CODES


def convert(fraction: float | None, bits: int, noise_v: float, rng: np.random.Generator) -> int:
    """Return the reading of a wiper, left-justified to 16 bits.

    The first transition between two codes is at half a step, as in the data sheet of the ATmega328P
    (section 24.7). A reading is therefore the code of the nearest step, and the mean error over a
    step is 0.

    `fraction` is the voltage as a fraction of the reference; None if the wiper has no contact.
    `bits` is the resolution, 1 ... 16, and `noise_v` the standard deviation of the noise from
    `rng`, in V; 0 for no noise.
    """
    if fraction is None:
        return 0
    if noise_v:
        fraction += rng.standard_normal() * (noise_v / REFERENCE_V)
    steps = 1 << bits
    count = floor(fraction * steps + 0.5)
    if not 0 <= count < steps:
        count = 0 if count < 0 else steps - 1
    return count << (CODE_BITS - bits)
