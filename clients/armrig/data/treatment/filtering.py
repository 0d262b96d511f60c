"""Filters for u and y: selection of a frequency band, and reduction of the sampling rate."""

from __future__ import annotations

from math import isclose

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import treats_signals
from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.numerics.checks import require_integers, require_numbers
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask

MAX_FORGOTTEN_SHARE = 1e-4  # share of sum |impulse response| after the filter's memory
_MAX_MEMORY_SAMPLES = 200_000
_HALF_LENGTH = 8  # of the anti-alias filter, in samples of the lower rate
_KAISER_BETA = 5.0


@treats_signals
def prefilter(data: Signals, *, band: tuple[float, float], order: int = 4) -> Signals:
    """Return the data with u and y filtered by the same L(q), which weights frequencies.

    From y = G u + v follows L y = G L u + L v: the plant G does not change. L determines at which
    frequencies the model is accurate (Ljung 14.4). `oe` minimises the output error weighted by
    ``|L|²``, and its residuals are white if L v is white.

    After the start of an experiment and after a gap, y is missing for the memory of the filter. The
    memory is the number of samples after which at most 1e-4 of the absolute sum of the impulse
    response is left.

    Parameters
    ----------
    data : Dataset or Signals
        N samples.
    band : (float, float)
        Edges, in rad/s, of the pass band of a Butterworth filter. (0, w) is a low-pass filter, and
        (w, inf) is a high-pass filter.
    order : int, default 4
        Order of the Butterworth filter.

    Returns
    -------
    Dataset or Signals
        N samples in the same units. `trends` is empty: `retrend` cannot restore a trend.

    Raises
    ------
    ValueError
        The band is not inside 0 to pi/Ts, or all samples would be missing.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")
    >>> slow = armrig.prefilter(data, band=(0, 50))
    >>> print(slow.history[0])
    filtered u and y with a Butterworth low-pass to 50 rad/s of order 4; ...
    """
    from scipy.signal import butter, sosfilt, sosfilt_zi

    low, high = band
    require_numbers(low=low, high=high)
    require_integers(order=(order, 1))
    nyquist = np.pi / data.Ts
    if not (0 <= low < high and low < nyquist) or (low == 0 and high >= nyquist):
        raise InputError(
            f"band=({low:g}, {high:g}) rad/s must be inside 0 to {nyquist:g} rad/s (pi/Ts), with "
            "low < high, and not the whole range"
        )
    edges: float | tuple[float, float]
    if low == 0:
        kind, edges, passed = "lowpass", high / nyquist, f"low-pass to {high:g}"
    elif high >= nyquist:
        kind, edges, passed = "highpass", low / nyquist, f"high-pass from {low:g}"
    else:
        kind, edges = "bandpass", (low / nyquist, high / nyquist)
        passed = f"band-pass from {low:g} to {high:g}"
    name = f"a Butterworth {passed} rad/s of order {order}"
    # Second-order sections: in a polynomial, rounding would move the poles of a low, narrow band.
    sections = butter(order, edges, kind, output="sos")
    steady, memory = sosfilt_zi(sections)[..., None], _memory(sections)
    u, y, valid = np.empty(data.u.shape), np.empty(data.y.shape), np.empty_like(data.valid)
    for part, start in zip(data.experiments(), data.starts, strict=True):
        rows = slice(start, start + part.N)
        pairs = zip(part.y.T, part.valid.T, strict=True)
        held = np.column_stack([_hold_last(x, there) for x, there in pairs])
        for filtered, x in ((u, part.u), (y, held)):
            filtered[rows], _ = sosfilt(sections, x, axis=0, zi=steady * x[0])
        valid[rows] = _full_windows(part.valid, memory)
    if not valid.any(axis=0).all():
        raise InputError(
            f"{name} remembers {plural(memory, 'sample')}, and no stretch of y without a gap is as "
            "long; use a shorter filter (a wider band, or a lower order)"
        )
    lost = int(np.count_nonzero(data.valid & ~valid))
    step = (
        f"filtered u and y with {name}; {plural(lost, 'more sample is', 'more samples are')} "
        "missing, within the "
    )
    step += f"filter's memory of {plural(memory, 'sample')} after the start or a gap"
    return data.replaced(u=u, y=y, valid=valid, trends=(), r=None, step=step)


