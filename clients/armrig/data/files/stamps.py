"""Times of a column as seconds: numbers with a unit, dates, and times of day."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.decimal_marks import number
from armrig.data.files.table import Column, Table, Vector, shown
from armrig.data.step import DOUBT, Step

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
)
_DATE_NAMES = frozenset({"date", "datum", "day", "fecha"})
_EPOCHS = {1.0: "s", 1e3: "ms", 1e6: "µs", 1e9: "ns"}
_EPOCH_S = (9e8, 4.2e9)  # 1998 to 2103, in seconds since 1970, or since 1904
_DATENUM = (7e5, 8e5)  # MATLAB's days since year 0, from 1916 to 2190
_TIME_OF_DAY = re.compile(
    r"(?:(?P<h>\d{1,3}):)?(?P<m>\d{1,3}):(?P<s>\d\d(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
)
_DATE = re.compile(r"(?P<a>\d{1,2})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<year>\d{4}|\d\d)")
_MATLAB = ("%d-%b-%Y %H:%M:%S", "%d-%b-%Y %H:%M:%S.%f")
_TIMER_BITS = (16, 32)  # Arduino's micros() begins again after 71 min
_EXCEL = (3.6e4, 5.5e4)  # Excel's days since 1900, from 1998 to 2050
_MAX_NAME = 80  # characters in which a unit is looked for
_MAX_SPAN_S = 1e11
_DAY_S = 86400.0
_HOUR_S = 3600.0
_MAX_DIGITS = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Times of the rows of a table."""

    t: Vector
    """Times in s, shape (N,)."""
    resolution: float
    """Value of the last digit of the times, in s; 0 if it is not known."""
    notes: tuple[str, ...] = ()
    """Notes about the unit or the clock."""


def time_columns(table: Table) -> list[int]:
    """Return the indices of the columns whose names mean the time; the plainest names first."""
    names = [column.name.casefold() for column in table.columns]
    plain = [i for i, name in enumerate(names) if name in ("t", "time")]
    return plain or [i for i, column in enumerate(table.columns) if _base(column) in _TIME_NAMES]


def _base(column: Column) -> str:
    """Return the name of a column of times without a unit at its end, such as t for t_ms."""
    name = column.name.casefold()[:_MAX_NAME]
    found = _WITH_UNIT.fullmatch(name)
    return name if name in _TIME_NAMES or found is None else (found["base"] or "t")


def unit_of(column: Column) -> float | None:
    """Return the unit of a column of times in s, from its header; None if the header has no unit.

    Raises
    ------
    FileError
        The unit is not a unit of time.
    """
    if column.unit:
        unit = column.unit.casefold().removesuffix(".")
        if unit not in _SECONDS:
            raise FileError(
                f"{_named(column)} are in {shown(column.unit)}, known units are {_KNOWN}; give Ts "
                "in s (--Ts)"
            )
        return _SECONDS[unit]
    found = _WITH_UNIT.fullmatch(column.name.casefold()[:_MAX_NAME])
    return _SECONDS[found["unit"]] if found else None


def times_of(table: Table, i: int) -> Times:
    """Return the times in column i of a table.

    Numbers have the unit of the header. Without a unit, numbers as large as the seconds,
    milliseconds, microseconds or nanoseconds since 1970 are such times, and other numbers are
    seconds. A time of day may have its date in a column named date.

    Raises
    ------
    FileError
        The unit is unknown, or a time is missing, or a text is not a time.
    """
    column, cells = table.columns[i], table.texts(i)
    if cells and all(number(cells[0], mark) is None for mark in ".,"):
        return _of_stamps(table, i, cells)
    t = table.numbers(i)
    missing = ~np.isfinite(t)
    if missing.any():
        raise FileError(
            f"{table.place(int(np.argmax(missing)))}: {_named(column)} have no value here; add "
            "it, or give Ts in s (--Ts)"
        )
    unit, notes = unit_of(column), []
    middle = float(np.median(t)) if t.size else 0.0
    usual = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    if unit is None:
        unit = 1.0
        epochs = [e for e in _EPOCHS if _EPOCH_S[0] * e <= middle < _EPOCH_S[1] * e]
        if epochs:
            unit = 1 / epochs[0]
            notes.append(f"read {_named(column)} as {_EPOCHS[epochs[0]]} since 1970")
        elif _DATENUM[0] <= middle < _DATENUM[1] and 0 < usual < 0.5:
            unit = _DAY_S
            notes.append(f"read {_named(column)} as days (MATLAB's datenum)")
        elif _EXCEL[0] <= middle < _EXCEL[1] and 0 < usual < 0.05:
            unit = _DAY_S
            text = f"read {_named(column)} as days (Excel's dates); give --Ts if they are in s"
            notes.append(Step(text, DOUBT))
        elif usual >= 1.0:
            notes.append(Step(f"{_named(column)} have no unit: read as s", DOUBT))
    for bits in _TIMER_BITS:
        steps = np.diff(t)
        wraps = (steps < 0) & (np.abs(steps + 2.0**bits - usual) <= usual)
        if wraps.any():
            t = t + 2.0**bits * np.append(0, np.cumsum(wraps))
            notes.append(f"{_named(column)} begin again after {2**bits}: joined, as of a timer")
    if not np.ptp(t) * unit < _MAX_SPAN_S:
        raise FileError(f"{_named(column)} span more than {_MAX_SPAN_S:g} s; give Ts in s (--Ts)")
    # The difference first: the unit of an epoch in ns would round times of 1e18.
    return Times(t=(t - t[:1]) * unit, resolution=_last_digit(t) * unit, notes=tuple(notes))


