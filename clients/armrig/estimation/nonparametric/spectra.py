"""Spectra of u and y, by a lag window on the covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.models.spectral_estimate import COHERENT, SpectralEstimate
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.quantities import digits, plural

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int_]

FINE_LAG_RATIO = 4
"""Ratio of the longer lag window (for the noise and for `blunting_notes`) to the lag window "
"of G."""
MIN_POWER_SHARE = 1e-8
"""Share of the largest value of Phi_u; G is not known at frequencies with a smaller Phi_u."""
_MIN_BLUNTED_RATIO = 1.1  # least ratio of |G| with the longer window to |G| for a note
_BLUNTED_SIGMAS = 4.0  # least difference of the two |G| for a note, in standard deviations
_MAX_RESPONSE_LAGS = 60  # lags of the impulse response from which missing outputs are computed
_MIN_FREQUENCIES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectra:
    """Spectra at n frequencies, in the product of the units of the two signals, times s."""

    u: Vector
    """Spectrum Phi_u, (n,)."""
    y: Vector
    """Spectrum Phi_y, (n,)."""
    yu: Complex
    """Cross spectrum Phi_yu, (n,)."""
    averages: Vector
    """Number nu of independent averages, (n,), with two degrees of freedom each."""
    reality: Vector
    """Ratio E(dG²)/E|dG|², (n,); dG is the error of G divided by G/|G|.

    The ratio is 1 at the frequencies 0 and pi/Ts, and about 0 between them.
    """
    noise: Vector
    """Noise spectrum Phi_v, (n,)."""


def blackman_tukey(data: Dataset, gamma: Integers, omega: Vector, N: int) -> Spectra:
    """Return the spectra of data after `fill_outputs`; N is the number of measured outputs."""
    L = int(gamma.max())
    k = np.arange(-L, L + 1)
    w = _hann(k, gamma[:, None])
    turn = np.exp(-1j * omega[:, None] * k * data.Ts)
    energy = np.sum(w**2, axis=1)
    longer = finer(data, L)
    R = _covariances(data, longer)
    noise = _noise_covariance(R, N, data.N)[longer + k]
    u, y, yu = (data.Ts * (w * turn) @ R[:, longer + k].T).T
    return Spectra(
        u=np.real(u),
        y=np.real(y),
        yu=yu,
        noise=data.Ts * np.maximum(np.real((w * turn) @ noise), 0.0),
        averages=N / energy,
        reality=np.real(np.sum(w**2 * turn**2, axis=1)) / energy,
    )


