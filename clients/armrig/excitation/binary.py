"""Signals of two levels: all the power that an interval allows, for a linear model."""

from __future__ import annotations

from math import ceil
from typing import Literal

import numpy as np
from armrig_core.calls import checked_call
from armrig_core.errors import InputError

from armrig.excitation.levels import Vector, generator, require_levels
from armrig.numerics.checks import require_integers, require_numbers

_LONGEST_REGISTER = 24  # 2^24 - 1 clocks are more than any run has
_HALF_WIDTH_IN_STD = 3.0


@checked_call
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
    require_levels(low=low, high=high)
    require_numbers(a=a)
    rng = generator(seed)
    if not 0 <= a <= 1:
        raise InputError(f"a={a!r} is a probability, 0 <= a <= 1")
    x = rng.random(N)
    switch = x < a
    switch[0] = x[0] < 0.5
    return np.where(np.cumsum(switch) % 2 == 1, high, low).astype(np.float64)


@checked_call
def prbs(
    N: int,
    clock: int = 1,
    low: float = 0.5,
    high: float = 4.5,
    seed: int | np.random.Generator = 1,
    *,
    register: int | None = None,
) -> Vector:
    """Return a maximal-length pseudo-random binary signal (N,).

    A shift register of n bits repeats itself after M = 2^n - 1 clocks, in which it shows every
    pattern of n bits but one: as white as two levels can be over one period (autocorrelation
    -1/M at every lag but 0), and persistently exciting of order M.

    Parameters
    ----------
    N : int
        Number of samples, >= 1. Whole periods are N = (2^register - 1) clock, or times that.
    clock : int, default 1
        Samples for which each value is held, >= 1: a longer clock moves the power below
        the frequency 2.8 / (clock Ts) rad/s.
    low, high : float
        The levels in V, 0 <= low < high <= 5.
    seed : int or numpy.random.Generator, default 1
        Chooses where in its period the signal begins.
    register : int, optional
        Bits of the register, 2 to 24; by default the fewest with which nothing repeats in N.

    Returns
    -------
    ndarray, shape (N,)
        Voltage in V at each sample.

    Raises
    ------
    ValueError
        A level is outside 0 to 5 V, or N, clock, register or seed is impossible.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 13.3.
    """
    from scipy.signal import max_len_seq

    require_integers(N=(N, 1), clock=(clock, 1))
    require_levels(low=low, high=high)
    clocks = ceil(N / clock)
    n = max(2, clocks.bit_length()) if register is None else register
    require_integers(register=(n, 2))
    if n > _LONGEST_REGISTER:
        raise InputError(
            f"register={n} is more than {_LONGEST_REGISTER} bits; lower N or lengthen the clock"
        )
    period = 2**n - 1
    sequence, _ = max_len_seq(n)
    begin = int(generator(seed).integers(period))
    bits = sequence[(begin + np.arange(clocks)) % period]
    return np.where(np.repeat(bits, clock)[:N] == 1, high, low).astype(np.float64)


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