def _last_digit(t: Vector) -> float:
    """Return the value of the last decimal digit that any of the numbers has; 0 if unknown."""
    for digits in range(_MAX_DIGITS):
        scaled = t * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) <= 1e-4 + 4e-16 * np.abs(scaled)):
            return 10.0**-digits
    return 0.0


def _named(column: Column) -> str:
    return f"the times in column {shown(column.name)}" if column.name else "the times"


def _of_stamps(table: Table, i: int, cells: Sequence[str]) -> Times:
    """Return the times of dates or times of day, with the change of a clock removed."""
    dates = [j for j, column in enumerate(table.columns) if column.name.casefold() in _DATE_NAMES]
    if _TIME_OF_DAY.fullmatch(cells[0].strip()) and dates and dates[0] != i:
        days = table.texts(dates[0]) or ()
        cells = [f"{day.strip()} {cell.strip()}" for day, cell in zip(days, cells, strict=True)]
    read, notes = _reader(cells), list[str]()
    if table.columns[i].unit == "" and re.fullmatch(r"\d{1,3}:\d\d", cells[0].strip()):
        notes.append(Step(f"times such as {cells[0].strip()} are read as hours:minutes", DOUBT))
    t, is_local = np.empty(len(cells)), True
    for k, cell in enumerate(cells):
        try:
            t[k], has_zone = read(cell.strip())
            is_local &= not has_zone
        except (ValueError, OverflowError):
            raise FileError(
                f"{table.place(k)}: '{shown(cell.strip())}' is not a time; write a number, or a "
                "time such as 2024-03-31T01:59:00 or 01:59:00.25, or give Ts in s (--Ts)"
            ) from None
    if _TIME_OF_DAY.fullmatch(cells[0].strip()):
        t += _DAY_S * np.cumsum(np.diff(t, prepend=t[:1]) < -_DAY_S / 2)  # midnight
    t -= t[:1]
    if is_local:
        t, changes = _without_clock_changes(t, table.place)
        notes += changes
    return Times(t=t, resolution=_last_digit(t), notes=tuple(notes))


def _reader(cells: Sequence[str]) -> Callable[[str], tuple[float, bool]]:
    """Return the function that converts a text of this column into s, and whether it has a zone."""
    if _TIME_OF_DAY.fullmatch(cells[0].strip()):
        return lambda text: (_time_of_day(text), False)
    if not _DATE.match(cells[0].strip()):
        return _iso
    parts = [_DATE.match(cell.strip()) for cell in cells]
    # 3/31/2024 is American, 31.3.2024 is not. If both orders are possible, the times lie closer
    # together in the right one.
    first = max((int(part["a"]) for part in parts if part), default=0)
    second = max((int(part["b"]) for part in parts if part), default=0)
    days = [[31 * int(p[m]) + int(p[d]) for p in parts if p] for m, d in ("ab", "ba")]
    jumps = [max(np.abs(np.diff(x)), default=0) for x in days]
    month_first = second > 12 or (first <= 12 and jumps[0] <= jumps[1])
    if first <= 12 and jumps[0] == jumps[1]:
        month_first = any(part["mark"] == "/" for part in parts if part)

    def read(text: str) -> tuple[float, bool]:
        found = _DATE.match(text)
        if found is None:
            raise ValueError(text)
        a, b, year = int(found["a"]), int(found["b"]), int(found["year"])
        month, day = (a, b) if month_first else (b, a)
        begin = datetime(year + 2000 * (year < 100), month, day) - datetime(2000, 1, 1)
        rest = text[found.end() :].strip(" T,")
        return begin.total_seconds() + (_time_of_day(rest) if rest else 0.0), False

    return read


def _time_of_day(text: str) -> float:
    found = _TIME_OF_DAY.fullmatch(text.strip())
    if found is None:
        raise ValueError(text)
    hours, minutes, seconds = int(found["h"] or 0), int(found["m"]), found["s"].replace(",", ".")
    if found["h"] is None and "." not in seconds:  # 1:59 is in hours, Excel's 1:59.5 in minutes
        hours, minutes, seconds = minutes, int(seconds), "0"
    half = (found["half"] or "").casefold()[:1]
    if half:
        hours = hours % 12 + 12 * (half == "p")
    return 3600.0 * hours + 60.0 * minutes + float(seconds)


def _iso(text: str) -> tuple[float, bool]:
    text = text.replace(",", ".").replace("/", "-")
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = datetime.strptime(text, _MATLAB["." in text])
    zone = moment.utcoffset() or timedelta()
    since = moment.replace(tzinfo=None) - zone - datetime(2000, 1, 1)
    return since.total_seconds(), moment.tzinfo is not None


def _without_clock_changes(t: Vector, place: Callable[[int], str]) -> tuple[Vector, list[str]]:
    """Remove jumps of one hour, as at the begin and the end of summer time."""
    intervals = np.diff(t)
    usual = float(np.median(intervals)) if intervals.size else 0.0
    if not 0 < usual < _HOUR_S / 6:
        return t, []
    notes, moved = list[str](), np.zeros(t.size)
    for hours in (1, -1):
        jumps = np.abs(intervals - usual - hours * _HOUR_S) <= max(usual / 2, 1.0)
        if np.count_nonzero(jumps) > 1:
            continue
        for k in np.flatnonzero(jumps) + 1:
            moved[k:] += hours * _HOUR_S
            way = "forward" if hours > 0 else "back"
            text = (
                f"{place(int(k))}: the clock goes {way} by 1 h, as at a change of summer time; "
                "this hour was removed from the times"
            )
            notes.append(Step(text, DOUBT))
    return t - moved, notes
