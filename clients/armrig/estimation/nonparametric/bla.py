"""Best linear approximation, with standard deviations due to noise and to nonlinearity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.data.treatment import difference
from armrig.data.treatment.integrating import integration
from armrig.estimation.nonparametric.etfe import excited, period
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.checks import require_integers
from armrig.numerics.polynomial import summation
from armrig.numerics.quantities import plural

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]
Transforms = tuple[Complex, Complex, NDArray[np.intp]]
"""U (lines,), Y (periods, lines), and number of known y at each instant of the period, (P,)."""


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

    A missing y (for example in the dead band of theta_1) is replaced by the mean over the other
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

    >>> import armrig
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
    pairs = [_whole_periods(part, P, transient, integrates=integrates) for part in parts]
    found = _approximation(joint, pairs, P, integrates=integrates)
    return replace(found, notes=(*decided.notes, *found.notes))


def _approximation(
    joint: Dataset, pairs: Sequence[Transforms], P: int, *, integrates: bool
) -> SpectralEstimate:
    """Return the mean of G over the realisations, with standard deviations."""
    at = _common_lines(pairs)
    R = len(pairs)
    G_r = np.array([np.mean(Y[:, at], axis=0) / U[at] for U, Y, _ in pairs])
    noise = _noise_variance(pairs, at) / R
    total = np.var(G_r, axis=0, ddof=1) / R if R > 1 else noise
    omega: Vector = 2 * np.pi * at.astype(np.float64) / (P * joint.Ts)
    S = summation(omega, joint.Ts) if integrates else np.ones(at.size)
    G = np.mean(G_r, axis=0)
    std = np.sqrt(total / 2)
    nonlinear = np.sqrt(np.maximum(R * (total - noise), 0.0)) if R > 1 else np.full(at.size, np.nan)
    counts = [Y.shape[0] for _, Y, _ in pairs]
    return SpectralEstimate(
        omega=omega,
        G=G * S,
        std_magnitude=std * np.abs(S),
        std_phase=std / np.abs(G),
        noise_only_std=np.sqrt(noise) * np.abs(S),
        nonlinear_std=nonlinear * np.abs(S),
        method=f"best linear approximation, {R} realisations of {min(counts)} … {max(counts)} "
        f"periods of {P} samples",
        integrator=integrates,
        N=sum(int(n_k.sum()) for _, _, n_k in pairs),
        Ts=joint.Ts,
        output=joint.output,
        unit=joint.unit,
        input_unit=joint.input_unit,
        source=joint.source,
        notes=tuple(_notes(R, counts, noise, total)),
    )


def _common_lines(pairs: Sequence[Transforms]) -> NDArray[np.int_]:
    """Return the lines above 0 that are excited in all realisations."""
    lit = np.all([excited(U) for U, _, _ in pairs], axis=0)
    lit[0] = False
    at = np.flatnonzero(lit)
    if at.size == 0:
        raise InputError(
            "no line is excited in all realisations: use the same lines with different phases"
        )
    return at


def _common_period(parts: Sequence[Dataset]) -> int:
    found = {period(part.u) for part in parts}
    if len(found) > 1 or None in found:
        shown = ", ".join(str(P or "none") for P in sorted(found, key=lambda P: P or 0))
        raise InputError(
            f"bla needs the same period in all realisations, at least two periods each; got "
            f"{shown}. Repeat one multisine in each experiment, or give period_length"
        )
    (P,) = found
    return P or 0


def _whole_periods(part: Dataset, P: int, transient: int, *, integrates: bool) -> Transforms:
    """Return the transforms of one realisation, in which missing y are replaced."""
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
            f"after {before}, a realisation of {part.N} samples has no period of {P} samples of "
            "which at least half are known: record more periods"
        )
    n_k = np.count_nonzero(seen, axis=0)
    if never := int(np.count_nonzero(n_k == 0)):
        raise InputError(
            f"after {before}, a realisation of {part.N} samples has no value at {never} of the "
            f"{P} instants of its period: record more periods"
        )
    bridged = np.where(seen, y, np.nanmean(y, axis=0))
    U = np.fft.rfft(part.u[cut][:P])
    return U, np.asarray(np.fft.rfft(bridged, axis=1)), n_k


def _noise_variance(pairs: Sequence[Transforms], at: NDArray[np.int_]) -> Vector:
    """Return the noise variance of G_r, averaged over the realisations; NaN if unknown."""
    variances = [
        np.var(Y[:, at], axis=0, ddof=1) * _share_of_mean(n_k, Y.shape[0]) / np.abs(U[at]) ** 2
        for U, Y, n_k in pairs
        if Y.shape[0] > 1
    ]
    return np.mean(variances, axis=0) if variances else np.full(at.size, np.nan)


def _share_of_mean(n_k: NDArray[np.intp], periods: int) -> float:
    """Return the variance of the mean over periods, divided by the variance between periods.

    For complete y the ratio is 1/periods. For incomplete y the ratio is larger, because values
    that replace missing samples do not scatter.
    """
    free = float(np.mean(n_k)) - 1
    return (periods - 1) / free * float(np.mean(1 / n_k)) if free > 0 else float("nan")


def _notes(R: int, counts: Sequence[int], noise: Vector, total: Vector) -> list[str]:
    if R == 1:
        return ["one realisation: nonlinear distortion cannot be estimated; record more"]
    if max(counts) < 2:
        why = "noise and nonlinear distortion cannot be distinguished"
        return [f"one period in each realisation: {why}"]
    ratio = float(np.mean(total) / np.mean(noise))
    verdict = "nonlinear distortion" if ratio > 2 else "hardly any nonlinear distortion"
    said = f"variance between realisations is {ratio:.2g} times the variance of the noise"
    return [f"{said}: {verdict}"]
