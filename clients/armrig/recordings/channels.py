"""The channels of a recording: calibrated, on the grid of time, and where each is valid.

A shaft turns on. Over most of a turn its potentiometer shows the angle; in its dead band it shows
nothing. What it shows there, and at the first sample after it, while the reading settles, is no
angle.
"""

from __future__ import annotations

from dataclasses import fields
from math import pi, tau
from typing import Any

import numpy as np
from armrig_core import telemetry
from armrig_core.calibration import Calibration, Potentiometer
from armrig_core.protobuf import ABSENT
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from armrig.numerics.stretches import Mask
from armrig.recordings.grid import Grid
from armrig.recordings.recording import Channel, Recording

Vector = NDArray[np.float64]
Indices = NDArray[np.intp]
_FIELDS = frozenset(field.name for field in fields(Recording))

HALF_TURN_S = 0.25
"""Shortest time in which the chassis can make half a turn, in s.

With 5 V it turns at 5 V / (N K_m) = 9.3 rad/s, half a turn in 0.34 s; the rest is for the springs.
"""


def channels_of(
    samples: NDArray[np.void],
    rows: Grid,
    calibration: Calibration | None,
    Ts: float,
    before: NDArray[np.void],
) -> dict[str, Any]:
    """Return the channels, where they are valid, and where the turns are not known."""
    found: dict[str, Any] = {"others": {}, "turns_unknown": ()}
    for channel in telemetry.CHANNELS:
        pot: Potentiometer | None = getattr(calibration, channel.name, None)
        y = _on_grid(_calibrated(samples, channel, pot), rows.present)
        valid = _valid(samples, channel, rows.present, before) & np.isfinite(y)
        if channel.turns and (pot is None or pot.wraps):
            y = unwrap(y, valid)
            found["turns_unknown"] += tuple(turns_unknown(valid, rows.present, Ts).tolist())
        y[~valid] = np.nan
        if channel.name in _FIELDS:
            found |= {channel.name: y, channel.valid: valid}
        else:
            found["others"][channel.name] = Channel(y, valid)
    return found


def _valid(
    samples: NDArray[np.void], channel: telemetry.Channel, present: Mask, before: NDArray[np.void]
) -> Mask:
    """Return (N,) where a sample came whose reading is at no end of its range."""
    rail = int(Flag[channel.rail])  # as a Flag numpy takes 8 bytes each
    valid, rails = present.copy(), samples["flags"]
    if channel.turns:
        # The sample before the first decides whether that one shows an angle.
        near = np.concatenate([before["flags"][-1:], rails])
        valid[present] = outside_dead_band((near & rail) != 0)[near.size - rails.size :]
    else:
        valid[present] = (rails & rail) == 0
    return valid


def _calibrated(
    samples: NDArray[np.void], channel: telemetry.Channel, pot: Potentiometer | None
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
    """Return the values (n,) of the samples that came in their rows, NaN in the others, (N,)."""
    if values.size == present.size:
        return values
    on_grid = np.full(present.size, np.nan)
    on_grid[present] = values
    return on_grid


def outside_dead_band(rail: Mask) -> Mask:
    """Return which of the samples that came (n,) show an angle: no rail, and no rail before.

    So a sample between two rails shows none either, whatever the converter says: at the edges of
    the dead band it shows values from anywhere.
    """
    after = np.zeros_like(rail)
    after[1:] = rail[:-1]
    return ~rail & ~after


def unwrap(angle: Vector, valid: Mask) -> Vector:
    """Return the angle (N,) with its turns counted, NaN where it is not valid.

    Each valid sample is taken to lie within half a turn of the valid one before it. The first one
    keeps its value.
    """
    unwrapped = np.full(angle.size, np.nan)
    shown = angle[valid]
    steps = np.diff(shown)
    # As np.unwrap to the last bit, which takes the remainder of each step; few of them need it.
    over = np.flatnonzero(np.abs(steps) >= pi)
    short = np.mod(steps[over] + pi, tau) - pi
    short[(short == -pi) & (steps[over] > 0)] = pi
    if over.size:
        turned = np.cumsum(short - steps[over])
        shown[over[0] + 1 :] += np.repeat(turned, np.diff(over, append=steps.size))
    unwrapped[valid] = shown
    return unwrapped


def turns_unknown(valid: Mask, present: Mask, Ts: float) -> Indices:
    """Return the samples from which on the number of turns is a guess.

    Before each of them the shaft was unseen for so long that it can have made half a turn. In the
    dead band it is not unseen: a sample at a rail says where it is. With a sampling time longer
    than half a turn takes, that is every sample.

    Parameters
    ----------
    valid, present : (N,) bool
        Which samples show an angle, and which came at all.
    Ts : float
        Sampling time, in s.
    """
    if present.all() and Ts <= HALF_TURN_S:
        return np.zeros(0, np.intp)
    missing = np.cumsum(~present)
    known = np.flatnonzero(valid)
    # The interval before the first sample that came back is unseen, too.
    unseen = np.diff(missing[known])
    return known[1:][(unseen + 1) * Ts > HALF_TURN_S]
