"""Lines above the rows of a table: names, units, and what instruments write above them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise, takewhile

from armrig_core.errors import FileError

from armrig.data.files.cells import REWRITTEN, CellKind, is_missing, kind, split
from armrig.data.files.table import Column, column_of, shorten

Lines = Sequence[tuple[int, str]]
"""Lines with their numbers from 1, without empty lines and remarks."""
SplitLines = Sequence[tuple[int, list[str]]]
"""Cells of lines with their numbers."""
TIMES = frozenset(
    {"t", "time", "times", "timestamp", "datetime", "date", "date&time", "x_value", "zeit"}
)
"""Names of columns that are names of times and of nothing else."""
_MAX_LINES = 30  # above the names
PROBED_LINES = 2 * _MAX_LINES + 5
"""Number of first lines that contain the names, the units, and more rows than lines above them."""
_MAX_UNIT_CHARACTERS = 16
_VALUES = frozenset({CellKind.NUMBER, CellKind.QUANTITY, CellKind.TIME, CellKind.SWITCH})
_KNOWN_UNIT = re.compile(
    r"s|sec|seconds?|[mµun]s|min|h|[km]?hz|[mkuµ]?v|volts?|[muµk]?a|amp(?:ere)?|[mk]?w|va|k|c|f|℃|"
    r"°[cf]?|deg[cf]?(?:/s)?|%(?:rh)?|rh|ppm|rpm|1/min|rad(?:/s2?)?|[mcµk]?m|m/s(?:\^?2)?|k?g|k?n|"
    r"n·?m|[kmh]?pa|m?bar|psi|ohm|ω|l(?:/min)?|j|k?wh|db[mv]?|mt"
)
_PLAIN_UNITS = {"volt": "V", "volts": "V", "second": "s"} | dict.fromkeys(
    ("no.", "time", "ts", "rn", "sequence", "-"), ""
)
_UNITS_OF_VALUES = re.compile(r"(?:Y|Vertical)[ _]Unit.*")
_LOGGER = re.compile(  # of HOBO
    r"(?:,\s*(?P<unit>[^,()]+?))?\s*\((?:LGR|SEN) S/N.*|,\s*GMT[-+]\d\d:\d\d$"
)


Head = tuple[list[Column], list[str], Lines]
"""Columns, [] if the file contains no names; notes on the lines above the rows; the rows."""


def head_of(lines: Lines, separator: str) -> Head:
    """Return the columns of a table by the lines above its rows.

    The rows begin at the first line that resembles the longest run of lines with values. The lines
    of words directly above the rows contain the names, or the names and below them the units. The
    lines above the names are left out.
    """
    probed = [split(line, separator) for _, line in lines[:PROBED_LINES]]
    run = longest_run(probed) or range(len(probed), len(probed))
    # Of the run, the last row with the most values: a missing value resembles any cell.
    row = max((probed[k] for k in reversed(run)), key=_count_values, default=[*probed, [""]][0])
    begin = next((k for k in range(run.start) if _resembles(probed[k], row)), run.start)
    above = [k for k in range(begin) if set(map(kind, probed[k])) != {CellKind.MISSING}]
    is_closed = all(not probed[k][-1].strip() for k in run)

    def is_head(k: int) -> bool:
        cells, kinds = probed[k], [*map(kind, probed[k])]
        # A line above the names such as `Logger: ACME` is a fact, and with two columns `Scale,0.1`.
        *first_ends, last_end = [cell.strip()[-1:] for cell in cells]
        has_label = ":" in first_ends and last_end != ":"
        is_fact = has_label or (len(row) == 2 and CellKind.NUMBER in kinds)
        is_fact = is_fact and k < above[-1]
        # LabVIEW writes the name of a column of comments above rows without this column.
        extra = 1 if cells[-1].strip() == "Comment" else -is_closed
        fits = len(cells) - len(row) in (0, extra) and CellKind.WORD in kinds and not is_fact
        return fits and (_VALUES.isdisjoint(kinds) or bool(_word_above_value(cells, row)))

    block = list(takewhile(is_head, reversed(above)))[::-1]
    if not block:
        begin = above[-1] + 1 if above and _is_remark(probed[above[-1]]) else 0
        return [], _left_out(lines[:begin], "above the first row"), lines[begin:]
    at, units_at = _names_and_units(block, lines, probed)
    names, notes, begin = _names(probed[at])[: len(row)], list[str](), block[-1] + 1
    if CellKind.NUMBER in map(kind, probed[at]):
        _require_times(lines[at][0], probed[at], row)
    if numbered := [name for name in names if name.isdecimal()]:
        # A number chooses a column by its place.
        names = [f"CH{name}" if name.isdecimal() else name for name in names]
        notes.append(f"line {lines[at][0]}: the name {numbered[0]} is read as CH{numbered[0]}")
    notes += _left_out(lines[:at], "above the names")
    if units_at:
        notes.append(f"read line {lines[units_at][0]} as units")
        notes += _left_out(lines[units_at + 1 : begin], "below the units")
    units = units_of(probed[units_at]) if units_at else _units_above(probed[:at], len(names))
    rows = lines[begin:]
    if repeated := [k for k, line in rows if line == lines[at][1]]:
        header = {line for _, line in lines[:begin]}
        rows = [(k, line) for k, line in rows if line not in header]
        notes.append(f"left out the names that line {repeated[0]} repeats")
    return columns_of(names, units), notes, rows


def longest_run(probed: Sequence[Sequence[str]]) -> range:
    """Return the indices of the longest run of rows with values and equally many cells."""
    widths = [len(cells) if has_values(cells) else 0 for cells in probed]
    runs, begin = list[range](), 0
    for width, group in groupby(widths):
        end = begin + len(list(group))
        if width:
            is_named = end - begin > 1 and bool(_word_above_value(probed[begin], probed[end - 1]))
            runs.append(range(begin + is_named, end))
        begin = end
    # Of equally long runs the last: facts about the file are above its rows.
    return max(reversed(runs), key=len, default=range(0))


def _count_values(cells: Sequence[str]) -> int:
    return sum(kind(cell) in _VALUES for cell in cells)


def has_values(cells: Sequence[str]) -> bool:
    """Return whether any of the cells is a number, a quantity, a time or a switch."""
    return any(kind(cell) in _VALUES for cell in cells)


def _word_above_value(cells: Sequence[str], row: Sequence[str]) -> str:
    """Return the first word of these cells that is above a value of a row; "" without one."""
    pairs = zip(cells, row, strict=False)
    return next(
        (a for a, b in pairs if kind(a) is CellKind.WORD and kind(b) in _VALUES), ""
    ).strip()


def _names_and_units(
    block: Sequence[int], lines: Lines, probed: Sequence[Sequence[str]]
) -> tuple[int, int]:
    """Return the indices of the names and of the units in a block of lines; 0 without units."""
    if len(block) == 1:
        return block[0], 0
    pairs = [(a, b) for a, b in pairwise(block) if are_units(probed[b], probed[a])]
    if pairs:
        return min(pairs, key=lambda pair: has_values(probed[pair[0]]))
    upper, lower = block[-2:]
    if are_units(probed[lower], probed[upper]) is False:
        return lower, 0
    raise FileError(
        f"line {lines[upper][0]} or line {lines[lower][0]} may contain the names; delete the other "
        "line, or begin it with #"
    )


def _require_times(line: int, cells: Sequence[str], row: Sequence[str]) -> None:
    """Refuse names with a number, unless the first name is a name of times."""
    word = _word_above_value(cells, row)
    if column_of(word).name.casefold() not in {*TIMES, "x-axis"}:  # the latter is of Keysight
        raise FileError(
            f"line {line}: '{shorten(word)}' is above numbers, like a name, but next to a number; "
            "name each column by a word, or begin the line with #"
        )


def _names(cells: Sequence[str]) -> list[str]:
    """Return the names in the cells of a line; a separator at its end is not followed by a name."""
    names = [_LOGGER.sub(lambda p: f" [{p['unit']}]" * bool(p["unit"]), c.strip()) for c in cells]
    return names[:-1] if names and not names[-1] else names


def are_units(units: Sequence[str], names: Sequence[str]) -> bool | None:
    """Return whether the lower of two lines above the rows contains units; None if in doubt."""
    units, names = (row if row[-1].strip() else row[:-1] for row in (units, names))
    if has_values(units) or any(len(cell) > _MAX_UNIT_CHARACTERS for cell in units):
        return None
    are_known = share_of_units(units) >= 0.5
    has_times, lower_has_times = (
        bool(TIMES & {column_of(cell.strip()).name.casefold() for cell in cells})
        for cells in (names, units)
    )
    if len(units) > len(names) or (lower_has_times and not has_times):
        return None if are_known else False
    return are_known or (has_times and not lower_has_times) or None


def share_of_units(cells: Sequence[str]) -> float:
    """Return the share of known units in the cells that are not empty; 0 without such cells."""
    words = [cell.strip().strip("[]()").casefold() for cell in cells if not is_missing(cell)]
    return sum(map(bool, map(_KNOWN_UNIT.fullmatch, words))) / max(1, len(words))


def units_of(cells: Sequence[str]) -> list[str]:
    """Return the units in the cells of a line; "" for a word that is no unit."""
    units = [cell.strip().strip("[]()") for cell in cells]
    return [_PLAIN_UNITS.get(unit.casefold(), unit) for unit in units]


def columns_of(names: Sequence[str], units: Sequence[str] = ()) -> list[Column]:
    """Return columns of these names; a unit in a name has precedence over `units`."""
    columns = zip(map(column_of, names), [*units, *[""] * len(names)], strict=False)
    return [c if c.unit else replace(c, unit=unit) for c, unit in columns]


def _units_above(above: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return the units of a line such as `Vertical Units,V,V` above the names; [] without it."""
    for first, *cells in above:
        units = [cell for cell in units_of(cells) if cell]
        if _UNITS_OF_VALUES.fullmatch(first.strip()) and len(units) == width - 1:
            return ["", *units]
    return []


