"""Which way the arm's potentiometer counts."""

from __future__ import annotations

import numpy as np
from armrig_core.calibration import Figure

from armrig.recordings.calibration.readings import Readings

CLEAR = 8.0
"""Deflections are told from noise of so many standard deviations, and a step beside."""
HAND_RAD = 0.02
"""Shortest deflection by hand that counts, in rad: a touch says nothing."""


def sign_of_lag(readings: Readings, noise: float, step: float) -> int:
    """Return the sign of alpha for growing counts, 0 where the arm was not seen to deflect.

    When the motor sets the chassis in motion from rest, towards positive angles, the arm stays
    behind: alpha is negative first.

    Parameters
    ----------
    readings : Readings
        A run that begins at 0 V and at rest.
    noise : float
        Standard deviation of alpha's readings at rest, in counts.
    step : float
        The converter's step, in counts.
    """
    driven = np.flatnonzero(readings.u > 0)
    if not driven.size or driven[0] == 0:
        return 0
    deflection = readings.alpha - readings.alpha[: driven[0]].mean()
    seen = np.flatnonzero(np.abs(deflection) > CLEAR * noise + step)
    seen = seen[seen > driven[0]]
    return 0 if not seen.size else int(-np.sign(deflection[seen[0]]))


def sign_by_hand(readings: Readings, rest: Figure, rad_per_count: float) -> int:
    """Return the sign of alpha for growing counts; 0 where the arm was deflected either way or not.

    Parameters
    ----------
    readings : Readings
        The arm deflected by hand towards positive alpha, and let go or held.
    rest : Figure
        Reading at rest, in counts.
    rad_per_count : float
        About how much a count is, in rad; the sign does not matter.
    """
    deflection = (readings.alpha - rest.value) * abs(rad_per_count)
    # Quantiles count the time in which the arm is held; once let go it swings either way.
    low, high = np.quantile(deflection, [0.25, 0.75])
    farthest = max(low, high, key=abs)
    return 0 if abs(farthest) < HAND_RAD else int(np.sign(farthest))
