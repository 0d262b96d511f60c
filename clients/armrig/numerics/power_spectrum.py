"""Power spectrum of a signal, averaged over all stretches without a missing sample (NaN)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.numerics.quantities import plural
from armrig.numerics.stretches import stretches

Vector = NDArray[np.float64]

_SEGMENTS = 8
_MIN_SEGMENT_SAMPLES, _MAX_SEGMENT_SAMPLES = 16, 4096


def power_spectrum(signals: Iterable[Vector], Ts: float) -> tuple[Vector, Vector]:
    """Return omega (n,) in rad/s and the one-sided power density (n,), in unit² per rad/s.

    There is one signal for each experiment; a missing sample is NaN. Ts is in s. The method is
    Welch's average of Hann-windowed segments that overlap by half. The mean of each segment is
    removed. The integral of the density over omega is the mean variance of a segment.
    The length of a segment is an eighth of the samples, between 16 and 4096, and at most the
    longest stretch without a missing sample. Stretches that are shorter than a segment are not
    used.

    Raises ValueError if all stretches without a missing sample are shorter than 16 samples.

    References
    ----------
    .. [1] P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73.
    """
    from scipy.signal import welch

    pieces = [signal[s] for signal in signals for s in stretches(np.isfinite(signal))]
    longest = max((x.size for x in pieces), default=0)
    if longest < _MIN_SEGMENT_SAMPLES:
        raise InputError(
            f"the longest stretch without a gap has {plural(longest, 'sample')}; a spectrum needs "
            f"{_MIN_SEGMENT_SAMPLES}"
        )
    total = sum(x.size for x in pieces)
    L = min(max(total // _SEGMENTS, _MIN_SEGMENT_SAMPLES), _MAX_SEGMENT_SAMPLES, longest)
    omega, density, weight = np.zeros(0), np.zeros(L // 2 + 1), 0
    for x in pieces:
        if x.size >= L:
            f, P = welch(x, fs=1 / Ts, nperseg=L, detrend="constant")
            segments = 1 + (x.size - L) // (L - L // 2)
            omega, weight = 2 * np.pi * f, weight + segments
            density = density + segments * P / (2 * np.pi)
    return omega, density / weight
