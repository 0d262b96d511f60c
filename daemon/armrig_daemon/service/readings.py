"""What the potentiometers have shown lately, and whether a rig with such readings may be armed.

At rest a reading that does not move says nothing: a still shaft and a torn wire look alike. What
can be told: alpha at an end of its track (it never gets there by turning on), and a theta_1 that
stayed where it was while the motor was driven for as long as a whole turn takes. theta_1 at a rail
at rest is no fault: the chassis may stand in the dead band. Nor is an alpha that does not move:
the arm follows a constant voltage without deflecting.
"""

from __future__ import annotations

from math import isnan
from typing import NamedTuple

from armrig_core.codes import RefusalCode
from armrig_core.commands import Refused, refused
from armrig_core.telemetry import Sample
from armrig_protocol.messages import Flag

RAIL_NS = 200_000_000
"""At a rail for so long, alpha is out of its range, in ns."""
STILL_COUNTS = 256
"""Readings this close together, of 65536, are one place: 1.4°, beyond any noise."""
FRICTION_V = 1.0
"""A lower voltage may not overcome the friction, in V."""
APART_S = 0.2
"""At 5 V the chassis turns by less than a third of a turn in so long, in s."""
_ADC1_RAIL = int(Flag.ADC1_RAIL)


class Readings(NamedTuple):
    """What is remembered of the samples so far."""

    newest: Sample | None = None
    alpha_free_ns: int = 0
    """When alpha was last inside its range, on the host's clock."""
    least: int = 0
    """Smallest reading of theta_1 since it last left its place."""
    greatest: int = 0
    """Greatest reading of theta_1 since then."""
    volt_s: float = 0.0
    """Integral of the voltage beyond the friction since then, in Vs."""


def updated(before: Readings, sample: Sample) -> Readings:
    """Return the readings after one more sample."""
    last, y0 = before.newest, sample.theta_1_counts
    free = before.alpha_free_ns
    if last is None or not sample.flags & _ADC1_RAIL:
        free = sample.t_host_ns
    least, greatest = min(before.least, y0), max(before.greatest, y0)
    if last is None or greatest - least > STILL_COUNTS:
        return Readings(sample, free, y0, y0, 0.0)
    held_s = 1e-6 * (sample.t_device_us - last.t_device_us)
    # Samples further apart may have whole turns between them, which look like none.
    counts = 0 < held_s <= APART_S and last.u_applied_v > FRICTION_V
    driven = (last.u_applied_v - FRICTION_V) * held_s if counts else 0.0
    return Readings(sample, free, least, greatest, before.volt_s + driven)


def theta_1_rad(readings: Readings) -> float | None:
    """Return where the chassis was at last, in rad; None where that is not known."""
    newest = readings.newest
    return None if newest is None or isnan(newest.theta_1_rad) else newest.theta_1_rad


def objection(
    readings: Readings, *, turns_per_volt_s: float, alpha_is_read: bool
) -> Refused | None:
    """Return why a rig with these readings is not armed, or None.

    Parameters
    ----------
    turns_per_volt_s : float
        Turns of the chassis for one Vs, in the model, once it turns.
    alpha_is_read : bool
        Whether alpha's potentiometer is there, and does not turn on beyond its ends.
    """
    newest = readings.newest
    if newest is None:
        return refused(RefusalCode.STALE, "no sample has come from the rig yet: try again")
    railed_ns = newest.t_host_ns - readings.alpha_free_ns
    if alpha_is_read and railed_ns >= RAIL_NS:
        return refused(
            RefusalCode.READINGS,
            f"alpha reads {newest.alpha_counts} of 65535, the end of its range: see to its wires, "
            "and that the arm hangs free",
        )
    turns = readings.volt_s * turns_per_volt_s
    if turns >= 1:
        return refused(
            RefusalCode.READINGS,
            f"theta_1 reads {newest.theta_1_counts} of 65535 and did not move while the motor was "
            f"driven for {turns:.1f} turns: see to its wires and to the motor's, then turn the "
            "chassis by hand",
        )
    return None
