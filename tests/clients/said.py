"""Output of commands, as text that a person reads, and its comparison with a stored text.

A line `$ armrig …` or `$ armrigd …` is a command, `>>> …` a line of Python. Below it are standard
output (after two blanks), standard error (`! `), the exit code if it is not 0, and the written
files (`+ `). The text of a file is shown after a command: the first lines, or all if the file is
named whole. JSON is a line for each value, short object, or table of numbers. The first help of a
file is as printed. Of the others a paragraph and an option are one line each, and an option that an
earlier help describes alike is named only.
"""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import sys
from code import InteractiveInterpreter
from collections.abc import Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from difflib import SequenceMatcher, unified_diff
from importlib.metadata import version
from pathlib import Path
from traceback import format_exception_only
from typing import Any

import pytest
from armrig.cli import main
from armrig_daemon.command_line import app as armrigd

WITHIN = 1e-3
"""Share by which a number may differ from the stored one; a whole number may not."""
_TINY = 1e-9  # two numbers that are smaller are rounding
_NUMBER = re.compile(r" *(?<![\w.])[-+−]?\d+(?:\.\d+)*(?:e[-+]?\d+)? *")
_SHOWN, _ITEMS, _LINES, _WIDEST = ("  ", "! ", "+ ", "exit "), 8, 20, 200
_OTHERS = (  # of another machine, day or version
    (re.compile(rf"(?<![\w.]){re.escape(version('armrig'))}(?!\.?\w)"), "VERSION"),
    (re.compile(r"(?<![\w.])(?:[0-9a-f]{12}|(?=\w*[a-f])[0-9a-f]{13,64})(?![\w-]|\.\w)"), "HASH"),
    (re.compile(r"(imported-[a-z0-9-]+?)-\d{8}T\d{6}-[0-9a-f]{8}"), r"\1-TIME-RUN"),
    (re.compile(r"━ 100% \d\d:\d\d"), "━ 100%"),
    (re.compile(r"(bytes|_offset_ns|modified_ns): \d+"), r"\1: …"),
    (re.compile(r"\b20[2-9]\d-\d\d-\d\d([T ]\d\d:\d\d[\d:.]*(Z|[-+]\d\d:\d\d)?)?"), "DATE"),
)


def said_again(stored: str, folder: Path) -> str:
    """Return a text with what its commands print now, run one after the other in `folder`.

    A line of which only the last digits are others is left as it is stored.
    """
    python, lines, shown = _Python({}), list[str](), set[str]()
    for line in stored.splitlines():
        if line.startswith(("$ ", ">>> ")):
            found = _printed(line, python, folder)
            lines += [line, *(_help([*found], shown) if line.endswith("--help") else found)]
        elif not line.startswith(_SHOWN):  # a remark
            lines.append(line)
    return "\n".join(_rounded_as(stored.splitlines(), lines)) + "\n"


def assert_said(file: Path, folder: Path) -> None:
    """Compare a stored text with what its commands print now, run in a folder."""
    with chdir(folder):
        compare(file, said_again(file.read_text(encoding="utf-8"), folder))


def compare(file: Path, found: str) -> None:
    """Fail where a stored text is another than the one found; or store that (`WRITE_STORED`)."""
    stored = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    lines = _rounded_as(stored, found.splitlines())
    if os.environ.get("WRITE_STORED"):
        file.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return
    differs = unified_diff(stored, lines, f"{file.name}, stored", "now", n=2, lineterm="")
    if shown := "\n".join(differs):
        pytest.fail(f"{shown}\n\nIf it is to be said so: make stored", pytrace=False)


class _Python(InteractiveInterpreter):
    def showtraceback(self) -> None:
        print(*format_exception_only(sys.exc_info()[1]), end="", file=sys.stderr)


def _printed(line: str, python: _Python, folder: Path) -> Iterator[str]:
    before, out, err = _files(folder), io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = _code(line, python)
    yield from ("  " + x for x in _lines(out.getvalue(), folder))
    yield from ("! " + x for x in _lines(err.getvalue(), folder))
    yield from [f"exit {code}"] if code else []
    for path, text in sorted(_files(folder).items()):
        if before.get(path) != text:
            yield from (f"+ {x}" for x in _lines(str(path.relative_to(folder)), folder))
            if line.startswith("$ ") and not text.startswith(b"-----BEGIN"):
                with suppress(UnicodeDecodeError):
                    if path.stem == "whole":
                        yield from ("+   " + x for x in _lines(text.decode(), folder, whole=True))
                    else:
                        yield from ("+   " + x for x in _lines(text.decode(), folder)[:_LINES])


def _help(found: list[str], shown: set[str]) -> Iterator[str]:
    """Yield the lines of a help; a later one has a line for each paragraph and each new option."""
    entries = [*_entries(found)]
    if not shown:
        shown.update(text for text, is_option in entries if is_option)
        yield from found
        return
    again: list[str] = []
    for text, is_option in [*entries, ("", False)]:
        if again and not is_option:
            yield f"    as above: {' '.join(again)}"
            again.clear()
        if is_option and text in shown and (name := re.match(r" *((?:-\w, )?[-\w…|]+)", text)):
            again.append(name[1])
        elif text:
            yield text
        shown.update([text] if is_option else [])


