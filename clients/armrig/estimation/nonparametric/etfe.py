"""Ratios of transforms: the empirical transfer function (ETFE), and the best linear approximation.

A period is a whole number of samples, so that a periodic input has power only at the lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.columns import Matrix
from armrig.data.dataset import Dataset, labels
from armrig.data.merging import merge
from armrig.data.step import loop_notes
from armrig.data.treatment import difference
from armrig.data.treatment.integrating import integration
from armrig.estimation.nonparametric.transients import decaying_transient
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.checks import require_integers
from armrig.numerics.polynomial import summation
from armrig.numerics.quantities import digits, plural

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.intp]
Lines = tuple[Integers, Complex, Vector, int, str, list[str]]
"""Numbers of the lines, G, its variance, the number of samples of a transform, method and notes."""
Transforms = tuple[Complex, Complex, Integers]
"""U (lines,), Y (periods, lines), and number of known y at each instant of the period, (P,)."""
Periods = tuple[Transforms, list[str]]
"""Transforms of the whole periods of one realisation, and notes on its transient."""

# Least magnitude of an excited line, as a share of the largest line. Between the 125 lines of a
# multisine, a PWM of 10 bits causes lines with shares of 1e-3, at most 2e-3.
_MIN_LINE_SHARE = 5e-3
_MORE_POWER = 2.0  # ratio of the first difference of periods to the later ones, for a note
_ROUNDING = 1e-9  # of the range of u, by which a period may differ


@takes_recordings
def etfe(
    data: Dataset, *, period_length: int | None = None, integrator: bool | None = None
) -> SpectralEstimate:
    """Return G(omega_k) = Y(omega_k)/U(omega_k) at the lines of the discrete Fourier transform.

    A periodic input is detected if it has at least two whole periods. The first period is not used,
    and the other periods are averaged. What is left of a decaying transient is estimated from the
    differences of the periods and subtracted; a note reports it. The result contains only excited
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
        of the period was measured at least once; they are replaced as in `bla`.
    period_length : int, optional
        Length of the period in samples. By default the period is detected in u.
    integrator : bool, optional
        True if y integrates u. By default the turning angle of the arm integrates, and any other y
        is tested. If the test finds an integrator, a note of the result reports it.

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
    P = period(data.u) if period_length is None else period_length
    if P is not None and not 2 <= P <= data.N // 2:
        raise InputError(
            f"period_length={P} must be 2 to {data.N // 2}, two whole periods of "
            f"{plural(data.N, 'sample')}"
        )
    integrates = decided.integrates
    lines = _periodic(data, P, integrates) if P else _aperiodic(data, integrates)
    at, G, variance, N, words, notes = lines
    return _estimate(
        data,
        at / N,
        G,
        variance,
        integrates=integrates,
        method=f"ETFE, {words}",
        N=data.N - data.missing,
        notes=(*loop_notes(data.history), *decided.notes, *notes),
    )


