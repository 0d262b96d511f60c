"""Devices of the emulator that each break one rule of PROTOCOL.md, and where they stand."""

from __future__ import annotations

from typing import Any

from tests.daemon.conformance import (
    spoilt_fields,
    spoilt_frames,
    spoilt_readings,
    spoilt_requests,
    spoilt_setpoints,
    spoilt_states,
)
from tests.daemon.conformance.spoiling import SpoiltDevice

UNPLUGGED: dict[str, Any] = {"arm": {"R_m": 1e9}}
"""Settings with an open motor circuit: the motor does not turn the arm."""
AT_A_RAIL: dict[str, Any] = {"theta_1_zero_deg": 356.0, **UNPLUGGED}
"""Settings with theta_1 in its dead band, for the tests of the guard over the rails."""

SPOILT: dict[str, SpoiltDevice] = (
    spoilt_frames.SPOILT
    | spoilt_states.SPOILT
    | spoilt_readings.SPOILT
    | spoilt_setpoints.SPOILT
    | spoilt_requests.SPOILT
    | spoilt_fields.SPOILT
)
