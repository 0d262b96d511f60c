"""Lines above the rows of a table: names, units, and what instruments write above them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from armrig_core.errors import FileError

from armrig.data.files.cells import REWRITTEN, Kind, kind, split
from armrig.data.files.decimal_marks import number
from armrig.data.files.table import shown, titled

Lines = Sequence[tuple[int, str]]
"""Lines with their numbers from 1, without empty lines and remarks."""
TIMES = frozenset(
    {"t", "time", "times", "timestamp", "datetime", "date", "date&time", "x_value", "zeit"}
)
"""Names of columns that are names of times and of nothing else."""
_MAX_LINES = 30  # above the names
PROBED_LINES = 2 * _MAX_LINES + 5  # names, units, and more rows than lines above them
_MAX_LABVIEW_LINES = 500  # above the names
_MAX_PROBED_CELLS = 32
_MAX_UNIT_CHARACTERS = 16
_VALUES = frozenset({Kind.NUMBER, Kind.QUANTITY, Kind.TIME, Kind.SWITCH})
_KNOWN_UNIT = re.compile(
    r"s|sec|seconds?|[mµun]s|min|h|[km]?hz|[mkuµ]?v|volts?|[muµk]?a|amp(?:ere)?|[mk]?w|va|k|c|f|℃|"
    r"°[cf]?|deg[cf]?(?:/s)?|%(?:rh)?|rh|ppm|rpm|1/min|rad(?:/s2?)?|[mcµk]?m|m/s(?:\^?2)?|k?g|k?n|"
    r"n·?m|[kmh]?pa|m?bar|psi|ohm|ω|l(?:/min)?|j|k?wh|db[mv]?|mt"
)
_PLAIN_UNITS = {"volt": "V", "volts": "V", "second": "s"} | dict.fromkeys(
    ("no.", "time", "ts", "rn", "sequence", "-"), ""
)
_INCREMENT = re.compile(r"\s*t(?:0|Inc)\s*=\s*(?P<value>[-+.\deE]+)\s*s?\s*")
_LOGGER = re.compile(  # of HOBO
    r"(?:,\s*(?P<unit>[^,()]+?))?\s*\((?:LGR|SEN) S/N.*|,\s*GMT[-+]\d\d:\d\d$"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """Names and units above the rows of a table."""

    names: Sequence[str] = ()
    """Name of each column; () if the file contains no names."""
    units: Sequence[str] = ()
    """Unit of each column, "" if unknown; () if the file contains no units."""
    notes: Sequence[str] = ()
    """Notes about the lines above the rows."""
    decimal: str | None = None
    """Decimal mark that the file states."""


HeadAndRows = tuple[Head, Lines, str]
"""Head, rows, and the separator of their cells."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument:
    """Form of the files of an instrument that the general rule does not read."""

    maker: str
    """Name in messages."""
    beginning: re.Pattern[str]
    """Pattern of the beginning of the file; its group `separator` separates the cells."""
    read: Callable[[Lines, Sequence[list[str]], str], HeadAndRows]
    """Function that returns the head and the rows of the lines and their cells."""


def head_of_instrument(text: str, lines: Lines) -> HeadAndRows | None:
    """Return the head and the rows of a known instrument's file; None for every other text."""
    for known in INSTRUMENTS:
        if (parts := known.beginning.match(text)) is None:
            continue
        separator = parts.groupdict().get("separator", ",")
        try:
            cells = [split(line, separator) for _, line in lines]
            head, rows, separator = known.read(lines, cells, separator)
        except (ValueError, LookupError, StopIteration) as err:
            why = f": {err}" if isinstance(err, FileError) else ""
            raise FileError(f"the header of {known.maker} is damaged{why}; export again") from err
        return (
            replace(head, notes=[f"read as a file of {known.maker}", *head.notes]),
            rows,
            separator,
        )
    return None


def head_of(lines: Lines, separator: str) -> tuple[Head, Lines]:
    """Return the names and units of a table that no known instrument wrote, and its rows."""
    if not lines:
        return Head(), lines
    return _head_below(lines, separator) or _head_at_begin(lines, separator)


def _head(lines: Lines, separator: str, at: int, units: int, begin: int) -> tuple[Head, Lines]:
    """Return the names in line `at`, the units `units` lines below, and the rows from `begin`."""
    names, notes = _names(split(lines[at][1], separator)), list[str]()
    if numbered := [name for name in names if name.isdecimal()]:
        # A number chooses a column by its place.
        names = [f"CH{name}" if name.isdecimal() else name for name in names]
        notes.append(f"line {lines[at][0]}: the name {numbered[0]} is read as CH{numbered[0]}")
    if at:
        notes.append(_left_out(lines[:at], "names"))
    if units:
        notes.append(f"read line {lines[at + units][0]} as units")
    in_units = split(lines[at + units][1], separator) if units else []
    rows, of_names = lines[begin:], lines[at][1]
    if repeated := [k for k, line in rows if line == of_names]:
        above = {line for _, line in lines[:begin]}
        rows = [(k, line) for k, line in rows if line not in above]
        notes.append(f"left out the names that line {repeated[0]} repeats")
    return Head(names=names, units=units_of(in_units), notes=notes), rows


