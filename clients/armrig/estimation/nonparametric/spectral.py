"""Spectral analysis: frequency response and noise spectrum with standard deviations."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, labels
from armrig.data.merging import merge
from armrig.data.step import loop_notes
from armrig.data.treatment import difference
from armrig.data.treatment.integrating import integration
from armrig.estimation.nonparametric.spectra import (
    MIN_POWER_SHARE,
    Spectra,
    blackman_tukey,
    blunting_notes,
    fill_outputs,
)
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.checks import column, require_integers
from armrig.numerics.polynomial import summation
from armrig.numerics.quantities import plural

Vector = NDArray[np.float64]

LOGARITHMIC_RESOLUTION = 0.5  # resolution of the window at omega, divided by omega
_LEAST_SAMPLES = 8  # with an output
MAX_LAGS = 300
"""Largest lag window of `spectral_reference`, in samples."""
POINTS = 40
"""Number of frequencies of `spectral_reference`."""


@takes_recordings
def spa(
    data: Dataset,
    window: int | Literal["log"] | None = None,
    omega: ArrayLike | None = None,
    *,
    delay: int = 0,
    integrator: bool | None = None,
) -> SpectralEstimate:
    """Estimate the frequency response and the noise spectrum by spectral analysis.

    The method of Blackman and Tukey uses a Hann lag window ::

        w(k) = (1 + cos(pi k/gamma))/2,    |k| <= gamma
        Phi_yu(omega) = Ts sum of w(k) R_yu(k) exp(-i omega k Ts),   Phi_u, Phi_y likewise
        G = Phi_yu / Phi_u,     E|dG|² = Phi_v / (nu Phi_u),    nu = N / sum of w(k)²

    Phi_v is ``(Phi_y - |Phi_yu|²/Phi_u) nu/(nu - 1)`` , computed with a lag window of 4 gamma (at
    most N/5). A window of gamma does not separate frequencies that are close together. If G differs
    at these frequencies, the difference would count as noise; the longer window separates them.
    Phi_v is then smoothed to the resolution of gamma. Missing outputs are replaced by the part that
    the input explains, and are not counted in N.

    The standard deviations describe the scatter about the smoothed response. The smoothed response
    is the expected value of G for this window. The window blunts resonances that are narrower than
    about 2 pi/(gamma Ts) rad/s. A note reports a blunted resonance if the gain is clearly higher
    with the longer window: by more than 10 % and by more than four standard deviations. Half of the
    variance of G is due to the magnitude, and half is due to the phase. Near 0 and pi/Ts the share
    of the phase is smaller, because G is real at these frequencies. If the reported standard
    deviation of the phase is above 0.3 rad, the true standard deviation is larger.

    If y integrates, the response of the rate of y is estimated and then divided by 1 - q^-1.

    Parameters
    ----------
    data : Dataset
        N samples; missing samples and several experiments are allowed.
    window : int or "log", optional
        gamma in samples, >= 2, by default N/10 but at most 30. With "log", gamma decreases as omega
        increases, so that the resolution is half of omega; gamma is limited to 4 … N/4.
    omega : array_like (n,), optional
        Frequencies in rad/s, 0 to pi/Ts. By default there are 128 equally spaced frequencies up to
        pi/Ts. With window="log" there are 100 frequencies on a logarithmic scale.
    delay : int, default 0
        Known delay in samples. Before the estimation y is advanced by the delay, and afterwards the
        phase of G is corrected. If `delay` is not given, a delay comparable to the length of the
        window makes the gain and the coherence too low.
    integrator : bool, optional
        As in `etfe`.

    Returns
    -------
    SpectralEstimate
        `G`, `std_magnitude`, `std_phase`, `noise_spectrum`, `noise_std` and `coherence`, (n,).

    Raises
    ------
    ValueError
        The window is not allowed, a frequency is outside 0 to pi/Ts, or u is constant.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 6.4 and 6.5.

    Examples
    --------
    >>> estimate = armrig.spa(armrig.example_recording().dataset("alpha"), window=120)
    >>> peak = abs(estimate.G).argmax()
    >>> print(f"{estimate.omega[peak]:.0f} rad/s, coherence {estimate.coherence[peak]:.2f}")
    20 rad/s, coherence 0.93
    """
    decided = integration(data, integrator)
    integrates = decided.integrates
    require_integers(delay=(delay, 0))
    data = _advance_output(data, delay) if delay else data
    N = data.N - data.missing
    if N < _LEAST_SAMPLES:
        needed = f"spa needs at least {_LEAST_SAMPLES} samples with an output"
        raise InputError(f"{needed}, got {N}; record longer")
    if np.ptp(data.u) == 0:
        raise InputError("u is constant: it excites no frequency; record an input that varies")
    w = _frequencies(omega, data, logarithmic=isinstance(window, str))
    gamma = _gamma(window, w, data.Ts, N)
    complete = fill_outputs(data, integrator=integrates)
    if integrates:  # the rate is not known at the first sample of an experiment
        complete = merge([difference(part)[1:] for part in complete.experiments() if part.N > 1])
    spectra = blackman_tukey(complete, gamma, w, N)
    notes = [*loop_notes(data.history), *decided.notes]
    if not isinstance(window, str):
        notes += blunting_notes(complete, spectra, int(gamma[0]), w, N)
    size = f"{gamma.min()} … {gamma.max()}" if gamma.min() < gamma.max() else str(gamma[0])
    words = f"Blackman-Tukey, Hann lag window, gamma {size} samples"
    words += f", aligned by {plural(delay, 'sample')}" if delay else ""
    turned = replace(spectra, yu=spectra.yu * np.exp(-1j * w * delay * data.Ts))
    return _estimate(data, w, turned, words, N, integrates=integrates, notes=notes)


def _advance_output(data: Dataset, delay: int) -> Dataset:
    """Return the data with y advanced by `delay` samples."""
    parts = [part for part in data.experiments() if delay + 1 < part.N]
    if not parts:
        longest = max(part.N for part in data.experiments())
        raise InputError(
            f"delay={delay} is too long; the longest experiment has {plural(longest, 'sample')}"
        )
    return merge(
        [
            part.replaced(
                u=part.u[: part.N - delay],
                y=part.y[delay:],
                valid=part.valid[delay:],
                r=None,
                step=None,
            )
            for part in parts
        ]
    )


def _frequencies(omega: ArrayLike | None, data: Dataset, *, logarithmic: bool) -> Vector:
    nyquist = np.pi / data.Ts
    if omega is None and logarithmic:
        return np.geomspace(min(8 * np.pi / (data.N * data.Ts), nyquist / 10), nyquist, 100)
    if omega is None:
        return nyquist * np.arange(1, 129) / 128
    w = np.sort(column("omega", np.atleast_1d(omega)))
    if not (w[0] >= 0 and w[-1] <= nyquist * (1 + 1e-9)):
        raise InputError(
            f"omega from {w[0]:g} to {w[-1]:g} rad/s is outside 0 to {nyquist:g} rad/s (pi/Ts)"
        )
    return w


def _gamma(window: int | str | None, omega: Vector, Ts: float, N: int) -> NDArray[np.int_]:
    if isinstance(window, str):
        if window != "log":
            raise InputError(f'window={window!r} must be a number of samples, "log" or None')
        with np.errstate(divide="ignore"):
            wanted = 2 * np.pi / (LOGARITHMIC_RESOLUTION * omega * Ts)
        return np.clip(wanted, 4, max(N // 4, 4)).astype(int)
    gamma = max(2, min(N // 10, 30)) if window is None else window
    require_integers(window=(gamma, 2))
    if gamma >= N:
        raise InputError(
            f"window={gamma} must be less than the {plural(N, 'sample')} with an output; N/10 is "
            "usual"
        )
    return np.full(omega.size, gamma)


def _estimate(
    data: Dataset,
    omega: Vector,
    s: Spectra,
    words: str,
    N: int,
    *,
    integrates: bool,
    notes: list[str],
) -> SpectralEstimate:
    floor = MIN_POWER_SHARE * float(np.max(s.u, initial=0.0))
    notes = [*notes]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(s.u > floor, s.u, np.nan)
        G = s.yu / u
        explained = np.abs(s.yu) ** 2 / u
        coherence = np.clip(explained / np.where(s.y > 0, s.y, np.nan), 0.0, 1.0)
        variance = s.noise / (s.averages * u)
        S = summation(omega, data.Ts) if integrates else np.ones(omega.size, dtype=np.complex128)
        relative = np.sqrt(variance) / np.abs(G)
        std_magnitude = np.sqrt(variance * (1 + s.reality) / 2) * np.abs(S)
        std_phase = relative * np.sqrt(np.maximum(1 - s.reality, 0.0) / 2)
        response = G * S
        noise = s.noise * np.abs(S) ** 2
    if (unknown := int(np.count_nonzero(np.isnan(G)))) > 0:
        notes.append(f"u has no power at {unknown} of {omega.size} frequencies: G is NaN there")
    if float(np.min(s.averages)) < 8:
        notes.append(
            f"only {float(np.min(s.averages)):.1f} independent averages: too few for trustworthy "
            "bands; use a smaller window"
        )
    return SpectralEstimate(
        omega=omega,
        G=response,
        std_magnitude=std_magnitude,
        std_phase=std_phase,
        noise_spectrum=noise,
        noise_std=noise / np.sqrt(s.averages),
        coherence=coherence,
        method=words,
        integrator=integrates,
        N=N,
        **labels(data),
        notes=tuple(notes),
    )


def spectral_reference(data: Dataset) -> SpectralEstimate:
    """Return a spectral analysis of data, for comparison with a model in a figure.

    The lag window is N/10, at most 300 samples. This limit is ten times the limit in `spa`. With a
    short window a blunted resonance would seem to contradict a correct model. With a long window
    the error bars are wide, but they do not contradict a correct model. The 40 frequencies are
    equally spaced on a logarithmic scale from the lowest resolved frequency, 2 pi/(window Ts).
    """
    window = max(2, min(data.N // 10, MAX_LAGS))
    nyquist = np.pi / data.Ts
    return spa(data, window, np.geomspace(2 * nyquist / window, nyquist, POINTS))
