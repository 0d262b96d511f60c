"""The equidistant grid on which the rows of a file lie, and the rows that the file leaves out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import isclose

import numpy as np
from armrig_core.errors import FileError
from numpy.typing import NDArray

from armrig.data.files.stamps import Times
from armrig.data.files.table import Vector
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural

MAX_INTERVAL_DEVIATION = 0.05
"""Largest deviation of a regular interval from the usual interval, as a share of it."""
MAX_TS_DEVIATION = 0.05
"""Largest relative deviation of a given Ts from the interval of the times without a note."""
_MAX_IRREGULAR_SHARE = 0.1  # share of irregular intervals above which times are uneven
_MAX_SHIFT = 0.25  # of an interval, from the next multiple
_MAX_LONGER = 0.4  # of an interval: a longer one that no later interval makes up is a break
_MAX_UNUSUAL_SHARE = 0.2  # share of intervals above which whole steps of the last digit are jitter
_MIN_COARSE = 10  # intervals that show the mean of coarse times
_MAX_LEFT_OUT = 20  # rows that are put in at one place; a longer gap begins an experiment
_MAX_CAUGHT_UP = 10  # intervals within which late rows catch up
_MAX_INTERPOLATED = 3.0  # usual intervals; y is missing inside a longer one
_MIN_SHARE = 1e-6
_MAX_GAP = 1e9  # usual intervals
_MAX_FINER = 100.0  # samples for each row
_MAX_DIGITS = 12


class UnevenTimesError(FileError):
    """The times are not on an equidistant grid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Equidistant instants of the rows of a file."""

    Ts: float
    """Sampling time in s."""
    at: NDArray[np.int64]
    """Instant of each row of the file, shape (N,), from 0."""
    size: int
    """Number of instants; those without a row are missing."""
    breaks: tuple[int, ...] = ()
    """Instants at which a new experiment begins."""
    notes: tuple[str, ...] = ()
    """Notes about late rows, rows that were put in, and gaps."""
    times: tuple[Vector, Vector] | None = None
    """Times in s of the rows and of the instants, if the rows must be resampled."""

    def placed(self, x: Vector, *, held: bool) -> Vector:
        """Return the values of a column at the instants, NaN where missing.

        Resampled values are interpolated on a straight line, or, if `held`, are the last values.
        """
        if self.times is None:
            placed = np.full(self.size, np.nan)
            placed[self.at] = x
            return placed
        t, wanted = self.times
        x = x[self.at]
        before = np.clip(np.searchsorted(t, wanted + 1e-9 * self.Ts, side="right") - 1, 0, None)
        if held:
            return np.asarray(x[before])
        after = np.minimum(before + 1, t.size - 1)
        span = t[after] - t[before]
        share = np.clip((wanted - t[before]) / np.where(span > 0, span, np.inf), 0.0, 1.0)
        share[share < _MIN_SHARE] = 0.0  # then a missing neighbour has no weight
        between = np.where(share > 0, (1 - share) * x[before] + share * x[after], x[before])
        far = span > _MAX_INTERPOLATED * max(self.Ts, float(np.median(np.diff(t))))
        return np.where(far & (share > 0), np.nan, between)


def unit_grid(N: int, Ts: float) -> Grid:
    """Return the grid of rows without times."""
    return Grid(Ts=Ts, at=np.arange(N), size=N)


def grid_of(
    times: Times,
    name: str,
    place: Callable[[int], str],
    *,
    Ts: float | None = None,
    resample: bool = False,
) -> Grid:
    """Return the grid of rows at these times.

    The usual interval is the median. An interval of several usual intervals leaves out rows, which
    are put in as missing. A longer gap, or a time that goes back, begins a new experiment. A late
    row belongs to its own instant if the next rows catch up. The times are as exact as their last
    digit. Ts is the mean interval, rounded to the fewest digits with which its multiples still fit
    the times.

    Parameters
    ----------
    times : Times
        Times of the rows, in s.
    name : str
        Name of the times in messages.
    place : callable
        Function that returns the place of row k in the file.
    Ts : float, optional
        Sampling time in s that is used instead of the interval of the times.
    resample : bool
        Interpolate rows at uneven times.

    Raises
    ------
    FileError
        There is only one time, or the times never advance.
    UnevenTimesError
        More than a tenth of the intervals differ from the usual interval by more than a twentieth
        and the last digit of the times.
    """
    t = times.t
    if t.size < 2 and Ts is not None:
        return unit_grid(t.size, Ts)
    if t.size < 2:
        raise FileError(
            f"{name}: a sampling time needs at least 2 times, got {t.size}; give Ts in s (--Ts)"
        )
    if not np.any(np.diff(t) > 0):
        raise FileError(
            f"{place(1)}: {name} do not increase; give Ts in s (--Ts) if the times are wrong"
        )
    if resample:
        return _resampled(times, Ts)
    if Ts is None:
        return _of_times(times, name, place)
    try:
        grid = _of_times(times, name, place)
        usual = grid.Ts
    except UnevenTimesError as err:
        usual = _usual(t)
        breaks = np.flatnonzero((np.diff(t) < 0) | (np.diff(t) > _MAX_LEFT_OUT * usual)) + 1
        doubt = Step(f"used each row as one sample although {err}", DOUBT)
        notes = (doubt, *_gap_notes(t, breaks, place))
        grid = Grid(Ts=Ts, at=np.arange(t.size), size=t.size, breaks=tuple(breaks), notes=notes)
    notes = grid.notes
    if not isclose(usual, Ts, rel_tol=MAX_TS_DEVIATION):
        text = f"used the given Ts = {Ts:g} s, although the times are {usual:g} s apart"
        notes = (Step(text, DOUBT), *notes)
    return Grid(Ts=Ts, at=grid.at, size=grid.size, breaks=grid.breaks, notes=notes)


def _usual(t: Vector) -> float:
    intervals = np.diff(t)
    return float(np.median(intervals[intervals > 0]))


def _of_times(times: Times, name: str, place: Callable[[int], str]) -> Grid:
    t = times.t
    d, usual = np.diff(t), _usual(t)
    digit = min(times.resolution, _MAX_SHIFT * usual)
    unusual = float(np.mean(np.abs(d - usual) > digit))
    is_coarse = digit < times.resolution and d.size >= _MIN_COARSE
    if is_coarse and np.all(d >= 0) and unusual > _MAX_UNUSUAL_SHARE:
        grid = _coarse(times, name)
        if grid is not None:
            return grid
    tolerance = MAX_INTERVAL_DEVIATION * usual + digit + 1e-9 * usual
    regular = np.abs(d - usual) <= tolerance
    if not regular.any():
        raise _uneven(t, ~regular, usual, name, place)
    Ts = float(d[regular].mean())
    steps, late = _steps(d, Ts, tolerance)
    deviation = d - steps * Ts
    back, gaps = d < 0, steps > 1
    irregular = ~back & (late | (np.abs(deviation) > tolerance))
    moved = irregular & ~late
    lost = moved & ~gaps & (np.abs(deviation) > _MAX_LONGER * Ts)
    if np.mean(irregular) > _MAX_IRREGULAR_SHARE or np.any(~back & (steps < 1)):
        raise _uneven(t, irregular | (steps < 1), usual, name, place)
    long = gaps & ((steps > _MAX_LEFT_OUT + 1) | (np.abs(deviation) > _MAX_SHIFT * Ts + tolerance))
    breaks = back | long | lost
    steps[breaks] = 1
    at = np.concatenate(([0], np.cumsum(steps)))
    notes = _late_note(irregular & ~breaks & ~gaps, d, Ts)
    if put_in := int(at[-1] + 1 - at.size):
        notes += (
            f"put in {plural(put_in, 'missing row')} that the file leaves out, in "
            f"{plural(int(np.count_nonzero(steps > 1)), 'place')}",
        )
    begins = np.flatnonzero(breaks) + 1
    notes += _gap_notes(t, begins, place)
    return Grid(
        # Without the intervals that really were longer or shorter.
        Ts=_roundest(*_longest(t - np.append(0, np.cumsum(deviation * moved)), at, begins)),
        at=at,
        size=int(at[-1]) + 1,
        breaks=tuple(int(at[k]) for k in begins),
        notes=(*times.notes, *notes),
    )


def _steps(d: Vector, Ts: float, tolerance: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the number of instants from row to row, and the intervals around late rows."""
    steps = np.rint(np.clip(d / Ts, -1, _MAX_GAP)).astype(np.int64)
    late = np.zeros(d.size, np.bool_)
    irregular = np.abs(d - Ts) > tolerance
    for a in map(int, np.flatnonzero(irregular & (steps <= _MAX_CAUGHT_UP))):
        if late[a]:
            continue
        ahead = np.cumsum(d[a : a + _MAX_CAUGHT_UP] - Ts)
        made_up = np.flatnonzero(np.abs(ahead[1:]) <= tolerance)
        if made_up.size:
            window = slice(a, a + int(made_up[0]) + 2)
            steps[window], late[window] = 1, irregular[window]
    return steps, late


