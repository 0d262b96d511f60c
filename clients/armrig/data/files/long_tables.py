"""Long tables: one row for each value, with a column that names the quantity."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from armrig.data.files.cells import REWRITTEN, Kind, kind
from armrig.data.files.instrument_headers import TIMES
from armrig.data.files.table import Column

_MAX_NAMES = 12
_MIN_SHARED_TIMES = 0.5  # share of the rows, if the headings say nothing
_VALUE_NAMES = frozenset({"value", "values", "val", "state", "reading", "_value", "wert", "valeur"})
_NAME_NAMES = frozenset(
    {"entity_id", "entity", "sensor", "sensor_id", "name", "signal", "channel", "topic", "variable"}
    | {"tag", "field", "_field", "key", "id", "metric", "parameter", "series", "device", "quantity"}
    | {"item", "point", "kanal", "messstelle"}
)


def long_table(
    columns: Sequence[Column], firsts: Sequence[str], texts: Callable[[int], Sequence[str]]
) -> tuple[str, list[Column], list[str]] | None:
    """Return the note, the columns and the rows of a long table; None for every other table.

    A long table has a column of times, a column of values, and a column of 2 to 12 names. Either
    their headings are such as `value` and `sensor`, or several names share the times. A status
    (`good` or `bad`) at each time chooses nothing.
    """
    kinds = [kind(cell) for cell in firsts]
    if len(columns) != 3 or kinds.count(Kind.WORD) != 1:
        return None
    names_at = kinds.index(Kind.WORD)
    is_time = [
        k is Kind.TIME or (k is Kind.NUMBER and column.name.casefold() in TIMES)
        for k, column in zip(kinds, columns, strict=True)
    ]
    if sum(is_time) != 1:
        return None
    at = is_time.index(True)
    value_at = 3 - names_at - at
    names, times = ([cell.strip() for cell in texts(i)] for i in (names_at, at))
    distinct = list(dict.fromkeys(names))
    if not 2 <= len(distinct) <= min(_MAX_NAMES, len(names) - 1) or "" in distinct:
        return None
    values = texts(value_at)
    if any(kind(cell) in (Kind.WORD, Kind.TIME) for cell in set(values)):
        return None
    title = columns[names_at].name
    is_titled = columns[value_at].name.casefold() in _VALUE_NAMES
    is_titled &= title.casefold() in _NAME_NAMES
    if not is_titled and not _overlap(names, times):
        return None
    rows = [
        REWRITTEN.join([time, *(value if name == other else "" for other in distinct)])
        for time, name, value in zip(times, names, values, strict=True)
    ]
    unit = columns[value_at].unit
    return (
        f"long table: a column for each {title or 'word'}",
        [columns[at], *(Column(name=name, unit=unit) for name in distinct)],
        rows,
    )


def _overlap(names: Sequence[str], times: Sequence[str]) -> bool:
    """Return whether several names have the same times, and no name has a time twice."""
    pairs = set(zip(times, names, strict=True))
    shared = len(names) - len(set(times))
    return len(pairs) == len(names) and shared >= _MIN_SHARED_TIMES * len(names) / 2
