"""Rows in which each value has its name: JSON, and `name=value` or `name:value`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from armrig_core.errors import FileError

from armrig.data.files.cells import REWRITTEN
from armrig.data.files.instrument_headers import Lines
from armrig.data.files.table import require_room, shown

_LABELLED = re.compile(
    r"\s*(?P<name>[^\W\d][^=:]*?)\s*[=:]\s*(?P<value>(?:[^=:]|(?<=\d):(?=\d))*?)\s*"
)
_AROUND_MARK = re.compile(r"\s*([=:])\s*")
_BETWEEN_OBJECTS = re.compile(r"[\s,]*")
_PROBED_LINES = 20
_DECODER = json.JSONDecoder(parse_float=str, parse_int=str, parse_constant=str)

LabelledRows = tuple[Sequence[str], Lines, str]
"""Names, lines in which `REWRITTEN` separates the cells, and the separator in the file."""


def json_rows(text: str) -> LabelledRows | None:
    """Return the rows of JSON lines or of an array of objects; None for text that is not JSON.

    A key is a name; the keys of nested objects are joined by points. A missing key is a missing
    value.
    """
    begin = re.match(r"\s*(?:\[\s*)?(?=\{\s*[\"}])", text)
    if begin is None:
        return None
    rows = list(_objects(text, begin.end()))
    return _of_mappings(rows, len(text), ",") if rows else None


def _objects(text: str, at: int) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Yield the line number and the content of each object from `at` on."""
    line, counted = 1, 0
    while at < len(text) and not (text[at] == "]" and not text[at + 1 :].strip()):
        line, counted = line + text.count("\n", counted, at), at
        try:
            content, at = _DECODER.raw_decode(text, at)
            row = dict(_leaves(content)) if isinstance(content, dict) else None
        except (ValueError, RecursionError) as err:
            why = err.msg if isinstance(err, json.JSONDecodeError) else "nested too deeply"
            raise FileError(
                f"line {line}: JSON is damaged here ({why}); write one object with all values of "
                "a sample on each line"
            ) from err
        if row is None:
            raise FileError(
                f'line {line} is JSON, but not an object with a name for each value: write {{"t": '
                '0, "u": 1, "y": 2}'
            )
        yield line, row
        separator = _BETWEEN_OBJECTS.match(text, at)
        at = separator.end() if separator else at


def _leaves(content: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{path}{key}.")
        else:
            cell = "" if value is None else value if isinstance(value, str) else json.dumps(value)
            yield f"{path}{key}", cell


def without_labels(lines: Lines) -> LabelledRows | None:
    """Return the rows of lines such as `t=0.01 u=1` or `u:1,y:2`; None for other lines."""
    probed = [line for _, line in lines[:_PROBED_LINES]]
    for separator in ("\t", ";", ",", ""):
        first, *others = [next(iter(_labelled(line, separator)), "") for line in probed] or [""]
        if first and others and others.count(first) >= len(others) / 2:
            break
    else:
        return None
    rows = []
    for k, line in lines:
        if not (row := _labelled(line, separator)):
            raise FileError(
                f"line {k}: '{shown(line.strip())}' is not of the form name=value, as the first "
                "line is; delete the line, or begin it with #"
            )
        rows.append((k, row))
    return _of_mappings(rows, sum(len(line) for _, line in lines), separator)


def _labelled(line: str, separator: str) -> dict[str, str]:
    """Return the values of a line by their names; {} if a cell has no name, or another's name."""
    if separator:
        cells = line.strip(f" \r{separator}").split(separator)
    else:
        cells = [cell.rstrip(",;") for cell in _AROUND_MARK.sub(r"\1", line).split()]
    row, name = dict[str, str](), ""
    for cell in cells:
        part = _LABELLED.fullmatch(cell)
        if part is None and name and not separator:
            row[name] += f" {cell}"  # the unit of a value
        elif part is None or part["name"] in row:
            return {}
        else:
            name = part["name"]
            row[name] = part["value"]
    return row


def _of_mappings(
    rows: Sequence[tuple[int, Mapping[str, str]]], size: int, separator: str
) -> LabelledRows:
    names = list(dict.fromkeys(name for _, row in rows for name in row))
    require_room(8 * len(names) * len(rows), size)
    lines = [
        (k, REWRITTEN.join(row.get(name, "").replace(REWRITTEN, " ") for name in names))
        for k, row in rows
        if row
    ]
    return names, lines, separator
