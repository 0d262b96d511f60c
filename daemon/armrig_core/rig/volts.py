"""Conversion of motor voltages to codes of the protocol and back: 0 … 65535 is 0 … 5 V."""

from __future__ import annotations

from collections.abc import Iterable
from struct import pack

from armrig_protocol.messages import CODE_FULL_SCALE, FULL_SCALE_MV

from armrig_core.errors import InputError

U_MAX_V = FULL_SCALE_MV / 1000
"""Largest motor voltage, in V. A higher voltage, or a voltage below 0 V, destroys the rig."""
CODES_PER_V = CODE_FULL_SCALE / U_MAX_V
"""Codes per volt."""


def code_of(u: float) -> int:
    """Return the code nearest to the voltage `u`, in V.

    Raises ValueError if `u` is not a number in [0, 5]. The voltage is never clamped.
    """
    if not 0.0 <= u <= U_MAX_V:  # also true of NaN
        why = f"a voltage outside 0 … {U_MAX_V:g} V destroys the rig"
        raise InputError(f"{u!r} V is not allowed: {why}")
    return round(u / U_MAX_V * CODE_FULL_SCALE)


def codes_of(u: Iterable[float]) -> bytes:
    """Return the codes of the voltages as little-endian u16 values; raise as `code_of` does."""
    codes = [code_of(voltage) for voltage in u]
    return pack(f"<{len(codes)}H", *codes)


def volts_of(code: int) -> float:
    """Return the voltage of a code, in V."""
    return code / CODE_FULL_SCALE * U_MAX_V


def duty(code: int, pwm_bits: int) -> int:
    """Return the duty cycle nearest to `code`, in steps of 1/2^pwm_bits; ties cannot occur."""
    return ((code << (pwm_bits + 1)) + CODE_FULL_SCALE) // (2 * CODE_FULL_SCALE)


def device_code(code: int, pwm_bits: int) -> int:
    """Return the code that a device with this duty resolution latches for `code`; ties round up."""
    steps = duty(code, pwm_bits)
    return (2 * steps * CODE_FULL_SCALE + (1 << pwm_bits)) >> (pwm_bits + 1)
