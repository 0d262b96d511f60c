"""Calibration of a rig's counts and codes, estimated from recordings for this purpose."""

from __future__ import annotations

from armrig.recordings.calibration.estimate import Estimate, estimate
from armrig.recordings.calibration.readings import Readings, compressed, decompressed
from armrig.recordings.calibration.staleness import STALE_DAYS, remarks

__all__ = [
    "STALE_DAYS",
    "Estimate",
    "Readings",
    "compressed",
    "decompressed",
    "estimate",
    "remarks",
]
