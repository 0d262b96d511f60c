"""Times of a column as seconds: numbers with a unit, dates, and times of day."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.cells import number
from armrig.data.files.table import Column, Table, Vector, shorten
from armrig.data.step import DOUBT, Step, codes_of
from armrig.numerics.quantities import digits

_UNITS = {
    1.0: "s sec secs second seconds",
    1e-3: "ms msec msecs millis millisecond milliseconds",
    1e-6: "us µs μs usec usecs micros microsecond microseconds",
    1e-9: "ns nsec nsecs nanosec nanosecs nanos nanosecond nanoseconds",
    60.0: "min mins minute minutes",
    3600.0: "h hr hrs hour hours",
    86400.0: "d day days",
}
_SECONDS = {name: seconds for seconds, names in _UNITS.items() for name in names.split()}
_KNOWN = ", ".join(names.split()[0] for names in _UNITS.values())
_WITH_UNIT = re.compile(
    rf"(?:(?P<base>.+?)(?:\s+in\s+|[\s_/.,-]+))?(?P<unit>{'|'.join(_SECONDS)})\.?"
)
TIME_NAMES = frozenset(
    {"t", "time", "times", "timestamp", "timestamps", "time_stamp", "datetime", "date_time"}
    | {"elapsed", "elapsed_time", "zeit", "uhrzeit", "tid", "temps", "tiempo", "millis", "micros"}
    | {"tout", "x_value", "datum_zeit", "zeitstempel", "created_at", "last_changed", "ts"}
    | {"epoch", "clock", "unixtime"}
)
"""Names of columns of times, without a unit."""
BETWEEN_WORDS = r"[\s/_-]+"
"""Characters between the words of a name, as an expression."""
DATE_NAMES = frozenset({"date", "datum", "day", "fecha"})
"""Names of a column of dates, if another column contains times of day."""
_DAY_S = 86400.0
_EPOCH = "s since 1970"
_EPOCH_S = (9e8, 4.2e9)  # 1998 to 2103, in seconds since 1970, or since 1904
_MONTH_S = 2.7e6
_DOUBTFUL_S = 1.0  # smallest usual interval without a unit that may be ms
_LONG_S = 100.0  # usual interval from which a unit of ms or µs is more usual
_YEAR_S = 3.2e7  # times without a unit are not seconds beyond it
_MOST_MS = 1000.0  # usual interval in ms; longer ones are µs
_HOURS_AND_MINUTES = re.compile(r"\d{1,3}:\d\d")
_SECONDS_WRITTEN = re.compile(r":\d\d[:.,]\d")
_TICKS = {1.0: "s", 1e-3: "ms", 1e-6: "µs", 1e-9: "ns"}
_MAX_RETURNS = 0.3  # share of intervals at which a clock begins again; more are shuffled rows
_TIMER_BITS = (16, 32)  # Arduino's micros() begins again after 71 min
_BY_SIZE = {
    **{
        f"{name} since 1970": (_EPOCH_S[0] / unit, _EPOCH_S[1] / unit, _MONTH_S / unit, unit)
        for unit, name in _TICKS.items()
    },
    "days (MATLAB's datenum)": (7e5, 8e5, 0.5, _DAY_S),  # since year 0, from 1916 to 2190
    # Since 1900, from 1998 to 2050.
    Step("days (Excel's dates); give --Ts if they are in s", DOUBT): (3.6e4, 5.5e4, 0.05, _DAY_S),
}
"""Range of times without a unit, their largest usual interval, and the unit in s, by its name."""
_MAX_NAME = 80  # characters in which a unit is looked for
_SPAN_S = (1e-9, 1e11)
_HOUR_S = 3600.0
_MAX_DIGITS = 9
_UTC = "UTC"
_TIME_OF_DAY = re.compile(
    r"(?:(?P<days>-?\d+) days?,? \+?)?(?:(?P<h>\d{1,3}):)?(?P<m>\d{1,3}):"
    r"(?P<s>\d\d(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
)
_DATE = re.compile(r"(?P<a>\d{1,2})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<year>\d{4}|\d\d)")
_FRACTION = re.compile(r"(?<=:\d\d:\d\d)[.,](\d+)")
_ZONE = re.compile(
    r"(?P<moment>.*?:\d\d(?:[.,]\d+)?(?: [AP]M)?)\s*(?P<name>Z|[A-Z]{3,5})?"
    r"(?:(?P<sign>[+-])(?P<h>\d\d?)(?::?(?P<m>[0-5]\d))?)?(?:\[.*\])?",
    re.IGNORECASE,
)
_MATLAB = "%d-%b-%Y %H:%M:%S"
_ORIGIN = (datetime(1970, 1, 1), datetime(1970, 1, 1, tzinfo=UTC))  # of dates as numbers


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
    begin: float = 0.0
    """Time of the first row, in s from the origin of the clock."""
    clock: str = ""
    """Origin of the clock, such as `s since 1970`; "" if it is not known."""
    has_unit: bool = True
    """True if the header, or the size of the times, states their unit."""


def time_columns(table: Table) -> list[int]:
    """Return the indices of the columns whose names mean the time; the plainest names first."""
    names = [_lower_name(column) for column in table.columns]
    plain = [i for i, name in enumerate(names) if name in ("t", "time")]
    # A temperature may be named T.
    plain = [i for i in plain if table.columns[i].name != "T"] or plain
    named = [i for i in range(len(names)) if is_time(table.columns[i]) or has_nanoseconds(table, i)]
    return plain or [i for i in named if not (i and has_nanoseconds(table, i - 1))]


def is_time(column: Column) -> bool:
    """Return whether the name of a column means the time; Ts is a sampling time."""
    base, unit = base_and_unit(column)
    plain = re.sub(BETWEEN_WORDS, "_", base)
    return plain in TIME_NAMES | ({""} if unit else set()) and column.name != "Ts"


def _lower_name(column: Column) -> str:
    """Return the name of a column in lower case, such as millis for `millis()`."""
    return column.name.casefold()[:_MAX_NAME].lstrip("%").removesuffix("()")


def base_and_unit(column: Column) -> tuple[str, str]:
    """Return the name of a column without a unit of time, and this unit, "" without one."""
    unit, name = column.unit.casefold().removesuffix("."), _lower_name(column)
    if unit or not (parts := _WITH_UNIT.fullmatch(name)):
        return name, unit if unit in _SECONDS else ""
    return parts["base"] or "", parts["unit"]


def has_nanoseconds(table: Table, i: int) -> bool:
    """Return whether column i is named as seconds, and the next column as their nanoseconds."""
    pair = [
        (base, _SECONDS.get(unit)) for base, unit in map(base_and_unit, table.columns[i : i + 2])
    ]
    return pair == [(pair[0][0], 1.0), (pair[0][0], 1e-9)]


def times_of(table: Table, i: int) -> Times:
    """Return the times in column i of a table.

    Numbers have the unit of the header. Without a unit, numbers as large as the seconds,
    milliseconds, microseconds or nanoseconds since 1970 are such times, and other numbers are
    seconds. A time of day may have its date in a column named date.
    """
    column, cells = table.columns[i], table.texts(i)
    named = f"the times in column {shorten(column.name)}" if column.name else "the times"
    if cells and all(number(cells[0], mark) is None for mark in ".,"):
        times = _of_stamps(table, i, cells, named)
    else:
        times = _of_numbers(table, i, named)
    return _with_fractions(table, i, times)


def _of_numbers(table: Table, i: int, named: str) -> Times:
    """Return times in s, their resolution, and notes about their unit."""
    t = table.numbers(i)
    if not t.size:
        raise FileError(f"{named} have no value; add them, or give Ts in s (--Ts)")
    missing = ~np.isfinite(t)
    if missing.any():
        raise FileError(
            f"{table.place(int(np.argmax(missing)))}: {named} have no value here; add it, or give "
            "Ts in s (--Ts)"
        )
    column, notes, clock = table.columns[i], list[str](), ""
    _, suffix = base_and_unit(column)
    if column.unit and not suffix:
        raise FileError(
            f"{named} are in {shorten(column.unit)}, known units are {_KNOWN}; give Ts in s (--Ts)"
        )
    unit, has_unit = _SECONDS.get(suffix), bool(suffix)
    others = (c.name.casefold() for j, c in enumerate(table.columns) if j != i)
    is_name = has_unit and suffix in others
    if is_name and not column.unit and suffix != "s":
        notes.append(Step(f"{named} are read in {suffix}, and not as the times of {suffix}", DOUBT))
    low, middle = map(float, np.quantile(t, (0.1, 0.5)) if t.size else (0.0, 0.0))
    usual = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    if unit is None:
        for name, (least, most, largest, size) in _BY_SIZE.items():
            if least <= low and middle < most and usual < largest:
                unit, has_unit, clock = size, True, f"s, from {name.partition(';')[0]}"
                notes.append(Step(f"read {named} as {name}", *codes_of([name])))
                break
        else:
            if (k := _carry(t)) is not None:
                raise FileError(
                    f"{table.place(k)}: {named} go from {t[k - 1]:.16g} to {t[k]:.16g}, as digits "
                    "of a clock: write them as 09:59:59, or give Ts in s (--Ts)"
                )
            is_known = not column.name or i in time_columns(table)
            unit, doubts = _without_unit(t, usual, named, column.name, is_known=is_known)
            notes += doubts
    if _EPOCH_S[0] <= middle * unit < _EPOCH_S[1]:
        clock = _EPOCH
    for bits in _TIMER_BITS:
        steps = np.diff(t)
        wraps = (steps < 0) & (np.abs(steps + 2.0**bits - usual) <= usual)
        if wraps.any() and np.mean(steps < 0) < _MAX_RETURNS:
            t = t + 2.0**bits * np.append(0, np.cumsum(wraps))
            notes.append(f"{named} begin again after {2**bits}: joined, as of a timer")
    span = float(np.ptp(t)) * unit
    if span and not _SPAN_S[0] <= span <= _SPAN_S[1]:
        raise FileError(
            f"{named} cover {digits(span, 3)} s, but {_SPAN_S[0]:g} to {_SPAN_S[1]:g} s are "
            "allowed; give Ts in s (--Ts)"
        )
    return Times(
        # The difference first: the unit of an epoch in ns would round times of 1e18.
        t=(t - t[:1]) * unit,
        resolution=_last_digit(t) * unit,
        name=named,
        place=table.place,
        notes=notes,
        begin=float(t[0]) * unit if t.size else 0.0,
        clock=clock,
        has_unit=has_unit,
    )


def _without_unit(
    t: Vector, usual: float, named: str, name: str, *, is_known: bool
) -> tuple[float, list[str]]:
    """Return the unit, in s, of times whose header has none, and a doubt if it may be another.

    A name that is not a known name of times may contain another unit, such as Stunden.
    """
    if usual < _LONG_S:
        text = f"{named} have no unit: read as s"
        if not is_known:
            text += f"; if they are not, rename the column to {name}_ms or {name}_min"
        return 1.0, [Step(text, DOUBT)] * (usual >= _DOUBTFUL_S or not is_known)
    # No file covers a year from the start of its clock.
    sizes = {"s": 1.0, "ms": 1e-3 * (usual < _MOST_MS), "us": 1e-6, "ns": 1e-9}
    longest = float(np.abs(t).max())
    unit = next((u for u, size in sizes.items() if size and longest * size <= _YEAR_S), "s")
    others = " or ".join(f"{name or 'time'}_{u}" for u in ("s", "ms", "us") if u != unit)
    text = (
        f"{named} have no unit and are {usual:.10g} apart: read as {unit}, so Ts is "
        f"{usual * sizes[unit]:g} s. If they are not, rename the column to {others}, or give Ts in "
        "s (--Ts)"
    )
    return sizes[unit], [Step(text, DOUBT)]


def _with_fractions(table: Table, i: int, times: Times) -> Times:
    """Add the next column, if it contains the fractions of times in whole seconds."""
    if i + 1 >= len(table.columns) or times.t.size < 2 or np.any(times.t != np.rint(times.t)):
        return times
    column, n = table.columns[i + 1], np.empty(0)
    base, unit = base_and_unit(column)
    is_named = bool(unit) and base in ("", base_and_unit(table.columns[i])[0])
    with suppress(FileError):
        n = table.numbers(i + 1)
    if (column.name and not is_named) or n.shape != times.t.shape:
        return times
    d_s = np.diff(times.t)
    for size, name in _TICKS.items():
        d, rises = d_s + size * np.diff(n), d_s > 0
        # Without names, the fraction must make the times even where the seconds rise.
        is_even = np.any(rises) and not np.all(rises) and d.min() > 0
        is_even = is_even and abs(np.median(d[rises]) - np.median(d)) <= np.median(d) / 2
        is_fraction = size < 1 and np.all((n >= 0) & (size * n < 1) & (n == np.rint(n)))
        if is_fraction and (_SECONDS[unit] == size if is_named else is_even):
            title = shorten(column.name) or str(i + 2)
            notes = [note for note in times.notes if not codes_of([note])[0]]
            return replace(
                times,
                t=times.t + size * (n - n[0]),
                begin=times.begin + size * float(n[0]),
                resolution=size * _last_digit(n),
                notes=[*notes, f"added column {title} to {times.name}, in {name}"],
                has_unit=True,
            )
    return times


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


def _of_stamps(table: Table, i: int, cells: Sequence[str], named: str) -> Times:
    """Return the times of dates or times of day, without the changes of a clock."""
    is_time = bool(_TIME_OF_DAY.fullmatch(cells[0].strip()))
    dates = [j for j, column in enumerate(table.columns) if column.name.casefold() in DATE_NAMES]
    if is_time and dates and dates[0] != i:
        days, is_time = table.texts(dates[0]), False
        cells = [f"{day.strip()} {cell.strip()}" for day, cell in zip(days, cells, strict=True)]
    notes: list[str] = []
    if not table.columns[i].unit and _HOURS_AND_MINUTES.fullmatch(cells[0].strip()):
        notes.append(Step(f"times such as {cells[0].strip()} are read as hours:minutes", DOUBT))
    is_american, zones = _is_month_first(cells), dict[str, int]()
    ns = np.empty(len(cells), np.int64)
    for k, cell in enumerate(map(str.strip, cells)):
        try:
            ns[k], zone = _moment(cell, month_first=is_american)
        except (ValueError, OverflowError):
            raise FileError(
                f"{table.place(k)}: '{shorten(cell)}' is not a time; write a number, or a time "
                "such as 2024-03-31T01:59:00 or 01:59:00.25, or give Ts in s (--Ts)"
            ) from None
        if zones.setdefault(zone, k) == k and len(zones) > 1:
            raise FileError(
                f"{table.place(k)}: '{shorten(cell)}' is in another time zone than the times before"
                "; write all times in UTC, or with their offsets, as 2024-03-31T01:59:00+01:00"
            )
    t = (ns - ns[0]) / 1e9
    is_span = "day" in cells[0]
    if is_time and not is_span:
        t += _DAY_S * np.cumsum(np.diff(t, prepend=t[:1]) < -_DAY_S / 2)  # midnight
    if "" in zones:
        t, changes = _without_clock_changes(t, table.place)
        notes += changes
    has_seconds = any(map(_SECONDS_WRITTEN.search, cells)) or ":" not in cells[0]
    zone = "" if zones.keys() == {_UTC} else f" in {''.join(zones) or 'local time'}"
    clock = "" if is_span else "s since midnight" if is_time else _EPOCH + zone
    return Times(
        t=t,
        resolution=_last_digit(t) if has_seconds else 60.0,
        name=named,
        place=table.place,
        notes=notes,
        begin=float(ns[0] / 1e9),
        clock=clock,
    )


def _without_clock_changes(t: Vector, place: Callable[[int], str]) -> tuple[Vector, list[str]]:
    """Remove jumps of one hour, as at the begin and the end of summer time."""
    intervals, notes, moved = np.diff(t), list[str](), np.zeros(t.size)
    usual = float(np.median(intervals)) if intervals.size else 0.0
    if not intervals.size or np.mean(intervals < 0) >= _MAX_RETURNS:
        return t, []
    for hours, way in ((1, "forward"), (-1, "back")):
        jumps = np.abs(intervals - usual - hours * _HOUR_S) <= max(usual / 2, 1.0)
        if 0 < usual < _HOUR_S / 6 and np.count_nonzero(jumps) == 1:
            k = int(np.argmax(jumps)) + 1
            moved[k:] += hours * _HOUR_S
            text = f"{place(k)}: the clock goes {way} by 1 h, as at a change of summer time; "
            notes.append(Step(f"{text}this hour was removed from the times", DOUBT))
    return t - moved, notes


# ---- dates and times of day


def _is_month_first(cells: Sequence[str]) -> bool:
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


def _moment(text: str, *, month_first: bool) -> tuple[int, str]:
    """Return a date in ns since 1970, or a time of day in ns, and the zone, "" without one."""
    ns = 0
    if match := _FRACTION.search(text):
        ns, text = round(1e9 * float(f"0.{match[1]}")), text[: match.start()] + text[match.end() :]
    with suppress(ValueError):  # first, because it is fast
        date = datetime.fromisoformat(text)
        return ns + _ns(date - _ORIGIN[date.tzinfo is not None]), _UTC if date.tzinfo else ""
    if (match := _ZONE.fullmatch(text)) and text != match["moment"]:
        more, zone = _moment(match["moment"], month_first=month_first)
        name, sign = (match["name"] or _UTC).upper(), match["sign"]
        offset = _ns(timedelta(hours=int(match["h"] or 0), minutes=int(match["m"] or 0)))
        zone = zone or (_UTC if sign or name in ("Z", "GMT") else name)
        return ns + more - offset * (-1 if sign == "-" else 1), zone
    if _TIME_OF_DAY.fullmatch(text):
        return ns + _ns(_time_of_day(text)), ""
    if match := _DATE.match(text):
        month, day, year = map(int, match.group(*("ab" if month_first else "ba"), "year"))
        time = text[match.end() :].strip(" T,") or "0:00:00"
        date = datetime(year + 2000 * (year < 100), month, day)
        return ns + _ns(date - _ORIGIN[0] + _time_of_day(time)), ""
    if (plain := text.replace(",", ".").replace("/", "-")) != text:
        more, zone = _moment(plain, month_first=month_first)
        return ns + more, zone
    return ns + _ns(datetime.strptime(text, _MATLAB) - _ORIGIN[0]), ""


def _ns(span: timedelta) -> int:
    return span // timedelta(microseconds=1) * 1000


def _time_of_day(text: str) -> timedelta:
    match = _TIME_OF_DAY.fullmatch(text)
    if match is None:
        raise ValueError(text)
    hours, minutes, seconds = int(match["h"] or 0), int(match["m"]), match["s"].replace(",", ".")
    if match["h"] is None and "." not in seconds:  # 1:59 is in hours, Excel's 1:59.5 in minutes
        hours, minutes, seconds = minutes, int(seconds), "0"
    if half := (match["half"] or "").casefold()[:1]:
        hours = hours % 12 + 12 * (half == "p")
    days = int(match["days"] or 0)
    return timedelta(days=days, hours=hours, minutes=minutes, seconds=float(seconds))
