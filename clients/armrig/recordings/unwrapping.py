"""The angle of a shaft that turns on, from a potentiometer with a dead band.

Over most of a turn the potentiometer shows the angle; in its dead band it shows nothing. What it
shows there, and at the first sample after it, while the reading settles, is no angle.
"""

from __future__ import annotations

from math import pi, tau

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.stretches import Mask

Vector = NDArray[np.float64]
Indices = NDArray[np.intp]

HALF_TURN_S = 0.25
"""Shortest time in which the chassis can make half a turn, in s.

With 5 V it turns at 5 V / (N K_m) = 9.3 rad/s, half a turn in 0.34 s; the rest is for the springs.
"""


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
