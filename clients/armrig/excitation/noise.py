"""White noise inside an interval."""

from __future__ import annotations

from typing import Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.excitation.limits import Vector, generator, require_levels
from armrig.numerics.checks import require_integers

_HALF_WIDTH_IN_STD = 3.0


def white_noise(
    N: int,
    low: float = 0.5,
    high: float = 4.5,
    seed: int | np.random.Generator = 1,
    *,
    distribution: Literal["uniform", "normal"] = "uniform",
) -> Vector:
    """Return white noise (N,): independent values, so that the spectrum is flat.

    Parameters
    ----------
    N : int
        Number of samples, >= 1.
    low, high : float
        The interval in V, 0 <= low < high <= 5.
    seed : int or numpy.random.Generator, default 1
        The same seed, an integer >= 0, gives the same signal.
    distribution : {"uniform", "normal"}
        Uniform (MATLAB's rand), of variance (high - low)²/12; or normal (randn) with its
        standard deviation a sixth of the interval and its tails cut off there, which keeps it
        white, with less than a third of the power.

    Raises
    ------
    ValueError
        The interval is outside 0 to 5 V, or N, seed or distribution is impossible.
    """
    from scipy.special import ndtr, ndtri

    require_integers(N=(N, 1))
    require_levels(low=low, high=high)
    if distribution not in ("uniform", "normal"):
        raise InputError(f'distribution={distribution!r} must be "uniform" or "normal"')
    x = generator(seed).random(N)
    if distribution == "normal":
        tail = ndtr(-_HALF_WIDTH_IN_STD)
        x = 0.5 + ndtri(tail + (1 - 2 * tail) * x) / (2 * _HALF_WIDTH_IN_STD)
    # The product may round to just above the interval.
    return np.clip(low + (high - low) * x, low, high)
