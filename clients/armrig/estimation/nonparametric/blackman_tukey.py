"""Spectra by a lag window on the covariances, and a check whether the window is too short."""

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

FINE_LAG_RATIO = 4
"""Ratio of the longer lag window (for the noise and for `blunted`) to the lag window of G."""
MIN_POWER_SHARE = 1e-8
"""Share of the largest value of Phi_u; G is not known at frequencies with a smaller Phi_u."""
_MIN_BLUNTED_RATIO = 1.1  # least ratio of |G| with the longer window to |G| for a note
_BLUNTED_SIGMAS = 4.0  # least difference of the two |G| for a note, in standard deviations
MAX_RESPONSE_LAGS = 60
"""Largest number of lags of the impulse response from which missing outputs are computed."""


def blackman_tukey(data: Dataset, gamma: NDArray[np.int_], omega: Vector, N: int) -> Spectra:
    """Return the spectra of data after `filled`; N is the number of measured outputs."""
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
    """Return the length of a longer lag window, for comparison with a window of gamma samples."""
    return min(FINE_LAG_RATIO * gamma, max(data.N // 5, gamma))


def blunted(data: Dataset, found: Spectra, gamma: int, omega: Vector, N: int) -> list[str]:
    """Return a note if a longer lag window gives a clearly higher |G|.

    The window of gamma samples smooths the response over 2 pi/(gamma Ts) rad/s. A resonance that is
    narrower than this interval becomes lower and wider. The standard deviations do not include this
    bias, because they describe the scatter about the smoothed response.
    """
    longer = finer(data, gamma)
    if longer <= gamma:
        return []
    k = np.arange(-longer, longer + 1)
    w = _hann(k, longer)
    turn = w * np.exp(-1j * omega[:, None] * k * data.Ts)
    R: Covariances = covariances(data, longer)
    u, yu = data.Ts * np.real(turn @ R.uu), data.Ts * (turn @ R.yu)
    known = np.minimum(u, found.u) > MIN_POWER_SHARE * float(np.max(found.u, initial=0.0))
    if not known.any():
        return []
    sharp, blunt = np.abs(yu[known]) / u[known], np.abs(found.yu[known]) / found.u[known]
    std = np.sqrt(found.noise[known] * float(np.sum(w**2)) / N / u[known])
    higher = (sharp - blunt > _BLUNTED_SIGMAS * std) & (sharp > _MIN_BLUNTED_RATIO * blunt)
    if not higher.any():
        return []
    worst = int(np.argmax(np.where(higher, (sharp - blunt) / np.max(sharp), 0.0)))
    return [
        f"the lag window of {gamma} samples blunts the response near "
        f"{omega[known][worst]:.3g} rad/s: with {longer} samples |G| is "
        f"{sharp[worst] / max(blunt[worst], 1e-300):.2g} times as high. For a resonance use "
        f'window={longer} or "log", for a delay give delay='
    ]


def _hann(k: NDArray[np.int_], gamma: NDArray[np.int_] | int) -> Vector:
    return np.where(np.abs(k) <= gamma, 0.5 * (1 + np.cos(np.pi * k / gamma)), 0.0)


def _noise_covariance(data: Dataset, L: int, fine: int, N: int) -> Vector:
    """Return R_v(k), |k| <= L, from Phi_y - |Phi_yu|²/Phi_u, with the longer lag window `fine`.

    With the shorter window of G, the variation of G within the resolution of this window would
    count as noise. Bands near a resonance would then be far too wide, with a coverage of 100 %.
    """
    R = covariances(data, fine)
    k = np.arange(-fine, fine + 1)
    w = _hann(k, fine)
    size = 4 * fine

    def spectrum(r: Vector) -> NDArray[np.complex128]:
        whole = np.zeros(size)
        whole[k] = w * r  # the FFT expects the negative lags at the end
        return np.asarray(np.fft.fft(whole))

    u = np.real(spectrum(R.uu))
    known = u > MIN_POWER_SHARE * float(u.max())
    explained = np.abs(spectrum(R.yu)) ** 2 / np.where(known, u, 1.0)
    nu = N / float(np.sum(w**2))
    Phi = np.maximum(np.real(spectrum(R.yy)) - np.where(known, explained, 0.0), 0.0)
    Phi = Phi * nu / max(nu - 1, 1e-3) * data.N / N  # filled outputs contain no noise
    return np.asarray(np.real(np.fft.ifft(Phi))[np.arange(-L, L + 1)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariances:
    """Sample covariances at lags -L … L, with the means of each experiment subtracted."""

    uu: Vector
    """Covariances of u(t + lag) and u(t), (2 L + 1,)."""
    yy: Vector
    """Covariances of y(t + lag) and y(t), (2 L + 1,)."""
    yu: Vector
    """Covariances of y(t + lag) and u(t), (2 L + 1,); at a positive lag u is earlier than y."""


def covariances(data: Dataset, L: int) -> Covariances:
    """Return the biased covariances R(k) = (1/N) sum over t of x(t + k) z(t) for |k| <= L.

    No sample of the data may be missing (see `filled`). The spectrum of these covariances is
    positive if the spectrum of the lag window is positive.
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
    """Return the data with each missing y replaced by the part that the input explains.

    This part is the output of a regularised impulse response plus the level of the experiment. With
    an integrator, the ramp of the experiment is added too. The method does not interpolate y. If
    the missing samples were left out of a correlation instead, the error of the correlation would
    depend on all of y, not only on the noise.
    """
    if data.missing == 0:
        return data
    n = max(2, min((data.N - data.missing) // 5, MAX_RESPONSE_LAGS))
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
