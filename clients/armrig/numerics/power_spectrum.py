"""Power spectrum of a signal that may have holes (NaN), averaged over its whole stretches."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.numerics.stretches import stretches

Vector = NDArray[np.float64]

_SEGMENTS = 8
_SHORTEST, _LONGEST = 16, 4096


def power_spectrum(signals: Iterable[Vector], Ts: float) -> tuple[Vector, Vector]:
    """Return omega (n,) in rad/s and the one-sided density (n,), in the signal's unit² per rad/s.

    Welch's average of Hann-windowed segments that overlap by half, each less its mean; the area
    below the density is the variance within a segment. A segment has an eighth of the samples,
    4096 at most, and no more than the longest stretch without a hole; stretches shorter than it
    are left out.

    Parameters
    ----------
    signals : iterable of ndarray (N_i,)
        The experiments, NaN where a sample is missing.
    Ts : float
        Sampling time in s.

    Raises
    ------
    ValueError
        No stretch without a hole has 16 samples.

    References
    ----------
    .. [1] P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73.
    """
    from scipy.signal import welch

    whole = [signal[s] for signal in signals for s in stretches(np.isfinite(signal))]
    longest = max((x.size for x in whole), default=0)
    if longest < _SHORTEST:
        raise InputError(
            f"the longest stretch without a hole has {longest} samples; a spectrum needs "
            f"{_SHORTEST}"
        )
    total = sum(x.size for x in whole)
    L = min(max(total // _SEGMENTS, _SHORTEST), _LONGEST, longest)
    omega, density, weight = np.zeros(0), np.zeros(L // 2 + 1), 0
    for x in whole:
        if x.size >= L:
            f, P = welch(x, fs=1 / Ts, nperseg=L, detrend="constant")
            segments = 1 + (x.size - L) // (L - L // 2)
            omega, weight = 2 * np.pi * f, weight + segments
            density = density + segments * P / (2 * np.pi)
    return omega, density / weight
