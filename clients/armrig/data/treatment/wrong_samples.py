"""The search for single wrong samples, by what each would leave in a model's residuals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, Vector
from armrig.data.treatment.whitening import Whitening, whitening
from armrig.numerics.checks import require_integers, require_numbers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.stretches import Mask, pieces

Indices = NDArray[np.intp]
_Found = tuple[Mask, Vector]

_MAD_TO_STD = 1.4826  # of a normal distribution
_NEIGHBOURS = 11  # samples, whose median up to five wrong ones in a row do not move
_GROSS = 100  # median deviations from it, beyond which a sample is of another order of magnitude
_EARLY = 2  # times the limit, after a start or a gap
_ROUNDS = 25
MOST = 0.1
"""Share of the samples beyond which they are no outliers; twice as many end the search."""
_SHOWN = 1e-3  # share of its own trace that a sample must leave beside those marked already


def wrong_samples(parts: Sequence[tuple[Vector, Vector]], n: int, limit: float) -> list[Mask]:
    """Return which samples are wrong, for (u, y) of each experiment, y NaN where it is missing.

    n is the order of the model, `limit` the least size in robust standard deviations. In the first
    n samples after a gap the residuals lack their past, so a model of the data in reverse order,
    which foresees y(t) from what follows, searches these first, for what is grossly wrong: how a
    poor input began is not foreseen either.
    """
    backwards = _marked([(u[::-1], y[::-1]) for u, y in parts], n, _EARLY * limit)
    mended, early = [], []
    for (u, y), (wrong, expected) in zip(parts, backwards, strict=True):
        marked = wrong[::-1] & _lacks_past(y, n)
        mended.append((u, np.where(marked, expected[::-1], y)))
        early.append(marked)
    forwards = _marked(mended, n, limit)
    return [marked | wrong for marked, (wrong, _) in zip(early, forwards, strict=True)]


def _lacks_past(y: Vector, n: int) -> Mask:
    """Return where one of the n samples before is missing."""
    missing = np.concatenate(([n], np.cumsum(np.isnan(y)) + n))
    before = np.concatenate((np.arange(n), missing))[: y.size]
    return missing[:-1] > before


def _marked(parts: Sequence[tuple[Vector, Vector]], n: int, limit: float) -> list[_Found]:
    """Return which samples do not fit a model, and y as it expects it.

    Samples of another order of magnitude than their neighbours would make the first model theirs,
    and the search is then tried without them, too: what marks fewer samples is taken.
    """
    gross = [_gross(y) for _, y in parts]
    none = [np.zeros(y.size, dtype=np.bool_) for _, y in parts]
    most = int(MOST * sum(y.size for _, y in parts))
    if not any(marked.any() for marked in gross):
        return _searched(parts, n, limit, none, most)
    found = _searched(parts, n, limit, gross, most)
    count = _count(wrong for wrong, _ in found)
    without = _searched(parts, n, limit, none, min(most, count))
    return without if _count(wrong for wrong, _ in without) < count else found


def _count(wrong: Iterable[Mask]) -> int:
    return sum(int(np.count_nonzero(marked)) for marked in wrong)


def _gross(y: Vector) -> Mask:
    """Return where y is far from the median of its neighbours, as no dynamics are."""
    from scipy.ndimage import median_filter

    known = np.flatnonzero(np.isfinite(y))
    wrong = np.zeros(y.size, dtype=np.bool_)
    if known.size > _NEIGHBOURS:
        off = np.abs(y[known] - median_filter(y[known], _NEIGHBOURS, mode="nearest"))
        # A reading that mostly rests is its neighbours' median, and a step of its converter is not
        # gross: the median is that of those that are off it.
        typical = float(np.median(off[off > 0])) if off.any() else 0.0
        wrong[known] = off > _GROSS * max(typical, 1e-9 * float(np.max(np.abs(y[known]))))
    return wrong


def _searched(
    parts: Sequence[tuple[Vector, Vector]],
    n: int,
    limit: float,
    wrong: list[Mask],
    most: int,
) -> list[_Found]:
    """Return the wrong samples, found from those that are marked to begin with, and y without.

    With far more than `most` it gives up, for the search of very many takes long.
    """
    expected = [(u, _bridged(y, marked)) for (u, y), marked in zip(parts, wrong, strict=True)]
    seen = set()
    for _ in range(_ROUNDS):
        model = whitening(expected, n)
        sizes = [
            _sizes(model, model.residuals(u, y), marked)
            for (u, y), marked in zip(expected, wrong, strict=True)
        ]
        s = _robust_std(np.concatenate(sizes), parts)
        for x, marked in zip(sizes, wrong, strict=True):
            marked[_peaks(np.where(np.isnan(x), 0.0, np.abs(x) / s), limit, n)] = True
        if _count(wrong) > 2 * most + n:
            break
        for (u, y), (_, y_expected), marked in zip(parts, expected, wrong, strict=True):
            y_expected[:] = _expect(model, u, y, marked, s * limit)
        found = b"".join(marked.tobytes() for marked in wrong)
        if found in seen:
            break
        seen.add(found)
    return [(marked, y) for marked, (_, y) in zip(wrong, expected, strict=True)]


def _bridged(y: Vector, wrong: Mask) -> Vector:
    """Return a copy of y, interpolated where it is wrong."""
    bridged = y.copy()
    right = np.flatnonzero(np.isfinite(y) & ~wrong)
    if wrong.any() and right.size:
        bridged[wrong] = np.interp(np.flatnonzero(wrong), right, y[right])
    return bridged


def _robust_std(x: Vector, parts: Sequence[tuple[Vector, Vector]]) -> float:
    # The spread of x, not of e: where noise is no ARX model's, e is coloured and x is larger.
    known = x[np.isfinite(x)]
    if known.size == 0:
        raise InputError(
            "no stretch of y is long enough for the model: there are too many gaps; lower the order"
        )
    mad = float(np.median(np.abs(known)))
    # A least size: without noise, rounding errors would be outliers.
    largest = max(float(np.nanmax(np.abs(y), initial=0.0)) for _, y in parts)
    return max(_MAD_TO_STD * mad, 1e-9 * largest, np.finfo(np.float64).tiny)


def _sizes(model: Whitening, e: Vector, marked: Mask) -> Vector:
    """Return x (N,), the size of an outlier at each sample as a residual; NaN where none shows.

    Beside samples that are marked already, only what those do not explain counts.
    """
    n = model.A.size - 1
    there = np.isfinite(e)
    ahead = np.convolve(np.where(there, e, 0.0)[::-1], model.A)[: e.size][::-1]
    weight = np.convolve(there[::-1].astype(np.float64), model.A**2)[: e.size][::-1]
    for group in _groups(np.flatnonzero(marked), n):
        near = np.arange(max(group[0] - n, 0), min(group[-1] + n + 1, e.size))
        rows = _rows(there, group, n)
        explained = orthonormal(_columns(model, rows, group)).Q.T @ _columns(model, rows, near)
        weight[near] -= np.sum(explained**2, axis=0)
    shows = weight > _SHOWN * np.sum(model.A**2)
    return np.asarray(np.where(shows, ahead / np.sqrt(np.where(shows, weight, 1.0)), np.nan))


def _peaks(z: Vector, limit: float, n: int) -> Indices:
    """Return where z is beyond the limit, none within n samples of a larger one."""
    candidates = np.flatnonzero(z > limit)
    taken = np.zeros(z.size, dtype=np.bool_)
    peaks = []
    for t in candidates[np.argsort(-z[candidates], kind="stable")]:
        if not taken[max(t - n, 0) : t + n + 1].any():
            taken[t] = True
            peaks.append(t)
    return np.array(peaks, dtype=np.intp)


def _expect(model: Whitening, u: Vector, y: Vector, marked: Mask, least: float) -> Vector:
    """Return y with the marked samples set to what makes the residuals least, near ones together.

    A marked sample whose size, with its neighbours free too, is below `least` is unmarked.
    """
    n = model.A.size - 1
    expected, e = y.copy(), model.residuals(u, y)
    for group in _groups(np.flatnonzero(marked), n):
        rows = _rows(np.isfinite(e), group, n)
        kept, wrong_by = _surely_wrong(_columns(model, rows, group), e[rows], least)
        expected[group[kept]] -= wrong_by
        marked[np.delete(group, kept)] = False
    return expected


def _surely_wrong(columns: Array, e: Vector, least: float) -> tuple[Indices, Vector]:
    """Return which columns explain e by at least so much each, and by how much.

    The least one is left out until all are: b and P, P s² the covariance of b, without column j are
    b - P_j b_j / P_jj and P - P_j P_j^T / P_jj.
    """
    basis = orthonormal(columns)
    kept, b, P = np.arange(columns.shape[1]), basis.coefficients(e), basis.W @ basis.W.T
    while kept.size:
        variance = np.diag(P)
        size = np.abs(b) / np.sqrt(np.where(variance > 0, variance, np.inf))
        j = int(np.argmin(size))
        if size[j] >= least:
            break
        if variance[j] > 0:
            b, P = b - P[:, j] * (b[j] / P[j, j]), P - np.outer(P[:, j], P[j] / P[j, j])
        kept, b = np.delete(kept, j), np.delete(b, j)
        P = np.delete(np.delete(P, j, axis=0), j, axis=1)
    return kept, b


def _rows(there: Mask, group: Indices, n: int) -> Indices:
    """Return the residuals that see a sample of the group."""
    rows = np.arange(group[0], min(group[-1] + n + 1, there.size))
    return rows[there[rows]]


def _columns(model: Whitening, rows: Indices, samples: Indices) -> Array:
    """Return what a unit error of each sample adds to the residuals in the rows."""
    n = model.A.size - 1
    lag = rows[:, None] - samples[None, :]
    return np.where((lag >= 0) & (lag <= n), model.A[np.clip(lag, 0, n)], 0.0)


def _groups(indices: Indices, n: int) -> Iterator[Indices]:
    """Yield runs of indices that are no more than n apart: no residual sees two of them."""
    if indices.size:
        for group in pieces(np.diff(indices) > n):
            yield indices[group]


# Single wrong samples, found where a model did not foresee them.


_FALSE_ALARM = 0.01  # chance of one or more in a clean record
_LISTED = 10


@takes_recordings
def hampel(data: Dataset, *, threshold: float | None = None, order: int | None = None) -> Dataset:
    """Return the data with outliers of y marked missing.

    An ARX model of high order takes the dynamics out: a step of the input is no outlier, however
    far y moves. A wrong y(t) shows in the residuals e(t) … e(t+n) with the pattern 1, a1 … an, and
    its size in robust standard deviations is ::

        z(t) = x(t) / s,    x(t) = sum a_k e(t+k) / sqrt(sum a_k²),    s = 1.4826 median |x|

    The largest |z| are marked, set to what the model expects (for this search alone), and the
    search goes on; those that their neighbours explain are let go. Nothing is interpolated in the
    data returned. The first n samples after the start or a gap are searched in the reversed data,
    for outliers of twice the size. In a stretch of n samples or fewer no outlier shows.

    Parameters
    ----------
    data : Dataset
        N samples; each experiment is searched by itself, with one model and one s for all.
    threshold : float, optional
        Least |z| of an outlier; by default the one that N normal residuals stay below with a
        chance of 99 % (4.6 for 3000).
    order : int, optional
        n, by default 20, or a tenth of the samples where they are fewer than 200.

    Returns
    -------
    Dataset
        N samples, the outliers with `valid` False, and in `history` which they were.

    Raises
    ------
    ValueError
        There are too few samples, or a tenth of them would be outliers.

    References
    ----------
    .. [1] F. R. Hampel, J. Amer. Statist. Assoc. 69 (1974) 383-393.
    .. [2] I. Chang, G. C. Tiao, C. Chen, Technometrics 30 (1988) 193-204 (additive outliers).
    """
    from scipy.special import ndtri

    count = data.N - data.missing
    n = max(min(20, count // 10), 1) if order is None else order
    require_integers(order=(n, 1))
    if count < 5 * n + 10:
        raise InputError(
            f"{count} samples are too few to find outliers with order={n}; "
            f"{5 * n + 10} are needed: lower the order"
        )
    limit = float(-ndtri(_FALSE_ALARM / (2 * count))) if threshold is None else threshold
    require_numbers(threshold=limit)
    if not limit > 0:
        raise InputError(f"threshold={threshold!r} must be > 0, in robust standard deviations")
    wrong = np.concatenate(wrong_samples([(d.u, d.y) for d in data.experiments()], n, limit))
    found = np.flatnonzero(wrong)
    if found.size > MOST * count:
        raise InputError(
            f"{found.size} of {count} samples would be outliers at threshold={limit:.2f}: that "
            "is another process, not outliers; plot the data, or raise the threshold"
        )
    where = ", ".join(map(str, found[:_LISTED])) + (", …" if found.size > _LISTED else "")
    return data.replaced(
        valid=data.valid & ~wrong,
        step=f"marked {found.size} of {count} samples of {data.output} missing as outliers"
        f"{f' (samples {where})' if found.size else ''}: beyond {limit:.2f} robust standard "
        f"deviations in the residuals of an ARX model of order {n}",
    )
