"""Times of a column as seconds: numbers with a unit, dates, and times of day."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.decimal_marks import number
from armrig.data.files.table import Column, Table, Vector, shown
from armrig.data.step import DOUBT, Step, codes_of
from armrig.numerics.quantities import digits

_UNITS = {
    1.0: "s sec secs second seconds",
    1e-3: "ms msec millis millisecond milliseconds",
    1e-6: "us µs μs usec micros microsecond microseconds",
    1e-9: "ns nsec nanos nanosecond nanoseconds",
    60.0: "min mins minute minutes",
    3600.0: "h hr hrs hour hours",
    86400.0: "d day days",
}
_SECONDS = {name: seconds for seconds, names in _UNITS.items() for name in names.split()}
_KNOWN = ", ".join(names.split()[0] for names in _UNITS.values())
_WITH_UNIT = re.compile(
    rf"(?:(?P<base>.+?)(?:\s+in\s+|[\s_/.,-]+))?(?P<unit>{'|'.join(_SECONDS)})\.?"
)
_TIME_NAMES = frozenset(
    {"t", "time", "times", "timestamp", "timestamps", "time_stamp", "datetime", "date_time"}
    | {"elapsed", "elapsed_time", "zeit", "uhrzeit", "tid", "temps", "tiempo", "millis", "micros"}
    | {"tout", "x_value", "datum_zeit", "zeitstempel"}
)
_BETWEEN_WORDS = re.compile(r"[\s/_-]+")
_DATE_NAMES = frozenset({"date", "datum", "day", "fecha"})
_DAY_S = 86400.0
_EPOCH_S = (9e8, 4.2e9)  # 1998 to 2103, in seconds since 1970, or since 1904
_DOUBTFUL_S = 1.0  # smallest usual interval without a unit that may be ms
_TIME_OF_DAY = re.compile(
    r"(?:(?P<h>\d{1,3}):)?(?P<m>\d{1,3}):(?P<s>\d\d(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
)
_DATE = re.compile(r"(?P<a>\d{1,2})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<year>\d{4}|\d\d)")
_HOURS_AND_MINUTES = re.compile(r"\d{1,3}:\d\d")
_SECONDS_WRITTEN = re.compile(r":\d\d[:.,]\d")
_MATLAB = ("%d-%b-%Y %H:%M:%S", "%d-%b-%Y %H:%M:%S.%f")
_BEGIN = (datetime(2000, 1, 1), datetime(2000, 1, 1, tzinfo=UTC))  # of dates as numbers
_TICKS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))
_TIMER_BITS = (16, 32)  # Arduino's micros() begins again after 71 min
_BY_SIZE = (
    *((_EPOCH_S[0] / unit, _EPOCH_S[1] / unit, np.inf, unit) for unit, _ in _TICKS),
    (7e5, 8e5, 0.5, _DAY_S),  # MATLAB's days since year 0, from 1916 to 2190
    (3.6e4, 5.5e4, 0.05, _DAY_S),  # Excel's days since 1900, from 1998 to 2050
)
"""Range of the times, their largest usual interval, and the unit in s."""
_NAMES = (
    *(f"{name} since 1970" for _, name in _TICKS),
    "days (MATLAB's datenum)",
    Step("days (Excel's dates); give --Ts if they are in s", DOUBT),
)
"""Names of these units."""
_MAX_NAME = 80  # characters in which a unit is looked for
_SPAN_S = (1e-9, 1e11)
_HOUR_S = 3600.0
_MAX_DIGITS = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Times of the rows of a table."""

    t: Vector
    """Times in s, shape (N,)."""
    resolution: float
    """Value of the last digit of the times, in s; 0 if it is not known."""
    name: str
    """Name of the times in messages."""
    place: Callable[[int], str]
    """Function that returns the place of row k in the file."""
    notes: Sequence[str] = ()
    """Notes about the unit or the clock."""


def time_columns(table: Table) -> list[int]:
    """Return the indices of the columns whose names mean the time; the plainest names first."""
    names = [_folded(column) for column in table.columns]
    plain = [i for i, name in enumerate(names) if name in ("t", "time")]
    return plain or [i for i, name in enumerate(names) if _base(name) in _TIME_NAMES]


def _folded(column: Column) -> str:
    """Return the name of a column in lower case, such as millis for `millis()`."""
    return column.name.casefold()[:_MAX_NAME].removesuffix("()")


def _base(name: str) -> str:
    """Return a name of times without a unit at its end, such as t for t_ms."""
    found, plain = _WITH_UNIT.fullmatch(name), _BETWEEN_WORDS.sub("_", name)
    return plain if plain in _TIME_NAMES or found is None else (found["base"] or "t")