def _is_remark(cells: Sequence[str]) -> bool:
    """Return whether a line directly above rows without names is a sentence, or a fact."""
    return kind(cells[0]) is CellKind.WORD and (len(cells) == 1 or has_values(cells))


def _resembles(cells: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether a line has the number and the kinds of the cells of a row."""
    pairs = {(kind(a), kind(b)) for a, b in zip(cells, row, strict=False)}
    kinds = {a for a, b in pairs if CellKind.MISSING not in (a, b)}
    is_like = all(a is b for a, b in pairs if CellKind.MISSING not in (a, b))
    return is_like and not _VALUES.isdisjoint(kinds) and len(cells) == len(row)


def _left_out(lines: Lines, where: str) -> list[str]:
    """Return the note on lines that are left out; [] without lines."""
    if len(lines) < 2:
        return [f"left out line {k} {where}" for k, _ in lines]
    return [f"left out lines {lines[0][0]} to {lines[-1][0]} {where}"]


def head_of_instrument(text: str, lines: Lines) -> Head | None:
    """Return the columns of a known instrument's file, with rows that `REWRITTEN` separates.

    The result is None for every other text.
    """
    for maker, (beginning, read) in INSTRUMENTS.items():
        if re.match(beginning, text):
            try:
                return read([(k, [*map(str.strip, split(line, ","))]) for k, line in lines])
            except (ValueError, LookupError) as err:
                raise FileError(f"the header of {maker} is damaged; export again") from err
    return None


def _rigol(lines: SplitLines) -> Head:
    """Return times for the counts; the second line contains units, the start and the increment."""
    (_, names), (_, second), *rows = lines
    n = names.index("Start")
    t0, dt = map(float, second[n : n + 2])
    for _, row in rows:
        row[:] = f"{t0 + dt * float(row[0]):.12g}", *row[1:n], *filter(None, row[n:])
    note = f"{names[0]} is in s: {dt:g} s a sample from {t0:g} s on, by the header of Rigol"
    return columns_of(names[:n], ["s", *units_of(second[1:n])]), [note], join_cells(rows)


def _tektronix(lines: SplitLines) -> Head:
    """Return the times and values in columns 4 and 5; the facts are in columns 1 to 3."""
    facts = {row[0]: row[1] for _, row in reversed(lines) if row[0]}
    units = units_of([facts.get("Horizontal Units", "s"), facts.get("Vertical Units", "")])
    rows = [(k, row if any(row[5:]) else row[3:5]) for k, row in lines]
    notes = ["read as a file of Tektronix"]
    return columns_of(["time", facts["Source"]], units), notes, join_cells(rows)


def join_cells(rows: SplitLines) -> Lines:
    """Return rows whose cells `REWRITTEN` separates."""
    return [(k, REWRITTEN.join(cell.replace(REWRITTEN, " ") for cell in row)) for k, row in rows]


INSTRUMENTS: Mapping[str, tuple[str, Callable[[SplitLines], Head]]] = {
    "Rigol": (r"X,.*,Start,Increment\b.*\n\s*Sequence,", _rigol),
    "Tektronix": (r"Record Length,[^,\n]*,[^,\n]*(?:,[-+ .\deE]+){2}", _tektronix),
}
"""Beginning of the files that the general rule does not read, and their reader, by the maker.

The general rule reads the files of LabVIEW, TekScope, Keysight, Siglent, Graphtec, HOBO, Campbell,
PicoScope and Saleae.
"""
