"""Empirical transfer function estimate (ETFE): the transform of y divided by the transform of u."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.treatment import difference
from armrig.data.treatment.integrating import integration
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.polynomial import summation

Vector = NDArray[np.float64]
# Least magnitude of an excited line, as a share of the largest line. Between the 125 lines of a
# multisine, a PWM of 10 bits causes lines with shares of 1e-3, at most 2e-3.
_MIN_LINE_SHARE = 5e-3


@takes_recordings
def etfe(
    data: Dataset, *, period_length: int | None = None, integrator: bool | None = None
) -> SpectralEstimate:
    """Return G(omega_k) = Y(omega_k)/U(omega_k) at the lines of the discrete Fourier transform.

    A periodic input is detected if it has at least two whole periods. The first period, with the
    transient, is not used, and the other periods are averaged. The result contains only excited
    lines, and is exact if there is no noise. With P >= 2 averaged periods, the variance of G is
    estimated from their scatter ::

        E|dG|² = s²_Y / (P |U|²),    s²_Y = variance of Y between P periods

    If the input has no period, values at neighbouring frequencies are independent. Their
    uncertainty (noise/U) does not decrease with the length of the data, so use `spa` for a smooth
    estimate. If y integrates, the response of the rate of y is estimated and divided by 1 - q^-1.

    Parameters
    ----------
    data : Dataset
        One experiment. Missing outputs are allowed only if the input is periodic and each instant
        of the period was measured at least once.
    period_length : int, optional
        Length of the period in samples. By default the period is detected in u.
    integrator : bool, optional
        True if y integrates u. By default theta_1 integrates, and any other y is tested. If the
        test finds an integrator, a note of the result reports it.

    Returns
    -------
    SpectralEstimate
        Estimate at ascending frequencies above 0. A standard deviation that is not known is NaN.

    Raises
    ------
    ValueError
        There are several experiments, an output is missing in all periods, or u is constant.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 6.3.

    Examples
    --------
    >>> import armrig
    >>> from scipy.signal import lfilter
    >>> u = armrig.multisine(500, lines=[1, 3, 10, 30], periods=5)
    >>> data = armrig.Dataset(u=u, y=lfilter([0, 0.1], [1, -0.9], u), Ts=0.01)
    >>> estimate = armrig.etfe(data)
    >>> estimate.omega.round(1)
    array([  6.3,  18.8,  62.8, 188.5])
    >>> abs(estimate.G).round(3)
    array([0.859, 0.489, 0.168, 0.065])
    """
    if len(data.starts) > 1:
        raise InputError(
            f"etfe takes one experiment, got {len(data.starts)}: call it for each of "
            "data.experiments(), or use spa, or bla for realisations of a multisine"
        )
    if np.ptp(data.u) == 0:
        raise InputError("u is constant and excites no frequency; record an input that varies")
    decided = integration(data, integrator)
    integrates = decided.integrates
    P = period(data.u) if period_length is None else period_length
    if P is not None and not 2 <= P <= data.N // 2:
        raise InputError(
            f"period_length={P} must be 2 to {data.N // 2}, two whole periods of {data.N} samples"
        )
    if P is None:
        omega, G, variance, words = _aperiodic(data, integrates=integrates)
    else:
        omega, G, variance, words = _periodic(data, P, integrates=integrates)
    S = summation(omega, data.Ts) if integrates else np.ones(omega.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.sqrt(variance / 2)
        phase = std / np.abs(G)
    return SpectralEstimate(
        omega=omega,
        G=G * S,
        std_magnitude=std * np.abs(S),
        std_phase=phase,
        method=f"ETFE, {words}",
        integrator=integrates,
        N=data.N - data.missing,
        Ts=data.Ts,
        output=data.output,
        unit=data.unit,
        input_unit=data.input_unit,
        source=data.source,
        notes=decided.notes,
    )


Lines = tuple[Vector, NDArray[np.complex128], Vector, str]


def _aperiodic(data: Dataset, *, integrates: bool) -> Lines:
    if data.missing:
        raise InputError(
            f"without a periodic input etfe needs every output, but {data.missing} of {data.N} "
            "are missing: use spa, or cut the longest stretch without a gap, data[a:b]"
        )
    # The rate is not known at the first sample, so the first u is removed too.
    treated = difference(data)[1:] if integrates else data
    U = np.fft.rfft(treated.u - np.mean(treated.u))
    Y = np.fft.rfft(treated.y - np.mean(treated.y))
    at = np.flatnonzero(excited(U))
    at = at[at > 0]
    omega: Vector = 2 * np.pi * at.astype(np.float64) / (treated.N * data.Ts)
    words = "the input has no period: no smoothing, and the scatter does not decrease with N"
    return omega, Y[at] / U[at], np.full(at.size, np.nan), words


def _periodic(data: Dataset, P: int, *, integrates: bool) -> Lines:
    treated = difference(data) if integrates else data
    periods = data.N // P
    cut = slice(P, periods * P)
    y = treated.y[cut].reshape(periods - 1, P)
    there = np.isfinite(y)
    if not there.any(axis=0).all():
        holes = int(np.count_nonzero(~there.any(axis=0)))
        raise InputError(
            f"{holes} of the {P} instants of the period were never measured after the first "
            "period, which is a transient: record more periods, or use spa"
        )
    U = np.fft.rfft(data.u[cut].reshape(periods - 1, P)[0])
    Y = np.fft.rfft(np.nanmean(y, axis=0))
    at = np.flatnonzero(excited(U))
    at = at[at > 0]
    variance = np.full(at.size, np.nan)
    whole = there.all(axis=1)
    if np.count_nonzero(whole) >= 2:
        scatter = np.var(np.fft.rfft(y[whole], axis=1)[:, at], axis=0, ddof=1)
        variance = scatter / (np.abs(U[at]) ** 2 * (periods - 1))
    words = f"{periods - 1} periods of {P} samples, after a transient period: exact except for "
    omega: Vector = 2 * np.pi * at.astype(np.float64) / (P * data.Ts)
    return omega, Y[at] / U[at], variance, f"{words}noise"


def period(u: Vector, tolerance: float = 1e-9) -> int | None:
    """Return the least P <= N/2 with u(t + P) = u(t) for all t, or None if there is none.

    A constant has no period.
    """
    allowed = tolerance * float(np.ptp(u))
    if allowed == 0:
        return None
    head = min(16, u.size // 2)
    for P in range(2, u.size // 2 + 1):
        # Most candidates fail at the first few samples, so these are compared first.
        if np.abs(u[P : P + head] - u[:head]).max() <= allowed and (
            np.abs(u[P:] - u[:-P]).max() <= allowed
        ):
            return P
    return None


def excited(U: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Return a mask of the lines whose power exceeds the effects of rounding and PWM."""
    return np.asarray(np.abs(U) > _MIN_LINE_SHARE * np.abs(U).max(initial=0.0))
