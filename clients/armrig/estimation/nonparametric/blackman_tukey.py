"""Spectra by a lag window on the covariances, and what a window too short hides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.estimation.nonparametric.welch import Spectra
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import filtered

Vector = NDArray[np.float64]

FINER = 4  # times the lag window of G, for the noise and for what the window blunts
NO_POWER = 1e-8  # share of u's largest spectrum below which G is not known
_BLUNTED = 1.1  # factor by which |G| is higher through the longer window
_SURE = 4.0  # standard deviations of it, one of some hundred frequencies
LONGEST = 60  # lags of the response


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariances:
    """Sample covariances at lags -L … L, each experiment about its own means."""

    uu: Vector
    """(2 L + 1,), of u(t + lag) with u(t)."""
    yy: Vector
    """(2 L + 1,), of y(t + lag) with y(t)."""
    yu: Vector
    """(2 L + 1,), of y(t + lag) with u(t): at a positive lag the input came first."""


def covariances(data: Dataset, L: int) -> Covariances:
    """Return R(k) = (1/N) sum over t of x(t + k) z(t), the biased form, for |k| <= L.

    No sample may be missing: see `armrig.estimation.nonparametric.blackman_tukey`. A spectrum
    of these covariances is positive wherever the lag window's is.
    """
    u = [part.u - np.mean(part.u) for part in data.experiments()]
    y = [part.y - np.mean(part.y) for part in data.experiments()]
    return Covariances(
        uu=_sums(u, u, L) / data.N, yy=_sums(y, y, L) / data.N, yu=_sums(y, u, L) / data.N
    )


def _sums(x: list[Vector], z: list[Vector], L: int) -> Vector:
    """Return the sums of x(t + k) z(t), k = -L … L, over all experiments."""
    total = np.zeros(2 * L + 1)
    for a, b in zip(x, z, strict=True):
        size = 1 << int(np.ceil(np.log2(a.size + L + 1)))
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        reach = min(L, a.size - 1)
        k = np.arange(-reach, reach + 1)
        total[L + k] += product[k]
    return total


def filled(data: Dataset, *, integrator: bool) -> Dataset:
    """Return the data with each missing y replaced by what the input explains of it.

    That is the regularised impulse response's answer plus the experiment's own level (and, with an
    integrator, ramp), not an interpolation between neighbours. Correlating with holes instead
    would turn all of y into noise, not only what u does not explain. A filled sample adds no
    information: who counts samples must count the valid ones.
    """
    if data.missing == 0:
        return data
    n = max(2, min((data.N - data.missing) // 5, LONGEST))
    response = impulse_response(data, n, "tc", integrator=integrator)
    g, _ = response.decaying
    y = np.array(data.y)
    mean = float(np.mean(data.u))
    for a, b in zip(data.starts, (*data.starts[1:], data.N), strict=True):
        u = data.u[a:b] - mean
        x = data.Ts * np.cumsum(u) if integrator else u
        there = data.valid[a:b]
        explained = filtered(g, [1.0], x)
        own = np.vander(np.linspace(-1, 1, b - a), 1 + integrator)
        basis = orthonormal(own[there])
        free = own @ basis.coefficients((data.y[a:b] - explained)[there])
        y[a:b] = np.where(there, data.y[a:b], explained + free)
    return data.replaced(y=y, valid=np.ones(data.N, dtype=np.bool_), step=None)
