"""Recent readings of the sensors, and the check whether they permit arming the rig.

At rest a constant reading proves nothing, because a still shaft and a torn wire give the same
reading. Two faults can be detected. The first is a reading at an end of its range, which a sensor
of a rig in order never reaches. The second is a constant angle of a turning shaft although the
motor was driven long enough for a whole turn. A turning shaft at a rail is no fault, because the
shaft may be in the dead band.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Refused, build_refusal
from armrig_core.rig.channels import HALF_COUNTS, DeviceChannel
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

RAIL_NS = 200_000_000
"""Time at a rail, in ns, after which a channel is treated as out of its range."""
STILL_COUNTS = 256
"""Largest difference between readings of one position, in counts: 1.4°, more than the noise."""
FRICTION_V = 1.0
"""Voltage below which the friction may stop the motor, in V."""
APART_S = 0.2
"""Largest time between two compared samples, in s; a motor needs longer for 1/3 turn."""
_RAILS = int(Flag.ADC0_RAIL), int(Flag.ADC1_RAIL)


class ReadingSummary(NamedTuple):
    """Summary of the samples so far."""

    newest: Sample | None = None
    inside_ns: tuple[int, int] = (0, 0)
    """Host's time at which each channel was last inside its range, in ns."""
    least: int = 0
    """Smallest reading of the turning shaft since its last change of position."""
    greatest: int = 0
    """Largest reading of the turning shaft since its last change of position."""
    volt_s: float = 0.0
    """Integral of the voltage above `FRICTION_V` since the last change of position, in Vs."""


def update_readings(before: ReadingSummary, sample: Sample, turning: int = 0) -> ReadingSummary:
    """Return the summary updated by a new sample; `turning` is the channel of the turning shaft."""
    last, now_ns = before.newest, sample.t_host_ns
    reading = sample.counts_1 if turning else sample.counts_0
    first, second = before.inside_ns
    inside_ns = (
        now_ns if last is None or not sample.flags & _RAILS[0] else first,
        now_ns if last is None or not sample.flags & _RAILS[1] else second,
    )
    least, greatest = min(before.least, reading), max(before.greatest, reading)
    if last is None or greatest - least > STILL_COUNTS:
        return ReadingSummary(sample, inside_ns, reading, reading, 0.0)
    held_s = 1e-6 * (sample.t_device_us - last.t_device_us)
    # Between samples further apart, a whole turn would look like no motion.
    counts = 0 < held_s <= APART_S and last.u_applied_v > FRICTION_V
    driven = (last.u_applied_v - FRICTION_V) * held_s if counts else 0.0
    return ReadingSummary(sample, inside_ns, least, greatest, before.volt_s + driven)


def start_rad(readings: ReadingSummary) -> float | None:
    """Return the last angle of channel 0, in rad; None if the angle is unknown."""
    newest = readings.newest
    return None if newest is None or isnan(newest.value_0) else newest.value_0


def objection(
    readings: ReadingSummary,
    channels: Sequence[DeviceChannel],
    *,
    turns_per_volt_s: float,
    is_described: bool = False,
) -> Refused | None:
    """Return the refusal to arm a rig with these readings, or None.

    `channels` are the channels that are read, in their order. `turns_per_volt_s` is the number of
    turns of a moving shaft per Vs of input, as the model predicts; 0 without such a model. An
    output of a rig that `is_described` may have a valid end.
    """
    newest = readings.newest
    if newest is None:
        return build_refusal(RefusalCode.STALE, "no sample has come from the rig yet: try again")
    turns = readings.volt_s * turns_per_volt_s
    counts_, values = (newest.counts_0, newest.counts_1), (newest.value_0, newest.value_1)
    read = zip(channels, counts_, values, readings.inside_ns, strict=False)
    for channel, counts, value, inside_ns in read:
        is_valid = is_described and not isnan(value)
        if not (channel.turns or is_valid) and newest.t_host_ns - inside_ns >= RAIL_NS:
            text = (
                f"{channel.name} reads {counts} of 65535, the end of its range: check the wires "
                "of its sensor, and that nothing holds it there"
            )
            if is_described:
                end = "low" if counts < HALF_COUNTS else "high"
                text += (
                    f"; if the sensor rests there, give valid_rail = '{end}' to [outputs."
                    f"{channel.name}] in the rig's description"
                )
            return build_refusal(RefusalCode.READINGS, text)
        if channel.turns and turns >= 1:
            return build_refusal(
                RefusalCode.READINGS,
                f"{channel.name} reads {counts} of 65535 and did not move while the motor was "
                f"driven for {turns:.1f} turns: check the wires of sensor and motor, then turn "
                "the shaft by hand",
            )
    return None
