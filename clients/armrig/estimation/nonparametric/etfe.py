"""The empirical transfer function estimate: transform of y over transform of u."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.treatment import difference
from armrig.estimation.nonparametric.integrator import integration
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.polynomial import summation

Vector = NDArray[np.float64]
# A PWM of 10 bits puts 1e-3 of a multisine's 125 lines on each of the lines between, 2e-3 at most.
_ROUNDED = 5e-3


@takes_recordings
def etfe(
    data: Dataset, *, period_length: int | None = None, integrator: bool | None = None
) -> SpectralEstimate:
    """Return G(omega_k) = Y(omega_k)/U(omega_k) at the lines of the discrete Fourier transform.

    With a periodic input (found by itself, two whole periods at least) the first period, which
    holds the transient, is left out, the others are averaged, and only excited lines are given:
    without noise the result is exact. From two periods on that are left, the scatter between them
    gives the noise, of which ::

        E|dG|² = s²_Y / (P |U|²),    s²_Y = variance of Y between P periods

    Without a period neighbouring values are independent, each as uncertain as |noise|/|U| there,
    however long the record: smooth with `spa`. An integrating y is treated as its rate, and the
    result divided by 1 - q^-1.

    Parameters
    ----------
    data : Dataset
        One experiment. Missing outputs are allowed only where the input is periodic and each
        instant of the period was measured once.
    period_length : int, optional
        P in samples; by default found from u.
    integrator : bool, optional
        Whether y integrates u; by default so for theta_1 and another y that behaves so, which
        the result then says.

    Returns
    -------
    SpectralEstimate
        At rising frequencies above 0; standard deviations are NaN where they are not known.

    Raises
    ------
    ValueError
        Several experiments, missing outputs that nothing replaces, or a constant input.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 6.3.
    """
    if len(data.starts) > 1:
        raise InputError(
            f"etfe takes one experiment, got {len(data.starts)}: call it for each of "
            "data.experiments(), or use spa, or bla for realisations of a multisine"
        )
    if np.ptp(data.u) == 0:
        raise InputError(
            "u is constant: it has no frequency to answer at; record an input that varies"
        )
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
            f"etfe needs every output of an input without a period, {data.missing} of {data.N} "
            "are missing: use spa, or cut the longest stretch without a hole, data[a:b]"
        )
    # The rate has no first sample; u keeps step with it.
    treated = difference(data)[1:] if integrates else data
    U = np.fft.rfft(treated.u - np.mean(treated.u))
    Y = np.fft.rfft(treated.y - np.mean(treated.y))
    at = np.flatnonzero(excited(U))
    at = at[at > 0]
    omega: Vector = 2 * np.pi * at.astype(np.float64) / (treated.N * data.Ts)
    words = "the input has no period: not smoothed, its scatter does not fall with N"
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
            f"{holes} of the {P} instants of the period were never measured (the first period, "
            "a transient, does not count): record more periods, or use spa"
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
    words = f"{periods - 1} periods of {P} samples after one left out as transient: exact but for "
    omega: Vector = 2 * np.pi * at.astype(np.float64) / (P * data.Ts)
    return omega, Y[at] / U[at], variance, f"{words}noise"


def period(u: Vector, tolerance: float = 1e-9) -> int | None:
    """Return the least P with u(t + P) = u(t) throughout and two periods at least, else None.

    A constant has none.
    """
    allowed = tolerance * float(np.ptp(u))
    if allowed == 0:
        return None
    head = min(16, u.size // 2)
    for P in range(2, u.size // 2 + 1):
        # Most candidates fail on the first few samples.
        if np.abs(u[P : P + head] - u[:head]).max() <= allowed and (
            np.abs(u[P:] - u[:-P]).max() <= allowed
        ):
            return P
    return None


def excited(U: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Tell at which lines of a transform there is power beyond rounding, and that of the PWM."""
    return np.asarray(np.abs(U) > _ROUNDED * np.abs(U).max(initial=0.0))
