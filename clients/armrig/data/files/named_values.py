"""Values with their names: JSON, lines of `name=value`, and tables with a column of names."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from armrig_core.errors import FileError

from armrig.data.files.cells import REWRITTEN, Kind, kind
from armrig.data.files.instrument_headers import Lines
from armrig.data.files.table import Column, require_room, shown

_NAME = r"[^\W\d][^\s=:,;]{0,63}\s*[=:]"
_BETWEEN_VALUES = re.compile(rf"[\s,;]++(?={_NAME})")
_NAMED_VALUE = re.compile(rf"(?P<name>{_NAME})\s*(?P<value>.*)")
_BETWEEN_OBJECTS = re.compile(r"(?![\s,])|\Z")
_PROBED_LINES = 20
_DECODER = json.JSONDecoder(parse_float=str, parse_int=str, parse_constant=str)
_MAX_NAMES = 12
_OF_VALUES = frozenset({"value", "values", "val", "state", "reading", "_value", "wert", "valeur"})
_OF_NAMES = frozenset(
    {"entity_id", "entity", "sensor", "sensor_id", "name", "signal", "channel", "topic", "variable"}
    | {"tag", "field", "_field", "key", "id", "metric", "parameter", "series", "device", "quantity"}
    | {"item", "point", "kanal", "messstelle"}
)

NamedRows = tuple[Sequence[str], Lines]
"""Names, and lines in which `REWRITTEN` separates the cells."""


def json_rows(text: str) -> NamedRows | None:
    """Return the rows of JSON lines or of an array of objects; None for text that is not JSON.

    A key is a name; the keys of nested objects are joined by points. A missing key is a missing
    value.
    """
    begin = re.match(r"\s*(?:\[\s*)?(?=\{\s*[\"}])", text)
    return _of_mappings(list(_objects(text, begin.end())), len(text)) if begin else None


def _objects(text: str, at: int) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Yield the line number and the content of each object from `at` on."""
    line, counted = 1, 0
    while at < len(text) and not (text[at] == "]" and not text[at + 1 :].strip()):
        line, counted = line + text.count("\n", counted, at), at
        try:
            content, at = _DECODER.raw_decode(text, at)
            yield line, dict(_leaves(content.items()))
        except (ValueError, AttributeError, RecursionError) as err:
            raise FileError(
                f'line {line}: JSON is damaged here, or not an object such as {{"t": 0, "u": 1, '
                '"y": 2}; write an object with all values of a sample on each line'
            ) from err
        at = _BETWEEN_OBJECTS.search(text, at).start()


def _leaves(items: Any, path: str = "") -> Iterator[tuple[str, str]]:
    for key, value in items:
        if isinstance(value, dict):
            yield from _leaves(value.items(), f"{path}{key}.")
        else:
            cell = "" if value is None else value if isinstance(value, str) else json.dumps(value)
            yield f"{path}{key}", cell


def without_names(lines: Lines) -> NamedRows | None:
    """Return the rows of lines such as `t=0.01 u=1` or `u:1,y:2`; None for other lines."""
    first, *others = [next(iter(_named(line)), "") for _, line in lines[:_PROBED_LINES]] or [""]
    if not first or not others or others.count(first) < len(others) / 2:
        return None
    rows = [(k, _named(line)) for k, line in lines]
    for (k, line), (_, row) in zip(lines, rows, strict=True):
        if not row:
            raise FileError(
                f"line {k}: '{shown(line.strip())}' is not of the form name=value, as the first "
                "line is; delete the line, or begin it with #"
            )
    return _of_mappings(rows, sum(len(line) for _, line in lines))


def _named(line: str) -> dict[str, str]:
    """Return the values of a line by their names; {} if a value has no name, or another's name."""
    texts = _BETWEEN_VALUES.split(line.strip(" \t\r,;"))
    parts = [part for text in texts if (part := _NAMED_VALUE.fullmatch(text))]
    row = {part["name"].rstrip(" \t=:"): part["value"] for part in parts}
    return row if len(row) == len(texts) else {}


def _of_mappings(rows: Sequence[tuple[int, Mapping[str, str]]], size: int) -> NamedRows:
    names = list(dict.fromkeys(name for _, row in rows for name in row))
    require_room(8 * len(names) * len(rows), size)
    return names, [
        (k, REWRITTEN.join(row.get(name, "").replace(REWRITTEN, " ") for name in names))
        for k, row in rows
        if row
    ]


def long_table(
    columns: Sequence[Column], firsts: Sequence[str], texts: Callable[[int], Sequence[str]]
) -> tuple[str, list[Column], list[str]] | None:
    """Return the note, the columns and the rows of a long table; None for every other table.

    A long table has one row for each value, and three columns: times, values and 2 to 12 names. The
    headings of the values and of the names are such as `value` and `sensor`.
    """
    headings = [column.name.casefold() for column in columns]
    of_names = next((i for i, heading in enumerate(headings) if heading in _OF_NAMES), None)
    of_values = next((i for i, heading in enumerate(headings) if heading in _OF_VALUES), None)
    if len(columns) != 3 or of_names is None or of_values is None:
        return None
    of_times = 3 - of_names - of_values
    cells = [cell.strip() for cell in texts(of_names)]
    names = list(dict.fromkeys(cells))
    are_words = [kind(firsts[i]) is Kind.WORD for i in (of_names, of_times)]
    if are_words != [True, False] or not 2 <= len(names) <= min(_MAX_NAMES, len(cells) - 1):
        return None
    rows = [
        REWRITTEN.join([time, *(value if name == cell else "" for name in names)])
        for time, cell, value in zip(texts(of_times), cells, texts(of_values), strict=True)
    ]
    unit = columns[of_values].unit
    return (
        f"long table: a column for each {columns[of_names].name}",
        [columns[of_times], *(Column(name=name, unit=unit) for name in names)],
        rows,
    )
