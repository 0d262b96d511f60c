"""The tables of a TOML that anybody may have written."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from armrig_core.bounded import read_text
from armrig_core.errors import FileError

_DEEPEST, _MOST_LEVELS = 16, 64
# The reader's time grows with the square of the depth, and what it returns cannot be printed.
_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_TOO_DEEP = re.compile(rf"(?:{_PART}[ \t]*\.[ \t]*){{{_DEEPEST}}}{_PART}")


def read_toml(path: Path, most: int) -> dict[str, Any]:
    """Return the tables of a regular file of at most so many bytes.

    Raises
    ------
    FileError
        It is no TOML, is saved in another encoding than UTF-8, or is nested too deeply.
    OSError
        It cannot be read, or is too long.
    """
    return toml_tables(read_text(path, most))


def toml_tables(text: str) -> dict[str, Any]:
    """Return the tables of a text.

    Raises
    ------
    FileError
        It is no TOML, or is nested too deeply.
    """
    if _TOO_DEEP.search(text):
        raise FileError(f"nested too deeply: a key has at most {_DEEPEST} parts")
    try:
        tables = tomllib.loads(text)
    except RecursionError as err:
        raise FileError("nested too deeply") from err
    except ValueError as err:  # TOMLDecodeError is one
        raise FileError(f"not a TOML file: {err}") from err
    _check_depth(tables)
    return tables


def _check_depth(tables: dict[str, Any]) -> None:
    """Refuse tables and lists so deep in each other that nothing can walk or print them."""
    level: list[Any] = [tables]
    for _ in range(_MOST_LEVELS):
        inner = [x.values() if isinstance(x, dict) else x for x in level]
        level = [x for values in inner for x in values if isinstance(x, dict | list)]
        if not level:
            return
    raise FileError(f"nested too deeply: at most {_MOST_LEVELS} levels are read")
