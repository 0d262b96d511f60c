"""White noise, and two-level signals with the largest possible power in an interval."""

from __future__ import annotations

from math import ceil
from typing import Literal

import numpy as np
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks

from armrig.excitation.levels import Vector, generator, require_levels
from armrig.numerics.checks import require_integers, require_numbers

_MAX_REGISTER_BITS = 24  # a period of 2^24 - 1 clocks is longer than any run
_HALF_WIDTH_STDS = 3.0


@with_argument_checks
def telegraph(
    N: int, a: float, low: float = 0.5, high: float = 4.5, seed: int | np.random.Generator = 1
) -> Vector:
    """Return a random telegraph signal (N,): at each sample, the level changes with probability a.

    Both levels have equal probability for the first sample. The spectrum equals the spectrum of a
    first-order process with the autocorrelation (1 - 2a)^|k|.

    Parameters
    ----------
    a : float
        Probability of a switch at a sample, 0 to 1.
    N, low, high, seed
        As for every signal, see `armrig.excitation`.

    Notes
    -----
    telegraph.m of the handout (3.1.2) returns the values -1 and 1, which would damage the rig.

    Examples
    --------
    >>> import armrig
    >>> armrig.telegraph(8, 0.3, seed=1)
    array([0.5, 0.5, 4.5, 4.5, 4.5, 4.5, 4.5, 4.5])
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


@with_argument_checks
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

    The sequence of a shift register of n bits has the period M = 2^n - 1 clocks. Each period
    contains all patterns of n bits except one pattern. Over one period the autocorrelation is -1/M
    at every lag except 0. The signal is therefore nearly white, and persistently exciting of order
    M.

    Parameters
    ----------
    clock : int, default 1
        Number of samples for which each value is held, >= 1. A longer clock concentrates the power
        below 2.8 / (clock Ts) rad/s.
    register : int, optional
        Number of bits, 2 to 24. The default is the smallest number of bits for which the signal
        does not repeat within N samples.
    N, low, high, seed
        As for every signal, see `armrig.excitation`. The signal has whole periods only if N is a
        multiple of (2^register - 1) times `clock`. The seed determines the position in the period
        at which the signal begins.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 13.3.

    Examples
    --------
    A register of 7 bits has a period of 127 samples.

    >>> import armrig
    >>> u = armrig.prbs(254, register=7)
    >>> bool((u[:127] == u[127:]).all())
    True
    """
    from scipy.signal import max_len_seq

    require_integers(N=(N, 1), clock=(clock, 1))
    require_levels(low=low, high=high)
    clocks = ceil(N / clock)
    n = max(2, clocks.bit_length()) if register is None else register
    require_integers(register=(n, 2))
    if n > _MAX_REGISTER_BITS:
        raise InputError(
            f"register={n} is more than {_MAX_REGISTER_BITS} bits; lower N or lengthen the clock"
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
    """Return white noise (N,): independent values, with a flat spectrum.

    Parameters
    ----------
    distribution : {"uniform", "normal"}
        "uniform" (MATLAB's rand) has the variance (high - low)²/12. "normal" (randn) has a standard
        deviation of a sixth of the interval before the tails are cut off at low and high. Normal
        noise is white too, but has less than a third of the power of uniform noise.
    N, low, high, seed
        As for every signal, see `armrig.excitation`.

    Examples
    --------
    >>> import armrig
    >>> u = armrig.white_noise(1000, seed=1)
    >>> print(f"{u.min():.1f} to {u.max():.1f} V, standard deviation {u.std():.1f} V")
    0.5 to 4.5 V, standard deviation 1.2 V
    """
    from scipy.special import ndtr, ndtri

    require_integers(N=(N, 1))
    require_levels(low=low, high=high)
    if distribution not in ("uniform", "normal"):
        raise InputError(f'distribution={distribution!r} must be "uniform" or "normal"')
    x = generator(seed).random(N)
    if distribution == "normal":
        tail = ndtr(-_HALF_WIDTH_STDS)
        x = 0.5 + ndtri(tail + (1 - 2 * tail) * x) / (2 * _HALF_WIDTH_STDS)
    # By rounding, the sum may be just outside the interval.
    return np.clip(low + (high - low) * x, low, high)