def _entries(found: list[str]) -> Iterator[tuple[str, bool]]:
    """Yield each paragraph, heading and option in one line, and whether it is an option."""
    entry, in_list = "", False
    for line in [*found, ""]:
        depth = len(line) - len(line.lstrip())
        if entry and line.strip() and (depth > 4 or (depth == 4 and not in_list)):
            entry += f" {line.strip()}"
            continue
        if entry:
            is_option = in_list and entry.startswith("    ") and "  " in entry.strip()
            yield re.sub(r"(?<=\S) {2,}", "  ", entry), is_option
        entry = line.rstrip()
        if depth == 2:
            in_list = entry.endswith(":")


def _code(line: str, python: _Python) -> int:
    if line.startswith(">>> "):
        python.runsource(line.removeprefix(">>> "))
        return 0
    _, program, *words = shlex.split(line)
    if program == "armrig":
        return main(words)
    try:
        armrigd(words, prog_name=program)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def _files(folder: Path) -> dict[Path, bytes]:
    every = (p for p in folder.rglob("*") if p.is_file() and ".home" not in p.parts)
    return {path: path.read_bytes() for path in every}


def _lines(text: str, folder: Path, *, whole: bool = False) -> list[str]:
    """Return lines without what differs on another machine or day."""
    if text.startswith(("{", "[")):
        with suppress(ValueError):
            value = json.loads(text)
            text = "\n".join(_words(value) if whole else _values(value))
    text = text.replace(str(folder.resolve()), "HERE")
    if sockets := os.environ.get("XDG_RUNTIME_DIR"):
        text = text.replace(sockets, "SOCKETS")
    for pattern, name in _OTHERS:
        text = pattern.sub(name, text)
    return [line.rstrip() for line in text.splitlines()]


def _values(value: Any, name: str = "") -> Iterator[str]:
    if isinstance(value, dict) and value and not (name and _is_row(value)):
        for key, item in value.items():
            yield from _values(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and not _is_plain(value) and not _is_table(value):
        n = 2 if isinstance(value[0], dict) and not _is_row(value[0]) else _ITEMS
        for i, item in enumerate(value[:n]):
            yield from _values(item, f"{name}[{i}]")
        yield from [f"{name}: {len(value)} rows"] if len(value) > n else []
    else:
        yield f"{name}: {_value(value)}"


def _is_row(value: dict[str, Any]) -> bool:
    """Return whether an object is short and without parts."""
    return all(map(_is_plain, value.values())) and len(_value(value)) <= _WIDEST


def _is_plain(value: Any) -> bool:
    """Return whether a value has no parts, or is a list of such values."""
    items = value if isinstance(value, list) else [value]
    return not any(isinstance(x, (dict, list)) for x in items)


def _is_table(value: Any) -> bool:
    """Return whether a list contains numbers only, at any depth."""
    if isinstance(value, list):
        return bool(value) and all(map(_is_table, value))
    return value is None or isinstance(value, (int, float))


def _words(value: Any, name: str = "") -> Iterator[str]:
    """Yield every value that has a text; texts in a row share a line."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _words(item, key)
    elif isinstance(value, list) and any(isinstance(x, (dict, list)) for x in value):
        for item in value:
            yield from _words(item, name)
    elif value:
        yield f"{name}: {' | '.join(map(str, value)) if isinstance(value, list) else value}"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_value(item)}" for key, item in value.items()) or "{}"
    if isinstance(value, list):
        n = _ITEMS if _is_plain(value) else max(2, _ITEMS // max(len(value[0]), 1))
        more = f" … {len(value)} values" if len(value) > n else ""
        return f"[{', '.join(map(_value, value[:n]))}]{more}"
    return f"{value:.6g}" if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


def _rounded_as(stored: list[str], found: list[str]) -> list[str]:
    """Return the lines found, a stored one in place of each that differs in last digits alone."""
    words = [[_NUMBER.sub("#", line) for line in lines] for lines in (stored, found)]
    for i, j, n in SequenceMatcher(None, *words, autojunk=False).get_matching_blocks():
        for k in range(n):
            pairs = zip(*map(_NUMBER.findall, (stored[i + k], found[j + k])), strict=True)
            if all(a == b or _is_close(a, b) for a, b in pairs):
                found[j + k] = stored[i + k]
    return found


def _is_close(a: str, b: str) -> bool:
    """Return whether two numbers are alike and end in the same column."""
    if len(a) != len(b) and a.replace(a.strip(), "#") != b.replace(b.strip(), "#"):
        return False
    if a.strip().isdecimal() and b.strip().isdecimal():
        return a.strip() == b.strip()
    with suppress(ValueError):  # a version is no number
        x, y = (float(text.strip().replace("−", "-")) for text in (a, b))
        return abs(x - y) <= max(WITHIN * abs(x), _TINY)
    return False
