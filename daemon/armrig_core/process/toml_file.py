"""Tables of a TOML file from an untrusted source."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from armrig_core.errors import FileError
from armrig_core.process.bounded import read_text

_MAX_KEY_PARTS, _MAX_LEVELS = 16, 64
# The reader's time grows with the square of the depth, and a deeply nested result cannot be
# printed.
_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(rf"(?:{_PART}[ \t]*\.[ \t]*){{{_MAX_KEY_PARTS}}}{_PART}")


def read_toml(path: Path, most: int) -> dict[str, Any]:
    """Return the tables of a TOML file; the file may have at most `most` bytes.

    Raises
    ------
    FileError
        The file is not TOML, is not encoded as UTF-8, or is nested too deeply.
    OSError
        The file cannot be read, or is too long.
    """
    return toml_tables(read_text(path, most))


def toml_tables(text: str) -> dict[str, Any]:
    """Return the tables in a TOML text.

    Raises
    ------
    FileError
        The text is not TOML, or is nested too deeply.
    """
    if _DEEP_KEY.search(text):
        raise FileError(f"nested too deeply: a key has at most {_MAX_KEY_PARTS} parts")
    try:
        tables = tomllib.loads(text)
    except RecursionError as err:
        raise FileError("nested too deeply") from err
    except ValueError as err:  # such as TOMLDecodeError
        raise FileError(f"not a TOML file: {err}") from err
    _check_depth(tables)
    return tables


def _check_depth(tables: dict[str, Any]) -> None:
    """Refuse tables and lists that are nested too deeply to be walked or printed."""
    level: list[Any] = [tables]
    for _ in range(_MAX_LEVELS):
        inner = [x.values() if isinstance(x, dict) else x for x in level]
        level = [x for values in inner for x in values if isinstance(x, dict | list)]
        if not level:
            return
    raise FileError(f"nested too deeply: at most {_MAX_LEVELS} levels are read")