def _unit_of(column: Column, named: str) -> float | None:
    """Return the unit of a column of times in s, from its header; None if the header has none."""
    if not column.unit:
        found = _WITH_UNIT.fullmatch(_folded(column))
        return _SECONDS[found["unit"]] if found else None
    if (unit := column.unit.casefold().removesuffix(".")) not in _SECONDS:
        raise FileError(
            f"{named} are in {shown(column.unit)}, known units are {_KNOWN}; give Ts in s (--Ts)"
        )
    return _SECONDS[unit]


def times_of(table: Table, i: int) -> Times:
    """Return the times in column i of a table.

    Numbers have the unit of the header. Without a unit, numbers as large as the seconds,
    milliseconds, microseconds or nanoseconds since 1970 are such times, and other numbers are
    seconds. A time of day may have its date in a column named date.
    """
    column, cells = table.columns[i], table.texts(i)
    named = f"the times in column {shown(column.name)}" if column.name else "the times"
    if cells and all(number(cells[0], mark) is None for mark in ".,"):
        t, resolution, notes = _of_stamps(table, i, cells)
    else:
        t, resolution, notes = _of_numbers(table, i, named)
    return Times(t=t, resolution=resolution, name=named, place=table.place, notes=notes)


def _of_numbers(table: Table, i: int, named: str) -> tuple[Vector, float, list[str]]:
    """Return times in s, their resolution, and notes about their unit."""
    t = table.numbers(i)
    missing = ~np.isfinite(t)
    if missing.any():
        raise FileError(
            f"{table.place(int(np.argmax(missing)))}: {named} have no value here; add it, or give "
            "Ts in s (--Ts)"
        )
    unit, notes = _unit_of(table.columns[i], named), list[str]()
    middle = float(np.median(t)) if t.size else 0.0
    usual = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    if unit is None:
        for name, (least, most, largest, size) in zip(_NAMES, _BY_SIZE, strict=True):
            if least <= middle < most and usual < largest:
                unit = size
                notes.append(Step(f"read {named} as {name}", *codes_of([name])))
                break
        else:
            unit = 1.0
            if (k := _carry(t)) is not None:
                raise FileError(
                    f"{table.place(k)}: {named} go from {t[k - 1]:.16g} to {t[k]:.16g}, as digits "
                    "of a clock: write them as 09:59:59, or give Ts in s (--Ts)"
                )
            if usual >= _DOUBTFUL_S:
                notes.append(Step(f"{named} have no unit: read as s", DOUBT))
    for bits in _TIMER_BITS:
        steps = np.diff(t)
        wraps = (steps < 0) & (np.abs(steps + 2.0**bits - usual) <= usual)
        if wraps.any():
            t = t + 2.0**bits * np.append(0, np.cumsum(wraps))
            notes.append(f"{named} begin again after {2**bits}: joined, as of a timer")
    span = float(np.ptp(t)) * unit
    if span and not _SPAN_S[0] <= span <= _SPAN_S[1]:
        raise FileError(
            f"{named} span {digits(span, 3)} s, allowed are {_SPAN_S[0]:g} to {_SPAN_S[1]:g} s; "
            "give Ts in s (--Ts)"
        )
    # The difference first: the unit of an epoch in ns would round times of 1e18.
    return (t - t[:1]) * unit, _last_digit(t) * unit, notes


