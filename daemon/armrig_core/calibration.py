"""Counts of a potentiometer to an angle."""

from __future__ import annotations

from math import inf, isfinite, radians

import msgspec


class Potentiometer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One potentiometer: angle = (counts - zero_counts) · rad_per_count, in rad."""

    zero_counts: float = 0.0
    """Reading at angle 0, of 65536."""
    rad_per_count: float = radians(352) / 65536
    """Angle of one count; negative where it is mounted the other way round. Not 0."""
    wraps: bool = True
    """Whether it turns through its dead band and starts anew after one turn."""

    def __post_init__(self) -> None:
        """Refuse a calibration that gives no angles."""
        if not isfinite(self.zero_counts):
            msg = f"zero_counts={self.zero_counts!r} must be finite"
            raise ValueError(msg)
        if not 0 < abs(self.rad_per_count) < inf:
            msg = f"rad_per_count={self.rad_per_count!r} must be finite and not 0"
            raise ValueError(msg)

    def angle(self, counts: float) -> float:
        """Return the angle for a reading, in rad."""
        return (counts - self.zero_counts) * self.rad_per_count


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Both potentiometers of a rig."""

    theta_1: Potentiometer = Potentiometer()
    alpha: Potentiometer = Potentiometer(zero_counts=32768.0, wraps=False)
