"""Channels of a recording: calibrated angles on the grid of samples, and their validity.

A potentiometer of a turning shaft shows the angle over most of a turn. In its dead band it shows no
angle. The first sample after the dead band shows no angle either, because the reading still
settles.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, tau
from typing import Any

import numpy as np
from armrig_core.rig import channels as rig
from armrig_core.rig.calibration import Calibration, Potentiometer
from armrig_core.telemetry.protobuf import ABSENT
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from armrig.data.columns import Vector
from armrig.numerics.stretches import Mask
from armrig.recordings.grid import SampleGrid
from armrig.recordings.recording import Channel

Indices = NDArray[np.intp]

HALF_TURN_S = 0.25
"""Shortest time, in s, in which the arm can make half a turn.

At 5 V the arm turns at 5 V / (N K_m) = 9.3 rad/s and makes half a turn in 0.34 s. The constant
leaves a margin for the effect of the springs.
"""


def channels_of(
    samples: NDArray[np.void],
    rows: SampleGrid,
    calibration: Calibration | None,
    Ts: float,
    before: NDArray[np.void],
    channels: Sequence[rig.DeviceChannel],
) -> dict[str, Any]:
    """Return the channels, their masks, and the rows from which the number of turns is unknown."""
    signals: dict[str, Channel] = {}
    unknown: tuple[int, ...] = ()
    for channel in channels:
        pot: Potentiometer | None = getattr(calibration, channel.name, None)
        y = _on_grid(_channel_values(samples, channel, pot), rows.present)
        valid = np.isfinite(y)
        if channel.turns or pot is not None:  # of every other channel the daemon marks by NaN
            valid &= _valid(samples, channel, rows.present, before)
        if channel.turns and (pot is None or pot.wraps):
            y = unwrap(y, valid)
            unknown += tuple(turns_unknown(valid, rows.present, Ts).tolist())
        y[~valid] = np.nan
        signals[channel.name] = Channel(y, valid)
    return {"channels": signals, "turns_unknown": unknown}


def _valid(
    samples: NDArray[np.void], channel: rig.DeviceChannel, present: Mask, before: NDArray[np.void]
) -> Mask:
    """Return a mask (N,): True if the sample arrived and shows an angle of this channel."""
    rail = int(Flag[channel.rail])  # an array of a Flag would have 8 bytes for each sample
    valid, rails = present.copy(), samples["flags"]
    if channel.turns:
        # The sample before row 0 shows whether row 0 directly follows the dead band.
        near = np.concatenate([before["flags"][-1:], rails])
        valid[present] = outside_dead_band((near & rail) != 0)[near.size - rails.size :]
    else:
        valid[present] = (rails & rail) == 0
    return valid


def _channel_values(
    samples: NDArray[np.void], channel: rig.DeviceChannel, pot: Potentiometer | None
) -> Vector:
    if pot is None:
        return np.array(samples[channel.value_field], np.float64)
    counts = samples[channel.counts_field]
    y: Vector = counts.astype(np.float64)
    y -= pot.zero_counts
    y *= pot.rad_per_count
    y[counts == ABSENT["fixed32"]] = np.nan
    return y


def _on_grid(values: Vector, present: Mask) -> Vector:
    """Return values (n,) of the samples that arrived on the grid (N,), NaN for missing samples."""
    if values.size == present.size:
        return values
    on_grid = np.full(present.size, np.nan)
    on_grid[present] = values
    return on_grid


def outside_dead_band(rail: Mask) -> Mask:
    """Return a mask (n,), False for samples at a rail and for the first sample after them.

    At the edges of the dead band, the converter can read any value. A single sample between two
    samples at a rail is therefore False, too.
    """
    after = np.zeros_like(rail)
    after[1:] = rail[:-1]
    return ~rail & ~after


def unwrap(angle: Vector, valid: Mask) -> Vector:
    """Return the unwrapped angle (N,), NaN where `valid` is False.

    Each valid sample is assumed to be within half a turn of the previous valid sample. The first
    valid sample keeps its value.
    """
    unwrapped = np.full(angle.size, np.nan)
    valid_angle = angle[valid]
    steps = np.diff(valid_angle)
    # The result equals that of np.unwrap to the last bit. Only steps of pi or more need a
    # remainder.
    over = np.flatnonzero(np.abs(steps) >= pi)
    short = np.mod(steps[over] + pi, tau) - pi
    short[(short == -pi) & (steps[over] > 0)] = pi
    if over.size:
        turned = np.cumsum(short - steps[over])
        valid_angle[over[0] + 1 :] += np.repeat(turned, np.diff(over, append=steps.size))
    unwrapped[valid] = valid_angle
    return unwrapped


def turns_unknown(valid: Mask, present: Mask, Ts: float) -> Indices:
    """Return the indices of the samples at which the number of turns becomes uncertain.

    Before each of these samples, so many samples are missing that the shaft can have made half a
    turn. Samples in the dead band arrived, and do not count as missing. If the sampling time
    exceeds `HALF_TURN_S`, the indices of all valid samples except the first are returned.

    `valid` (N,) is the mask of the samples that show an angle, `present` (N,) of those that
    arrived; Ts is in s.
    """
    if present.all() and Ts <= HALF_TURN_S:
        return np.zeros(0, np.intp)
    missing = np.cumsum(~present)
    valid_indices = np.flatnonzero(valid)
    # The interval between the last missing sample and the next sample is unseen, too.
    unseen = np.diff(missing[valid_indices])
    return valid_indices[1:][(unseen + 1) * Ts > HALF_TURN_S]