def _carry(t: Vector) -> int | None:
    """Return the first row at which digits of a clock, such as 95959 or 9.59, go from 59 to 100."""
    digits = np.rint(t if np.all(t == np.rint(t)) else 100 * t)
    d = np.diff(digits)
    carries = np.flatnonzero(np.diff(digits // 100) == 1)
    usual = d[d > 0].min(initial=np.inf)
    is_clock = usual < 60 and np.all(digits % 100 < 60)
    is_clock &= carries.size > 0 and np.median(d[carries]) == usual + 40
    return int(carries[0]) + 1 if is_clock else None


def _last_digit(t: Vector) -> float:
    """Return the value of the last decimal digit that any of the numbers has; 0 if unknown."""
    for places in range(_MAX_DIGITS):
        scaled = t * 10.0**places
        if np.all(np.abs(scaled - np.rint(scaled)) <= 1e-4 + 4e-16 * np.abs(scaled)):
            return 10.0**-places
    return 0.0


def _of_stamps(table: Table, i: int, cells: Sequence[str]) -> tuple[Vector, float, list[str]]:
    """Return the times of dates or times of day, without the changes of a clock."""
    is_time = bool(_TIME_OF_DAY.fullmatch(cells[0].strip()))
    dates = [j for j, column in enumerate(table.columns) if column.name.casefold() in _DATE_NAMES]
    if is_time and dates and dates[0] != i:
        days, is_time = table.texts(dates[0]), False
        cells = [f"{day.strip()} {cell.strip()}" for day, cell in zip(days, cells, strict=True)]
    notes: list[str] = []
    if not table.columns[i].unit and _HOURS_AND_MINUTES.fullmatch(cells[0].strip()):
        notes.append(Step(f"times such as {cells[0].strip()} are read as hours:minutes", DOUBT))
    month_first, t, is_local = _month_first(cells), np.empty(len(cells)), True
    for k, cell in enumerate(map(str.strip, cells)):
        try:
            t[k], has_zone = _moment(cell, month_first)
            is_local &= not has_zone
        except (ValueError, OverflowError):
            raise FileError(
                f"{table.place(k)}: '{shown(cell)}' is not a time; write a number, or a time such "
                "as 2024-03-31T01:59:00 or 01:59:00.25, or give Ts in s (--Ts)"
            ) from None
    if is_time:
        t += _DAY_S * np.cumsum(np.diff(t, prepend=t[:1]) < -_DAY_S / 2)  # midnight
    t -= t[:1]
    if is_local:
        t, changes = _without_clock_changes(t, table.place)
        notes += changes
    has_seconds = any(map(_SECONDS_WRITTEN.search, cells)) or ":" not in cells[0]
    return t, _last_digit(t) if has_seconds else 60.0, notes


def _month_first(cells: Sequence[str]) -> bool:
    """Return whether dates are written as 3/31/2024, not as 31.3.2024."""
    if not _DATE.match(cells[0].strip()):
        return False
    parts = [part for cell in cells if (part := _DATE.match(cell.strip()))]
    firsts, seconds = ([int(part[m]) for part in parts] for m in "ab")
    if max(firsts) > 12 or max(seconds) > 12:
        return max(firsts) <= 12
    # The times lie closer together in the right order.
    american, other = (
        max(np.abs(np.diff(31 * np.array(months) + days)), default=0)
        for months, days in ((firsts, seconds), (seconds, firsts))
    )
    if american != other:
        return bool(american < other)
    return any(part["mark"] == "/" for part in parts)


def _moment(text: str, month_first: bool) -> tuple[float, bool]:
    """Return the seconds of a date or a time of day, and whether its zone is written."""
    with suppress(ValueError):  # first, because it is fast
        moment = datetime.fromisoformat(text)
        return (moment - _BEGIN[moment.tzinfo is not None]).total_seconds(), bool(moment.tzinfo)
    if _TIME_OF_DAY.fullmatch(text):
        return _time_of_day(text), False
    if found := _DATE.match(text):
        a, b, year = int(found["a"]), int(found["b"]), int(found["year"])
        month, day = (a, b) if month_first else (b, a)
        begin = datetime(year + 2000 * (year < 100), month, day) - _BEGIN[0]
        rest = text[found.end() :].strip(" T,") or "0:00:00"
        return begin.total_seconds() + _time_of_day(rest), False
    plain = text.replace(",", ".").replace("/", "-")
    if plain != text:
        return _moment(plain, month_first)
    moment = datetime.strptime(text, _MATLAB["." in text])
    return (moment - _BEGIN[0]).total_seconds(), False


def _time_of_day(text: str) -> float:
    found = _TIME_OF_DAY.fullmatch(text)
    if found is None:
        raise ValueError(text)
    hours, minutes, seconds = int(found["h"] or 0), int(found["m"]), found["s"].replace(",", ".")
    if found["h"] is None and "." not in seconds:  # 1:59 is in hours, Excel's 1:59.5 in minutes
        hours, minutes, seconds = minutes, int(seconds), "0"
    if half := (found["half"] or "").casefold()[:1]:
        hours = hours % 12 + 12 * (half == "p")
    return 3600.0 * hours + 60.0 * minutes + float(seconds)


def _without_clock_changes(t: Vector, place: Callable[[int], str]) -> tuple[Vector, list[str]]:
    """Remove jumps of one hour, as at the begin and the end of summer time."""
    intervals, notes, moved = np.diff(t), list[str](), np.zeros(t.size)
    usual = float(np.median(intervals)) if intervals.size else 0.0
    for hours, way in ((1, "forward"), (-1, "back")):
        jumps = np.abs(intervals - usual - hours * _HOUR_S) <= max(usual / 2, 1.0)
        if 0 < usual < _HOUR_S / 6 and np.count_nonzero(jumps) == 1:
            k = int(np.argmax(jumps)) + 1
            moved[k:] += hours * _HOUR_S
            text = f"{place(k)}: the clock goes {way} by 1 h, as at a change of summer time; "
            notes.append(Step(f"{text}this hour was removed from the times", DOUBT))
    return t - moved, notes
