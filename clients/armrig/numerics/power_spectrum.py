"""Power spectrum of a signal that may have holes (NaN), averaged over its whole stretches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

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

    stretches = [s for signal in signals for s in _stretches(signal)]
    longest = max((s.size for s in stretches), default=0)
    if longest < _SHORTEST:
        msg = f"the longest stretch without a hole has {longest} samples; a spectrum needs "
        msg += f"{_SHORTEST}"
        raise ValueError(msg)
    total = sum(s.size for s in stretches)
    L = min(max(total // _SEGMENTS, _SHORTEST), _LONGEST, longest)
    omega, density, weight = np.zeros(0), np.zeros(L // 2 + 1), 0
    for s in stretches:
        if s.size >= L:
            f, P = welch(s, fs=1 / Ts, nperseg=L, detrend="constant")
            segments = 1 + (s.size - L) // (L - L // 2)
            omega, weight = 2 * np.pi * f, weight + segments
            density = density + segments * P / (2 * np.pi)
    return omega, density / weight


def _stretches(x: Vector) -> Iterator[Vector]:
    there = np.concatenate([[False], np.isfinite(x), [False]])
    edges = np.flatnonzero(np.diff(there.astype(np.int8)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        yield x[a:b]