def _names(cells: Sequence[str]) -> list[str]:
    """Return the names in the cells of a line; a separator at its end is not followed by a name."""
    names = [_LOGGER.sub(lambda p: f" [{p['unit']}]" * bool(p["unit"]), c.strip()) for c in cells]
    return names[:-1] if names and not names[-1] else names


def _head_at_begin(lines: Lines, separator: str) -> tuple[Head, Lines]:
    """Return the names in the first line and the units in the second, if they are there."""
    first, last = (split(lines[k][1], separator) for k in (0, min(len(lines), PROBED_LINES) - 1))
    second = split(lines[1][1], separator) if len(lines) > 1 else []
    if not are_names(first, last if second else ()):
        if len(lines) <= 2 or not _are_numbered_names(lines[0][0], first, second, last):
            return Head(), lines
        return _head(lines, separator, 0, 0, 1)
    if not _fit_units(second, first):
        return _head(lines, separator, 0, 0, 1)
    if are_units(second, first) is not False:
        return _head(lines, separator, 0, 1, 2)
    third = split(lines[2][1], separator) if len(lines) > 2 else []
    units = int(_fit_units(third, second) and are_units(third, second) is True)
    return _head(lines, separator, 1, units, 2 + units)


def _are_numbered_names(line: int, cells: Sequence[str], *rows: Sequence[str]) -> bool:
    """Return whether a line with a number contains names, such as `time,1,2`; refuse a doubt."""
    words = [_word_above_value(cells, row) for row in rows]
    if None in words:
        return False
    if str(words[0]).casefold() in {*TIMES, "x-axis"}:  # the latter is of Keysight
        return True
    raise FileError(
        f"line {line}: '{shown(str(words[0]))}' is above numbers, like a name, but next to a "
        "number; name each column by a word, or begin the line with #"
    )


def _head_below(lines: Lines, separator: str) -> tuple[Head, Lines] | None:
    """Return the names and units below other lines, and the rows; None for other tables.

    The longest run of rows with values and equally many cells begins the data. The line above it
    contains the names, or the units of the line above them. No line that is left out resembles a
    row.
    """
    run = longest_run(lines, separator)
    if not run or run[0] == 0:
        return None
    probed, begin = [split(line, separator) for _, line in lines[: run[-1] + 1]], run[0]
    width = len(probed[begin])
    are_closed = all(not probed[k][-1].strip() for k in run)
    allowed = {width, width - 1} if are_closed else {width}
    can_be_names = [
        len(cells) in allowed and any(map(str.strip, cells)) and are_names(cells, probed[begin])
        for cells in probed[:begin]
    ]
    last, units = begin - 1, 0
    names = last if can_be_names[last] else begin
    upper = last - 1 if names == last else last
    # With two columns, a line such as `Scale,0.1` is a fact.
    if upper >= 0 and 2 < len(probed[upper]) in allowed and _has_number(probed[upper]):
        is_above_units = upper == last or are_units(probed[last], probed[upper]) is not False
        if is_above_units and _are_numbered_names(lines[upper][0], probed[upper], probed[begin]):
            names, units = upper, last - upper
    elif names == last > 0 and can_be_names[upper]:
        decision = are_units(probed[last], probed[upper])
        if decision is not False and upper == 0:
            return None
        if decision is None or (decision and not _fit_units(probed[last], probed[upper])):
            raise FileError(
                f"line {lines[upper][0]} or line {lines[last][0]} may contain the names; delete "
                "the other line, or begin it with #"
            )
        units = int(decision)
        names -= units
    is_named = names < begin
    if (names == 0 and not units) or (not is_named and not _is_remark(probed[last])):
        return None
    if any(_resembles(cells, probed[begin]) for cells in probed[:names]):
        return None
    if not is_named:
        head, rows = _head_at_begin(lines[begin:], separator)
        return replace(head, notes=[_left_out(lines[:begin], "first row"), *head.notes]), rows
    return _head(lines, separator, names, units, begin)


def longest_run(lines: Lines, separator: str) -> range:
    """Return the indices of the longest run of rows with values and equally many cells."""
    probed = [split(line, separator) for _, line in lines[:PROBED_LINES]]
    widths = [len(cells) if has_values(cells) else 0 for cells in probed]
    runs, begin = list[range](), 0
    for width, group in groupby(widths):
        end = begin + len(list(group))
        if width:
            is_named = end - begin > 1 and are_names(probed[begin], probed[end - 1])
            runs.append(range(begin + is_named, end))
        begin = end
    # Of equally long runs the last: facts about the file are above its rows.
    return max(reversed(runs), key=len, default=range(0))