def finer(data: Dataset, gamma: int) -> int:
    """Return the length of a longer lag window, for comparison with a window of gamma samples."""
    return min(FINE_LAG_RATIO * gamma, max(data.N // 5, gamma))


def blunting_notes(data: Dataset, spectra: Spectra, gamma: int, omega: Vector, N: int) -> list[str]:
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
    phi = data.Ts * (w * np.exp(-1j * omega[:, None] * k * data.Ts)) @ _covariances(data, longer).T
    u, yu = np.real(phi[:, 0]), phi[:, 2]
    strong = np.minimum(u, spectra.u) > MIN_POWER_SHARE * float(np.max(spectra.u, initial=0.0))
    if not strong.any():
        return []
    sharp, blunt = np.abs(yu[strong]) / u[strong], np.abs(spectra.yu[strong]) / spectra.u[strong]
    std = np.sqrt(spectra.noise[strong] * float(np.sum(w**2)) / N / u[strong])
    higher = (sharp - blunt > _BLUNTED_SIGMAS * std) & (sharp > _MIN_BLUNTED_RATIO * blunt)
    if not higher.any():
        return []
    worst = int(np.argmax(np.where(higher, (sharp - blunt) / np.max(sharp), 0.0)))
    return [
        f"the lag window of {plural(gamma, 'sample')} blunts the response near "
        f"{digits(omega[strong][worst], 3)} rad/s: with {plural(longer, 'sample')} |G| is "
        f"{digits(sharp[worst] / max(blunt[worst], 1e-300), 2)} times as high. For a resonance use "
        f'window={longer} or "log", for a delay give delay='
    ]


def _hann(k: Integers, gamma: Integers | int) -> Vector:
    return np.where(np.abs(k) <= gamma, 0.5 * (1 + np.cos(np.pi * k / gamma)), 0.0)


def _noise_covariance(R: Vector, N: int, samples: int) -> Vector:
    """Return R_v from Phi_y - |Phi_yu|²/Phi_u, at the lags -L … L of the covariances R."""
    # L is the longer lag window. With the shorter window of G, the variation of G within its
    # resolution would count as noise, and bands near a resonance would be far too wide.
    L = R.shape[1] // 2
    k = np.arange(-L, L + 1)
    w = _hann(k, L)
    windowed = np.zeros((3, 4 * L))
    windowed[:, k] = w * R  # the FFT expects the negative lags at the end
    u, y, yu = np.fft.fft(windowed)
    u = np.real(u)
    strong = u > MIN_POWER_SHARE * float(u.max())
    explained = np.abs(yu) ** 2 / np.where(strong, u, 1.0)
    nu = N / float(np.sum(w**2))
    Phi = np.maximum(np.real(y) - np.where(strong, explained, 0.0), 0.0)
    Phi = Phi * nu / max(nu - 1, 1e-3) * samples / N  # filled outputs contain no noise
    return np.asarray(np.real(np.fft.ifft(Phi))[k])


def _covariances(data: Dataset, L: int) -> Vector:
    """Return (1/N) sum_t x(t + k) z(t), |k| <= L, for (u, u), (y, y), (y, u), (3, 2 L + 1)."""
    # Biased, so that the spectrum is positive if that of the lag window is; `fill_outputs` has no
    # gaps.
    total = np.zeros((3, 2 * L + 1))
    for part in data.experiments():
        size = 1 << int(np.ceil(np.log2(part.N + L + 1)))
        U, Y = (np.fft.rfft(x - np.mean(x), size) for x in (part.u, part.y))
        product = np.fft.irfft([U * np.conj(U), Y * np.conj(Y), Y * np.conj(U)], size)
        reach = min(L, part.N - 1)
        k = np.arange(-reach, reach + 1)
        total[:, L + k] += product[:, k]
    return total / data.N


def fill_outputs(data: Dataset, *, integrator: bool) -> Dataset:
    """Return the data with each missing y replaced by the part that the input explains.

    This part is the output of a regularised impulse response plus the level of the experiment. With
    an integrator, the ramp of the experiment is added too. The method does not interpolate y. If
    the missing samples were left out of a correlation instead, the error of the correlation would
    depend on all of y, not only on the noise.
    """
    if data.missing == 0:
        return data
    n = max(2, min((data.N - data.missing) // 5, _MAX_RESPONSE_LAGS))
    g, _ = impulse_response(data, n, "tc", integrator=integrator).decaying
    y = np.array(data.y)
    mean = float(np.mean(data.u))
    for a, b in zip(data.starts, (*data.starts[1:], data.N), strict=True):
        u = data.u[a:b] - mean
        x = data.Ts * np.cumsum(u) if integrator else u
        there = data.valid[a:b]
        explained = apply_filter(g, [1.0], x)
        terms = np.vander(np.linspace(-1, 1, b - a), 1 + integrator)
        basis = orthonormal(terms[there])
        free = terms @ basis.coefficients((data.y[a:b] - explained)[there])
        y[a:b] = np.where(there, data.y[a:b], explained + free)
    return data.replaced(y=y, valid=np.ones(data.N, dtype=np.bool_), step=None)


def coherent_range(estimate: SpectralEstimate) -> Integers:
    """Return the indices of the frequencies in the range where u explains y.

    The range extends from the first to the last frequency at which u explains y; at least three
    such frequencies are needed. Frequencies at which G is not known are left out.
    """
    coherence = np.nan_to_num(np.zeros(1) if estimate.coherence is None else estimate.coherence)
    good = np.flatnonzero(coherence > COHERENT)
    if good.size < _MIN_FREQUENCIES:
        at = ("no frequency", "one frequency", "two frequencies")[good.size]
        raise InputError(
            f"u explains y at {at} (coherence above {COHERENT:g}), and {_MIN_FREQUENCIES} are "
            "needed: record longer, or with a "
            "larger or richer input"
        )
    finite = np.flatnonzero(np.isfinite(estimate.G))
    return np.asarray(finite[(finite >= good[0]) & (finite <= good[-1])])