def _coarse(times: Times, name: str) -> Grid | None:
    """Return the grid of evenly sampled rows whose times have few digits; None if they are not.

    An example is ten rows in each second with times in whole seconds.
    """
    t, k = times.t, np.arange(times.t.size)
    slope, start = np.polyfit(k, t, 1)
    if slope <= 0 or np.abs(t - start - slope * k).max() > times.resolution:
        return None
    note = f"{name} have a last digit of {times.resolution:g} s; Ts is their mean interval"
    return Grid(Ts=_roundest(t, k), at=k, size=t.size, notes=(*times.notes, note))


def _late_note(irregular: NDArray[np.bool_], d: Vector, Ts: float) -> tuple[str, ...]:
    count = int(np.count_nonzero(irregular))
    if not count:
        return ()
    most = float(np.abs(d[irregular] - Ts).max())
    verb = "differs" if count == 1 else "differ"
    return (
        f"{count} of {d.size} intervals {verb} from {Ts:.4g} s by more than 5 %, at most by "
        f"{most:.3g} s ({100 * most / Ts:.0f} %): read as late rows of the same grid",
    )


def _gap_notes(t: Vector, begins: NDArray[np.intp], place: Callable[[int], str]) -> tuple[str, ...]:
    """Return a note that names the first of the breaks."""
    if not len(begins):
        return ()
    k = int(begins[0])
    step = t[k] - t[k - 1]
    what = f"a gap of {step:.4g} s" if step > 0 else f"the time goes back by {-step:.4g} s"
    more = f", and {len(begins) - 1} more such places" if len(begins) > 1 else ""
    return (f"{place(k)}: {what}{more}; a new experiment begins there",)


