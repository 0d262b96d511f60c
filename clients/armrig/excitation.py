"""Input signals for the rig, in volts and inside its 0 to 5 V."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armrig.checks import require_integers, require_numbers

Vector = NDArray[np.float64]

# Handout, assignment 3.3: outside this interval the lab process is destroyed.
LOWEST_V, HIGHEST_V = 0.0, 5.0


def telegraph(
    N: int,
    a: float,
    low: float = 0.5,
    high: float = 4.5,
    seed: int | np.random.Generator = 1,
) -> Vector:
    """Return a random telegraph signal (N,): two levels, switched with probability a a sample.

    The first level is drawn with equal chances. The spectrum is that of a first-order process
    with the autocorrelation (1 - 2a)^|k|.

    Parameters
    ----------
    N : int
        Number of samples, >= 1.
    a : float
        Probability of a switch at each sample, 0 to 1.
    low, high : float
        The levels in V, 0 <= low < high <= 5.
    seed : int or numpy.random.Generator, default 1
        The same seed, an integer >= 0, gives the same signal.

    Returns
    -------
    ndarray, shape (N,)
        Voltage in V at each sample.

    Raises
    ------
    ValueError
        A level is outside 0 to 5 V, or N, a or seed is impossible.

    Notes
    -----
    The handout's telegraph.m (3.1.2) gives -1 and 1, which the rig must not be given.
    """
    require_integers(N=(N, 1))
    _require_levels(low=low, high=high)
    require_numbers(a=a)
    if not isinstance(seed, np.random.Generator):
        require_integers(seed=(seed, 0))
    if not 0 <= a <= 1:
        msg = f"a={a!r} is a probability, 0 <= a <= 1"
        raise ValueError(msg)
    x = np.random.default_rng(seed).random(N)
    switch = x < a
    switch[0] = x[0] < 0.5
    return np.where(np.cumsum(switch) % 2 == 1, high, low).astype(np.float64)


def step(N: int, *, low: float = 0.5, high: float = 4.5, at: int = 0) -> Vector:
    """Return a step from one voltage to a higher one.

    Parameters
    ----------
    N : int
        Number of samples, >= 1.
    low, high : float
        The levels in V, 0 <= low < high <= 5.
    at : int, default 0
        First sample at the higher level, 0 to N; N is a signal that stays low.

    Returns
    -------
    ndarray, shape (N,)
        Voltage in V at each sample.

    Raises
    ------
    ValueError
        A level is outside 0 to 5 V, or N or `at` is impossible.
    """
    require_integers(N=(N, 1), at=(at, 0))
    _require_levels(low=low, high=high)
    if at > N:
        msg = f"at={at!r} must be a sample number, 0 <= at <= N={N}"
        raise ValueError(msg)
    return np.where(np.arange(N) < at, low, high).astype(np.float64)


def _require_levels(*, low: float, high: float) -> None:
    require_numbers(low=low, high=high)
    for name, level in (("low", low), ("high", high)):
        if not LOWEST_V <= level <= HIGHEST_V:  # also refuses NaN
            msg = f"{name}={level!r} V is outside the rig's {LOWEST_V:g} to {HIGHEST_V:g} V"
            raise ValueError(msg)
    if not low < high:
        msg = f"low={low!r} V must lie below high={high!r} V"
        raise ValueError(msg)
