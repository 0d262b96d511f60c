"""Filters of u and y alike: a band to identify in, and a slower sampling rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isclose

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, Vector
from armrig.numerics.checks import column, require_integers, require_numbers
from armrig.numerics.polynomial import filtered, stable
from armrig.numerics.stretches import Mask

_FORGOTTEN = 1e-4  # share of the impulse response's weight that may still be to come
_LONGEST_MEMORY = 200_000
_SIDE = 8  # half length of the anti-alias filter, in samples of the slower rate
_KAISER = 5.0


@takes_recordings
def prefilter(
    data: Dataset,
    numerator: ArrayLike | None = None,
    denominator: ArrayLike = (1.0,),
    *,
    band: tuple[float, float] | None = None,
    order: int = 4,
) -> Dataset:
    """Return u and y both through one filter L(q): the model stays the same, its weighting not.

    L y = G L u + L v, so L says in which frequencies the model is to be good (Ljung 14.4); an
    output-error fit is weighted by |L|², and its residuals are white where L v is.

    A value depends on the past: it is missing until the filter has forgotten all but 1e-4 of what
    went before the experiment, or of a gap in it.

    Parameters
    ----------
    data : Dataset
        N samples.
    numerator, denominator : array_like
        Coefficients of L in q^-1; a denominator of 1 alone is forgotten soonest.
    band : (float, float), optional
        Instead: a Butterworth filter from one frequency to another in rad/s; (0, w) is a low-pass,
        (w, inf) a high-pass.
    order : int, default 4
        Of the Butterworth filter.

    Returns
    -------
    Dataset
        N samples in the same units; the trends that `detrend` took cannot be put back on it.

    Raises
    ------
    ValueError
        Neither or both of numerator and band are given, the filter is unstable, the band is not
        inside 0 to pi/Ts, or no sample would be left.
    """
    if (numerator is None) == (band is None):
        raise InputError(
            "give either numerator (and denominator) of the filter, or band=(low, high) in rad/s"
        )
    if band is not None:
        L = _butterworth(band, order, data.Ts)
    else:
        L = _rational(numerator, denominator)
    memory = _memory(L)
    u, y = np.empty(data.N), np.empty(data.N)
    valid = np.zeros(data.N, dtype=np.bool_)
    for part, start in zip(data.experiments(), data.starts, strict=True):
        rows = slice(start, start + part.N)
        u[rows] = _from_steady(L, part.u)
        y[rows] = _from_steady(L, _held(part.y, part.valid))
        valid[rows] = _known_for(part.valid, memory)
    if not valid.any():
        raise InputError(
            f"{L.name} remembers {memory} samples, and no stretch of y without a gap is that long; "
            "take a shorter filter (a wider band, a lower order, or a numerator alone)"
        )
    lost = int(np.count_nonzero(data.valid & ~valid))
    step = f"filtered u and y with {L.name}; {lost} more samples are missing, where the filter "
    step += f"(memory {memory} samples) had not forgotten the start or a gap"
    return data.replaced(u=u, y=y, valid=valid, trends=(), step=step)


@takes_recordings
def resample(data: Dataset, Ts: float) -> Dataset:
    """Return the data at a slower rate, u and y both through one anti-alias filter.

    A symmetric low-pass filter of 16 Ts_new/Ts + 1 coefficients (Kaiser window, 53 dB down from
    the new Nyquist frequency on, flat to 60 % of it) that shifts nothing and leaves straight lines
    as they are; then every (Ts_new/Ts)-th sample is kept. A sample is missing where any that its
    filter would weigh is. The first and last 8 new samples of each experiment cannot be made, and
    are cut off. Only to slower rates: a faster one would invent samples.

    Parameters
    ----------
    data : Dataset
        N samples.
    Ts : float
        New sampling time in s, a whole multiple of the data's.

    Returns
    -------
    Dataset
        About N Ts_old/Ts_new samples. Between them u is no longer held: a model for a held input
        is an approximation, good well below the new Nyquist frequency.

    Raises
    ------
    ValueError
        Ts is no whole multiple of the data's, an experiment is too short, or all would be missing.
    """
    from scipy.signal import firwin

    require_numbers(Ts=Ts)
    factor = round(Ts / data.Ts) if 0 < Ts < np.inf else 0
    if factor < 1 or not isclose(factor * data.Ts, Ts, rel_tol=1e-6):
        raise InputError(
            f"Ts={Ts!r} s must be a whole multiple of the data's {data.Ts:g} s, for example "
            f"{2 * data.Ts:g} s; a faster rate would invent samples"
        )
    if factor == 1:
        return data
    half = _SIDE * factor
    h = firwin(2 * half + 1, 0.8 / factor, window=("kaiser", _KAISER))
    us, ys, masks = [], [], []
    for i, part in enumerate(data.experiments()):
        if 2 * half + 1 > part.N:
            raise InputError(
                f"experiment {i} has {part.N} samples; resampling to {Ts:g} s needs "
                f"{2 * half + 1}: leave it out with select, or take a shorter Ts"
            )
        u, y, valid = _decimated(part, h, factor)
        us.append(u)
        ys.append(y)
        masks.append(valid)
    valid = np.concatenate(masks)
    if not valid.any():
        raise InputError(
            f"no stretch of y without a gap has {2 * half + 1} samples, as the anti-alias filter "
            f"for {Ts:g} s needs: record at that rate instead, or difference and average"
        )
    step = f"resampled from {data.Ts:g} s to {factor * data.Ts:g} s behind a low-pass filter of "
    step += f"{2 * half + 1} coefficients; {np.count_nonzero(~valid)} of {valid.size} samples "
    step += "are missing"
    return data.replaced(
        u=np.concatenate(us),
        y=np.concatenate(ys),
        valid=valid,
        starts=tuple(int(s) for s in np.cumsum([0, *(m.size for m in masks[:-1])])),
        trends=tuple(trend.later(half * data.Ts) for trend in data.trends),
        Ts=factor * data.Ts,
        step=step,
    )


def _decimated(part: Dataset, h: Vector, factor: int) -> tuple[Vector, Vector, Mask]:
    """Return u, y and valid of an experiment behind the filter h, every factor-th sample."""
    from scipy.signal import upfirdn

    level = float(np.mean(part.y[part.valid])) if part.valid.any() else 0.0
    y = np.where(part.valid, part.y - level, 0.0)
    # Row j of the decimated convolution is centred on sample j factor - half.
    rows = slice(2 * _SIDE, (part.N - 1) // factor + 1)
    return (
        upfirdn(h, part.u, down=factor)[rows],
        upfirdn(h, y, down=factor)[rows] + level,
        _known_for(part.valid, h.size)[h.size - 1 :: factor],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Filter:
    """One filter L(q), and its name in the history."""

    apply: Callable[[Vector], Vector]
    """From rest."""
    gain: float
    """L(1)."""
    name: str


def _rational(numerator: ArrayLike | None, denominator: ArrayLike) -> _Filter:
    b = column("numerator", () if numerator is None else numerator)
    a = column("denominator", denominator)
    if a[0] == 0 or not stable(a):
        raise InputError(
            f"the filter's denominator {a.tolist()} must begin with a number that is not 0 and "
            "have its roots inside the unit circle; differences are made with difference(data)"
        )
    name = f"L = {_listed(b)}" + (f" / {_listed(a)}" if a.size > 1 or a[0] != 1 else "")
    return _Filter(apply=lambda x: filtered(b, a, x), gain=float(np.sum(b) / np.sum(a)), name=name)


def _listed(p: Vector) -> str:
    return f"[{' '.join(f'{c:.4g}' for c in p)}]"


def _butterworth(band: tuple[float, float], order: int, Ts: float) -> _Filter:
    from scipy.signal import butter, sosfilt

    low, high = band
    require_numbers(low=low, high=high)
    require_integers(order=(order, 1))
    nyquist = np.pi / Ts
    if not (0 <= low < high and low < nyquist) or (low == 0 and high >= nyquist):
        raise InputError(
            f"band=({low:g}, {high:g}) rad/s must lie inside 0 to {nyquist:g} rad/s (pi/Ts), "
            "with low < high and not all of it"
        )
    edges: float | tuple[float, float]
    if low == 0:
        kind, edges, name = "lowpass", high / nyquist, f"low-pass to {high:g}"
    elif high >= nyquist:
        kind, edges, name = "highpass", low / nyquist, f"high-pass from {low:g}"
    else:
        kind, edges = "bandpass", (low / nyquist, high / nyquist)
        name = f"band-pass from {low:g} to {high:g}"
    # Sections, not polynomials: rounding moves a polynomial's poles where a band is low and narrow.
    sections = butter(order, edges, kind, output="sos")
    return _Filter(
        apply=lambda x: np.asarray(sosfilt(sections, x)),
        gain=float(np.prod(sections[:, :3].sum(axis=1) / sections[:, 3:].sum(axis=1))),
        name=f"a Butterworth {name} rad/s of order {order}",
    )


def _memory(L: _Filter) -> int:
    """Return the samples after which all but 1e-4 of the impulse response has passed."""
    length = 256
    while True:
        pulse = np.zeros(length)
        pulse[0] = 1.0
        weight = np.abs(L.apply(pulse))
        ahead = np.cumsum(weight[::-1])[::-1]
        short = np.flatnonzero(ahead <= _FORGOTTEN * ahead[0])
        # The response decays: what was not computed is smaller than the last half of what was.
        if short.size and short[0] <= length // 2:
            return max(int(short[0]), 1)
        length *= 4
        if length > _LONGEST_MEMORY:
            raise InputError(
                f"the filter remembers more than {length // 8} samples; widen its band"
            )


def _from_steady(L: _Filter, x: Vector) -> Vector:
    """Return x filtered as though its first value had always been there."""
    return np.asarray(L.apply(x - x[0]) + L.gain * x[0])


def _held(y: Vector, valid: Mask) -> Vector:
    """Return y with the last known value in its gaps, whose traces are then marked missing."""
    if not valid.any():
        return np.zeros(y.size)
    known = np.flatnonzero(valid)
    before = np.clip(np.searchsorted(known, np.arange(y.size), side="right") - 1, 0, None)
    return np.asarray(y[known[before]])


def _known_for(valid: Mask, memory: int) -> Mask:
    """Return where `memory` samples in a row, the last of them here, are all known."""
    count = np.concatenate([[0], np.cumsum(valid)])
    whole = np.zeros(valid.size, dtype=np.bool_)
    if valid.size >= memory:
        whole[memory - 1 :] = count[memory:] - count[:-memory] == memory
    return whole
