"""Sums of sines (multisine), and sines with a moving frequency (chirp)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks

from armrig.data.columns import interval
from armrig.excitation.levels import Vector, generator, require_levels, within
from armrig.numerics.checks import require_integers, require_numbers
from armrig.numerics.quantities import plural


def multisine(
    N: int,
    lines: Iterable[int] | None = None,
    low: float = 0.5,
    high: float = 4.5,
    seed: int | np.random.Generator = 1,
    *,
    periods: int = 1,
    rms: float | None = None,
) -> Vector:
    """Return a random-phase multisine (N,) with equal power at chosen lines, no power at others.

    u(k) = middle + A sum over the lines l of cos(2 pi l k / P + phase_l). The signal has whole
    periods of P = N / periods samples. Line l is therefore exactly at 2 pi l / (P Ts) rad/s,
    without leakage.

    For a period of T seconds and a band from f1 to f2 in Hz, give N = periods T / Ts, and lines =
    range(ceil(f1 T), floor(f2 T) + 1).

    Parameters
    ----------
    lines : iterable of int, optional
        Harmonics, 1 <= l < P/2; by default all. If only odd harmonics are excited, even
        nonlinearities are visible at the even harmonics.
    periods : int, default 1
        Number of whole periods in N.
    rms : float, optional
        Effective value about the middle of the interval, in V. The default is the largest value
        with which the signal fits into the interval. Realisations that are compared must have the
        same effective value.
    N, low, high, seed
        As for every signal, see `armrig.excitation`. N is a whole multiple of `periods`. The seed
        determines the phases.

    Raises
    ------
    ValueError
        N is not a whole number of periods, a line is not allowed, or `rms` is so large that a value
        is outside [low, high]. The message contains the first such line or value.

    References
    ----------
    .. [1] R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*,
       2nd ed., 2012, section 5.3.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> u = armrig.multisine(1000, lines=[1, 3, 5])
    >>> np.flatnonzero(abs(np.fft.rfft(u)) > 1e-6)  # 0 is the mean
    array([0, 1, 3, 5])

    Five periods of 5 s at Ts = 0.01 s, with the band from 0.2 to 4 Hz:

    >>> armrig.multisine(2500, lines=range(1, 21), periods=5).size
    2500
    """
    require_integers(N=(N, 1), periods=(periods, 1))
    require_levels(low=low, high=high)
    if N % periods:
        nearest = max(N - N % periods, periods)
        raise InputError(f"N={N} is not a whole number of periods={periods}; use N={nearest}")
    P = N // periods
    if P < 3:
        raise InputError(
            f"a period of N/periods={plural(P, 'sample')} has no line; a period needs at least 3 "
            "samples"
        )
    l = _lines(lines, P)  # noqa: E741 - the textbook's letter
    X = np.zeros(P // 2 + 1, dtype=np.complex128)
    X[l] = np.exp(2j * np.pi * generator(seed).random(l.size))
    s = np.fft.irfft(X, P) * P / 2  # cosines of amplitude 1
    middle = (low + high) / 2
    if rms is None:
        s *= (high - low) / 2 / np.max(np.abs(s))
        u = np.clip(middle + s, low, high)  # by rounding, u may be just outside
    else:
        require_numbers(rms=rms)
        if not rms > 0:
            raise InputError(f"rms={rms!r} V must be > 0")
        u = within(middle + s * rms / np.sqrt(l.size / 2), low=low, high=high)
    return np.tile(u, periods)


def _lines(lines: Iterable[int] | None, P: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    highest = (P - 1) // 2
    chosen = range(1, highest + 1) if lines is None else sorted(set(lines))
    if not len(chosen):
        raise InputError("lines is empty; give harmonics, for example range(1, 50)")
    for line in () if lines is None else chosen:
        require_integers(line=(line, 1))
        if line > highest:
            raise InputError(
                f"line {line} is above {highest}, the highest line for the period P={P}; "
                "lower it or lengthen the period"
            )
    return np.fromiter(chosen, dtype=np.intp, count=len(chosen))


@with_argument_checks
def chirp(
    N: int,
    Ts: float,
    from_hz: float,
    to_hz: float,
    low: float = 0.5,
    high: float = 4.5,
    *,
    sweep: Literal["linear", "logarithmic"] = "linear",
) -> Vector:
    """Return a sine (N,) whose frequency moves from `from_hz` to `to_hz`.

    A linear sweep takes the same time for each hertz, and a logarithmic sweep takes the same time
    for each octave. The sine begins in the middle of the interval and moves between low and high.
    The crest factor of the sine is sqrt(2).

    Parameters
    ----------
    Ts : float
        Sampling time in s.
    from_hz, to_hz : float
        Frequency at the first sample and at the time N Ts, in Hz; > 0 and below 1/(2 Ts).
    sweep : {"linear", "logarithmic"}
        Dependence of the frequency on time.
    N, low, high
        As for every signal, see `armrig.excitation`.

    Examples
    --------
    >>> import armrig
    >>> u = armrig.chirp(1000, 0.01, from_hz=0.1, to_hz=10)
    >>> print(f"{u.size} samples, {u.min():.1f} to {u.max():.1f} V")
    1000 samples, 0.5 to 4.5 V
    """
    require_integers(N=(N, 1))
    require_levels(low=low, high=high)
    require_numbers(Ts=Ts, from_hz=from_hz, to_hz=to_hz)
    if sweep not in ("linear", "logarithmic"):
        raise InputError(f'sweep={sweep!r} must be "linear" or "logarithmic"')
    interval(Ts)
    for name, f in (("from_hz", from_hz), ("to_hz", to_hz)):
        if not 0 < f < 0.5 / Ts:
            raise InputError(
                f"{name}={f!r} must be > 0 and below {0.5 / Ts:g} Hz, half the sampling frequency"
            )
    t, T, ratio = Ts * np.arange(N), N * Ts, to_hz / from_hz
    if sweep == "linear":
        cycles = from_hz * t + (to_hz - from_hz) * t**2 / (2 * T)
    elif abs(ratio - 1) < 1e-9:
        cycles = from_hz * t
    else:
        cycles = from_hz * T * (ratio ** (t / T) - 1) / np.log(ratio)
    u = (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * cycles)
    return np.clip(u, low, high)
