"""Spectra by a lag window on the covariances, and what a window too short hides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.covariance_functions import Covariances, covariances
from armrig.estimation.nonparametric.welch import Spectra

Vector = NDArray[np.float64]

FINER = 4  # times the lag window of G, for the noise and for what the window blunts
NO_POWER = 1e-8  # share of u's largest spectrum below which G is not known
_BLUNTED = 1.1  # factor by which |G| is higher through the longer window
_SURE = 4.0  # standard deviations of it, one of some hundred frequencies


def blackman_tukey(data: Dataset, gamma: NDArray[np.int_], omega: Vector, N: int) -> Spectra:
    """Return the spectra of data whose missing outputs were filled, N not counting them."""
    L = int(gamma.max())
    R = covariances(data, L)
    k = np.arange(-L, L + 1)
    w = _hann(k, gamma[:, None])
    turn = np.exp(-1j * omega[:, None] * k * data.Ts)
    energy = np.sum(w**2, axis=1)
    noise = _noise_covariance(data, L, finer(data, L), N)
    return Spectra(
        u=data.Ts * np.real((w * turn) @ R.uu),
        y=data.Ts * np.real((w * turn) @ R.yy),
        yu=data.Ts * ((w * turn) @ R.yu),
        noise=data.Ts * np.maximum(np.real((w * turn) @ noise), 0.0),
        averages=N / energy,
        reality=np.real(np.sum(w**2 * turn**2, axis=1)) / energy,
    )


def finer(data: Dataset, gamma: int) -> int:
    """Return the longer lag window that this one is held against."""
    return min(FINER * gamma, max(data.N // 5, gamma))


def blunted(data: Dataset, found: Spectra, gamma: int, omega: Vector, N: int) -> list[str]:
    """Return a note where the longer lag window sees |G| clearly higher.

    |G| through the window of gamma samples is that of a response smoothed over 2 pi/(gamma Ts)
    rad/s: a narrower resonance is lower and wider in it, and its standard deviations, which are
    about the smoothed response, do not tell.
    """
    longer = finer(data, gamma)
    if longer <= gamma:
        return []
    k = np.arange(-longer, longer + 1)
    w = _hann(k, longer)
    turn = w * np.exp(-1j * omega[:, None] * k * data.Ts)
    R: Covariances = covariances(data, longer)
    u, yu = data.Ts * np.real(turn @ R.uu), data.Ts * (turn @ R.yu)
    known = np.minimum(u, found.u) > NO_POWER * float(np.max(found.u, initial=0.0))
    if not known.any():
        return []
    sharp, blunt = np.abs(yu[known]) / u[known], np.abs(found.yu[known]) / found.u[known]
    std = np.sqrt(found.noise[known] * float(np.sum(w**2)) / N / u[known])
    higher = (sharp - blunt > _SURE * std) & (sharp > _BLUNTED * blunt)
    if not higher.any():
        return []
    worst = int(np.argmax(np.where(higher, (sharp - blunt) / np.max(sharp), 0.0)))
    return [
        f"the lag window of {gamma} samples blunts the response near "
        f"{omega[known][worst]:.3g} rad/s: with {longer} |G| is "
        f"{sharp[worst] / max(blunt[worst], 1e-300):.2g} times as high. Where that is a resonance "
        f'take window={longer} or "log"; where it is a delay say delay='
    ]


def _hann(k: NDArray[np.int_], gamma: NDArray[np.int_] | int) -> Vector:
    return np.where(np.abs(k) <= gamma, 0.5 * (1 + np.cos(np.pi * k / gamma)), 0.0)


def _noise_covariance(data: Dataset, L: int, fine: int, N: int) -> Vector:
    """Return R_v(k), |k| <= L, from Phi_y - |Phi_yu|²/Phi_u with the longer lag window `fine`.

    With the window of G itself the variation of G inside it would be taken for noise: bands near a
    resonance would hold 100 %.
    """
    R = covariances(data, fine)
    k = np.arange(-fine, fine + 1)
    w = _hann(k, fine)
    size = 4 * fine

    def spectrum(r: Vector) -> NDArray[np.complex128]:
        whole = np.zeros(size)
        whole[k] = w * r  # negative lags wrap to the end, as the transform wants them
        return np.asarray(np.fft.fft(whole))

    u = np.real(spectrum(R.uu))
    known = u > NO_POWER * float(u.max())
    explained = np.abs(spectrum(R.yu)) ** 2 / np.where(known, u, 1.0)
    nu = N / float(np.sum(w**2))
    Phi = np.maximum(np.real(spectrum(R.yy)) - np.where(known, explained, 0.0), 0.0)
    Phi = Phi * nu / max(nu - 1, 1e-3) * data.N / N  # filled outputs carry no noise
    return np.asarray(np.real(np.fft.ifft(Phi))[np.arange(-L, L + 1)])
