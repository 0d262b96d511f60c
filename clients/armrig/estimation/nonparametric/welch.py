"""Spectra by Welch's method: averages of the periodograms of segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.models.spectral_estimate import COHERENT, SpectralEstimate

Vector = NDArray[np.float64]
OVERLAP_CORRELATION = 1 / 36  # correlation of two periodograms if the Hann segments overlap by half
MIN_FREQUENCIES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectra:
    """Spectra at n frequencies, in the product of the units of the two signals, times s."""

    u: Vector
    """Spectrum Phi_u, (n,)."""
    y: Vector
    """Spectrum Phi_y, (n,)."""
    yu: NDArray[np.complex128]
    """Cross spectrum Phi_yu, (n,)."""
    averages: Vector
    """Number nu of independent averages, (n,), with two degrees of freedom each."""
    reality: Vector
    """Ratio E(dG²)/E|dG|², (n,); dG is the error of G divided by G/|G|.

    The ratio is 1 at the frequencies 0 and pi/Ts, and about 0 between them.
    """
    noise: Vector
    """Noise spectrum Phi_v, (n,)."""


def welch(data: Dataset, length: int, omega: Vector) -> Spectra:
    """Return the spectra, averaged over Hann-tapered segments that overlap by half.

    The mean of each segment is subtracted.

    Raises
    ------
    ValueError
        Every segment of this length has a missing sample.
    """
    taper = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    turn = np.exp(-1j * np.outer(np.arange(length), omega) * data.Ts) * taper[:, None]
    U, Y = _transforms(data, length, turn)
    K = U.shape[0]
    if K == 0:
        raise InputError(
            f"no {length} samples in a row have an output; use shorter segments (window), "
            'or method="blackman-tukey", which needs no complete segments'
        )
    scale = data.Ts / float(np.sum(taper**2))
    energy = taper**2
    own = energy @ np.exp(-2j * np.outer(np.arange(length), omega) * data.Ts)
    Phi_u, Phi_y = (scale * np.mean(np.abs(X) ** 2, axis=0) for X in (U, Y))
    Phi_yu = scale * np.mean(Y * np.conj(U), axis=0)
    nu = K / (1 + 2 * OVERLAP_CORRELATION * (K - 1) / K)
    return Spectra(
        u=Phi_u,
        y=Phi_y,
        yu=Phi_yu,
        averages=np.full(omega.size, nu),
        reality=np.abs(own / np.sum(energy)) ** 2,
        noise=np.maximum(Phi_y - np.abs(Phi_yu) ** 2 / Phi_u, 0.0) * nu / max(nu - 1, 1e-3),
    )


def _transforms(
    data: Dataset, length: int, turn: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the transforms of u and y, (segments, n)."""
    U, Y = [], []
    for part in data.experiments():
        begin = 0
        while begin + length <= part.N:
            cut = slice(begin, begin + length)
            if not part.valid[cut].all():
                # Continue after the last missing sample of the segment.
                begin += int(np.flatnonzero(~part.valid[cut])[-1]) + 1
                continue
            U.append((part.u[cut] - np.mean(part.u[cut])) @ turn)
            Y.append((part.y[cut] - np.mean(part.y[cut])) @ turn)
            begin += max(length // 2, 1)
    empty = np.zeros((0, turn.shape[1]), dtype=np.complex128)
    return (np.array(U), np.array(Y)) if U else (empty, empty)


def explained(estimate: SpectralEstimate) -> NDArray[np.int_]:
    """Return the indices of the frequencies in the range where u explains y.

    The range extends from the first to the last frequency at which u explains y. Frequencies at
    which G is not known are left out.

    Raises
    ------
    ValueError
        u explains y at fewer than three frequencies.
    """
    coherence = np.nan_to_num(np.zeros(1) if estimate.coherence is None else estimate.coherence)
    good = np.flatnonzero(coherence > COHERENT)
    if good.size < MIN_FREQUENCIES:
        at = ("no frequency", "one frequency", "two frequencies")[good.size]
        raise InputError(
            f"u explains y at {at} (coherence above {COHERENT:g}), and {MIN_FREQUENCIES} are "
            "needed: record longer, or with a "
            "larger or richer input"
        )
    known = np.flatnonzero(np.isfinite(estimate.G))
    return np.asarray(known[(known >= good[0]) & (known <= good[-1])])