@treats_signals
def resample(data: Signals, Ts: float) -> Signals:
    """Return the data at a lower sampling rate, after the same anti-alias filter for u and y.

    The filter is a symmetric low-pass of 16 Ts_new/Ts_old + 1 coefficients with a Kaiser window. It
    is flat up to 60 % of the new Nyquist frequency and attenuates by 53 dB above the new Nyquist
    frequency. It causes no delay and does not change straight lines. Every (Ts_new/Ts_old)-th
    filtered sample is kept. A new sample is missing if the filter would use a missing sample for
    it. The first and last 8 new samples of each experiment cannot be computed and are cut off. A
    higher rate is refused, because the additional samples would be invented.

    Parameters
    ----------
    data : Dataset or Signals
        N samples.
    Ts : float
        New sampling time in s, a whole multiple of the sampling time of the data.

    Returns
    -------
    Dataset or Signals
        About N Ts_old/Ts_new samples. Between the new samples u is not constant. A model that
        assumes a zero-order hold is therefore an approximation, accurate well below the new Nyquist
        frequency.

    Raises
    ------
    ValueError
        Ts is not a multiple of the data's Ts, an experiment is too short, or all samples would be
        missing.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")
    >>> slow = armrig.resample(data, Ts=0.02)
    >>> slow.Ts, slow.N  # 8 samples are cut off at each end
    (0.02, 1484)
    """
    from scipy.signal import firwin

    require_numbers(Ts=Ts)
    old = data.Ts
    factor = round(Ts / old) if 0 < Ts < np.inf else 0
    if factor < 1 or not isclose(factor * old, Ts, rel_tol=1e-6):
        raise InputError(
            f"Ts={Ts!r} s must be a whole multiple of the data's {old:g} s, for example "
            f"{2 * old:g} s; a faster rate would invent samples"
        )
    if factor == 1:
        return data
    half = _HALF_LENGTH * factor
    experiments = [*data.experiments()]
    for i, part in enumerate(experiments):
        if 2 * half + 1 > part.N:
            raise InputError(
                f"experiment {i} has {plural(part.N, 'sample')}; resampling to {Ts:g} s needs "
                f"{2 * half + 1}: leave it out with select, or use a shorter Ts"
            )
    h = firwin(2 * half + 1, 0.8 / factor, window=("kaiser", _KAISER_BETA))
    parts = [_decimate(part, h, factor) for part in experiments]
    u, y, valid = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if not valid.any(axis=0).all():
        raise InputError(
            f"no stretch of y without a gap has the {plural(2 * half + 1, 'sample')} that the "
            "anti-alias "
            f"filter for {Ts:g} s needs: record at that rate instead, or difference and average"
        )
    step = f"resampled from {old:g} s to {factor * old:g} s after a low-pass filter of "
    step += f"{2 * half + 1} coefficients; {np.count_nonzero(~valid)} of {valid.size} samples "
    step += "are missing"
    return data.replaced(
        u=u,
        y=y,
        valid=valid,
        starts=np.cumsum([0, *(len(part[0]) for part in parts[:-1])]).tolist(),
        trends=[trend.later(half * old) for trend in data.trends],
        r=None,
        Ts=factor * old,
        step=step,
    )


def _decimate(part: Signals, h: Vector, factor: int) -> tuple[Matrix, Matrix, Mask]:
    """Return u, y and valid of an experiment, filtered by h, at every factor-th sample."""
    from scipy.signal import upfirdn

    pairs = zip(part.y.T, part.valid.T, strict=True)
    level = np.array([np.mean(y[valid]) if valid.any() else 0.0 for y, valid in pairs])
    y = np.where(part.valid, part.y - level, 0.0)
    # Row j of the decimated convolution is centred on sample j * factor - half.
    rows = slice(2 * _HALF_LENGTH, (part.N - 1) // factor + 1)
    return (
        upfirdn(h, part.u, down=factor, axis=0)[rows],
        upfirdn(h, y, down=factor, axis=0)[rows] + level,
        _full_windows(part.valid, h.size)[h.size - 1 :: factor],
    )


def _memory(sections: Matrix) -> int:
    """Return the number of samples until 1e-4 of the impulse response's absolute sum is left."""
    from scipy.signal import sosfilt

    length = 256
    while True:
        weight = np.abs(sosfilt(sections, np.eye(1, length)[0]))
        ahead = np.cumsum(weight[::-1])[::-1]
        short = np.flatnonzero(ahead <= MAX_FORGOTTEN_SHARE * ahead[0])
        # The response decays, so its uncomputed part is smaller than the computed second half.
        if short.size and short[0] <= length // 2:
            return max(int(short[0]), 1)
        length *= 4
        if length > _MAX_MEMORY_SAMPLES:
            raise InputError(
                f"the filter remembers more than {plural(length // 8, 'sample')}; widen its band"
            )


def _hold_last(y: Vector, valid: Mask) -> Vector:
    """Return y with its last valid value held in each gap."""
    if not valid.any():
        return np.zeros(y.size)
    indices = np.flatnonzero(valid)
    before = np.clip(np.searchsorted(indices, np.arange(y.size), side="right") - 1, 0, None)
    return np.asarray(y[indices[before]])


def _full_windows(valid: Mask, memory: int) -> Mask:
    """Return a mask (N, ny), True where the last `memory` samples of an output are all valid."""
    count = np.insert(np.cumsum(valid, axis=0), 0, 0, axis=0)
    complete = np.zeros(valid.shape, dtype=np.bool_)
    if len(valid) >= memory:
        complete[memory - 1 :] = count[memory:] - count[:-memory] == memory
    return complete
