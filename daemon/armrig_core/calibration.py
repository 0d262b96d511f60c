"""What makes physical quantities of counts and codes: angles of readings, volts of codes."""

from __future__ import annotations

from math import radians

import msgspec

from armrig_core.errors import InputError
from armrig_core.volts import U_MAX_V

_MOST_COUNTS = 655_360  # ten times what the converter reads
_LEAST_RAD, _MOST_RAD = 1e-8, 0.1  # 0.04° and a thousand turns over the whole range


class Potentiometer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One potentiometer: angle = (counts - zero_counts) · rad_per_count, in rad."""

    zero_counts: float = 0.0
    """Reading at angle 0, of 65536; at most ten ranges beyond it."""
    rad_per_count: float = radians(352) / 65536
    """Angle of one count, 1e-8 to 0.1 rad; negative where it is mounted the other way round."""
    wraps: bool = True
    """Whether it turns through its dead band and starts anew after one turn."""

    def __post_init__(self) -> None:
        """Refuse a calibration that gives no angles."""
        if not abs(self.zero_counts) <= _MOST_COUNTS:  # NaN fails this, too
            raise InputError(
                f"zero_counts={self.zero_counts!r} must be from -{_MOST_COUNTS} to {_MOST_COUNTS}"
            )
        if not _LEAST_RAD <= abs(self.rad_per_count) <= _MOST_RAD:
            raise InputError(
                f"rad_per_count={self.rad_per_count!r} must be from {_LEAST_RAD:g} to "
                f"{_MOST_RAD:g}, or as far below 0"
            )

    def angle(self, counts: float) -> float:
        """Return the angle for a reading, in rad."""
        return (counts - self.zero_counts) * self.rad_per_count


class Driver(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The motor's driver: terminal voltage = gain · u + offset_v where u > 0, and 0 at u = 0."""

    gain: float = 1.0
    """Terminal volts for one volt of the code, where 65535 is 5 V; 0.1 to 10."""
    offset_v: float = 0.0
    """Terminal voltage that the line of the readings has at code 0, in V; -5 to 5."""

    def __post_init__(self) -> None:
        """Refuse a driver that gives no voltages."""
        if not 0.1 <= self.gain <= 10:  # NaN fails this, too
            raise InputError(f"gain={self.gain!r} must be from 0.1 to 10")
        if not abs(self.offset_v) <= U_MAX_V:
            raise InputError(f"offset_v={self.offset_v!r} must be from -{U_MAX_V:g} to {U_MAX_V:g}")


class Figure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A figure that was measured."""

    value: float
    std: float
    """Its standard deviation, in the same unit."""


class Made(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a calibration was made."""

    date: str
    """Wall-clock time of its first recording, ISO 8601 with the offset from UTC."""
    rig: str
    device_uid: str
    """Of the device that was calibrated, as it calls itself."""
    armrig: str
    """Version of armrig."""
    figures: dict[str, Figure] = {}
    """All that was measured, by names that end in their units."""
    recordings: dict[str, str] = {}
    """SHA-256 of each recording that it was estimated from, by what it was for."""
    raw_sha256: str = ""
    """Of their samples, the compressed CSV beside the file."""
    file: str = ""
    """Where the daemon has read it; empty in the file itself."""


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Both potentiometers and the driver of a rig."""

    theta_1: Potentiometer = Potentiometer()
    alpha: Potentiometer = Potentiometer(zero_counts=32768.0, wraps=False)
    driver: Driver = Driver()
    made: Made | None = None
    """How it was made; None where it was not measured, but configured."""