def _uneven(
    t: Vector,
    irregular: NDArray[np.bool_],
    usual: float,
    name: str,
    place: Callable[[int], str],
) -> UnevenTimesError:
    k = int(np.argmax(irregular)) + 1
    count = int(np.count_nonzero(irregular))
    verb = "is" if count == 1 else "are"
    return UnevenTimesError(
        f"{place(k)}: {name} go from {t[k - 1]:.9g} to {t[k]:.9g} s, and {count} of "
        f"{t.size - 1} intervals {verb} not the usual {usual:.6g} s. Give --resample to "
        "interpolate, another column (--time), or Ts in s (--Ts) if the times are wrong"
    )


def _longest(
    t: Vector, at: NDArray[np.int64], begins: NDArray[np.intp]
) -> tuple[Vector, NDArray[np.int64]]:
    """Return the times and the instants of the part between two breaks with the most rows."""
    ends = [0, *map(int, begins), t.size]
    a, b = max(pairwise(ends), key=lambda part: part[1] - part[0])
    return (t[a:b], at[a:b]) if b - a > 1 else (t, at)


def _roundest(t: Vector, k: NDArray[np.int64]) -> float:
    """Return the mean interval, rounded to the fewest digits that still fit the times."""
    mean = float(t[-1] - t[0]) / float(k[-1] - k[0])
    apart = 1.1 * float(np.ptp(t - mean * k)) + 1e-9 * mean
    for digits in range(1, _MAX_DIGITS):
        rounded = float(f"{mean:.{digits}g}")
        if float(np.ptp(t - rounded * k)) <= apart:
            return rounded
    return mean


def _resampled(times: Times, given: float | None) -> Grid:
    """Return a grid between the times; each gap, and each time that goes back, begins a part."""
    keep = np.append(True, np.diff(times.t) != 0)  # of equal times the first
    rows = np.flatnonzero(keep)
    t = times.t[rows]
    usual = _usual(t)
    Ts = given or float(f"{usual:.3g}")
    if np.abs(np.diff(t)).max() / usual > _MAX_GAP or usual / Ts > _MAX_FINER:
        raise FileError(
            f"--resample at {Ts:g} s: the rows are {usual:.6g} s apart; give a larger --Ts, or cut "
            "the file at its gaps"
        )
    begins = np.flatnonzero((np.diff(t) < 0) | (np.diff(t) > _MAX_LEFT_OUT * usual)) + 1
    # The parts one after the other, so that the times increase.
    shift = np.zeros(t.size)
    shift[begins] = t[begins - 1] - t[begins] + 2 * Ts
    whole = t + np.cumsum(shift)
    parts = [
        np.arange(whole[a], whole[b - 1] + 1e-9 * Ts, Ts)
        for a, b in pairwise([0, *map(int, begins), t.size])
    ]
    wanted = np.concatenate(parts)
    breaks = np.cumsum([part.size for part in parts])[:-1].tolist()
    note = (
        f"resampled {times.t.size} rows to {wanted.size} samples, {Ts:g} s apart: y on straight "
        "lines between the rows, u held; this smooths the noise of y, so residuals may be coloured"
    )
    return Grid(
        Ts=Ts,
        at=rows,
        size=wanted.size,
        breaks=tuple(breaks),
        notes=(*times.notes, note, *_gap_notes(t, begins, lambda k: f"row {k + 1}")),
        times=(whole, wanted),
    )
