"""The conversion of counts to angles and of codes to volts."""

from __future__ import annotations

from math import nan, radians
from typing import Final, Literal

import msgspec

from armrig_core.errors import InputError
from armrig_core.rig.volts import U_MAX_V

THETA_1: Final = "theta_1"
ALPHA: Final = "alpha"
ChannelName = Literal["theta_1", "alpha"]
CALIBRATED = (THETA_1, ALPHA)
"""Names of the channels that a calibration contains, in the order of the device's readings."""
BODY = "chassis"
"""Part of the arm whose turns the device counts."""
ArmModel = Literal["", "arm", "chassis"]
"""Model with the arm's parameters: the whole arm, or its first part alone; "" for none."""
_MAX_ZERO_COUNTS = 655_360  # ten times the range of the converter
_MIN_RAD_PER_COUNT, _MAX_RAD_PER_COUNT = 1e-8, 0.1  # 0.04° and 1000 turns for the full range


class Potentiometer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One potentiometer: angle = (counts - zero_counts) · rad_per_count, in rad."""

    zero_counts: float = 0.0
    """Reading at angle 0, in counts (full scale 65536); from -655360 to 655360."""
    rad_per_count: float = radians(352) / 65536
    """Angle of one count, 1e-8 to 0.1 rad; negative if the potentiometer turns the other way."""
    wraps: bool = True
    """True if the shaft turns through the dead band, so that the reading repeats after one turn."""

    def __post_init__(self) -> None:
        """Refuse values outside their ranges."""
        if not abs(self.zero_counts) <= _MAX_ZERO_COUNTS:  # NaN fails this, too
            raise InputError(
                f"zero_counts={self.zero_counts!r} must be from -{_MAX_ZERO_COUNTS} to "
                f"{_MAX_ZERO_COUNTS}"
            )
        if not _MIN_RAD_PER_COUNT <= abs(self.rad_per_count) <= _MAX_RAD_PER_COUNT:
            raise InputError(
                f"rad_per_count={self.rad_per_count!r} must be from {_MIN_RAD_PER_COUNT:g} to "
                f"{_MAX_RAD_PER_COUNT:g}, or negative in the same range"
            )

    def value(self, counts: float) -> float:
        """Return the angle of a reading in counts, in rad."""
        return (counts - self.zero_counts) * self.rad_per_count

    def value_at_rail(self, _: float) -> float:
        """Return NaN: at an end of its range a potentiometer shows no angle."""
        return nan


class Driver(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The motor's driver: terminal voltage = gain · u + offset_v if u > 0, and 0 at u = 0."""

    gain: float = 1.0
    """Terminal voltage per volt of u (code 65535 is u = 5 V), 0.1 to 10."""
    offset_v: float = 0.0
    """Terminal voltage of the fitted line at code 0, in V; -5 to 5."""

    def __post_init__(self) -> None:
        """Refuse values outside their ranges."""
        if not 0.1 <= self.gain <= 10:  # NaN fails this, too
            raise InputError(f"gain={self.gain!r} must be from 0.1 to 10")
        if not abs(self.offset_v) <= U_MAX_V:
            raise InputError(f"offset_v={self.offset_v!r} must be from -{U_MAX_V:g} to {U_MAX_V:g}")


Conversion = tuple[Potentiometer, Potentiometer, Driver]
"""Conversion of counts to angles and of codes to volts; equal for equal values."""


class MeasuredValue(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured value."""

    value: float
    std: float
    """Standard deviation of the value, in the same unit."""


class Made(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Origin of a measured calibration."""

    date: str
    """Wall-clock time of the first recording, ISO 8601 with the offset from UTC."""
    rig: str
    device_uid: str
    """Identity that the calibrated device reports."""
    armrig: str
    """Version of armrig."""
    figures: dict[str, MeasuredValue] = {}
    """Measured values by name; each name ends in its unit."""
    recordings: dict[str, str] = {}
    """SHA-256 of each recording on which the calibration is based, by the recording's purpose."""
    raw_sha256: str = ""
    """SHA-256 of the compressed CSV file of the samples, next to the calibration file."""
    file: str = ""
    """Path from which the daemon read the calibration; empty in the file itself."""


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Both potentiometers and the driver of a rig."""

    theta_1: Potentiometer = Potentiometer()
    alpha: Potentiometer = Potentiometer(zero_counts=32768.0, wraps=False)
    driver: Driver = Driver()
    made: Made | None = None
    """Origin of the calibration; None if the values are configured instead of measured."""

    @property
    def channels(self) -> tuple[Potentiometer, Potentiometer]:
        """Potentiometers in the order of the device's channels."""
        return self.theta_1, self.alpha

    @property
    def conversion(self) -> Conversion:
        """Potentiometers and driver, without the origin of their values."""
        return *self.channels, self.driver