def _has_number(cells: Sequence[str]) -> bool:
    """Return whether any of the cells is a number."""
    return any(cell.strip() and number(cell, "") is not None for cell in cells)


def has_values(cells: Sequence[str]) -> bool:
    """Return whether any of the first cells is a number, a quantity, a time or a switch."""
    return any(kind(cell) in _VALUES for cell in cells[:_MAX_PROBED_CELLS])


def are_names(cells: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether cells above a row can be names: no number, and not the values of a row."""
    if _has_number(cells):
        return False
    return not has_values(cells) or _word_above_value(cells, row) is not None


def _word_above_value(cells: Sequence[str], row: Sequence[str]) -> str | None:
    """Return the first word of these cells that is above a value of a row."""
    pairs = zip(cells[:_MAX_PROBED_CELLS], row, strict=False)
    words = (a.strip() for a, b in pairs if kind(a) is Kind.WORD and kind(b) in _VALUES)
    return next(words, None)


def _fit_units(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether the cells can be units: short texts, no values, one for each name."""
    cells, names = (row[:-1] if row and not row[-1].strip() else row for row in (cells, names))
    fits = len(cells) == len(names) and any(map(str.strip, cells))
    fits = fits and all(len(cell.strip()) <= _MAX_UNIT_CHARACTERS for cell in cells)
    return fits and not has_values(cells) and not _has_number(cells)


def are_units(units: Sequence[str], names: Sequence[str]) -> bool | None:
    """Return whether the lower of two lines without values contains units; None if in doubt."""
    words = [cell.strip().strip("[]()").casefold() for cell in units if cell.strip()]
    are_known = 2 * sum(map(bool, map(_KNOWN_UNIT.fullmatch, words))) >= len(words) > 0
    has_times, lower_has_times = (
        bool(TIMES & {titled(cell.strip()).name.casefold() for cell in cells})
        for cells in (names, units)
    )
    if lower_has_times and not has_times:
        return None if are_known else False
    if are_known or has_times:
        return True if are_known or not lower_has_times else None
    return False if len(words) > sum(bool(cell.strip()) for cell in names) else None


def units_of(cells: Sequence[str]) -> list[str]:
    """Return the units in the cells of a line; "" for a word that is no unit."""
    units = [cell.strip().strip("[]()") for cell in cells]
    return [_PLAIN_UNITS.get(unit.casefold(), unit) for unit in units]


def _is_remark(cells: Sequence[str]) -> bool:
    """Return whether a line directly above rows without names is a sentence, or a fact."""
    kinds = {kind(cell) for cell in cells if cell.strip()}
    return Kind.WORD in kinds and (len(cells) == 1 or bool(kinds & _VALUES))


def _resembles(cells: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether a line has the number and the kinds of the cells of a row."""
    pairs = [(kind(a), kind(b)) for a, b in zip(cells[:_MAX_PROBED_CELLS], row, strict=False)]
    known = [(a, b) for a, b in pairs if Kind.MISSING not in (a, b)]
    is_like = all(a is b for a, b in known) and any(a in _VALUES for a, _ in known)
    return is_like and len(cells) == len(row)


def _left_out(lines: Lines, below: str) -> str:
    """Return the note on lines above the names or the first row."""
    first, last = lines[0][0], lines[-1][0]
    which = f"line {first}" if len(lines) == 1 else f"lines {first} to {last}"
    return f"left out {which} above the {below}"


def _with_times(
    head: Head, lines: Lines, cells: Sequence[list[str]], start: str, step: str
) -> HeadAndRows:
    """Return rows in which the first cell, a number of samples, is replaced by a time in s."""
    (t0, dt), mark, width = map(_value, (start, step)), head.decimal or ".", len(head.names)
    rows = []
    for (k, _), row in zip(lines, cells, strict=True):
        time = f"{t0 + dt * _value(row[0]):.12g}".replace(".", mark)
        extra = [cell for cell in row[width:] if cell.strip()]
        rows.append((k, REWRITTEN.join([time, *row[1:width], *extra])))
    note = f"{head.names[0]} is in s: {dt:g} s a sample from {t0:g} s on, by the header"
    units, notes = ["s", *head.units[1:width]], [*head.notes, note]
    return replace(head, units=units, notes=notes, decimal=mark), rows, REWRITTEN


def _rigol_counts(lines: Lines, cells: Sequence[list[str]], _: str) -> HeadAndRows:
    """Return the rows of counts; the second line contains units, the start and the increment."""
    n = cells[0].index("Start")
    head = Head(names=cells[0][:n], units=units_of(cells[1][:n]))
    start, step = cells[1][n : n + 2]
    return _with_times(head, lines[2:], cells[2:], start, step)


def _rigol_t0(lines: Lines, cells: Sequence[list[str]], _: str) -> HeadAndRows:
    """Return the rows of voltages; the first line contains names, the start and the increment."""
    start, step = (p["value"] for name in cells[0] if (p := _INCREMENT.fullmatch(name)))
    names = [name for name in _names(cells[0]) if not _INCREMENT.fullmatch(name)]
    if titled(names[0]).name.casefold() in TIMES:
        short = [REWRITTEN.join(row[: len(names)]) for row in cells[1:]]
        return (
            Head(names=names),
            [(k, row) for (k, _), row in zip(lines[1:], short, strict=True)],
            REWRITTEN,
        )
    counted = [[str(k), *row] for k, row in enumerate(cells[1:])]
    return _with_times(Head(names=["time", *names]), lines[1:], counted, start, step)


def _labview(lines: Lines, cells: Sequence[list[str]], separator: str) -> HeadAndRows:
    """Return the rows below the last header, with a cell for the comment, and with times."""
    ends = [
        k for k, row in enumerate(cells[:_MAX_LABVIEW_LINES]) if row[0] == "***End_of_Header***"
    ]
    at = next(
        k
        for k in (end + 1 for end in ends)
        if has_values(cells[k + 1]) and not _has_number(cells[k])
    )
    facts = {row[0]: [cell.strip() for cell in row[1:] if cell.strip()] for row in cells[:at]}
    head, rows = _head(lines, separator, at, 0, at + 1)
    channels = [name for name in head.names if name not in ("X_Value", "Comment")]
    of_channels = facts.get("Y_Unit_Label", [])
    units = dict(zip(channels, units_of(of_channels), strict=len(of_channels) == len(channels)))
    units["X_Value"] = "s" if facts.get("X_Dimension", ["Time"])[0] == "Time" else ""
    head = replace(
        head,
        units=[units.get(name, "") for name in head.names],
        decimal=facts.get("Decimal_Separator", ["."])[0],
    )
    if head.names[-1] == "Comment":
        few = len(head.names) - 2
        rows = [(k, row + separator * (row.count(separator) == few)) for k, row in rows]
    if facts.get("X_Columns") != ["No"]:
        return head, rows, separator
    (start,), (step,) = set(facts["X0"]), set(facts["Delta_X"])
    counted = [[str(k), *split(row, separator)[1:]] for k, (_, row) in enumerate(rows)]
    return _with_times(head, rows, counted, start, step)


def _tektronix(lines: Lines, cells: Sequence[list[str]], _: str) -> HeadAndRows:
    """Return the times and values in columns 4 and 5; the facts are in columns 1 to 3."""
    facts = {row[0].strip(): row[1].strip() for row in reversed(cells) if row[0].strip()}
    rows = [
        (k, REWRITTEN.join(map(str.strip, row[3:5] if not any(row[5:]) else row)))
        for (k, _), row in zip(lines, cells, strict=True)
    ]
    units = units_of([facts.get("Horizontal Units", "s"), facts.get("Vertical Units", "")])
    return Head(names=["time", facts["Source"]], units=units), rows, REWRITTEN


def _campbell(lines: Lines, _: Sequence[list[str]], separator: str) -> HeadAndRows:
    """Return the rows below the names, the units, and the line of processing."""
    return *_head(lines, separator, 1, 1, 4), separator


def _value(cell: str) -> float:
    """Return a number that is part of a time."""
    if (value := number(cell, "")) is None:
        raise FileError(f"'{shown(cell)}' is not a number")
    return value


INSTRUMENTS = (
    Instrument(
        maker="LabVIEW",
        beginning=re.compile(r"LabVIEW Measurement(?P<separator>[\t,;])"),
        read=_labview,
    ),
    Instrument(
        maker="Rigol",
        beginning=re.compile(r"X,.*,Start,Increment\b.*\n\s*Sequence,"),
        read=_rigol_counts,
    ),
    Instrument(
        maker="Rigol", beginning=re.compile(r".*\bt0\s*=[^,\n]*,\s*tInc\s*="), read=_rigol_t0
    ),
    Instrument(
        maker="Tektronix",
        beginning=re.compile(r"Record Length,[^,\n]*,[^,\n]*(?:,[-+ .\deE]+){2}"),
        read=_tektronix,
    ),
    Instrument(maker="Campbell", beginning=re.compile(r'"?TOA5\b'), read=_campbell),
)
"""Instruments by the beginning of their files.

The general rule reads the files of TekScope, Keysight, Siglent, Graphtec, HOBO, PicoScope, Saleae.
"""
