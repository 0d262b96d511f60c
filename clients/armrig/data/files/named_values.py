"""Values with their names: JSON, lines of `name=value`, and tables with a column of names."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from armrig_core.errors import FileError

from armrig.data.files.cells import REWRITTEN, CellKind, kind
from armrig.data.files.instrument_headers import Head, Lines, columns_of, join_cells
from armrig.data.files.table import Column, require_room, shorten

_NAME = r"[^\W\d][^\s=:,;]{0,63}\s*[=:]"
_BETWEEN_VALUES = re.compile(rf"(?<![\s,;])[\s,;]++(?={_NAME})")  # in linear time
_NAMED_VALUE = re.compile(rf"(?P<name>{_NAME})\s*(?P<value>.*)")
_BETWEEN_OBJECTS = tuple(" \t\r\n,")
_PROBED_LINES = 20
_DECODER = json.JSONDecoder(parse_float=str, parse_int=str, parse_constant=str)
_MAX_NAMES = 12
_OF_VALUES = re.compile(r"_?values?|val|state|reading|wert|valeur", re.I)
_OF_NAMES = re.compile(
    r"entity|(?:entity_|sensor_)?id|sensor|name|signal|channel|topic|variable|tag|_?field|key|item|"
    r"metric|parameter|series|device|quantity|point|kanal|messstelle",
    re.I,
)


def json_rows(text: str) -> Head | None:
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
        while text[at : at + 1] in _BETWEEN_OBJECTS:
            at += 1


def _leaves(items: Any, path: str = "") -> Iterator[tuple[str, str]]:
    for key, value in items:
        if isinstance(value, dict):
            yield from _leaves(value.items(), f"{path}{key}.")
        else:
            cell = "" if value is None else value if isinstance(value, str) else json.dumps(value)
            yield f"{path}{key}", cell


def without_names(lines: Lines) -> Head | None:
    """Return the rows of lines such as `t=0.01 u=1` or `u:1,y:2`; None for other lines."""
    first, *others = [next(iter(_pairs(line)), "") for _, line in lines[:_PROBED_LINES]] or [""]
    if not first or not others or others.count(first) < len(others) / 2:
        return None
    rows = [(k, _pairs(line)) for k, line in lines]
    for (k, line), (_, row) in zip(lines, rows, strict=True):
        if not row:
            raise FileError(
                f"line {k}: '{shorten(line.strip())}' is not of the form name=value, as the first "
                "line is; delete the line, or begin it with #"
            )
    return _of_mappings(rows, sum(len(line) for _, line in lines))


def _pairs(line: str) -> dict[str, str]:
    """Return the values of a line by their names; {} if a value has no name, or another's name."""
    texts = _BETWEEN_VALUES.split(line.strip(" \t\r,;"))
    parts = [part for text in texts if (part := _NAMED_VALUE.fullmatch(text))]
    row = {part["name"].rstrip(" \t=:"): part["value"] for part in parts}
    return row if len(row) == len(texts) else {}


def _of_mappings(rows: Sequence[tuple[int, Mapping[str, str]]], size: int) -> Head:
    names = list(dict.fromkeys(name for _, row in rows for name in row))
    require_room(8 * len(names) * len(rows), size)
    cells = [(k, [row.get(name, "") for name in names]) for k, row in rows if row]
    return columns_of(names), [], join_cells(cells)


def long_table(
    columns: Sequence[Column], firsts: Sequence[str], texts: Callable[[int], Sequence[str]]
) -> tuple[str, list[Column], list[str]] | None:
    """Return the note, the columns and the rows of a long table; None for every other table.

    A long table has one row for each value, and three columns: times, values and 2 to 12 names. The
    headings of the values and of the names are such as `value` and `sensor`.
    """
    titles = [column.name for column in columns]
    of_names, of_values = (
        [i for i, title in enumerate(titles) if heading.fullmatch(title)]
        for heading in (_OF_NAMES, _OF_VALUES)
    )
    if [len(columns), len(of_names), len(of_values)] != [3, 1, 1]:
        return None
    name_at, value_at = *of_names, *of_values
    time_at = 3 - name_at - value_at
    are_words = [kind(firsts[i]) is CellKind.WORD for i in (name_at, time_at)]
    cells = [cell.strip() for cell in texts(name_at)]
    names = list(dict.fromkeys(cells))
    if are_words != [True, False] or not 2 <= len(names) <= min(_MAX_NAMES, len(cells) - 1):
        return None
    rows = [
        REWRITTEN.join([time, *(value if name == cell else "" for name in names)])
        for time, cell, value in zip(texts(time_at), cells, texts(value_at), strict=True)
    ]
    values = [Column(name=name, unit=columns[value_at].unit) for name in names]
    return f"long table: a column for each {titles[name_at]}", [columns[time_at], *values], rows
