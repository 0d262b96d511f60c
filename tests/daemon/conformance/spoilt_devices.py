"""Devices of the emulator that each break one rule of PROTOCOL.md, and where they stand."""

from __future__ import annotations

from typing import Any

import spoilt_frames
import spoilt_readings
import spoilt_setpoints
import spoilt_states
from spoiling import SpoiltDevice

UNPLUGGED: dict[str, Any] = {"arm": {"R_m": 1e9}}
"""The motor does not turn the arm, whatever the code."""
AT_A_RAIL: dict[str, Any] = {"theta_1_zero_deg": 356.0, **UNPLUGGED}
"""theta_1 stands in its dead band, so that the guard over the rails can be tried."""

SPOILT: dict[str, SpoiltDevice] = (
    spoilt_frames.SPOILT | spoilt_states.SPOILT | spoilt_readings.SPOILT | spoilt_setpoints.SPOILT
)
