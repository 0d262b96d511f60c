"""What a rig's counts and codes mean: estimated from recordings made for it."""

from __future__ import annotations

from armrig.calibration.estimate import Estimate, estimate
from armrig.calibration.readings import CalibrationError, Readings, compressed, decompressed
from armrig.calibration.staleness import STALE_DAYS, remarks

__all__ = [
    "STALE_DAYS",
    "CalibrationError",
    "Estimate",
    "Readings",
    "compressed",
    "decompressed",
    "estimate",
    "remarks",
]
