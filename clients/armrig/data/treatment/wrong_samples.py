"""Search for single wrong samples by the pattern that they leave in a model's residuals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.columns import Vector
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.regressors import Whitening, whitening
from armrig.numerics.rounding import is_constant, rounding_std
from armrig.numerics.stretches import Mask, pieces

Indices = NDArray[np.intp]
_Found = tuple[Mask, Vector]

_MAD_TO_STD = 1.4826  # of a normal distribution
_MEDIAN_SAMPLES = 11  # up to five wrong samples in a row do not move the median of a window
_GROSS_RATIO = 100  # least ratio of a gross error to the median deviation
SAMPLES_PER_SPIKE = 200  # least number of samples at rest for each sample that counts as an error
_EARLY_FACTOR = 2  # factor of the limit in the first n samples after a start or a gap
_MAX_ROUNDS = 25
MOST = 0.1
"""Largest allowed share of outliers; the search ends early at twice this share."""
_MIN_LEVEL_SAMPLES = 40
_MAX_LEVELS = 20
_MAD_LOG_VARIANCE = 1.36  # of log MAD, times the number of samples; normal distribution
_NOISE_LEVEL = 0.01  # p value below which the noise depends on a level; else all samples count
MIN_VISIBLE_SHARE = 1e-3  # least share of a visible pattern that marked samples do not explain


def wrong_samples(parts: Sequence[tuple[Array, Vector]], n: int, limit: float) -> list[Mask]:
    """Return a mask of the wrong samples for each experiment (u, y); in y, a missing value is NaN.

    `n` is the order of the model. `limit` is the least size of an outlier, in robust standard
    deviations. The model cannot predict the first n samples after the start or after a gap. These
    samples are therefore searched first, with a model of the reversed data, which predicts y(t)
    from later samples. This model predicts less well if the input excites poorly, so it is used
    with twice the limit, and only for errors that earlier values of u do not explain. If the model
    explains all samples exactly, none is wrong.
    """
    if not any(_gross(y).any() for _, y in parts) and whitening(parts, n).exact:
        return [np.zeros(y.size, dtype=np.bool_) for _, y in parts]
    backwards = _mark_outliers([(u[::-1], y[::-1]) for u, y in parts], n, _EARLY_FACTOR * limit)
    early = [
        wrong[::-1] & _lacks_past(y, n) for (_, y), (wrong, _) in zip(parts, backwards, strict=True)
    ]
    forwards = _forwards(parts, backwards, early, n, limit)
    if any(marked.any() for marked in early):
        right = [np.where(m, np.nan, y) for m, (_, y) in zip(early, forwards, strict=True)]
        unexplained = _mask_unexplained(parts, right, n, limit)
        early = [marked & mask for marked, mask in zip(early, unexplained, strict=True)]
        forwards = _forwards(parts, backwards, early, n, limit)
    return [marked | wrong for marked, (wrong, _) in zip(early, forwards, strict=True)]


def _forwards(
    parts: Sequence[tuple[Array, Vector]],
    backwards: Sequence[_Found],
    early: Sequence[Mask],
    n: int,
    limit: float,
) -> list[_Found]:
    """Search the data in which the early outliers have the values of the reversed model."""
    corrected = [
        (u, np.where(marked, expected[::-1], y))
        for (u, y), (_, expected), marked in zip(parts, backwards, early, strict=True)
    ]
    return _mark_outliers(corrected, n, limit)


def _mask_unexplained(
    parts: Sequence[tuple[Array, Vector]], right: Sequence[Vector], n: int, limit: float
) -> list[Mask]:
    """Return a mask, True where later y, and u before and after y, do not explain y."""
    inputs = []
    for u, _ in parts:
        before = np.concatenate((np.repeat(u[:1], n + 1, axis=0), u))[: len(u)]  # u(t - n - 1)
        inputs.append(np.hstack((u, before))[::-1])
    model = whitening([(u, y[::-1]) for u, y in zip(inputs, right, strict=True)], n)
    residuals = [model.residuals(u, y[::-1])[::-1] for u, (_, y) in zip(inputs, parts, strict=True)]
    least = limit * _robust_std(np.concatenate(residuals), parts)
    steps = np.abs(np.cumsum(model.B[model.B.shape[0] // 2 :], axis=1))
    effect = np.ptp(np.concatenate([u for u, _ in parts]), axis=0) @ np.maximum.accumulate(steps, 1)
    for e in residuals:
        e[: n + 1] = np.maximum(np.abs(e[: n + 1]) - effect[::-1][: e.size], 0.0)
    return [~(np.abs(e) < least) for e in residuals]


def _lacks_past(y: Vector, n: int) -> Mask:
    """Return a mask, True where one of the n previous samples is missing or before the start."""
    missing = np.concatenate(([n], np.cumsum(np.isnan(y)) + n))
    before = np.concatenate((np.arange(n), missing))[: y.size]
    return missing[:-1] > before


def _mark_outliers(parts: Sequence[tuple[Array, Vector]], n: int, limit: float) -> list[_Found]:
    """Return a mask of the outliers of each experiment, and y with model values at the outliers."""
    # Samples of another order of magnitude would dominate the first model.
    gross = [_gross(y) for _, y in parts]
    none = [np.zeros(y.size, dtype=np.bool_) for _, y in parts]
    most = int(MOST * sum(y.size for _, y in parts))
    if not any(marked.any() for marked in gross):
        return _search_outliers(parts, n, limit, none, most)
    at_rest = [_bridge(y, marked) for (_, y), marked in zip(parts, gross, strict=True)]
    if all(map(is_constant, at_rest)):
        return list(zip(gross, at_rest, strict=True))
    outliers = _search_outliers(parts, n, limit, gross, most)
    count = _count(wrong for wrong, _ in outliers)
    without = _search_outliers(parts, n, limit, none, min(most, count))
    return without if _count(wrong for wrong, _ in without) < count else outliers


def _count(wrong: Iterable[Mask]) -> int:
    return sum(int(np.count_nonzero(marked)) for marked in wrong)


def _gross(y: Vector) -> Mask:
    """Return a mask, True where y is far from the median of its neighbours: a gross error."""
    from scipy.ndimage import median_filter

    finite = np.flatnonzero(np.isfinite(y))
    wrong = np.zeros(y.size, dtype=np.bool_)
    if finite.size > _MEDIAN_SAMPLES:
        off = np.abs(y[finite] - median_filter(y[finite], _MEDIAN_SAMPLES, mode="nearest"))
        # Most samples of a signal at rest are equal to the median. The typical deviation is
        # therefore the median of the deviations other than 0: one quantisation step is not gross.
        # If hardly any sample differs, these samples are the errors.
        few = np.count_nonzero(off) <= max(1, finite.size // SAMPLES_PER_SPIKE)
        typical = 0.0 if few else float(np.median(off[off > 0]))
        wrong[finite] = off > _GROSS_RATIO * max(typical, rounding_std(y))
    return wrong


def _search_outliers(
    parts: Sequence[tuple[Array, Vector]], n: int, limit: float, wrong: list[Mask], most: int
) -> list[_Found]:
    """Return masks of `wrong` and further outliers, and y with model values at the outliers."""
    expected = [(u, _bridge(y, marked)) for (u, y), marked in zip(parts, wrong, strict=True)]
    seen = set()
    for _ in range(_MAX_ROUNDS):
        model = whitening(expected, n)
        residuals = [model.residuals(u, y) for u, y in expected]
        sizes = [_sizes(model, e, marked) for e, marked in zip(residuals, wrong, strict=True)]
        levels = [
            np.column_stack((u, y - e)) for (u, y), e in zip(expected, residuals, strict=True)
        ]
        stds = _robust_stds(np.concatenate(sizes), np.concatenate(levels), parts)
        s = np.split(stds, np.cumsum([y.size for _, y in parts])[:-1])
        for x, s_x, marked in zip(sizes, s, wrong, strict=True):
            marked[_peaks(np.where(np.isnan(x), 0.0, np.abs(x) / s_x), limit, n)] = True
        if _count(wrong) > 2 * most + n:
            break
        for (u, y), (_, y_expected), s_x, marked in zip(parts, expected, s, wrong, strict=True):
            y_expected[:] = _expect(model, u, y, marked, s_x * limit)
        signature = b"".join(marked.tobytes() for marked in wrong)
        if signature in seen:
            break
        seen.add(signature)
    return [(marked, y) for marked, (_, y) in zip(wrong, expected, strict=True)]


def _bridge(y: Vector, wrong: Mask) -> Vector:
    """Return a copy of y, interpolated at the wrong samples."""
    bridged = y.copy()
    right = np.flatnonzero(np.isfinite(y) & ~wrong)
    if wrong.any() and right.size:
        bridged[wrong] = np.interp(np.flatnonzero(wrong), right, y[right])
    return bridged


def _robust_stds(x: Vector, levels: Array, parts: Sequence[tuple[Array, Vector]]) -> Vector:
    """Return the robust std of x (N,), at each level (N, k) if the noise grows with a level."""
    from scipy.ndimage import maximum_filter1d
    from scipy.stats import chi2

    s = _robust_std(x, parts)
    stds = np.full(x.size, s)
    finite = np.flatnonzero(np.isfinite(x))
    count = min(finite.size // _MIN_LEVEL_SAMPLES, _MAX_LEVELS)
    for level in levels.T if count > 1 else ():
        groups = np.array_split(finite[np.argsort(level[finite], kind="stable")], count)
        mads = np.array([_MAD_TO_STD * np.median(np.abs(x[group])) for group in groups])
        size = finite.size / count / _MAD_LOG_VARIANCE
        deviations = np.log(np.maximum(mads, 1e-3 * s) / s) * np.sqrt(size)
        if np.sum(deviations**2) > chi2.isf(_NOISE_LEVEL, count):
            for group, mad in zip(groups, maximum_filter1d(mads, 3, mode="nearest"), strict=True):
                stds[group] = np.maximum(stds[group], mad)
    return stds


def _robust_std(x: Vector, parts: Sequence[tuple[Array, Vector]]) -> float:
    # Use the spread of x, not of e: if the noise is not that of an ARX model, e is coloured and the
    # spread of x is larger.
    finite = x[np.isfinite(x)]
    if finite.size == 0:
        raise InputError(
            "no stretch of y is long enough for the model: there are too many gaps; lower the order"
        )
    mad = float(np.median(np.abs(finite)))
    # A lower bound: without noise, rounding errors would be outliers.
    return max(_MAD_TO_STD * mad, rounding_std(*(y for _, y in parts)))


def _sizes(model: Whitening, e: Vector, marked: Mask) -> Vector:
    """Return the size of an outlier at each sample, (N,), in the unit of e; NaN if not visible."""
    n = model.A.size - 1
    there = np.isfinite(e)
    ahead = np.convolve(np.where(there, e, 0.0)[::-1], model.A)[: e.size][::-1]
    weight = np.convolve(there[::-1].astype(np.float64), model.A**2)[: e.size][::-1]
    for group in _groups(np.flatnonzero(marked), n):
        near = np.arange(max(group[0] - n, 0), min(group[-1] + n + 1, e.size))
        rows = _rows(there, group, n)
        explained = orthonormal(_columns(model, rows, group)).Q.T @ _columns(model, rows, near)
        weight[near] -= np.sum(explained**2, axis=0)
    shows = weight > MIN_VISIBLE_SHARE * np.sum(model.A**2)
    return np.asarray(np.where(shows, ahead / np.sqrt(np.where(shows, weight, 1.0)), np.nan))


def _peaks(z: Vector, limit: float, n: int) -> Indices:
    """Return the indices of the peaks of z above the limit; peaks are more than n samples apart."""
    candidates = np.flatnonzero(z > limit)
    taken = np.zeros(z.size, dtype=np.bool_)
    peaks = []
    for t in candidates[np.argsort(-z[candidates], kind="stable")]:
        if not taken[max(t - n, 0) : t + n + 1].any():
            taken[t] = True
            peaks.append(t)
    return np.array(peaks, dtype=np.intp)


def _expect(model: Whitening, u: Array, y: Vector, marked: Mask, least: Vector) -> Vector:
    """Return y with the marked samples set to the values that jointly minimise the residuals."""
    n = model.A.size - 1
    expected, e = y.copy(), model.residuals(u, y)
    for group in _groups(np.flatnonzero(marked), n):
        rows = _rows(np.isfinite(e), group, n)
        kept, wrong_by = _surely_wrong(_columns(model, rows, group), e[rows], least[group])
        expected[group[kept]] -= wrong_by
        marked[np.delete(group, kept)] = False
    return expected


def _surely_wrong(columns: Array, e: Vector, least: Vector) -> tuple[Indices, Vector]:
    """Return the columns j with |b_j| / sqrt(P_jj) >= `least[j]`, and their coefficients b_j."""
    # Without column j, b becomes b - P_j b_j / P_jj, and P becomes P - P_j P_j^T / P_jj.
    basis = orthonormal(columns)
    kept, b, P = np.arange(columns.shape[1]), basis.coefficients(e), basis.W @ basis.W.T
    while kept.size:
        variance = np.diag(P)
        size = np.abs(b) / np.sqrt(np.where(variance > 0, variance, np.inf)) / least[kept]
        j = int(np.argmin(size))
        if size[j] >= 1:
            break
        if variance[j] > 0:
            b, P = b - P[:, j] * (b[j] / P[j, j]), P - np.outer(P[:, j], P[j] / P[j, j])
        kept, b = np.delete(kept, j), np.delete(b, j)
        P = np.delete(np.delete(P, j, axis=0), j, axis=1)
    return kept, b


def _rows(there: Mask, group: Indices, n: int) -> Indices:
    """Return the indices of the residuals that depend on a sample of the group."""
    rows = np.arange(group[0], min(group[-1] + n + 1, there.size))
    return rows[there[rows]]


def _columns(model: Whitening, rows: Indices, samples: Indices) -> Array:
    """Return the contribution of an error of 1 in each sample to the residuals at `rows`."""
    n = model.A.size - 1
    lag = rows[:, None] - samples[None, :]
    return np.where((lag >= 0) & (lag <= n), model.A[np.clip(lag, 0, n)], 0.0)


def _groups(indices: Indices, n: int) -> Iterator[Indices]:
    """Yield groups of neighbours at most n apart; no residual depends on samples of two groups."""
    if indices.size:
        for group in pieces(np.diff(indices) > n):
            yield indices[group]