def _estimate(
    data: Dataset,
    cycles: Vector,
    G: Complex,
    variance: Vector,
    *,
    integrates: bool,
    noise_only_std: Vector | None = None,
    nonlinear_std: Vector | None = None,
    **fields: Any,
) -> SpectralEstimate:
    """Return the estimate at frequencies in cycles per sample; a rate's response is integrated."""
    omega: Vector = 2 * np.pi * cycles / data.Ts
    S = summation(omega, data.Ts) if integrates else np.ones(omega.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.sqrt(variance / 2)
        return SpectralEstimate(
            omega=omega,
            G=G * S,
            std_magnitude=std * np.abs(S),
            std_phase=std / np.abs(G),
            noise_only_std=None if noise_only_std is None else noise_only_std * np.abs(S),
            nonlinear_std=None if nonlinear_std is None else nonlinear_std * np.abs(S),
            integrator=integrates,
            **labels(data),
            **fields,
        )


def _aperiodic(data: Dataset, integrates: bool) -> Lines:
    if data.missing:
        raise InputError(
            f"without a periodic input etfe needs every output, but {data.missing} of {data.N} "
            "are missing: use spa, or cut the longest stretch without a gap, data[a:b]"
        )
    # The rate is not known at the first sample, so the first u is removed too.
    treated = difference(data)[1:] if integrates else data
    U, Y = (np.fft.rfft(x - np.mean(x)) for x in (treated.u, treated.y))
    at = _lines(strong_lines(U))
    words = "the input has no period: no smoothing, and the scatter does not decrease with N"
    return at, Y[at] / U[at], np.full(at.size, np.nan), treated.N, words, []


def _periodic(data: Dataset, P: int, integrates: bool) -> Lines:
    (U, Y, n_k), notes = _whole_periods(data, P, 1, integrates=integrates)
    at = _lines(strong_lines(U))
    variance = _noise_variance([(U, Y, n_k)], at)
    words = (
        f"{plural(len(Y), 'period')} of {plural(P, 'sample')}, after a transient period: "
        "exact except for noise"
    )
    return at, np.mean(Y[:, at], axis=0) / U[at], variance, P, words, notes


def period(u: Vector) -> int | None:
    """Return the least P <= N/2 with u(t + P) = u(t) for all t, or None if there is none.

    A constant has no period.
    """
    allowed = _ROUNDING * float(np.ptp(u))
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


def strong_lines(U: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Return a mask of the lines whose power exceeds the effects of rounding and PWM."""
    return np.asarray(np.abs(U) > _MIN_LINE_SHARE * np.abs(U).max(initial=0.0))


def _lines(lit: NDArray[np.bool_]) -> Integers:
    """Return the numbers of the excited lines above 0."""
    at = np.flatnonzero(lit)
    return at[at > 0]


def bla(
    data: Dataset | Sequence[Dataset],
    *,
    period_length: int | None = None,
    transient: int = 1,
    integrator: bool | None = None,
) -> SpectralEstimate:
    """Estimate the best linear approximation from random-phase multisines by the robust method.

    Each of the R realisations has P whole periods after the first `transient` periods ::

        G_r = mean over p of Y_rp / U_r,    s²_r = var over p of Y_rp / (P |U_r|²)

        G = mean of G_r,    var_noise(G) = mean(s²_r) / R
        var(G) = var over r of G_r / R,    s²_nl = R (var(G) - var_noise(G)), 0 at least

    The scatter between periods is due to noise. The scatter between realisations is due to noise
    and to stochastic nonlinear distortion, for example by friction. An average over periods does
    not remove this distortion. The standard deviations `std_*` of the mean over realisations
    include noise and distortion. With one realisation they include only the noise.

    A missing y (for example in a dead band) is replaced by the mean over the other
    periods at the same instant of the period. The replacement does not bias G. Let n_k be the
    number of known values at instant k in the P periods. Then s²_r is multiplied by (P - 1) / (mean
    of n_k - 1) and by the mean of P/n_k. The two factors assume white noise.

    Parameters
    ----------
    data : Dataset or sequence of Dataset
        One experiment for each realisation, with the same period and different phases. A period is
        used only if at least half of its samples are known.
    period_length : int, optional
        Length of the period in samples. By default the period is detected in u.
    transient : int, default 1
        Number of unused periods at the beginning of each realisation, >= 0.
    integrator : bool, optional
        As in `etfe`.

    Returns
    -------
    SpectralEstimate
        Estimate at the lines that are excited in all realisations. `nonlinear_std` is s_nl, the
        standard deviation of G_r due to nonlinear distortion.

    Raises
    ------
    ValueError
        An input is not periodic, the periods differ, or y is missing at the same instant of every
        period.

    References
    ----------
    .. [1] R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed.,
       2012, section 4.3.1.

    Examples
    --------
    The cubic term causes nonlinear distortion at each of the ten lines.

    >>> from scipy.signal import lfilter
    >>> u = [armrig.multisine(600, range(1, 20, 2), seed=k, periods=3) for k in (1, 2, 3)]
    >>> y = [lfilter([0, 0.1], [1, -0.9], x) + 0.001 * x**3 for x in u]
    >>> estimate = armrig.bla([armrig.Dataset(u=u[k], y=y[k], Ts=0.01) for k in range(3)])
    >>> estimate.omega.size, bool((estimate.nonlinear_std > 1e-4).all())
    (10, True)
    """
    require_integers(transient=(transient, 0))
    joint = data if isinstance(data, Dataset) else merge(list(data))
    decided = integration(joint, integrator)
    integrates = decided.integrates
    parts = list(joint.experiments())
    P = _common_period(parts) if period_length is None else period_length
    require_integers(period_length=(P, 2))
    each = [_whole_periods(part, P, transient, integrates=integrates) for part in parts]
    pairs, left = [pair for pair, _ in each], [note for _, notes in each for note in notes]
    at = _lines(np.all([strong_lines(U) for U, _, _ in pairs], axis=0))
    if at.size == 0:
        raise InputError(
            "no line is excited in all realisations: use the same lines with different phases"
        )
    R = len(pairs)
    G_r = np.array([np.mean(Y[:, at], axis=0) / U[at] for U, Y, _ in pairs])
    noise = _noise_variance(pairs, at) / R
    total = np.var(G_r, axis=0, ddof=1) / R if R > 1 else noise
    counts = [Y.shape[0] for _, Y, _ in pairs]
    return _estimate(
        joint,
        at / P,
        np.mean(G_r, axis=0),
        total,
        integrates=integrates,
        noise_only_std=np.sqrt(noise),
        nonlinear_std=np.sqrt(np.maximum(R * (total - noise), 0.0))
        if R > 1
        else np.full(at.size, np.nan),
        method=f"best linear approximation, {R} realisations of {min(counts)} … {max(counts)} "
        f"periods of {plural(P, 'sample')}",
        N=sum(int(n_k.sum()) for _, _, n_k in pairs),
        notes=(
            *loop_notes(joint.history),
            *decided.notes,
            *left[:1],
            *_notes(R, counts, noise, total),
        ),
    )


def _common_period(parts: Sequence[Dataset]) -> int:
    periods = {period(part.u) for part in parts}
    if len(periods) > 1 or None in periods:
        listing = ", ".join(str(P or "none") for P in sorted(periods, key=lambda P: P or 0))
        raise InputError(
            f"bla needs the same period in all realisations, at least two periods each; got "
            f"{listing}. Repeat one multisine in each experiment, or give period_length"
        )
    (P,) = periods
    return P or 0


def _whole_periods(part: Dataset, P: int, transient: int, *, integrates: bool) -> Periods:
    """Return the transforms of one realisation, in which missing y are replaced.

    The rest of a decaying transient is subtracted.
    """
    treated = difference(part) if integrates else part
    periods = part.N // P
    cut = slice(transient * P, periods * P)
    y = treated.y[cut].reshape(-1, P)
    seen = np.isfinite(y)
    most = np.count_nonzero(seen, axis=1) >= P / 2
    y, seen = y[most], seen[most]
    before = plural(transient, "transient period")
    if y.shape[0] == 0:
        raise InputError(
            f"after {before}, a realisation of {plural(part.N, 'sample')} has no period of "
            f"{plural(P, 'sample')} of which at least half are known: record more periods"
        )
    n_k = np.count_nonzero(seen, axis=0)
    if never := int(np.count_nonzero(n_k == 0)):
        raise InputError(
            f"after {before}, a realisation of {plural(part.N, 'sample')} has no value at {never} "
            f"of the {P} instants of its period: record more periods"
        )
    bridged = np.where(seen, y, np.nanmean(y, axis=0))
    decay, tau = decaying_transient(bridged, seen, np.flatnonzero(most))
    bridged = np.where(seen, y - decay, np.nanmean(y - decay, axis=0))
    U = np.fft.rfft(part.u[cut][:P])
    Y = np.asarray(np.fft.rfft(bridged, axis=1))
    return (U, Y, n_k), _transient_notes(bridged, tau * part.Ts, before)


def _transient_notes(y: Matrix, tau: float, before: str) -> list[str]:
    """Return the time constant of the transient, and whether the first period still differs."""
    notes, power = [], np.sum(np.diff(y, axis=0) ** 2, axis=1)
    if tau:
        decays = f"a transient that decays with about {digits(tau, 2)} s was subtracted"
        notes.append(f"after {before}, {decays}")
    if len(power) > 1 and power[0] > _MORE_POWER * np.mean(power[1:]):
        notes.append(
            f"after {before}, the next period differs more than later ones, so a transient may "
            "bias G: leave out more periods (data[n:], or transient= of bla)"
        )
    return notes


def _noise_variance(pairs: Sequence[Transforms], at: NDArray[np.int_]) -> Vector:
    """Return the noise variance of G_r, averaged over the realisations; NaN if unknown."""
    variances = []
    for U, Y, n_k in pairs:
        if Y.shape[0] > 1:
            # The share of the mean is 1/periods for complete y. Values that replace missing samples
            # do not scatter.
            free = float(np.mean(n_k)) - 1
            share = (len(Y) - 1) / free * float(np.mean(1 / n_k)) if free > 0 else np.nan
            variances.append(np.var(Y[:, at], axis=0, ddof=1) * share / np.abs(U[at]) ** 2)
    return np.mean(variances, axis=0) if variances else np.full(at.size, np.nan)


def _notes(R: int, counts: Sequence[int], noise: Vector, total: Vector) -> list[str]:
    if R == 1:
        return ["one realisation: nonlinear distortion cannot be estimated; record more"]
    if max(counts) < 2:
        why = "noise and nonlinear distortion cannot be distinguished"
        return [f"one period in each realisation: {why}"]
    ratio = float(np.mean(total) / np.mean(noise))
    verdict = "nonlinear distortion" if ratio > 2 else "hardly any nonlinear distortion"
    text = f"variance between realisations is {digits(ratio, 2)} times the variance of the noise"
    return [f"{text}: {verdict}"]
