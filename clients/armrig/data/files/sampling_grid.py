"""The equidistant grid on which the rows of a file lie, and the rows that the file leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import isclose

import numpy as np
from armrig_core.errors import FileError
from numpy.typing import NDArray

from armrig.data.files.stamps import Times
from armrig.data.files.table import ReadingError, Vector
from armrig.data.step import DOUBT, Step, codes_of
from armrig.numerics.quantities import digits, plural
from armrig.numerics.stretches import Mask, pieces

_MAX_DEVIATION = 0.05  # relative, of a regular interval, and of a given Ts without a note
_MAX_IRREGULAR_SHARE = 0.1  # share of irregular intervals above which times are uneven
_MAX_SHIFT = 0.25  # of an interval, from the next multiple
_MAX_LONGER = 0.4  # of an interval: a longer one that no later interval makes up is a break
_MAX_UNUSUAL_SHARE = 0.2  # share of intervals above which whole steps of the last digit are jitter
_MIN_COARSE = 10  # intervals that show the mean of coarse times
_MIN_ROUNDED = 3  # of them longer or shorter than the others
_MAX_ROUNDING = 1.1  # range of the deviations of even times, in steps of the last digit
_MAX_LEFT_OUT = 20  # rows that are put in at one place; a longer gap begins an experiment
_MAX_CAUGHT_UP = 10  # intervals within which late rows catch up
_MAX_INTERPOLATED = 3.0  # usual intervals; y is missing inside a longer one
_MAX_BACK = 0.3  # share of intervals in which a clock may go back
_MIN_SHARE = 1e-6
_MAX_EARLY = 1e-3  # of Ts, by which a held input may change after an instant and count at it
_UNITS = (1.0, 1e-3, 1e-6, 1e-9)  # in s, that times without a unit may have
_MAX_GAP = 1e9  # usual intervals
_MAX_FINER = 100.0  # samples for each row
_MAX_DIGITS = 12


class UnevenTimesError(ReadingError):
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
    breaks: Sequence[int] = ()
    """Instants at which a new experiment begins."""
    notes: Sequence[str] = ()
    """Notes about late rows, rows that were put in, and gaps."""
    times: tuple[Vector, Vector] | None = None
    """Times in s of the rows and of the instants, if the rows must be resampled."""

    def place(self, x: Vector, *, held: bool) -> Vector:
        """Return the values of a column at the instants, NaN where missing; resampled if asked."""
        if self.times is None:
            placed = np.full(self.size, np.nan)
            placed[self.at] = x
            return placed
        t, wanted = self.times
        x = x[self.at]
        # Times since 1970 are rounded to 0.2 µs.
        error = (_MAX_EARLY if held else 1e-9) * self.Ts
        before = np.clip(np.searchsorted(t, wanted + error, side="right") - 1, 0, None)
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


def grid_of(times: Times, *, Ts: float | None = None, resample: bool = False) -> Grid:
    """Return the grid of rows at these times.

    The usual interval is the median. An interval of several usual intervals leaves out rows, which
    are put in as missing. A longer gap, or a time that goes back, begins a new experiment. A late
    row belongs to its own instant if the next rows catch up. The times are as exact as their last
    digit. Ts is the mean interval, rounded to the fewest digits with which its multiples still fit
    the times. Times are uneven if more than a tenth of the intervals differ from the usual interval
    by more than a twentieth and the last digit of the times. A given Ts has priority.
    """
    t = times.t
    if t.size < 2:
        if Ts is not None:
            return unit_grid(t.size, Ts)
        msg = f"{times.name}: a sampling time needs at least 2 times, got {t.size}"
        raise FileError(f"{msg}; give Ts in s (--Ts)")
    if not np.any(np.diff(t) > 0):
        msg = f"{times.place(1)}: {times.name} do not increase"
        raise FileError(f"{msg}; give Ts in s (--Ts) if the times are wrong")
    if (back := int(np.count_nonzero(d := np.diff(t) < 0))) > _MAX_BACK * d.size:
        raise FileError(
            f"{times.place(int(np.argmax(d)) + 1)}: {times.name} go back here, and in {back} of "
            f"{d.size} intervals in all; sort the rows, or name another column (--time)"
        )
    coarse = _coarse(times)
    if resample:
        if coarse:
            even = coarse.Ts * coarse.at.astype(np.float64)
            times = replace(times, t=even, notes=[*times.notes, *coarse.notes])
        return _resample(times, Ts)
    try:
        grid = coarse or _of_times(times)
    except UnevenTimesError as err:
        if Ts is None:
            raise
        begins = _gaps(t)
        doubt = Step(f"used each row as one sample although {err}", DOUBT)
        notes = [doubt, *_gap_notes(times, begins)]
        grid = replace(unit_grid(t.size, _usual(t)), breaks=begins.tolist(), notes=notes)
    if Ts is None:
        return replace(grid, notes=[*times.notes, *grid.notes])
    notes = [*times.notes, *grid.notes]
    fits = [unit for unit in _UNITS if isclose(grid.Ts * unit, Ts, rel_tol=_MAX_DEVIATION)]
    doubts = [note for note in times.notes if not times.has_unit and DOUBT in codes_of([note])]
    if fits and doubts:
        notes = [note for note in notes if note not in doubts]
        notes.append(f"{times.name} have no unit: the given Ts = {Ts:g} s is that of their rows")
    elif 1.0 not in fits:
        text = f"used the given Ts = {Ts:g} s, although the times are {grid.Ts:g} s apart"
        notes.insert(0, Step(text, DOUBT))
    return replace(grid, Ts=Ts, notes=notes)


def _usual(t: Vector) -> float:
    intervals = np.diff(t)
    return float(np.median(intervals[intervals > 0]))


def _gaps(t: Vector) -> NDArray[np.intp]:
    """Return the rows after long gaps, and after times that go back."""
    d = np.diff(t)
    return np.flatnonzero((d < 0) | (d > _MAX_LEFT_OUT * _usual(t))) + 1


def _of_times(times: Times) -> Grid:
    t = times.t
    d, usual = np.diff(t), _usual(t)
    tolerance = _MAX_DEVIATION * usual + min(times.resolution, _MAX_SHIFT * usual) + 1e-9 * usual
    regular = np.abs(d - usual) <= tolerance
    if not regular.any():
        raise _uneven(times, ~regular, usual)
    Ts = float(d[regular].mean())
    steps, late = _steps(d, Ts, tolerance)
    deviation = d - steps * Ts
    back, gaps = d < 0, steps > 1
    irregular = ~back & (late | (np.abs(deviation) > tolerance))
    moved = irregular & ~late
    lost = moved & ~gaps & (np.abs(deviation) > _MAX_LONGER * Ts)
    if np.mean(irregular) > _MAX_IRREGULAR_SHARE or np.any(~back & (steps < 1)):
        raise _uneven(times, irregular | (steps < 1), usual)
    long = gaps & ((steps > _MAX_LEFT_OUT + 1) | (np.abs(deviation) > _MAX_SHIFT * Ts + tolerance))
    breaks = back | long | lost
    steps[breaks] = 1
    at = np.append(0, np.cumsum(steps))
    notes = []
    if count := int(np.count_nonzero(shifted := irregular & ~breaks & ~gaps)):
        most = float(np.abs(d[shifted] - Ts).max())
        notes.append(
            f"{count} of {d.size} intervals differ{'s' * (count == 1)} from {Ts:.4g} s by more "
            f"than 5 %, at most by {digits(most, 3)} s ({100 * most / Ts:.0f} %): read as late "
            "rows of the same grid"
        )
    if put_in := int(at[-1] + 1 - at.size):
        notes.append(
            f"put in {plural(put_in, 'missing row')} that the file leaves out, in "
            f"{plural(int(np.count_nonzero(steps > 1)), 'place')}"
        )
    begins = np.flatnonzero(breaks) + 1
    # Ts is that of the longest part, without the intervals that really were longer or shorter.
    part = max(pieces(breaks), key=lambda part: part.stop - part.start)
    if part.stop - part.start < 2:
        part = slice(None)
    even = t - np.append(0, np.cumsum(deviation * moved))
    return Grid(
        Ts=_roundest(even[part], at[part]),
        at=at,
        size=int(at[-1]) + 1,
        breaks=at[begins].tolist(),
        notes=[*notes, *_gap_notes(times, begins)],
    )


def _steps(d: Vector, Ts: float, tolerance: float) -> tuple[NDArray[np.int64], Mask]:
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


def _coarse(times: Times) -> Grid | None:
    """Return the grid of even rows whose times have few digits, such as ten rows in each second."""
    t, k = times.t, np.arange(times.t.size)
    d, usual = np.diff(t), _usual(t)
    if d.size < _MIN_COARSE or np.any(d < 0) or times.resolution <= _MAX_SHIFT * usual:
        return None
    count = int(np.count_nonzero(np.abs(d - usual) > _MAX_SHIFT * usual))
    slope = float(np.polyfit(k, t, 1)[0])
    # A few longer intervals may be rows left out; those of the last digit are evenly distributed.
    width = 2.0 if count > _MAX_UNUSUAL_SHARE * d.size else _MAX_ROUNDING
    if count < _MIN_ROUNDED or slope <= 0 or np.ptp(t - slope * k) > width * times.resolution:
        return None
    note = f"{times.name} have a last digit of {times.resolution:g} s; Ts is their mean interval"
    if times.resolution > _MAX_DEVIATION * (t[-1] - t[0]):
        note = Step(f"{note}, which is inexact in a log so short: give --Ts if it is known", DOUBT)
    return Grid(Ts=_roundest(t, k, slope), at=k, size=t.size, notes=[note])


def _gap_notes(times: Times, begins: NDArray[np.intp]) -> list[str]:
    """Return a note that names the first of the breaks."""
    if not begins.size:
        return []
    k = int(begins[0])
    step = times.t[k] - times.t[k - 1]
    fault = f"a gap of {step:.4g} s" if step > 0 else f"the time goes back by {-step:.4g} s"
    more = f", and {begins.size - 1} more such places" if begins.size > 1 else ""
    return [f"{times.place(k)}: {fault}{more}; a new experiment begins there"]


def _uneven(times: Times, irregular: Mask, usual: float) -> UnevenTimesError:
    t, k = times.t, int(np.argmax(irregular)) + 1
    count = int(np.count_nonzero(irregular))
    return UnevenTimesError(
        f"{times.place(k)}: {times.name} go from {t[k - 1]:.9g} to {t[k]:.9g} s, and {count} of "
        f"{plural(t.size - 1, 'interval')} {'is' if count == 1 else 'are'} not the usual "
        f"{usual:.6g} s. Give --resample to interpolate, another column (--time), or Ts in s "
        "(--Ts) if the times are wrong",
        "--resample",
    )


def _roundest(t: Vector, k: NDArray[np.int64], slope: float | None = None) -> float:
    """Return the mean interval, rounded to the fewest digits that still fit the times."""
    mean = slope or float(t[-1] - t[0]) / float(k[-1] - k[0])
    apart = 1.1 * float(np.ptp(t - mean * k)) + 1e-9 * mean
    rounded = (float(f"{mean:.{digits}g}") for digits in range(1, _MAX_DIGITS))
    return next((Ts for Ts in rounded if float(np.ptp(t - Ts * k)) <= apart), mean)


def _resample(times: Times, Ts_wanted: float | None) -> Grid:
    """Return a grid between the times; each gap, and each time that goes back, begins a part."""
    rows = np.flatnonzero(np.append(True, np.diff(times.t) != 0))  # of equal times the first
    t = times.t[rows]
    usual = _usual(t)
    Ts = Ts_wanted or float(f"{usual:.3g}")
    if np.abs(np.diff(t)).max() / usual > _MAX_GAP or usual / Ts > _MAX_FINER:
        raise FileError(
            f"--resample at {Ts:g} s: the rows are {usual:.6g} s apart; give a larger --Ts, or cut "
            "the file at its gaps"
        )
    begins = _gaps(t)
    # The parts one after the other, so that the times increase.
    shift = np.zeros(t.size)
    shift[begins] = t[begins - 1] - t[begins] + 2 * Ts
    t_joined = t + np.cumsum(shift)
    parts = [
        np.arange(t_joined[a], t_joined[b - 1] + 1e-9 * Ts, Ts)
        for a, b in pairwise([0, *begins.tolist(), t.size])
    ]
    wanted = np.concatenate(parts)
    note = (
        f"resampled {plural(times.t.size, 'row')} to {plural(wanted.size, 'sample')}, {Ts:g} s "
        "apart: y on straight "
        "lines between the rows, u held; this smooths the noise of y, so residuals may be coloured"
    )
    notes = [*times.notes, note, *_gap_notes(times, rows[begins])]
    if count := times.t.size - rows.size:
        text = f"left out {plural(count, 'row')} with the time of the row before"
        notes.append(Step(text, DOUBT))
    return Grid(
        Ts=Ts,
        at=rows,
        size=wanted.size,
        breaks=np.cumsum([part.size for part in parts])[:-1].tolist(),
        notes=notes,
        times=(t_joined, wanted),
    )
