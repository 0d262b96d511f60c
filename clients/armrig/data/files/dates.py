"""Dates and times of day as text, in the notations of loggers and spreadsheets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np

UTC_ZONE = "UTC"
"""Zone of times with a known offset from UTC."""
DAY_S = 86400.0
"""Seconds of a day."""
TIME_OF_DAY = re.compile(
    r"(?:(?P<days>-?\d+) days?,? \+?)?(?:(?P<h>\d{1,3}):)?(?P<m>\d{1,3}):"
    r"(?P<s>\d\d(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
)
"""Pattern of a time of day, or of a span of days, hours, minutes and seconds."""
_DATE = re.compile(r"(?P<a>\d{1,2})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<year>\d{4}|\d\d)")
_FRACTION = re.compile(r"(?<=:\d\d:\d\d)[.,](\d+)")
_ZONE = re.compile(
    r"(?P<moment>.*?:\d\d(?:[.,]\d+)?(?: [AP]M)?)\s*(?P<name>Z|[A-Z]{3,5})?"
    r"(?:(?P<sign>[+-])(?P<h>\d\d?)(?::?(?P<m>[0-5]\d))?)?(?:\[.*\])?",
    re.IGNORECASE,
)
_MATLAB = "%d-%b-%Y %H:%M:%S"
_BEGIN = (datetime(1970, 1, 1), datetime(1970, 1, 1, tzinfo=UTC))  # of dates as numbers


def month_first(cells: Sequence[str]) -> bool:
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


def moment(text: str, *, month_first: bool) -> tuple[float, float, str]:
    """Return the seconds of a date, those to add, and the time zone, "" if none is written."""
    part = 0.0
    if match := _FRACTION.search(text):
        part, text = float(f"0.{match[1]}"), text[: match.start()] + text[match.end() :]
    with suppress(ValueError):  # first, because it is fast
        date = datetime.fromisoformat(text)
        span = date - _BEGIN[date.tzinfo is not None]
        seconds = span.days * DAY_S + span.seconds
        return seconds, part + 1e-6 * span.microseconds, UTC_ZONE if date.tzinfo else ""
    if (match := _ZONE.fullmatch(text)) and text != match["moment"]:
        seconds, more, zone = moment(match["moment"], month_first=month_first)
        name, sign = (match["name"] or UTC_ZONE).upper(), match["sign"]
        offset = 3600.0 * int(match["h"] or 0) + 60.0 * int(match["m"] or 0)
        zone = zone or (UTC_ZONE if sign or name in ("Z", "GMT") else name)
        return seconds - offset * (-1 if sign == "-" else 1), part + more, zone
    if TIME_OF_DAY.fullmatch(text):
        return 0.0, part + _time_of_day(text), ""
    if match := _DATE.match(text):
        a, b, year = int(match["a"]), int(match["b"]), int(match["year"])
        month, day = (a, b) if month_first else (b, a)
        begin = datetime(year + 2000 * (year < 100), month, day) - _BEGIN[0]
        time = text[match.end() :].strip(" T,") or "0:00:00"
        return begin.total_seconds(), part + _time_of_day(time), ""
    plain = text.replace(",", ".").replace("/", "-")
    if plain != text:
        seconds, more, zone = moment(plain, month_first=month_first)
        return seconds, part + more, zone
    return (datetime.strptime(text, _MATLAB) - _BEGIN[0]).total_seconds(), part, ""


def _time_of_day(text: str) -> float:
    match = TIME_OF_DAY.fullmatch(text)
    if match is None:
        raise ValueError(text)
    hours, minutes, seconds = int(match["h"] or 0), int(match["m"]), match["s"].replace(",", ".")
    if match["h"] is None and "." not in seconds:  # 1:59 is in hours, Excel's 1:59.5 in minutes
        hours, minutes, seconds = minutes, int(seconds), "0"
    if half := (match["half"] or "").casefold()[:1]:
        hours = hours % 12 + 12 * (half == "p")
    return DAY_S * int(match["days"] or 0) + 3600.0 * hours + 60.0 * minutes + float(seconds)
