"""Recent readings of the potentiometers, and the check whether they permit arming the rig.

At rest a constant reading proves nothing, because a still shaft and a torn wire give the same
reading. Two faults can be detected. The first is a reading of alpha at an end of its range, which
the moving arm never reaches. The second is a constant theta_1 although the motor was driven long
enough for a whole turn. At rest, theta_1 at a rail is no fault, because the chassis may be in the
dead band. A constant alpha is no fault either, because under a constant voltage the arm follows the
chassis without deflection.
"""

from __future__ import annotations

from math import isnan
from typing import NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Refused, refused
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

RAIL_NS = 200_000_000
"""Time at a rail, in ns, after which alpha is treated as out of its range."""
STILL_COUNTS = 256
"""Largest difference between readings of one position, in counts: 1.4°, more than the noise."""
FRICTION_V = 1.0
"""Voltage below which the friction may stop the motor, in V."""
APART_S = 0.2
"""Largest time between two compared samples, in s; the chassis needs longer for 1/3 turn."""
_ADC1_RAIL = int(Flag.ADC1_RAIL)


class Readings(NamedTuple):
    """Summary of the samples so far."""

    newest: Sample | None = None
    alpha_free_ns: int = 0
    """Host's time at which alpha was last inside its range, in ns."""
    least: int = 0
    """Smallest reading of theta_1 since theta_1 last changed its position."""
    greatest: int = 0
    """Largest reading of theta_1 since its last change of position."""
    volt_s: float = 0.0
    """Integral of the voltage above `FRICTION_V` since the last change of position, in Vs."""


def updated(before: Readings, sample: Sample) -> Readings:
    """Return the summary updated by a new sample."""
    last, y0 = before.newest, sample.theta_1_counts
    free = before.alpha_free_ns
    if last is None or not sample.flags & _ADC1_RAIL:
        free = sample.t_host_ns
    least, greatest = min(before.least, y0), max(before.greatest, y0)
    if last is None or greatest - least > STILL_COUNTS:
        return Readings(sample, free, y0, y0, 0.0)
    held_s = 1e-6 * (sample.t_device_us - last.t_device_us)
    # Between samples further apart, a whole turn would look like no motion.
    counts = 0 < held_s <= APART_S and last.u_applied_v > FRICTION_V
    driven = (last.u_applied_v - FRICTION_V) * held_s if counts else 0.0
    return Readings(sample, free, least, greatest, before.volt_s + driven)


def theta_1_rad(readings: Readings) -> float | None:
    """Return the last angle of the chassis, in rad; None if the angle is unknown."""
    newest = readings.newest
    return None if newest is None or isnan(newest.theta_1_rad) else newest.theta_1_rad


def objection(
    readings: Readings, *, turns_per_volt_s: float, alpha_is_read: bool
) -> Refused | None:
    """Return the refusal to arm a rig with these readings, or None.

    `turns_per_volt_s` is the number of turns of a moving chassis per Vs of input, as the model
    predicts. `alpha_is_read` is True if the arm is mounted, and the shaft of its potentiometer
    stops at the ends.
    """
    newest = readings.newest
    if newest is None:
        return refused(RefusalCode.STALE, "no sample has come from the rig yet: try again")
    railed_ns = newest.t_host_ns - readings.alpha_free_ns
    if alpha_is_read and railed_ns >= RAIL_NS:
        return refused(
            RefusalCode.READINGS,
            f"alpha reads {newest.alpha_counts} of 65535, the end of its range: check the wires "
            "of its potentiometer, and that the arm hangs free",
        )
    turns = readings.volt_s * turns_per_volt_s
    if turns >= 1:
        return refused(
            RefusalCode.READINGS,
            f"theta_1 reads {newest.theta_1_counts} of 65535 and did not move while the motor was "
            f"driven for {turns:.1f} turns: check the wires of potentiometer and motor, then turn "
            "the chassis by hand",
        )
    return None
